"""DROID-SLAM's networks as ONNX graphs: our own definition.

Six graphs; correlation, its look-up, motion filter and geometry are Plumbline's:

- `features`:  picture -> feature map at 1/8;
- `context`:   picture -> hidden state and context at the first use of a frame;
- `gates`:     context -> its share of the update's gates, which no update changes: once per frame;
- `update`:    per edge: hidden state, gates' share of the source, correlation, motion -> hidden state,
  change of the target, weight;
- `aggregate`: new hidden states and a matrix of averages over the edges of one source -> damping of
  its inverse depths, and what `upsample` takes;
- `upsample`:  -> weights of the convex up-sampling of disparities.

`update` followed by `aggregate` is the reference's update with aggregation. Apart, edges may be updated in
batches of any size, and no weight is stored twice. Pictures are RGB, normalised by ImageNet's mean and
deviation, sides multiples of 8. Changes and motions are x, y in cells of the 1/8 grid.
"""

import numpy as np

from graph import Graph, WeightsError
from residual import layer
from winograd import CHANNELS, Tiles

WIDTH = 32  # of the encoders' first layer
HIDDEN = 128
CORRELATIONS = 4 * 49
STRIDES = (1, 2, 2)
# The file's heads have three outputs, of which the reference keeps the first two.
HEADS = ("update.weight.2", "update.delta.2")
EDGES, SOURCES, ROWS, COLUMNS = "edges", "sources", "rows", "columns"


def state_dict(tensors):
    """The published file's tensors under the names used here: without its `module.` prefix, with two
    outputs per head."""
    prefixed = [key.startswith("module.") for key in tensors]
    if any(prefixed) and not all(prefixed):
        raise WeightsError("some keys begin with module. and some do not: this is no DROID checkpoint")
    named = {key.removeprefix("module."): value for key, value in tensors.items()}
    if "update.gru.convz.weight" not in named:
        raise WeightsError("this is no DROID-SLAM: update.gru.convz.weight is missing")
    for head in HEADS:
        for part in ("weight", "bias"):
            value = named.get(f"{head}.{part}")
            if value is not None and value.ndim and value.shape[0] == 3:
                named[f"{head}.{part}"] = value[:2]
    return named


def _encoder(g, x, key, channels_out, norm=None):
    x = g.conv(x, f"{key}.conv1", 3, WIDTH, 7, 2)
    x = g.relu(g.instance_norm(x, WIDTH) if norm else x)
    before = WIDTH
    for number, stride in enumerate(STRIDES, 1):
        width = WIDTH << (number - 1)
        # Convolutions of the first layer's few channels are no quicker in tiles.
        x = layer(g, x, f"{key}.layer{number}", before, width, 2, stride, norm, tiled=number > 1)
        before = width
    return g.conv(x, f"{key}.conv2", before, channels_out, 1)


def features(weights):
    g = Graph("features", weights)
    x = g.input("picture", ["pictures", 3, "height", "width"])
    x = _encoder(g, x, "fnet", HIDDEN, norm="instance")
    g.output("features", x, ["pictures", HIDDEN, ROWS, COLUMNS])
    return g


def context(weights):
    g = Graph("context", weights)
    x = g.input("picture", ["pictures", 3, "height", "width"])
    x = _encoder(g, x, "cnet", 2 * HIDDEN)
    net, held = g.channels(x, 0, HIDDEN), g.channels(x, HIDDEN, 2 * HIDDEN)
    g.output("net", g.tanh(net), ["pictures", HIDDEN, ROWS, COLUMNS])
    g.output("context", g.relu(held), ["pictures", HIDDEN, ROWS, COLUMNS])
    return g


# The gated unit's inputs, in the order of its weights: hidden state, context, correlation, motion.
INNER = HIDDEN + HIDDEN + 128 + 64
CONTEXT_PART = slice(HIDDEN, 2 * HIDDEN)


def _gate_weights(g, names, of_context):
    """The 3x3 kernels of gates, one after the other, for the context's channels or for all others."""
    taken = []
    for name in names:
        whole = g.weights.take(f"update.gru.{name}.weight", (HIDDEN, INNER, 3, 3))
        taken.append(whole[:, CONTEXT_PART] if of_context else np.delete(whole, CONTEXT_PART, axis=1))
    return np.concatenate(taken)


def gates(weights):
    """The context's share of the gated unit: it is the same in every update of every edge of a source."""
    g = Graph("gates", weights)
    held = g.input("context", ["pictures", HIDDEN, ROWS, COLUMNS])
    names = ("convz", "convr", "convq")
    bias = np.concatenate([g.weights.take(f"update.gru.{name}.bias", (HIDDEN,)) for name in names])
    weight = _gate_weights(g, names, of_context=True)
    x = Tiles(g, held).conv_plain(held, "update.gru.context", weight, bias)
    g.output("gates", x, ["pictures", 3 * HIDDEN, ROWS, COLUMNS])
    return g


def _gru(g, tiles, h, of_context, x):
    """The gated unit with a global context: h' = (1 - z) h + z q. `of_context` is what `gates` gives; `x`
    and h' are in tiles."""
    key = "update.gru"
    gate = g.sigmoid(g.conv(h, f"{key}.w", HIDDEN, HIDDEN, 1))
    mean = g.node("GlobalAveragePool", [g.mul(gate, h)])
    h = tiles.split(h, HIDDEN)

    def gated(inputs, names, first):
        """What enters the gates of these names, of which `first` stand before in `gates`."""
        everywhere = [g.conv(mean, f"{key}.{name}_glo", HIDDEN, HIDDEN, 1) for name in names]
        everywhere = g.concat(*everywhere) if len(names) > 1 else everywhere[0]
        own = g.channels(of_context, first * HIDDEN, (first + len(names)) * HIDDEN)
        own = tiles.split(g.add(own, everywhere), len(names) * HIDDEN)
        inputs = g.node("Concat", inputs, axis=CHANNELS)
        weight = _gate_weights(g, names, of_context=False)
        return g.add(tiles.conv(inputs, f"{key}.{'+'.join(names)}", weight, None), own)

    def part(x, first):
        bounds = (g.constant(f"index_{n}", np.array([n], np.int64)) for n in (first, first + HIDDEN, CHANNELS))
        return g.node("Slice", [x, *bounds])

    zr = g.sigmoid(gated([h, x], ("convz", "convr"), 0))
    z, r = part(zr, 0), part(zr, HIDDEN)
    q = g.tanh(gated([g.mul(r, h), x], ("convq",), 2))
    # h + z (q - h), which is the same.
    return tiles.clear(g.add(h, g.mul(z, g.node("Sub", [q, h]))))


def _head(g, tiles, net, key):
    x = tiles.conv(net, f"{key}.0", *g.kernel(f"{key}.0", HIDDEN, HIDDEN))
    return g.conv(tiles.join(g.relu(x), HIDDEN), f"{key}.2", HIDDEN, 2, 3)


def update(weights):
    g = Graph("update", weights)
    net = g.input("net", [EDGES, HIDDEN, ROWS, COLUMNS])
    of_context = g.input("gates", [EDGES, 3 * HIDDEN, ROWS, COLUMNS])
    correlation = g.input("correlation", [EDGES, CORRELATIONS, ROWS, COLUMNS])
    motion = g.input("motion", [EDGES, 4, ROWS, COLUMNS])
    tiles = Tiles(g, net)

    def conv(x, key, width):
        x = tiles.conv(tiles.split(x, HIDDEN), key, *g.kernel(key, HIDDEN, width))
        return tiles.clear(g.relu(x))

    c = g.relu(g.conv(correlation, "update.corr_encoder.0", CORRELATIONS, HIDDEN, 1))
    c = conv(c, "update.corr_encoder.2", HIDDEN)
    f = g.relu(g.conv(motion, "update.flow_encoder.0", 4, HIDDEN, 7))
    f = conv(f, "update.flow_encoder.2", HIDDEN // 2)
    net = _gru(g, tiles, net, of_context, g.node("Concat", [c, f], axis=CHANNELS))
    g.output("next_net", tiles.join(net, HIDDEN), [EDGES, HIDDEN, ROWS, COLUMNS])
    g.output("target_change", _head(g, tiles, net, "update.delta"), [EDGES, 2, ROWS, COLUMNS])
    g.output("weight", g.sigmoid(_head(g, tiles, net, "update.weight")), [EDGES, 2, ROWS, COLUMNS])
    return g


def aggregate(weights):
    g = Graph("aggregate", weights)
    net = g.input("net", [EDGES, HIDDEN, ROWS, COLUMNS])
    # averages[s, e] = 1 / (edges of source s) where e is one of them, else 0.
    averages = g.input("averages", [SOURCES, EDGES])
    # All edges of a source at once, some 16: tiles would be quicker, but take half a gigabyte.
    a = g.relu(g.conv(net, "update.agg.conv1", HIDDEN, HIDDEN, 3))
    flat = g.node("Flatten", [a], axis=1)
    mean = g.node("MatMul", [averages, flat])
    # One source per row, in the shape of a feature map again.
    size = g.node("Shape", [a], start=1)
    leading = g.constant("minus_one", np.array([-1], np.int64))
    a = g.node("Reshape", [mean, g.node("Concat", [leading, size], axis=0)])
    a = g.relu(g.conv(a, "update.agg.conv2", HIDDEN, HIDDEN, 3))
    g.output("aggregate", a, [SOURCES, HIDDEN, ROWS, COLUMNS])
    eta = g.node("Softplus", [g.conv(a, "update.agg.eta.0", HIDDEN, 1, 3)])
    scale = g.constant("hundredth", np.array(0.01, np.float32))
    g.output("damping", g.mul(eta, scale), [SOURCES, 1, ROWS, COLUMNS])
    return g


def upsample(weights):
    g = Graph("upsample", weights)
    x = g.input("aggregate", [SOURCES, HIDDEN, ROWS, COLUMNS])
    x = g.conv(x, "update.agg.upmask.0", HIDDEN, 576, 1)
    g.output("logits", x, [SOURCES, 576, ROWS, COLUMNS])
    return g


def graphs(weights):
    """All graphs; asks for every weight of the network."""
    return [part(weights) for part in (features, context, gates, update, aggregate, upsample)]
