"""3x3 convolutions of stride 1 by Winograd's minimal filtering F(4x4, 3x3), in operations that ONNX has.

Four outputs of a row need six products where a plain convolution takes twelve, hence sixteen of a tile 36
where it takes 144: the sums over channels, nearly all of the work, become 36 matrix products of a quarter of
the multiplications (Lavin & Gray, "Fast Algorithms for Convolutional Neural Networks", 2015). A map stays in
tiles (`Tiles.split`) through convolutions and whatever is done value by value, and is joined at the end.

The six points at which polynomials are evaluated are 0, +-sqrt(1/2), +-sqrt(2) and infinity: in float32
the result is off by twice the rounding of a plain convolution (the usual 0, +-1, +-2: by four times).
"""

import numpy as np

TILE = 4
POINTS = (0.0, 0.5**0.5, -(0.5**0.5), 2**0.5, -(2**0.5))
SAMPLES = len(POINTS) + 1  # of a tile along one axis; the last is at infinity
ROWS, COLUMNS, CHANNELS = 1, 2, 3  # axes of a split map: [items, 4, 4, channels, tiles down, tiles across]


def transforms(tile=TILE, points=POINTS, taps=3):
    """(of a tile's inputs [6, 6], of a kernel [6, 3], to a tile's outputs [4, 6]) along one axis, by Toom
    and Cook: polynomials are evaluated at the points, multiplied there, and interpolated."""
    samples = len(points) + 1
    inputs, kernel = np.zeros((samples, samples)), np.zeros((samples, taps))
    outputs = np.zeros((tile, samples))
    for n, point in enumerate(points):
        others = [other for m, other in enumerate(points) if m != n]
        inputs[n, :-1] = np.poly(others)[::-1]
        kernel[n] = point ** np.arange(taps) / np.prod([point - other for other in others])
        outputs[:, n] = point ** np.arange(tile)
    inputs[-1] = np.poly(points)[::-1]
    kernel[-1, -1] = outputs[-1, -1] = 1
    return inputs, kernel, outputs


INPUTS, KERNEL, OUTPUTS = transforms()


class Tiles:
    """The tiles of maps of one size in a graph, that of the tensor `like` [items, channels, rows, columns]
    (sizes are known at run time; the last tiles are filled up with zeros)."""

    def __init__(self, graph, like):
        g = self.graph = graph
        self.size = g.node("Shape", [like], start=2)
        tile = g.constant("tile", np.array([TILE, TILE], np.int64))
        missing = g.node("Mod", [g.node("Neg", [self.size]), tile])
        self.pads = g.node("Concat", [_integers(g, [0] * 6), missing], axis=0)
        self.count = g.node("Div", [g.node("Add", [self.size, missing]), tile])
        ones_shape = g.node("Concat", [_integers(g, [1, 1]), self.size], axis=0)
        ones = g.node("Expand", [g.constant("one_value", np.ones(1, np.float32)), ones_shape])
        self.inside = self.split(ones, 1)

    def _shaped(self, x, *leading):
        """`x` in the shape `leading`, tiles down, tiles across; 0 keeps a size."""
        g = self.graph
        shape = g.node("Concat", [_integers(g, leading), self.count], axis=0)
        return g.node("Reshape", [x, shape])

    def split(self, x, channels):
        """A map [items, channels, rows, columns] in tiles."""
        padded = self.graph.node("Pad", [x, self.pads])
        phases = self.graph.node("SpaceToDepth", [padded], blocksize=TILE)
        return self._shaped(phases, 0, TILE, TILE, channels)

    def join(self, x, channels):
        """A map in tiles as [items, channels, rows, columns]."""
        g = self.graph
        padded = g.node("DepthToSpace", [self._shaped(x, 0, TILE * TILE * channels)], blocksize=TILE)
        axes = _integers(g, [2, 3])
        return g.node("Slice", [padded, _integers(g, [0, 0]), self.size, axes])

    def clear(self, x):
        """Zeros what lies outside the map, as the next convolution needs it."""
        return self.graph.mul(x, self.inside)

    def _shifted(self, x, axis, row, shift):
        """One row (or column) of all tiles, that of the tile before (`shift` 1) or after (-1)."""
        g = self.graph
        # Of the tiles all but the last, or all but the first: beyond the map there are zeros.
        tiles_axis = axis + 3
        first, end = (0, -1) if shift == 1 else (1, np.iinfo(np.int64).max)
        bounds = ([row, first], [row + 1, end], [axis, tiles_axis])
        x = g.node("Slice", [x, *(_integers(g, bound) for bound in bounds)])
        pads = np.zeros((2, 6), np.int64)
        pads[0 if shift == 1 else 1, tiles_axis] = 1
        return g.node("Pad", [x, _integers(g, pads.ravel())])

    def _halo(self, x, axis):
        """Along one axis the six rows of the map that a tile's four outputs see."""
        before, after = self._shifted(x, axis, TILE - 1, 1), self._shifted(x, axis, 0, -1)
        return self.graph.node("Concat", [before, x, after], axis=axis)

    def conv(self, x, key, weight, bias):
        """A convolution [out, in, 3, 3] with a bias [out] or none, zero-padded by one, of a map in tiles
        that is zero outside. What it gives is not (`clear`)."""
        g = self.graph
        channels_out, channels = weight.shape[:2]
        to_samples, to_outputs = (
            g.constant(f"winograd_{name}", value.astype(np.float32))
            for name, value in (("inputs", INPUTS), ("outputs", OUTPUTS))
        )

        def along_first(matrix, x, *shape):
            return g.node("MatMul", [matrix, g.node("Reshape", [x, _integers(g, shape)])])

        x = along_first(to_samples, self._halo(x, ROWS), 0, SAMPLES, -1)
        x = self._halo(self._shaped(x, 0, SAMPLES, TILE, channels), COLUMNS)
        x = along_first(to_samples, x, 0, SAMPLES, SAMPLES, -1)
        x = g.node("Reshape", [x, _integers(g, [0, 0, 0, channels, -1])])
        x = g.node("MatMul", [self._samples_of(key, weight), x])
        x = along_first(to_outputs, x, 0, SAMPLES, SAMPLES, -1)
        x = along_first(to_outputs, x, 0, SAMPLES, -1)
        x = self._shaped(x, 0, TILE, TILE, channels_out)
        if bias is None:
            return x
        return g.add(x, g.constant(f"{key}.bias", bias.reshape(-1, 1, 1)))

    def conv_plain(self, x, key, weight, bias):
        """The same of a map [items, channels, rows, columns], which stays one."""
        x = self.split(x, weight.shape[1])
        return self.join(self.conv(x, key, weight, bias), weight.shape[0])

    def _samples_of(self, key, weight):
        """A kernel at the points, [6, 6, out, in]. The file keeps the kernel; ONNX Runtime computes this
        once, when it loads the graph."""
        g = self.graph
        both = np.einsum("xj,yi->xyji", KERNEL, KERNEL)
        samples = g.constant("winograd_kernel", both.astype(np.float32))
        x = g.constant(f"{key}.weight", weight.transpose(2, 3, 0, 1))
        return g.node("Einsum", [samples, x], equation="xyji,jioc->xyoc")


def _integers(g, values):
    values = [int(value) for value in values]
    return g.constant("integers_" + "_".join(map(str, values)), np.array(values, np.int64))
