#!/usr/bin/env bash
# Alternates one step of Plumbline's bundle adjustment with its NumPy twin, one thread each, and writes
# a dated table of medians over the rounds to tests/benches/results/.
#
#   bundle.sh [ROUNDS=3] [REPEAT=5]
#
# PYTHON names an interpreter with numpy (default: python3).
set -euo pipefail
cd "$(dirname "$0")/../.."
rounds=${1:-3}
repeat=${2:-5}
python=${PYTHON:-python3}
twin=tests/benches/bundle_twin.py
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 MKL_NUM_THREADS=1

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
bench=$(cargo bench -q -p plumbline-vision --bench bundle --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\/bundle-[^"]*\)".*/\1/p' | tail -n 1)

for ((round = 0; round < rounds; round++)); do
    "$bench" --repeat "$repeat" >>"$work/ours.csv"
    "$python" "$twin" time --repeat "$repeat" >>"$work/numpy.csv"
done

mkdir -p tests/benches/results
result=tests/benches/results/bundle-$(date +%F).md
{
    echo "# One step of the dense bundle adjustment, ours and a NumPy twin, one thread: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, $(. /etc/os-release; echo "$PRETTY_NAME"), load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker/vision || echo ' with changes'), $(rustc --version), $("$python" "$twin" versions)"
    echo "- command: \`tests/benches/bundle.sh $rounds $repeat\`; $rounds alternating rounds of $repeat steps, medians of medians"
    echo "- wall times; the machine's load is given above"
    echo "- a step linearises, eliminates the depths, solves the poses, substitutes back; float64 sums. Ours also checks its input, and computes the coupling a second time where the twin keeps it"
    echo "- agreement: relative difference of the pose step's norm"
    echo "- 8 frames have 56 ordered pairs and 30 have 870: larger edge counts do not exist for them"
    echo
    echo "| frames | edges | grid | ours ms | NumPy ms | NumPy / ours | agreement |"
    echo "|---|---|---|---|---|---|---|"
    "$python" - "$work/ours.csv" "$work/numpy.csv" <<'PYTHON'
import collections, csv, statistics, sys

def medians(path):
    rows = collections.defaultdict(list)
    for frames, edges, columns, height, ms, norm in csv.reader(open(path)):
        rows[frames, edges, columns, height].append((float(ms), float(norm)))
    return {key: (statistics.median(ms for ms, _ in values), values[0][1]) for key, values in rows.items()}

ours, twin = map(medians, sys.argv[1:])
for key, (ms, norm) in ours.items():
    frames, edges, columns, height = key
    peer, other = twin[key]
    print(f"| {frames} | {edges} | {columns}×{height} | {ms:.2f} | {peer:.2f} | {peer / ms:.1f} | {abs(norm / other - 1):.0e} |")
PYTHON
} >"$result"
echo "$result"
