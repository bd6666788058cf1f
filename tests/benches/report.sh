#!/usr/bin/env bash
# How large the report is and how long a browser needs for it: of 5,000 synthetic rows, and of the clips in DATA,
# beside an empty page and a plain table of the same rows. Writes tests/benches/results/report-DATE.md.
#
#   report.sh [DATA]
#
# DATA holds rollouts/, whose clips are scored at draft (below target/report or WORK, resumed there); without it only
# the synthetic rows are measured. PLUMBLINE names a built command (default: built here). Needs chromium and
# chromium-driver, which `deploy/test.sh browser` installs.
set -euo pipefail
cd "$(dirname "$0")/../.."
data=${1:-}
work=${WORK:-${CARGO_TARGET_DIR:-target}/report}
reports=
if [ -n "$data" ]; then
    [ -n "${PLUMBLINE:-}" ] || cargo build --release --locked --workspace --bin plumbline
    plumbline=$(realpath "${PLUMBLINE:-${CARGO_TARGET_DIR:-target}/release/plumbline}")
    # Exit code 3 says that some rows have no score.
    "$plumbline" score "$data/rollouts" --out "$work/rollouts" --profile draft --group-by path:1 || [ $? -eq 3 ]
    reports=$(realpath "$work/rollouts/report.html")
fi
cargo build --locked --bin plumbline
mkdir -p "$work" tests/benches/results
PLUMBLINE_BENCH_REPORTS=$reports cargo nextest run --locked --workspace --no-capture --run-ignored only \
    -E 'binary(browser) and test(pages_are_timed)' | tee "$work/timed.log"
result=tests/benches/results/report-$(date +%F).md
# What was noted by hand stays.
notes=$(sed -n '/^## Notes/,$p' "$result" 2>/dev/null || true)
{
    echo "# The report in a browser: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, load $(cut -d' ' -f1 /proc/loadavg) after the run"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- coordinator tests || echo ' with changes'); $(chromium --version --no-sandbox | head -n 1), headless, pages on a disk"
    echo "- command: \`tests/benches/report.sh${data:+ DATA}\`; medians of five, pages opened in turn"
    echo
    grep '^|' "$work/timed.log"
    [ -z "$notes" ] || printf '\n%s\n' "$notes"
} >"$work/result"
mv "$work/result" "$result"
echo "$result"
