#!/usr/bin/env bash
# How well each signal and recipe tells generated clips from recorded ones, per source, with controls:
# writes a dated table to tests/benches/results/.
#
#   separation.sh [DATA=../shared/data]
#
# DATA holds manifest.csv (columns path and label) and rollouts/. Clips are measured into
# target/separation, and kept there by the program's digest: a second run computes only the tables.
# Degraded copies of the recorded clips (half rate, half size, x264 at crf 28 and 35) are measured too.
# JOBS (default 2) is the number of clips measured at once. Needs ffmpeg and python3 with venv.
set -euo pipefail
export PYTHONDONTWRITEBYTECODE=1
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
jobs=${JOBS:-2}
here=tests/benches/separation
command="tests/benches/separation.sh"

if [ ! -f "$data/manifest.csv" ]; then
    echo "no manifest.csv in $data: name the folder of the clips" >&2
    exit 2
fi
command -v ffmpeg >/dev/null || { echo "ffmpeg is missing: install it (apt install ffmpeg)" >&2; exit 2; }

cargo build --release --locked --bin plumbline
target=${CARGO_TARGET_DIR:-target}
built=$target/release/plumbline
digest=$(sha256sum "$built" | cut -c1-16)
work=$target/separation
runs=$work/runs-$digest
mkdir -p "$work" "$runs"
# A later build must not change the program of a run under way.
[ -x "$runs/plumbline" ] || { cp "$built" "$runs/plumbline.new" && mv "$runs/plumbline.new" "$runs/plumbline"; }

python=$work/venv/bin/python
if [ ! -x "$python" ] || ! "$python" -c 'import numpy' 2>/dev/null; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet -r "$here/requirements.txt"
fi

# score RECIPE SOURCE NAME: the rows as $runs/NAME.RECIPE.jsonl. Exit code 3 says that some rows have
# no score, which the tables count.
score() {
    local out=$runs/$3.out code=0
    "$runs/plumbline" score "$2" --out "$out" --recipe "$1" --format jsonl --jobs "$jobs" >"$runs/$3.log" 2>&1 || code=$?
    case $code in
        0 | 3) cp "$out/scores.jsonl" "$runs/$3.$1.jsonl" ;;
        *) cat "$runs/$3.log" >&2; exit "$code" ;;
    esac
}

"$here/degrade.sh" "$data/rollouts/real" "$work/degraded"
echo "measuring $data/rollouts" >&2
score paper "$data/rollouts" original
score balanced "$data/rollouts" original
for control in crf35 half_rate half_size crf28; do
    echo "measuring recorded clips, $control" >&2
    score balanced "$work/degraded/$control" "$control"
done

mkdir -p tests/benches/results
result=tests/benches/results/separation-$(date +%F).md
{
    echo "# Generated against recorded clips: $(date +%F)"
    echo
    echo "- machine: $(hostname), $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(. /etc/os-release && echo "$PRETTY_NAME")"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- common worker coordinator || echo ' with changes'), $(rustc --version), $("$python" --version), NumPy $("$python" -c 'import numpy; print(numpy.__version__)'), $(ffmpeg -version | head -n 1 | cut -d' ' -f1-3)"
    echo "- command: \`$command\`, profile standard, frame 0 left out"
    echo
    "$python" "$here/report.py" "$data/manifest.csv" "$runs"
} >"$result.new"
mv "$result.new" "$result"
echo "$result"
