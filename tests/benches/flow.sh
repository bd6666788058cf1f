#!/usr/bin/env bash
# Plumbline's optical flow beside OpenCV's DISOpticalFlow on the same pictures, one thread each, alternating
# job by job: accuracy and time on pairs with ground truth, time by picture size, instructions by stage.
# Writes tests/benches/results/flow-<date>.md; a few minutes after the build.
#
#   flow.sh [PAIRS=../shared/data/flow] [ROUNDS=7] [REPEAT=3]
#
# PAIRS holds one folder per pair: frame1.png, frame2.png, gt.flo. PYTHON names an interpreter with
# opencv-python-headless (default: python3). The stages need valgrind; without it they are left out.
set -euo pipefail
cd "$(dirname "$0")/../.."
pairs=$(realpath "${1:-../shared/data/flow}")
rounds=${2:-7}
repeat=${3:-3}

bench=$(cargo bench -q -p plumbline-vision --bench flow --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\/flow-[^"]*\)".*/\1/p' | tail -n 1)
mkdir -p tests/benches/results
result=tests/benches/results/flow-$(date +%F).md
partial=$(mktemp)
trap 'rm -f "$partial"' EXIT
{
    echo "# Optical flow, ours and OpenCV's, one thread: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr), load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker/vision || echo ' with changes'), $(rustc --version)"
    echo "- command: tests/benches/flow.sh (PAIRS=shared/data/flow ROUNDS=$rounds REPEAT=$repeat)"
    "${PYTHON:-python3}" tests/benches/flow.py "$bench" "$pairs" --rounds "$rounds" --repeat "$repeat"
} >"$partial"
# What was noted by hand under "Notes" stays.
if [ -f "$result" ]; then
    echo >>"$partial"
    sed -n '/^## Notes/,$p' "$result" >>"$partial"
fi
cp "$partial" "$result"
echo "$result"
