"""Writes a network's graphs and their sidecar, `model.json`, which names and dates nothing: the same
checkpoint gives the same bytes."""

import json
import pathlib

from checkpoint import sha256
from graph import OPSET

FORMAT = 1


def _shapes(values):
    return {
        value.name: [d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim] for value in values
    }


def write(out, network, configuration, weights, models, source):
    """Writes `models` (name -> ONNX model) to the new directory `out` and returns the sidecar.

    `source` tells of the checkpoint: name, bytes, sha256. All tensors are float32; named sizes are free.
    """
    out = pathlib.Path(out)
    out.mkdir(parents=True)
    graphs = {}
    for name, model in models.items():
        path = out / f"{name}.onnx"
        path.write_bytes(model.SerializeToString(deterministic=True))
        graphs[name] = {
            "file": path.name,
            "bytes": path.stat().st_size,
            "sha256": sha256(path),
            "inputs": _shapes(model.graph.input),
            "outputs": _shapes(model.graph.output),
        }
    sidecar = {
        "format": FORMAT,
        "network": network,
        "configuration": configuration,
        "parameters": weights.parameters(),
        "opset": OPSET,
        "precision": "float32",
        "source": source,
        "graphs": graphs,
    }
    (out / "model.json").write_text(json.dumps(sidecar, indent=1) + "\n")
    return sidecar
