#!/usr/bin/env bash
# Clips with one frame broken: does the score or the verdict say so, and is the frame named? Tables per source
# and kind of noise, written to tests/benches/results/corruption-DATE.md.
#
#   corruption.sh [DATA=../shared/data] [CLIPS=3]
#
# CLIPS of each source, recorded and generated ones each. BEFORE=PROGRAM measures the same clips with another
# build of the command, too. JOBS (default 2) clips are measured at once. What was measured is kept in
# target/corruption, by the program's digest. Needs ffmpeg and python3 with venv.
set -euo pipefail
export PYTHONDONTWRITEBYTECODE=1
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
count=${2:-3}
jobs=${JOBS:-2}
here=tests/benches/corruption

if [ ! -f "$data/manifest.csv" ]; then
    echo "no manifest.csv in $data: name the folder of the clips" >&2
    exit 2
fi
command -v ffmpeg >/dev/null || { echo "ffmpeg is missing: install it (apt install ffmpeg)" >&2; exit 2; }

cargo build --release --locked --bin plumbline
target=${CARGO_TARGET_DIR:-target}
work=$target/corruption
mkdir -p "$work"
python=$work/venv/bin/python
if [ ! -x "$python" ] || ! "$python" -c 'import numpy' 2>/dev/null; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet -r tests/benches/separation/requirements.txt
fi
if [ ! -f "$work/clips-$count/truth.csv" ]; then
    rm -rf "$work/clips-$count"
    "$python" "$here/make.py" "$data" "$work/clips-$count" "$count"
fi

# measure PROGRAM: the rows of all clips; prints their file. Exit code 3 says that some rows have no score,
# which is what this is about.
measure() {
    local runs code=0
    runs=$work/runs-$count-$(sha256sum "$1" | cut -c1-16)
    mkdir -p "$runs"
    cp -n "$1" "$runs/plumbline"
    (cd "$work" && "$(realpath "$runs/plumbline")" score "clips-$count" --out "$(realpath "$runs")/out" --format jsonl --jobs "$jobs") \
        >"$runs/log" 2>&1 || code=$?
    case $code in
        0 | 3) echo "$runs/out/scores.jsonl" ;;
        *) cat "$runs/log" >&2; exit "$code" ;;
    esac
}

rows=$(measure "$target/release/plumbline")
before=${BEFORE:+$(measure "$BEFORE")}

mkdir -p tests/benches/results
result=tests/benches/results/corruption-$(date +%F).md
# What was written below the tables stays.
notes=$(sed -n '/^## What it says/,$p' "$result" 2>/dev/null || true)
{
    echo "# Clips with one broken frame: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- common worker coordinator || echo ' with changes'); command: \`tests/benches/corruption.sh\`, $count clips of each source and side, profile standard, frame 0 left out"
    echo
    "$python" "$here/report.py" "$work/clips-$count/truth.csv" "$rows" ${before:+"$before"}
    echo
    echo "$notes"
} >"$result.new"
mv "$result.new" "$result"
echo "$result"
