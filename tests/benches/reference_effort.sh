#!/usr/bin/env bash
# What the profile `reference` costs by stage, what reductions of its effort save and change, whether two runs
# give the same rows, and how much memory a clip of 100 keyframes takes. Full width, random weights (so that
# scores mean nothing, but every number of work is the real one). Writes a dated table to
# tests/benches/results/. Every frame takes up to a minute per core and variant: give clips of some ten frames.
#
#   reference_effort.sh clips SOURCE [VARIANT...]   reference twice, then the variants (default: all)
#   reference_effort.sh memory                      one clip of 100 keyframes with as many edges as there can be
#
# PLUMBLINE names the command (default: built), MODELS a directory of converted sets (default: made).
set -euo pipefail
cd "$(dirname "$0")/../.."
mode=$1
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
plumbline=${PLUMBLINE:-}
if [ -z "$plumbline" ]; then
    cargo build --release -q --bin plumbline
    plumbline=${CARGO_TARGET_DIR:-target}/release/plumbline
fi
venv=${CARGO_TARGET_DIR:-target}/tmp/models-venv
library=$(deploy/models/setup.sh "$venv")
python="$venv/bin/python -B"
models=${MODELS:-}
if [ -z "$models" ]; then
    models=$work/models
    for name in sea-raft-m droid; do
        $python deploy/models/seeded.py $name "$work/$name.safetensors"
        $python deploy/models/convert.py ${name%-m} "$work/$name.safetensors" --out "$models/$name" >&2
    done
fi

# score NAME SOURCE: at the knobs of NAME.toml.
score() {
    "$plumbline" score "$2" --out "$work/$1" --profile "$work/$1.toml" --models "$models" --onnxruntime "$library" \
        --recipe paper --format jsonl --jobs "${JOBS:-$(nproc)}" >&2
}
variant() { printf 'rung = "reference"\n%b' "$2" >"$work/$1.toml"; }
variant reference ""
variant again ""
variant fewer_edges "[droid.tracker]\nmost_edges = 24\nbackend_edges = 6\n"
variant early_stop "[sea_raft]\nstop_below_px = 0.1\n[droid.tracker]\nfrontend_updates = [3, 1]\nstop_below = 0.05\n"
variant half_resolution "[droid]\narea_px = 65536\n"
# The front end never begins, so that the one global run has every pair there is; a single update shows its memory.
variant memory "[droid.tracker]\nwarmup = 1000\nbackend_steps = [0, 1]\n"

if [ "$mode" = memory ]; then
    $python tests/benches/reference_effort.py frames "$work/clip" 100
    score memory "$work/clip"
    $python tests/benches/reference_effort.py memory "$work/memory" "$models"
    exit
fi
shift 2>/dev/null
source=$1
shift
variants=("$@")
[ $# -gt 0 ] || variants=(fewer_edges early_stop half_resolution)
for name in reference again "${variants[@]}"; do
    score "$name" "$source"
done
cmp "$work/reference/scores.jsonl" "$work/again/scores.jsonl"
mkdir -p tests/benches/results
result=tests/benches/results/reference-effort-$(date +%F).md
{
    echo "# The profile reference, its cost, and what less effort changes: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, $(. /etc/os-release; echo "$PRETTY_NAME"), load at the end $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker coordinator || echo ' with changes'), $(basename "$(readlink -f "$library")")"
    echo "- command: \`tests/benches/reference_effort.sh clips SOURCE ${variants[*]}\`; SEA-RAFT-M and DROID-SLAM, full width, random weights, fp32, one thread per clip"
    echo "- two runs of \`reference\` gave the same \`scores.jsonl\`, byte for byte"
    echo
    $python tests/benches/reference_effort.py table "$work" "$models" reference "${variants[@]}"
} >"$work/result.md"
cp "$work/result.md" "$result"
cat "$result"
