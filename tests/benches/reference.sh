#!/usr/bin/env bash
# Does a frozen reference of one half of a corpus score the other half as the whole corpus does? Rank
# correlation of both scores over the held-out half, for seeded splits by source and both recipes.
# Writes a dated table to tests/benches/results/.
#
#   reference.sh [DATA=../shared/data] [SPLITS=10]
#
# DATA holds rollouts/, files named SOURCE__...; ROWS names a finished run over them (default: measured
# into target/reference, and kept there), BINARY a built program. Needs python3, without packages.
set -euo pipefail
export PYTHONDONTWRITEBYTECODE=1
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
splits=${2:-10}
command="tests/benches/reference.sh"

target=${CARGO_TARGET_DIR:-target}
binary=${BINARY:-$target/release/plumbline}
[ -n "${BINARY:-}" ] || cargo build --release --locked --bin plumbline
rows=${ROWS:-$target/reference/rows}
if [ ! -f "$rows/corpus.json" ]; then
    code=0
    "$binary" score "$data/rollouts" --out "$rows" --jobs "${JOBS:-2}" || code=$?
    [ "$code" -eq 0 ] || [ "$code" -eq 3 ] || exit "$code"
fi
mkdir -p tests/benches/results
result=tests/benches/results/reference-$(date +%F).md
# What was noted by hand stays.
notes=$(sed -n '/^## Notes/,$p' "$result" 2>/dev/null || true)
{
    echo "# A held-out half against a frozen reference: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- common worker coordinator || echo ' with changes'), $(rustc --version), $(python3 --version)"
    echo "- command: \`$command\`, profile standard, frame 0 left out"
    echo
    python3 tests/benches/reference.py "$binary" "$rows" "$splits"
    printf '\n%s\n' "$notes"
} >"$result.new"
mv "$result.new" "$result"
echo "$result"
