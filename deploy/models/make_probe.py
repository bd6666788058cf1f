"""Writes the model by which `plumbline` probes ONNX Runtime: a convolution by 3x3 eighths, plus one.

    make_probe.py OUT.onnx

The file is part of the source, `worker/src/learned/probe.onnx`.
"""

import pathlib
import sys

import numpy as np

from graph import Graph, Weights


def model():
    """The probe, by the same means as the networks."""
    weights = Weights({
        "mean.weight": np.full((1, 1, 3, 3), 1 / 8, np.float32),
        "mean.bias": np.ones(1, np.float32),
    })
    g = Graph("probe", weights)
    x = g.input("picture", ["pictures", 1, "height", "width"])
    g.output("blurred", g.relu(g.conv(x, "mean", 1, 1, 3)), ["pictures", 1, "height", "width"])
    weights.check()
    return g.model()


if __name__ == "__main__":
    pathlib.Path(sys.argv[1]).write_bytes(model().SerializeToString(deterministic=True))
