"""Converts an official checkpoint to the ONNX files that Plumbline reads.

    convert.py sea-raft CHECKPOINT --out DIR [--size S|M|L] [--golden DIR]
    convert.py droid    CHECKPOINT --out DIR [--golden DIR]

CHECKPOINT is a .pth (a state dict) or a safetensors file. Its keys and shapes must be exactly the network's.
DIR is made: one .onnx per graph, and model.json with digests and shapes. At the end the written files are
run by ONNX Runtime and compared with ONNX' reference evaluator on the same weights, and, with --golden,
this converter's networks with the reference implementation's numbers.
"""

import argparse
import os
import pathlib
import sys

import checkpoint
import model_set
import networks
import parity
import sea_raft
import self_check
from graph import WeightsError


def convert(network, path, out, size=None):
    """Reads, checks, builds and writes; returns the sidecar."""
    tensors = checkpoint.read_tensors(path)
    try:
        built = networks.sea_raft(tensors, size) if network == "sea-raft" else networks.droid(tensors)
    except WeightsError as error:
        raise WeightsError(f"{path}: {error}") from None
    source = {"file": path.name, "bytes": path.stat().st_size, "sha256": checkpoint.sha256(path)}
    return model_set.write(out, network, *built, source)


def main():
    parser = argparse.ArgumentParser(
        description="Converts a SEA-RAFT or DROID-SLAM checkpoint to ONNX files for Plumbline."
    )
    parser.add_argument("network", choices=["sea-raft", "droid"])
    parser.add_argument("checkpoint", type=pathlib.Path, help=".pth (state dict) or safetensors file")
    parser.add_argument("--out", type=pathlib.Path, required=True, help="directory to make")
    parser.add_argument("--size", choices=sea_raft.SIZES, help="SEA-RAFT: L has the weights of M and more iterations")
    parser.add_argument("--golden", type=pathlib.Path, help="directory of the reference's numbers (*.npz)")
    arguments = parser.parse_args()
    if arguments.network == "droid" and arguments.size:
        parser.error("--size is SEA-RAFT's")
    if os.path.lexists(arguments.out):
        sys.exit(f"{arguments.out} exists: name another directory, or remove it")
    try:
        sidecar = convert(arguments.network, arguments.checkpoint, arguments.out, arguments.size)
        print(f"{arguments.out}: {sidecar['network']}, {sidecar['parameters']:,} parameters, {sidecar['configuration']}")
        for graph in sidecar["graphs"].values():
            print(f"  {graph['file']:<15} {graph['bytes']:>11,} bytes  sha256 {graph['sha256']}")
        failed = self_check.report(arguments.out, sidecar)
        if arguments.golden:
            failed |= parity.report(arguments.golden, [arguments.network])
        else:
            print("not compared with the reference's numbers: no --golden")
    except (checkpoint.CheckpointError, WeightsError, parity.GoldenError) as error:
        sys.exit(f"error: {error}")
    if failed:
        sys.exit("error: figures beyond their tolerance; do not use these files")


if __name__ == "__main__":
    main()
