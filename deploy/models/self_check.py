"""Runs the written files by ONNX Runtime and by ONNX' own reference evaluator (plain NumPy) on the same
random inputs, at an odd number of items and two sizes: what a user's machine computes is what the graphs say."""

import numpy as np
import onnx
from onnx.reference import ReferenceEvaluator

import runtime

# Rounding of float32 sums of a few thousand terms, relative to the output's largest value.
TOLERANCE = 2e-5
# Free sizes: (items, sources, rows, columns) of the two runs; small, since the evaluator is slow.
SIZES = [(1, 1, 4, 6), (3, 2, 5, 4)]


def _inputs(graph, items, sources, rows, columns):
    free = {
        "pictures": items, "pairs": items, "edges": items, "sources": sources,
        "rows": rows, "columns": columns, "height": 8 * rows, "width": 8 * columns,
    }
    rng = np.random.default_rng(0)
    return {
        name: rng.uniform(-1, 1, [free.get(n, n) for n in shape]).astype(np.float32)
        for name, shape in graph["inputs"].items()
    }


def worst_of(path, graph):
    """The largest difference of a graph's outputs, relative to each output's largest value."""
    session, evaluator = runtime.session(str(path)), ReferenceEvaluator(onnx.load(path))
    worst = 0.0
    for size in SIZES:
        inputs = _inputs(graph, *size)
        found = runtime.run(session, **inputs)
        expected = dict(zip(graph["outputs"], evaluator.run(list(graph["outputs"]), inputs)))
        for name, value in expected.items():
            if not np.isfinite(value).all() or found[name].shape != value.shape:
                return float("inf")
            largest = max(float(np.abs(value).max()), 1e-12)
            worst = max(worst, float(np.abs(found[name] - value).max()) / largest)
    return worst


def report(out, sidecar):
    """Prints one line per graph; true if one is beyond the tolerance."""
    failed = False
    print(f"against ONNX' reference evaluator (relative, at most {TOLERANCE:g}):")
    for name, graph in sidecar["graphs"].items():
        worst = worst_of(out / graph["file"], graph)
        failed |= not worst <= TOLERANCE
        print(f"  {name:<15} {worst:.1e}{'' if worst <= TOLERANCE else '  TOO MUCH'}")
    return failed
