#!/usr/bin/env bash
# What `score --budget` costs and how well it agrees with measuring everything at `accurate`, on real clips
# and on rendered ones with faults: writes a dated table to tests/benches/results/.
#
#   cascade.sh [SOURCE=../shared/data/rollouts]
#
# Both corpora are measured at draft, standard and accurate, one clip at a time (processor time is what
# counts), into target/cascade (or WORK), by the program's digest: a second run measures nothing again. From
# these the cascade is gone through by the program's own code over many draws of the sample
# (coordinator/examples/cascade_curve.rs), which judges only videos outside the sample that fits the model;
# then one real `--budget auto` run of each corpus is held against the full ones. SEEDS (default 10) times 24
# clips are rendered. Needs python3.
set -euo pipefail
cd "$(dirname "$0")/../.."
source=$(realpath "${1:-../shared/data/rollouts}")
target=${CARGO_TARGET_DIR:-target}
command="tests/benches/cascade.sh"

cargo build --release --locked --workspace --bin plumbline
cargo build --release --locked --workspace --example cascade_curve
built=$target/release/plumbline
work=${WORK:-$target/cascade}/$(sha256sum "$built" | cut -c1-16)
mkdir -p "$work"
# A later build must not change the programs of a run under way.
for program in "$built" "$target/release/examples/cascade_curve"; do
    [ -x "$work/$(basename "$program")" ] || cp "$program" "$work/"
done
plumbline=$work/plumbline

rendered=$work/rendered
for seed in $(seq 1 "${SEEDS:-10}"); do
    [ -f "$rendered/$seed/labels.csv" ] || "$plumbline" sample --out "$rendered/$seed" --seed "$seed" --no-dense-truth >&2
done

# Exit code 3 says that some rows have no score, which the tables count.
run() { "$@" >&2 || [ $? -eq 3 ]; }
measure() { # NAME SOURCE
    local rung
    for rung in draft standard accurate; do
        [ -f "$work/$1/$rung/corpus.json" ] || run "$plumbline" score "$2" --out "$work/$1/$rung" --profile "$rung" --format jsonl --jobs 1
    done
    [ -f "$work/$1/cascade/corpus.json" ] || run "$plumbline" score "$2" --out "$work/$1/cascade" --profile accurate --budget auto --format jsonl --jobs 1
}
measure real "$source"
measure rendered "$rendered"

# held NAME: the real run against the full one.
held() {
    python3 - "$work/$1/cascade" "$work/$1/accurate" <<'PY'
import json, sys
read = lambda out, name: [json.loads(line) for line in open(f"{out}/{name}.jsonl")]
cascade, full = sys.argv[1:]
decided = {row["video"]: row["decision"] for row in read(full, "scores")}
rows = read(cascade, "scores")
same = sum(decided[row["video"]] == row["decision"] for row in rows)
cpu_s = [sum(cost["cpu_s"] for cost in read(out, "costs")) for out in (cascade, full)]
told = json.load(open(f"{cascade}/corpus.json"))["cascade"]
print(f"One real run, `--profile accurate --budget auto`: {same} of {len(rows)} decisions are those of `accurate` "
      f"({same / len(rows):.4f}; foretold {told['expected_agreement']:.4f}) at {cpu_s[0]:.0f} of {cpu_s[1]:.0f} CPU seconds "
      f"({cpu_s[0] / cpu_s[1]:.3f}). " + "; ".join(f"{p['name']}: {p['measured']} measured, {p['rows']} rows" for p in told["profiles"]) + ".")
PY
}

mkdir -p tests/benches/results
result=tests/benches/results/cascade-$(date +%F).md
{
    echo "# The cascade: agreement against cost"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores; load when written $(cut -d' ' -f1-3 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- common worker coordinator || echo ' with changes'), $(rustc --version)"
    echo "- command: \`$command\`; cost is processor time, as a share of measuring everything at \`accurate\`, the sample included"
    echo "- \`judged\` leaves out the videos that fit the flip model; \`worst draw\` is the least of 40 draws of the sample"
    for corpus in real rendered; do
        for recipe in balanced paper; do
            for keep in 80% 50%; do
                echo
                echo "## $corpus clips, --recipe $recipe, --keep $keep"
                echo
                "$work/cascade_curve" "$work/$corpus/draft" "$work/$corpus/standard" "$work/$corpus/accurate" --keep "$keep" --recipe "$recipe"
            done
        done
        echo
        held "$corpus"
    done
} >"$result.new"
mv "$result.new" "$result"
echo "$result"
