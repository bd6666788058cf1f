#!/usr/bin/env bash
# What a standing, a turning and a travelling camera cost, in full and with the flow followed; whether the
# rows agree; `--jobs` 1 against 2; and where the instructions go. Writes a dated table to tests/benches/results/.
#
#   effort.sh [DATA] [CLIPS=20] [ROUNDS=2]
#
# DATA holds rollouts/{real,generated}/*.mp4, of which CLIPS are taken, evenly spread; without it only rendered clips
# are measured. PLUMBLINE names a built command, EFFORT the built example (default: built here). VALGRIND=0 leaves the
# instructions out. Wall times are for a machine that does nothing else.
set -euo pipefail
cd "$(dirname "$0")/../.."
data=${1:-}
count=${2:-20}
rounds=${3:-2}
target=${CARGO_TARGET_DIR:-target}
[ -n "${PLUMBLINE:-}" ] && [ -n "${EFFORT:-}" ] ||
    cargo build -q --release --locked --workspace --bin plumbline --example effort
plumbline=$(realpath "${PLUMBLINE:-$target/release/plumbline}")
effort=$(realpath "${EFFORT:-$target/release/examples/effort}")
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT

"$plumbline" sample --cameras --no-dense-truth --out "$work/cameras" 2>/dev/null
recorded=()
if [ -n "$data" ]; then
    mapfile -t recorded < <(find "$data/rollouts" -name '*.mp4' | sort |
        awk -v n="$count" '{ a[NR] = $0 } END { for (i = 0; i < n; i++) print a[int(i * NR / n) + 1] }')
fi
for profile in draft standard accurate; do
    "$effort" "$rounds" "$profile" '{}' '{"follow_flow":true}' -- "$work"/cameras/videos/*.mp4 "${recorded[@]}" \
        >"$work/$profile.jsonl"
done

# Wall seconds of a whole run, least of the rounds.
wall() {
    local jobs=$1 start end
    for ((round = 0; round < rounds; round++)); do
        rm -rf "$work/out"
        start=$(date +%s.%N)
        "$plumbline" score "$work/cameras/videos" ${data:+"${recorded[@]}"} --out "$work/out" --jobs "$jobs" >/dev/null 2>&1 || [ $? = 3 ]
        end=$(date +%s.%N)
        echo "$start $end" | awk '{ print $2 - $1 }'
    done | sort -g | head -n 1
}
one=$(wall 1)
two=$(wall 2)

instructions() {
    [ "${VALGRIND:-1}" = 1 ] || return 0
    for clip in static__00 rotation__00 parallax__00; do
        valgrind --tool=callgrind --callgrind-out-file="$work/$clip.callgrind" \
            "$effort" 1 standard '{}' -- "$work/cameras/videos/$clip.mp4" >/dev/null 2>&1
        echo
        echo "### $clip"
        echo
        echo '```'
        callgrind_annotate "$work/$clip.callgrind" | grep -E '%\)' | head -n 26 |
            sed -E 's/ \[[^]]*\]$//; s/^ +//' | cut -c1-150
        echo '```'
    done
}

mkdir -p tests/benches/results
result=tests/benches/results/effort-$(date +%F).md
# What was noted by hand stays.
notes=$(sed -n '/^## Notes/,$p' "$result" 2>/dev/null || true)
{
    echo "# What is left out, and what it saves: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker common || echo ' with changes'), $(rustc --version)"
    echo "- command: \`tests/benches/effort.sh ${data:+DATA }$count $rounds\`; CPU seconds of one measurement, the least of $rounds rounds, as the profile has it and with \`follow_flow = true\`, alternating clip by clip"
    python3 tests/benches/effort.py "$work"
    echo
    echo "## \`--jobs\`"
    echo
    echo "Whole runs at \`standard\` of the clips above: $(awk -v a="$one" -v b="$two" 'BEGIN { printf "%.2f s with one job, %.2f s with two: %.2f times as fast", a, b, a / b }')."
    echo
    echo "## Instructions by function (callgrind, self cost)"
    instructions
    [ -z "$notes" ] || printf '\n%s\n' "$notes"
} >"$work/result"
mv "$work/result" "$result"
echo "$result"
