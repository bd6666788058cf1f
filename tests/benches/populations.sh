#!/usr/bin/env bash
# Real and generated clips side by side, each with entropies and weights of its own (the paper's
# Table 2), and how well either recipe tells them apart: writes a dated table to tests/benches/results/.
#
#   populations.sh [DATA=../shared/data]
#
# DATA holds manifest.csv (columns path, label, task) and rollouts/. Clips are measured into
# target/populations (or WORK), which a second run takes over. JOBS (default 2) is the number of clips
# measured at once. Needs python3.
set -euo pipefail
cd "$(dirname "$0")/../.."
data=$(realpath "${1:-../shared/data}")
target=${CARGO_TARGET_DIR:-target}
work=${WORK:-$target/populations}
command="tests/benches/populations.sh"

if [ ! -f "$data/manifest.csv" ]; then
    echo "no manifest.csv in $data: name the folder of the clips" >&2
    exit 2
fi
cargo build --release --locked --bin plumbline
plumbline=$target/release/plumbline
mkdir -p "$work"
ln -sfn "$data/rollouts" "$work/rollouts"
python3 - "$data/manifest.csv" "$work/list.csv" <<'PY'
import csv, sys
rows = [r for r in csv.DictReader(open(sys.argv[1])) if r["path"].startswith("rollouts/") and r["label"] in ("real", "generated")]
with open(sys.argv[2], "w", newline="") as out:
    table = csv.writer(out)
    table.writerow(["video", "label", "task"])
    table.writerows([r["path"], r["label"], r["task"]] for r in rows)
PY

# Exit code 3 says that some rows have no score, which the tables count.
run() { "$@" >&2 || [ $? -eq 3 ]; }
run "$plumbline" score "$work/list.csv" --out "$work/all" --group-by label --recipe paper --jobs "${JOBS:-2}"
# One camera and robot: real bridge, openvla_widowx and worldgymnast against generated worldgym and worldgymnast.
python3 - "$work/all/scores.jsonl" "$work/widowx.jsonl" <<'PY'
import json, sys
sides = {"real": ("bridge", "openvla_widowx", "worldgymnast"), "generated": ("worldgym", "worldgymnast")}
with open(sys.argv[2], "w") as out:
    for line in open(sys.argv[1]):
        row = json.loads(line)
        if row["video"].split("/")[-1].split("__")[0] in sides[row["label"]]:
            out.write(line)
PY
results=tests/benches/results/populations-$(date +%F).md
{
    echo "# Real and generated clips side by side"
    echo
    echo "\`$command\`, $(date +%F), $(nproc) cores, $(sed -n 's/^model name.*: //p' /proc/cpuinfo | head -1)."
    echo "Errors in px of a 256-px-high picture, H in nats; populations are scored together, entropies and weights are each population's own."
    for rows in all widowx; do
        for recipe in paper balanced; do
            for range in full winsorised; do
                # Only the paper's score depends on the range.
                [ "$recipe $range" = "balanced winsorised" ] && continue
                source=$work/$rows; [ "$rows" = widowx ] && source=$work/widowx.jsonl
                run "$plumbline" reduce "$source" --out "$work/$rows-$recipe-$range" --recipe "$recipe" --range "$range"
                "$plumbline" evaluate "$work/$rows-$recipe-$range" --population label --range "$range" >&2
                echo
                echo "## $rows, recipe $recipe, $range range"
                sed '1,/^Each by itself/d' "$work/$rows-$recipe-$range/evaluation.md"
            done
        done
    done
} >"$results.new"
mv "$results.new" "$results"
echo "$results"
