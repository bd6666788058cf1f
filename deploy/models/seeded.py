"""Writes a checkpoint of random weights, to measure and to test with, where no official
checkpoint is at hand: full width, but for `sea-raft-small`, which is for tests. Its flows and trajectories mean nothing.

    seeded.py sea-raft-small | sea-raft-s | sea-raft-m | droid OUT.safetensors
"""

import argparse
import math

import numpy as np
import safetensors.numpy

import droid
import sea_raft
from graph import Weights

# The topology of S, in a quarter of its widths.
TINY = sea_raft.Configuration(16, (16, 24, 32), (2, 2, 2), 32, 4, 2)
SEA_RAFT = {"sea-raft-small": TINY, "sea-raft-s": sea_raft.SMALL, "sea-raft-m": sea_raft.MEDIUM}
NAMES = (*SEA_RAFT, "droid")


def _draw(rng, key, shape):
    if key.endswith((".bn1.weight", ".bn2.weight", ".bn3.weight", ".gamma")):
        value = rng.uniform(0.2, 0.6, shape)
    elif key.endswith("norm.weight"):
        value = rng.uniform(0.8, 1.2, shape)
    elif key.endswith("running_var"):
        value = rng.uniform(0.5, 1.5, shape)
    elif len(shape) == 1:
        value = rng.normal(0, 0.05, shape)
    else:
        value = rng.normal(0, math.sqrt(1 / math.prod(shape[1:])), shape)
    return value.astype(np.float32)


def tensors(name, seed=0):
    """A state dict by the official names."""
    asked = Weights(None)
    if name == "droid":
        droid.graphs(asked)
    else:
        sea_raft.graphs(SEA_RAFT[name], asked)
    rng = np.random.default_rng(seed)
    drawn = {key: _draw(rng, key, shape) for key, shape in asked.asked.items()}
    for key in list(drawn):
        # The official files hold these twice.
        if ".bn3." in key:
            drawn[key.replace(".bn3.", ".downsample.1.")] = drawn[key]
    return drawn


def main():
    parser = argparse.ArgumentParser(description="Writes a checkpoint of random weights.")
    parser.add_argument("name", choices=NAMES)
    parser.add_argument("out")
    arguments = parser.parse_args()
    safetensors.numpy.save_file(tensors(arguments.name), arguments.out)


if __name__ == "__main__":
    main()
