#!/usr/bin/env bash
# What each second buys: the speed/accuracy front on recorded and generated clips, what rendered truth says
# of it, and whether the planner's times come true: writes tests/benches/results/tradeoff-DATE.md.
#
#   tradeoff.sh [DATA=../shared/data]
#
# DATA holds manifest.csv (columns path and label) and rollouts/. `plumbline tradeoff` measures a sample of
# SAMPLE (default 40) clips at every point; its plan is then held against real runs over clips that are not
# in the sample: HELD_OUT of them (default 60) at draft and standard, a third of those at accurate.
# Measurements are kept in target/tradeoff (or WORK): remove it for times of one build and one machine state.
# JOBS (default 2) is the number of clips measured at once. Needs python3.
set -euo pipefail
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
jobs=${JOBS:-2}
target=${CARGO_TARGET_DIR:-target}
work=${WORK:-$target/tradeoff}

if [ ! -f "$data/manifest.csv" ]; then
    echo "no manifest.csv in $data: name the folder of the clips" >&2
    exit 2
fi
cargo build --release --locked --bin plumbline
plumbline=$(realpath "$target/release/plumbline")
mkdir -p "$work"
# The list, which has the labels, too: what was generated is held to be the failure.
python3 - "$data" "$work" <<'PY'
import csv, os, sys
data, work = sys.argv[1:]
rows = [r for r in csv.DictReader(open(os.path.join(data, "manifest.csv")))
        if r["path"].startswith("rollouts/") and r["label"] in ("real", "generated")]
with open(os.path.join(work, "list.csv"), "w", newline="") as out:
    table = csv.writer(out)
    table.writerow(["video", "label"])
    table.writerows([r["path"], 0 if r["label"] == "generated" else 1] for r in rows)
PY
ln -sfn "$data/rollouts" "$work/rollouts"
started=$(date +%s)
load=$(cut -d' ' -f1 /proc/loadavg)
"$plumbline" tradeoff "$work/list.csv" --out "$work/out" --sample "${SAMPLE:-40}" \
    --labels "$work/list.csv" --rendered 1 --jobs "$jobs" --cores "$jobs" --json >"$work/tradeoff.json" 2> >(tee "$work/tradeoff.log" >&2)

# Clips that are not in the sample, every k-th by name.
python3 - "$work" "${HELD_OUT:-60}" <<'PY'
import csv, json, os, sys
work, wanted = sys.argv[1], int(sys.argv[2])
sampled = set(json.load(open(os.path.join(work, "tradeoff.json")))["sample"])
rest = sorted(r["video"] for r in csv.DictReader(open(os.path.join(work, "list.csv"))) if r["video"] not in sampled)
wanted = min(wanted, len(rest))
held_out = [rest[k * len(rest) // wanted] for k in range(wanted)]
for profile, step in (("draft", 1), ("standard", 1), ("accurate", 3)):
    with open(os.path.join(work, f"held-out-{profile}.csv"), "w") as out:
        out.write("video\n" + "".join(video + "\n" for video in held_out[::step]))
PY
for profile in draft standard accurate; do
    # Exit code 3 says that some rows have no score.
    "$plumbline" score "$work/held-out-$profile.csv" --out "$work/held-out-$profile" --profile "$profile" --no-resume \
        --jobs "$jobs" --format jsonl --json >"$work/held-out-$profile.json" || [ $? -eq 3 ]
done

mkdir -p tests/benches/results
result=tests/benches/results/tradeoff-$(date +%F).md
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
echo "$result"
