"""Tests of convolutions in tiles against plain ones.

    python -m unittest test_winograd      (from this directory)
"""

import unittest

import numpy as np

import runtime
import winograd
from graph import Graph, Weights


def _plain(x, weight, bias):
    """The convolution by its definition, in float64."""
    rows, columns = x.shape[2:]
    padded = np.pad(x.astype(np.float64), ((0, 0), (0, 0), (1, 1), (1, 1)))
    return bias[:, None, None] + sum(
        np.einsum("oc,nchw->nohw", weight[:, :, j, i], padded[:, :, j : j + rows, i : i + columns])
        for j in range(3)
        for i in range(3)
    )


class Winograd(unittest.TestCase):
    def test_transforms_give_the_products_of_polynomials(self):
        rng = np.random.default_rng(1)
        signal, taps = rng.normal(size=6), rng.normal(size=3)
        found = winograd.OUTPUTS @ ((winograd.KERNEL @ taps) * (winograd.INPUTS @ signal))
        np.testing.assert_allclose(found, np.correlate(signal, taps), atol=1e-12)

    def test_two_convolutions_in_tiles_are_plain_ones_whatever_the_size(self):
        rng = np.random.default_rng(2)
        shapes = ((64, 32, 3, 3), (24, 64, 3, 3))
        weights = [rng.normal(0, (9 * shape[1]) ** -0.5, shape).astype(np.float32) for shape in shapes]
        biases = [rng.normal(size=shape[0]).astype(np.float32) for shape in shapes]
        g = Graph("two", Weights({}))
        x = g.input("x", ["items", 32, "rows", "columns"])
        tiles = winograd.Tiles(g, x)
        y = tiles.conv(tiles.split(x, 32), "first", weights[0], biases[0])
        y = tiles.conv(tiles.clear(g.relu(y)), "second", weights[1], biases[1])
        g.output("y", tiles.join(y, 24), ["items", 24, "rows", "columns"])
        session = runtime.session(g.model().SerializeToString())
        for rows, columns in ((1, 1), (4, 8), (5, 3), (6, 15), (9, 12)):
            x = rng.normal(size=(2, 32, rows, columns)).astype(np.float32)
            expected = _plain(np.maximum(_plain(x, weights[0], biases[0]), 0), weights[1], biases[1])
            found = runtime.run(session, x=x)["y"]
            # A few units of the last place of sums that reach 8.
            np.testing.assert_allclose(found, expected, atol=1e-5, err_msg=f"{rows} x {columns}")


if __name__ == "__main__":
    unittest.main()
