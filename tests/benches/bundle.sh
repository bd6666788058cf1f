#!/usr/bin/env bash
# Alternates one step of Plumbline's bundle adjustment, on one and two threads, with its NumPy twin on
# one and two (BLAS) threads, and writes a dated table to tests/benches/results/: the best step of all
# rounds, and the median of the rounds' medians, which a busy machine moves more. Three to four
# minutes on a quiet machine.
#
#   bundle.sh [ROUNDS=5] [REPEAT=5]
#
# PYTHON names an interpreter with numpy (default: python3).
set -euo pipefail
cd "$(dirname "$0")/../.."
rounds=${1:-5}
repeat=${2:-5}
python=${PYTHON:-python3}
twin=tests/benches/bundle_twin.py

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
bench=$(cargo bench -q -p plumbline-vision --bench bundle --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\/bundle-[^"]*\)".*/\1/p' | tail -n 1)

for ((round = 0; round < rounds; round++)); do
    for threads in 1 2; do
        "$bench" --repeat "$repeat" --threads $threads >>"$work/ours$threads.csv"
        OPENBLAS_NUM_THREADS=$threads OMP_NUM_THREADS=$threads MKL_NUM_THREADS=$threads \
            "$python" "$twin" time --repeat "$repeat" >>"$work/numpy$threads.csv"
    done
done

mkdir -p tests/benches/results
result=tests/benches/results/bundle-$(date +%F).md
{
    echo "# One step of the dense bundle adjustment, ours and a NumPy twin: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, $(. /etc/os-release; echo "$PRETTY_NAME"), load at the end $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker/vision || echo ' with changes'), $(rustc --version), $("$python" "$twin" versions)"
    echo "- command: \`tests/benches/bundle.sh $rounds $repeat\`; $rounds alternating rounds of $repeat steps; wall times, best (median of the rounds' medians), milliseconds"
    echo "- a step linearises, eliminates the depths, solves the poses, substitutes back; float64 sums. Ours also checks its input, and computes the coupling a second time where the twin keeps it"
    echo "- NumPy's second thread is BLAS's"
    echo "- ratio: NumPy's best on as many threads over ours; speed-up: our best on one thread over that on two"
    echo "- agreement: relative difference of the pose step's norm; ours is the same to the last printed digit on one and two threads (checked)"
    echo "- 8 frames have 56 ordered pairs and 30 have 870: larger edge counts do not exist for them. 30 edges of 100 frames are those of the first frames, so that most poses are held by damping alone"
    echo
    echo "| frames | edges | grid | ours, 1 thread | NumPy, 1 | ratio | ours, 2 threads | NumPy, 2 | ratio | speed-up | agreement |"
    echo "|---|---|---|---|---|---|---|---|---|---|---|"
    "$python" - "$work"/{ours,numpy}{1,2}.csv <<'PYTHON'
import collections, csv, statistics, sys

def read(path):
    rows = collections.defaultdict(list)
    for *key, best, median, norm in csv.reader(open(path)):
        rows[tuple(key)].append((float(best), float(median), norm))
    summary = {}
    for key, values in rows.items():
        norms = {norm for _, _, norm in values}
        assert len(norms) == 1, f"{path} {key}: rounds differ: {norms}"
        summary[key] = min(v[0] for v in values), statistics.median(v[1] for v in values), norms.pop()
    return summary

ours, ours2, twin, twin2 = map(read, sys.argv[1:])
for key, (best, median, norm) in ours.items():
    frames, edges, columns, height = key
    best2, median2, norm2 = ours2[key]
    assert norm == norm2, f"{key}: {norm} on one thread, {norm2} on two"
    peer, peer_median, peer_norm = twin[key]
    peer2, peer2_median, _ = twin2[key]
    print(f"| {frames} | {edges} | {columns}×{height} | {best:.2f} ({median:.2f}) | {peer:.2f} ({peer_median:.2f}) | {peer / best:.1f} "
          f"| {best2:.2f} ({median2:.2f}) | {peer2:.2f} ({peer2_median:.2f}) | {peer2 / best2:.1f} | {best / best2:.2f} | {abs(float(norm) / float(peer_norm) - 1):.0e} |")
PYTHON
} >"$result"
echo "$result"
