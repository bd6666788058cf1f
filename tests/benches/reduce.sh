#!/usr/bin/env bash
# `plumbline reduce` beside the same reduce in Polars and in NumPy, on the same seeded rows: wall time,
# CPU time and peak memory of each, Parquet in, scores, manifests and rewards out. Writes a dated table
# to tests/benches/results/.
#
#   reduce.sh [ROWS=10000000] [LARGE_ROWS]     LARGE_ROWS: ours alone once more, on so many rows
#
# PYTHON names an interpreter with polars, numpy and pyarrow (default: python3); WORK a directory with
# room for about 1500 bytes for each of ROWS, and 550 for each of LARGE_ROWS (default: a new one below
# /tmp). LEAN=1 makes the large run one of lean rows (short names, two signals, nothing carried), for
# which 330 bytes a row are enough. Needs GNU time.
set -euo pipefail
cd "$(dirname "$0")/../.."
rows=${1:-10000000}
large=${2:-}
python=${PYTHON:-python3}
script=tests/benches/reduce_peers.py
work=$(mktemp -d "${WORK:-/tmp}/reduce-XXXXXX")
trap 'rm -r "$work"' EXIT

cargo build -q --release --bin plumbline
binary=$(cargo metadata --format-version 1 --no-deps | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')/release/plumbline

# measure NAME COMMAND...: one line `NAME|wall s|CPU s|peak MiB`
measure() {
    local name=$1
    shift
    /usr/bin/time -f '%e %U %S %M' -o "$work/time" "$@" >/dev/null 2>"$work/stderr" ||
        [ $? -eq 3 ] || { cat "$work/stderr" >&2; exit 1; }
    tail -n 1 "$work/time" | awk -v name="$name" \
        '{ printf "%s|%.1f|%.1f|%.0f\n", name, $1, $2 + $3, $4 / 1024 }' >>"$work/lines"
    echo "$name: $(tail -n 1 "$work/time")" >&2
}
ours() { measure "$1" "$binary" reduce "$2" --out "$work/ours" --recipe "$3" --format parquet; }
# Every run finds its rows in the page cache.
rows_of() { "$python" "$script" rows "$@" && cat "$1" >/dev/null; }

echo "rendering $rows rows" >&2
rows_of "$work/rows.parquet" "$rows"
size=$(stat -c %s "$work/rows.parquet")
for recipe in paper balanced; do
    ours "plumbline $recipe" "$work/rows.parquet" "$recipe"
    measure "Polars $recipe" "$python" "$script" polars "$work/rows.parquet" "$work/polars" "$recipe"
    "$python" "$script" compare "$work/ours" "$work/polars" >>"$work/agreement"
done
measure "NumPy paper" "$python" "$script" numpy "$work/rows.parquet" "$work/numpy" paper
ours "plumbline paper again" "$work/rows.parquet" paper
"$python" "$script" compare "$work/ours" "$work/numpy" >>"$work/agreement"
rm -r "$work/rows.parquet" "$work/polars" "$work/numpy"
rows_of "$work/shuffled.parquet" "$rows" --shuffled
ours "plumbline paper, rows in random order" "$work/shuffled.parquet" paper
measure "Polars paper, rows in random order" "$python" "$script" polars "$work/shuffled.parquet" "$work/polars" paper
rm -r "$work/shuffled.parquet" "$work/polars"
if [ -n "$large" ]; then
    rm -r "$work/ours"
    rows_of "$work/large.parquet" "$large" ${LEAN:+--lean}
    ours "plumbline paper, $large ${LEAN:+lean }rows" "$work/large.parquet" paper
fi

mkdir -p tests/benches/results
result=tests/benches/results/reduce-$(date +%F).md
# What was noted by hand stays.
notes=$(sed -n '/^## Notes/,$p' "$result" 2>/dev/null || true)
{
    echo "# Reduce, ours, Polars and NumPy: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr), load $(cut -d' ' -f1-2 /proc/loadavg) at the end"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- coordinator || echo ' with changes'), $(rustc --version), $("$python" "$script" versions)"
    echo "- command: tests/benches/reduce.sh $rows $large"
    echo "- $rows seeded rows, $((size >> 20)) MiB of Parquet with zstd, 18 columns; in: the file in the page cache; out, for all: scores.parquet, manifests as JSON Lines and Parquet, rewards.parquet, the statistics of seven signals"
    echo "- what the peers leave out: see tests/benches/reduce_peers.py"
    echo
    echo "| | wall s | CPU s | peak MiB |"
    echo "|---|---|---|---|"
    awk -F'|' '{ printf "| %s | %s | %s | %s |\n", $1, $2, $3, $4 }' "$work/lines"
    echo
    echo "Ratios of wall time: $(awk -F'|' '{ t[$1] = $2 } END {
        printf "to Polars %.2f (paper), %.2f (balanced), %.2f (random order); to NumPy %.2f (paper)",
            t["plumbline paper"] / t["Polars paper"], t["plumbline balanced"] / t["Polars balanced"],
            t["plumbline paper, rows in random order"] / t["Polars paper, rows in random order"],
            t["plumbline paper"] / t["NumPy paper"] }' "$work/lines")."
    echo
    echo "Agreement:"
    sed 's/^/- /' "$work/agreement"
    printf '\n%s\n' "$notes"
} >"$result"
echo "$result"
