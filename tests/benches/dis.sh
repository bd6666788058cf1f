#!/usr/bin/env bash
# Alternates Plumbline's DIS and OpenCV's on the same frames, one thread each, and writes a dated table
# of medians over the rounds to tests/benches/results/.
#
#   dis.sh A.png B.png [ROUNDS=7] [REPEAT=9]
#
# PYTHON names an interpreter with opencv-python-headless (default: python3).
set -euo pipefail
cd "$(dirname "$0")/../.."
a=$(realpath "${1:?first frame}")
b=$(realpath "${2:?second frame}")
rounds=${3:-7}
repeat=${4:-9}
python=${PYTHON:-python3}
script=tests/benches/opencv_dis.py

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
"$python" "$script" frames "$work/frames" "$a" "$b"
bench=$(cargo bench -q -p plumbline-vision --bench dis --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\/dis-[^"]*\)".*/\1/p' | tail -n 1)

for ((round = 0; round < rounds; round++)); do
    "$bench" --frames "$work/frames" --repeat "$repeat" >>"$work/ours.csv"
    "$python" "$script" time "$work/frames" --repeat "$repeat" >>"$work/opencv.csv"
done

mkdir -p tests/benches/results
result=tests/benches/results/dis-$(date +%F)-$(hostname).md
{
    echo "# DIS, ours and OpenCV's, one thread: $(date +%F)"
    echo
    echo "- machine: $(hostname), $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker/vision || echo ' with changes'), $(rustc --version), $("$python" "$script" versions)"
    echo "- frames: $(basename "$(dirname "$a")")/$(basename "$a") and $(basename "$b"), resized; $rounds alternating rounds of $repeat runs; medians of medians, ms"
    echo "- pair = both frames prepared and the flow (OpenCV's calc); flow = the flow alone, frames shared"
    echo "- at 64 px ultrafast and fast have no scale 2: OpenCV then works at a finer scale, ours at the coarsest it has"
    echo
    echo "| preset | px | ours pair | ours flow | OpenCV | ratio |"
    echo "|---|---|---|---|---|---|"
    "$python" - "$work/ours.csv" "$work/opencv.csv" <<'PYTHON'
import collections, csv, statistics, sys

def medians(path):
    rows = collections.defaultdict(list)
    for preset, size, *times in csv.reader(open(path)):
        rows[preset, size].append([float(t) for t in times])
    return {key: [statistics.median(column) for column in zip(*times)] for key, times in rows.items()}

ours, opencv = map(medians, sys.argv[1:])
for (preset, size), (pair, flow) in ours.items():
    peer = opencv[preset, size][0]
    print(f"| {preset} | {size} | {pair:.3f} | {flow:.3f} | {peer:.3f} | {pair / peer:.2f} |")
PYTHON
} >"$result"
echo "$result"
