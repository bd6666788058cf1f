#!/usr/bin/env bash
# Alternates SEA-RAFT-M and DROID-SLAM's networks as Plumbline runs them with the same networks in PyTorch, same
# random weights, same inputs, one thread each, and writes a dated table to tests/benches/results/: the least
# CPU seconds of all rounds (what a busy machine moves least), and their ratio. About five minutes.
#
#   learned.sh [ROUNDS=3] [REPEAT=2]
#
# TORCH_PYTHON names an interpreter with torch and numpy (default: python3). Debian's python3-torch is enough
# and small; it needs libopenblas0-pthread beside it, or its linear layers run on reference BLAS.
set -euo pipefail
cd "$(dirname "$0")/../.."
rounds=${1:-3}
repeat=${2:-2}
python=${TORCH_PYTHON:-python3}
twin=tests/benches/learned_twin.py
names=("sea-raft-m 256x256" "sea-raft-m-clip 256x256" "sea-raft-m 512x320" "sea-raft-m-clip 512x320"
    "droid-features 512x384" "droid-context 512x384" "droid-update 1" "droid-update 8" "droid-update 32")

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
venv=${CARGO_TARGET_DIR:-target}/tmp/models-venv
library=$(deploy/models/setup.sh "$venv")
for name in sea-raft-m droid; do
    "$venv/bin/python" -B deploy/models/seeded.py $name "$work/$name.safetensors"
    "$venv/bin/python" -B deploy/models/convert.py ${name%-m} "$work/$name.safetensors" --out "$work/sets/$name" >&2
    "$venv/bin/python" -c 'import sys, numpy, safetensors.numpy
numpy.savez(sys.argv[2], **safetensors.numpy.load_file(sys.argv[1]))' "$work/$name.safetensors" "$work/$name.npz"
done
ours=$(cargo build ${PROFILE---release} -q --workspace --example learned_times --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\/learned_times[^"]*\)".*/\1/p' | tail -n 1)

for ((round = 0; round < rounds; round++)); do
    for name in "${names[@]}"; do
        "$ours" "$library" "$work/sets" "$name" "$repeat" >>"$work/ours.csv"
        OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 "$python" -B "$twin" "$work" "$name" "$repeat" >>"$work/torch.csv"
    done
done

mkdir -p tests/benches/results
result=tests/benches/results/learned-$(date +%F).md
{
    echo "# The learned networks, ours and PyTorch: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, $(. /etc/os-release; echo "$PRETTY_NAME"), load at the end $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker deploy || echo ' with changes'), $(rustc --version), $(basename "$(readlink -f "$library")"); $("$python" "$twin" versions)"
    echo "- command: \`tests/benches/learned.sh $rounds $repeat\`${PROFILE+, built with PROFILE='$PROFILE'}; $rounds alternating rounds of $repeat calls after one to warm up; CPU seconds of one thread, least of all"
    echo "- random weights, full width, the same on both sides; SEA-RAFT: one direction, four iterations, correlations and up-sampling included, in Rust on our side; \`clip\`: what one more frame of a clip costs, flow there and back, where WorldScore computes all features of both directions anew and ours computes a frame's features once; DROID-SLAM: networks alone, updates without aggregation; the context's share of the gates, which PyTorch computes in every update, is computed once per frame by ours and not part of its updates (it costs a quarter of one)"
    echo "- agreement: relative difference of the mean size of the outputs"
    echo
    echo "| network | ours, CPU s | PyTorch, CPU s | ratio | agreement |"
    echo "|---|---|---|---|---|"
    "$python" - "$work/ours.csv" "$work/torch.csv" <<'PYTHON'
import csv, sys

def read(path):
    best, size = {}, {}
    for name, cpu, _, mean in csv.reader(open(path)):
        best[name] = min(best.get(name, float("inf")), float(cpu))
        assert size.setdefault(name, mean) == mean, f"{path}: {name} gave two results"
    return best, {name: float(mean) for name, mean in size.items()}

(ours, found), (torch, expected) = map(read, sys.argv[1:])
for name in ours:
    off = abs(found[name] / expected[name] - 1)
    assert off < 1e-4, f"{name}: ours {found[name]}, PyTorch {expected[name]}"
    print(f"| {name} | {ours[name]:.3f} | {torch[name]:.3f} | {ours[name] / torch[name]:.2f} | {off:.0e} |")
PYTHON
} >"$work/result.md"
cp "$work/result.md" "$result"
cat "$result"
