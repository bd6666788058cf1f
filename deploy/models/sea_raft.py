"""SEA-RAFT as ONNX graphs: our own definition of its networks.

Four graphs; what lies between them (correlation, its look-up, convex up-sampling, padding) is Plumbline's:

- `features`: picture -> feature map at 1/8, run on each picture once;
- `context`:  picture pair -> hidden state, context, first flow and its uncertainty;
- `update`:   hidden state, context, correlation, flow -> hidden state, change of the flow, uncertainty;
- `upsample`: hidden state -> weights of the convex up-sampling (already times 0.25).

Pictures are RGB in [-1, 1], sides multiples of 8. Flows are x, y in pixels of the 1/8 grid. The uncertainty's
four channels are two mixture logits and two raw logarithms of scales.
"""

import dataclasses
import re

import numpy as np

from graph import Graph, WeightsError
from residual import layer
from winograd import CHANNELS, Tiles

LEVELS = 4
STRIDES = (1, 2, 2)
PAIR, ROWS, COLUMNS = "pairs", "rows", "columns"


@dataclasses.dataclass(frozen=True)
class Configuration:
    """What the weights' shapes tell."""

    initial_width: int
    widths: tuple
    blocks: tuple  # residual blocks of each of the backbone's three layers
    width: int  # of the hidden state
    radius: int  # of the correlation window, cells
    refinements: int  # blocks of the update

    @property
    def correlations(self):
        return LEVELS * (2 * self.radius + 1) ** 2


SMALL = Configuration(64, (64, 128, 256), (2, 2, 2), 128, 4, 2)
MEDIUM = Configuration(64, (64, 128, 256), (3, 4, 6), 128, 4, 2)
# The published sizes; L is M with more iterations.
SIZES = {"S": (SMALL, 4), "M": (MEDIUM, 4), "L": (MEDIUM, 12)}


def configuration(tensors):
    """Reads the configuration off a state dict's shapes."""

    def shape(key, rank):
        if key not in tensors or tensors[key].ndim != rank:
            raise WeightsError(f"this is no SEA-RAFT: {key} is missing or of another rank")
        return tensors[key].shape

    def count(pattern):
        found = {int(match[1]) for key in tensors if (match := re.match(pattern, key))}
        if not found or found != set(range(len(found))):
            raise WeightsError(f"this is no SEA-RAFT: no keys like {pattern}")
        return len(found)

    width = shape("flow_head.0.weight", 4)[1]
    taps = shape("update_block.encoder.convc1.weight", 4)[1] // LEVELS
    radius = (round(taps**0.5) - 1) // 2
    return Configuration(
        initial_width=shape("fnet.conv1.weight", 4)[0],
        widths=tuple(shape(f"fnet.layer{n}.0.conv1.weight", 4)[0] for n in (1, 2, 3)),
        blocks=tuple(count(rf"fnet\.layer{n}\.(\d+)\.") for n in (1, 2, 3)),
        width=width,
        radius=radius,
        refinements=count(r"update_block\.refine\.(\d+)\."),
    )


def _backbone(g, c, x, key, channels):
    x = g.conv(x, f"{key}.conv1", channels, c.initial_width, 7, 2)
    x = g.relu(g.batch_norm(x, f"{key}.bn1", c.initial_width))
    before = c.initial_width
    for number, (width, blocks, stride) in enumerate(zip(c.widths, c.blocks, STRIDES), 1):
        x = layer(g, x, f"{key}.layer{number}", before, width, blocks, stride, norm="batch")
        before = width
    return g.conv(x, f"{key}.final_conv", before, 2 * c.width, 1)


def _conv(g, tiles, x, key, width_in, width):
    """A 3x3 convolution in tiles."""
    return tiles.conv(x, key, *g.kernel(key, width_in, width))


def _flow_head(g, c, tiles, net):
    """Flow (or its change) and uncertainty, of a hidden state in tiles."""
    y = tiles.join(g.relu(_conv(g, tiles, net, "flow_head.0", c.width, 2 * c.width)), 2 * c.width)
    y = g.conv(y, "flow_head.2", 2 * c.width, 6, 3)
    return g.channels(y, 0, 2), g.channels(y, 2, 6)


def features(c, weights):
    g = Graph("features", weights)
    x = g.input("picture", ["pictures", 3, "height", "width"])
    g.output("features", _backbone(g, c, x, "fnet", 3), ["pictures", 2 * c.width, ROWS, COLUMNS])
    return g


def context(c, weights):
    g = Graph("context", weights)
    x = _backbone(g, c, g.input("pair", [PAIR, 6, "height", "width"]), "cnet", 6)
    tiles = Tiles(g, x)
    x = tiles.conv_plain(x, "init_conv", *g.kernel("init_conv", 2 * c.width, 2 * c.width))
    net = g.channels(x, 0, c.width)
    flow, uncertainty = _flow_head(g, c, tiles, tiles.split(net, c.width))
    g.output("net", net, [PAIR, c.width, ROWS, COLUMNS])
    g.output("context", g.channels(x, c.width, 2 * c.width), [PAIR, c.width, ROWS, COLUMNS])
    g.output("flow", flow, [PAIR, 2, ROWS, COLUMNS])
    g.output("uncertainty", uncertainty, [PAIR, 4, ROWS, COLUMNS])
    return g


def _motion(g, c, tiles, correlation, flow):
    """The motion encoder."""
    key, width = "update_block.encoder", c.width
    x = g.relu(g.conv(correlation, f"{key}.convc1", c.correlations, 2 * width, 1))
    x = g.relu(_conv(g, tiles, tiles.split(x, 2 * width), f"{key}.convc2", 2 * width, 3 * width // 2))
    f = g.relu(g.conv(flow, f"{key}.convf1", 2, width, 7))
    f = g.relu(_conv(g, tiles, tiles.split(f, width), f"{key}.convf2", width, width // 2))
    both = tiles.clear(g.node("Concat", [x, f], axis=CHANNELS))
    m = g.relu(_conv(g, tiles, both, f"{key}.conv", 2 * width, width - 2))
    return g.concat(tiles.join(m, width - 2), flow)


def _refine(g, c, x, key):
    """One ConvNeXt block; its skip is before the last 1x1."""
    wide = 3 * c.width
    y = g.conv(x, f"{key}.dwconv", wide, wide, 7, groups=wide)
    y = g.node("Transpose", [y], perm=[0, 2, 3, 1])
    scale, shift = g.weight(f"{key}.norm.weight", (wide,)), g.weight(f"{key}.norm.bias", (wide,))
    y = g.node("LayerNormalization", [y, scale, shift], axis=-1, epsilon=1e-6)
    y = g.node("Gelu", [g.linear(y, f"{key}.pwconv1", wide, 4 * c.width)])
    y = g.linear(y, f"{key}.pwconv2", 4 * c.width, wide)
    y = g.mul(y, g.weight(f"{key}.gamma", (wide,)))
    y = g.node("Transpose", [y], perm=[0, 3, 1, 2])
    return g.conv(g.add(x, y), f"{key}.final", wide, c.width, 1)


def update(c, weights):
    g = Graph("update", weights)
    net = g.input("net", [PAIR, c.width, ROWS, COLUMNS])
    held = g.input("context", [PAIR, c.width, ROWS, COLUMNS])
    correlation = g.input("correlation", [PAIR, c.correlations, ROWS, COLUMNS])
    flow = g.input("flow", [PAIR, 2, ROWS, COLUMNS])
    tiles = Tiles(g, flow)
    motion = _motion(g, c, tiles, correlation, flow)
    for block in range(c.refinements):
        net = _refine(g, c, g.concat(net, held, motion), f"update_block.refine.{block}")
    change, uncertainty = _flow_head(g, c, tiles, tiles.split(net, c.width))
    g.output("next_net", net, [PAIR, c.width, ROWS, COLUMNS])
    g.output("flow_change", change, [PAIR, 2, ROWS, COLUMNS])
    g.output("uncertainty", uncertainty, [PAIR, 4, ROWS, COLUMNS])
    return g


def upsample(c, weights):
    g = Graph("upsample", weights)
    x = g.input("net", [PAIR, c.width, ROWS, COLUMNS])
    first = "upsample_weight.0"
    x = g.relu(Tiles(g, x).conv_plain(x, first, *g.kernel(first, c.width, 2 * c.width)))
    x = g.conv(x, "upsample_weight.2", 2 * c.width, 576, 1)
    x = g.mul(x, g.constant("quarter", np.array(0.25, np.float32)))
    g.output("logits", x, [PAIR, 576, ROWS, COLUMNS])
    return g


def graphs(c, weights):
    """All graphs; asks for every weight of the network."""
    return [part(c, weights) for part in (features, context, update, upsample)]
