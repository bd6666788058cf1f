#!/usr/bin/env bash
# CPU seconds per clip, Plumbline at `standard` and the Python prototype computing the same signals, one
# thread each, alternating clip by clip; writes a dated table to tests/benches/results/.
#
#   prototype.sh [ROUNDS=2] [CLIPS=12]
#
# Needs ../shared/prototype and ../shared/data; PYTHON names an interpreter with the packages of
# tests/parity/requirements.txt (default: the one deploy/test.sh parity made).
set -euo pipefail
cd "$(dirname "$0")/../.."
rounds=${1:-2}
count=${2:-12}
target=${CARGO_TARGET_DIR:-target}
python=${PYTHON:-$target/tmp/prototype-venv/bin/python}
shared=$(realpath ../shared)
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1

# One clip of each source and side, spread over cameras, sizes and lengths.
clips=(
    real/bridge__sample_000000000__teleop real/openvla_widowx__put_eggplant_into_pot_clutter_2__openvla
    real/openvla_franka__flip_pot_upright__base_vlm real/openvla_rt1robot__move_banana_near_plate__openvla
    real/droid__0__ext real/worldgymnast__close_drawer__real
    generated/worldgym__ood_lang_pot_and_grapes__octo generated/ctrlworld__pickplace_01_ext__policy
    generated/ctrlworld_replay__sample0_wrist__ckpt100k generated/worldgymnast__close_drawer__worldgym
    generated/worldeval__bussing_table_fail__blue_mug_pi0_gen_9_frame_0_video generated/wow__cubes_00000023
)
clips=("${clips[@]:0:count}")

# PLUMBLINE names a built command (default: built here).
[ -n "${PLUMBLINE:-}" ] || cargo build -q --release --locked --bin plumbline
plumbline=$(realpath "${PLUMBLINE:-$target/release/plumbline}")
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT

# cpu_seconds COMMAND... : user and system time of a command and its children.
cpu_seconds() {
    local TIMEFORMAT='%U %S'
    { time "$@" >"$work/log" 2>&1; } 2>"$work/time" || { [ $? -eq 3 ] || { cat "$work/log" >&2; exit 1; }; }
    awk '{ printf "%.4f", $1 + $2 }' "$work/time"
}

mkdir "$work/none"
for ((round = 0; round < rounds; round++)); do
    for clip in "${clips[@]}"; do
        video=$shared/data/rollouts/$clip.mp4
        rm -rf "$work/out"
        seconds=$(cpu_seconds "$plumbline" score "$video" --out "$work/out" --jobs 1 --profile standard)
        stages=$("$python" -c 'import json, sys; c = json.loads(open(sys.argv[1]).readline()); print(*(f"{c[k]:.4f}" for k in ("total_s", "decode_s", "flow_s", "signals_s", "geometry_s")), sep=",")' "$work/out/costs.jsonl")
        echo "$(basename "$video"),$seconds,$stages" >>"$work/ours.csv"
        "$python" tests/benches/prototype.py measure "$shared/prototype" "$video" >>"$work/theirs.csv"
    done
done

mkdir -p tests/benches/results
result=tests/benches/results/prototype-$(date +%F).md
# What was noted by hand stays.
notes=$(sed -n '/^## Notes/,$p' "$result" 2>/dev/null || true)
{
    echo "# A clip at \`standard\` and in the Python prototype: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(env -u OMP_NUM_THREADS nproc) cores, $(sed -n 's/^PRETTY_NAME="\(.*\)"/\1/p' /etc/os-release), load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker coordinator common || echo ' with changes'), $(rustc --version), $("$python" tests/benches/prototype.py versions)"
    echo "- command: \`tests/benches/prototype.sh $rounds $count\`; clip by clip, the one after the other, of each figure the least of $rounds rounds; CPU seconds (user and system), one thread"
    echo "- Plumbline: the whole command \`plumbline score CLIP --jobs 1 --profile standard\`, with its start, corpus statistics and report. Signals: WorldScore's and the corrected end-point error, P, T, accs, Sd, sh, V, xr, step, vanq, pers, freeze with places and peak maps, U·R_c; motion models (static, homography, fundamental) of the pairs (t, t + 1) and (t, t + 2). The aspect is kept, so that wide clips have up to 1.8 times the prototype's pixels. Stages are wall seconds"
    echo "- shared: the prototype's signals, the same list, and its motion models (\`feat.rigid\`), each once on flow that is computed once, 256 × 256 (\`tests/benches/prototype.py\`, \`measure\`); no places, no report, imports not counted"
    echo "- as it stands: the prototype's scripts one after the other, each computing its own flow and all that it prints (\`measure_scripts\`)"
    echo "- OpenCV with one thread; its DIS, resizing, box filters and look-ups are compiled and vectorised: only what lies between them is Python"
    echo "- goal: 5 times faster than the prototype"
    echo
    echo "| clip | frames | Plumbline | decode | flow | signals | geometry | shared | decode | flow | as it stands | shared / Plumbline | as it stands / Plumbline |"
    echo "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    "$python" - "$work/ours.csv" "$work/theirs.csv" <<'PYTHON'
import csv, statistics, sys

def least(path):
    """Of each clip and column the least over the rounds."""
    rows = {}
    for name, *values in csv.reader(open(path)):
        values = [float(value) for value in values]
        rows[name] = [min(pair) for pair in zip(rows.get(name, values), values)]
    return rows

ours, theirs = map(least, sys.argv[1:])
ratios = {"shared": [], "as it stands": []}
for name, (cpu, _, *stages) in ours.items():
    shared, scripts, decode, flow, frames = theirs[name]
    ratios["shared"].append(shared / cpu)
    ratios["as it stands"].append(scripts / cpu)
    cells = [cpu, *stages, shared, decode, flow, scripts]
    print(f"| {name.removesuffix('.mp4')} | {frames:.0f} | " + " | ".join(f"{cell:.2f}" for cell in cells) + f" | {shared / cpu:.2f} | {scripts / cpu:.2f} |")
print()
for name, values in ratios.items():
    print(f"- {name} / Plumbline: median {statistics.median(values):.2f}, least {min(values):.2f}, most {max(values):.2f}")
PYTHON
    printf '\n%s\n' "$notes"
} >"$result"
echo "$result"
cat "$result"
