#!/usr/bin/env bash
# What each second buys: the speed/accuracy front on recorded and generated clips, what rendered truth says
# of it, and whether the planner's times come true: writes tests/benches/results/tradeoff-DATE.md, and the table in
# README.md.
#
#   tradeoff.sh [DATA=../shared/data [WORDS...]]
#
# DATA holds manifest.csv (columns path and label) and rollouts/. HELD_OUT (default 60) of the clips are held out;
# of the others `plumbline tradeoff` measures a sample of SAMPLE (default 40) at every point, and plans for the
# held-out ones (--plan-for), of which it reads the headers alone: all of them at draft and standard, a third at
# accurate. Then these are measured. RENDERED (default 1) corpora are rendered for the truth; WORDS go to
# `plumbline tradeoff` (--no-rendered, say, to try the script). README=no leaves README.md as it is, RESULT is the
# file that is written.
# Measurements are kept in target/tradeoff (or WORK): remove it for times of one build and one machine state.
# JOBS (default 2) is the number of clips measured at once. Needs python3.
set -euo pipefail
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
shift || true
words=("$@")
jobs=${JOBS:-2}
target=${CARGO_TARGET_DIR:-target}
work=${WORK:-$target/tradeoff}

if [ ! -f "$data/manifest.csv" ]; then
    echo "no manifest.csv in $data: name the folder of the clips" >&2
    exit 2
fi
cargo build --release --locked --workspace --bin plumbline
plumbline=$(realpath "$target/release/plumbline")
mkdir -p "$work"
# The list, which has the labels, too: what was generated is held to be the failure. Every k-th clip by name is
# held out.
python3 - "$data" "$work" "${HELD_OUT:-60}" <<'PY'
import csv, os, sys
data, work, wanted = sys.argv[1], sys.argv[2], int(sys.argv[3])
rows = sorted((r["path"], 0 if r["label"] == "generated" else 1)
              for r in csv.DictReader(open(os.path.join(data, "manifest.csv")))
              if r["path"].startswith("rollouts/") and r["label"] in ("real", "generated"))
wanted = min(wanted, len(rows))
held_out = [rows[k * len(rows) // wanted] for k in range(wanted)]
rest = [row for row in rows if row not in set(held_out)]
lists = {"list": rest, "held-out-draft": held_out, "held-out-standard": held_out, "held-out-accurate": held_out[::3]}
for name, rows in lists.items():
    with open(os.path.join(work, f"{name}.csv"), "w", newline="") as out:
        table = csv.writer(out)
        table.writerow(["video", "label"])
        table.writerows(rows)
PY
ln -sfn "$data/rollouts" "$work/rollouts"
started=$(date +%s)
load=$(cut -d' ' -f1 /proc/loadavg)
tradeoff() { # NAME WORDS...
    local name=$1
    shift
    "$plumbline" tradeoff "$work/list.csv" --out "$work/out" --sample "${SAMPLE:-40}" --labels "$work/list.csv" \
        --rendered "${RENDERED:-1}" --jobs "$jobs" --cores "$jobs" --json "${words[@]}" "$@" >"$work/$name.json" 2> >(tee "$work/$name.log" >&2)
}
# The first one measures; the others plan by the same measurements.
tradeoff tradeoff
for profile in draft standard accurate; do
    tradeoff "plan-$profile" --plan-for "$work/held-out-$profile.csv"
done
for profile in draft standard accurate; do
    # Exit code 3 says that some rows have no score.
    "$plumbline" score "$work/held-out-$profile.csv" --out "$work/held-out-$profile" --profile "$profile" --no-resume \
        --jobs "$jobs" --format jsonl --json >"$work/held-out-$profile.json" || [ $? -eq 3 ]
done

mkdir -p tests/benches/results
result=${RESULT:-tests/benches/results/tradeoff-$(date +%F).md}
# What was written below the tables stays.
notes=$(sed -n '/^## What limits the front/,$p' "$result" 2>/dev/null || true)
{
    echo "# What each second buys: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr), load before $load, after $(cut -d' ' -f1 /proc/loadavg); $(($(date +%s) - started)) s in all"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- common worker coordinator sample || echo ' with changes'), $(rustc --version); command: tests/benches/tradeoff.sh, ${SAMPLE:-40} clips sampled, jobs $jobs"
    python3 tests/benches/tradeoff_report.py "$work" "$jobs"
    echo
    echo "$notes"
} >"$result.new"
mv "$result.new" "$result"
[ "${README:-yes}" = no ] || python3 tests/benches/tradeoff_report.py "$work" "$jobs" README.md
echo "$result"
