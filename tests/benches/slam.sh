#!/usr/bin/env bash
# Accuracy and time of `plumbline slam` per profile, our ATE beside evo's, and the work that is saved
# where no depth is needed. Writes a dated table to tests/benches/results/.
#
#   slam.sh DATA
#
# DATA holds slam/7scenes_redkitchen (rgb/, groundtruth.txt, intrinsics.txt; synthetic times at 15 per
# second) and slam/traj_tum_fr1_xyz (trajectories only). EVO names an environment's bin directory that holds
# evo (default: a new one, from PyPI); PLUMBLINE the command (default: built).
set -euo pipefail
cd "$(dirname "$0")/../.."
data=$(realpath "$1")
kitchen=$data/slam/7scenes_redkitchen
desk=$data/slam/traj_tum_fr1_xyz
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
plumbline=${PLUMBLINE:-}
if [ -z "$plumbline" ]; then
    cargo build --release -q --bin plumbline
    plumbline=${CARGO_TARGET_DIR:-target}/release/plumbline
fi
evo=${EVO:-}
if [ -z "$evo" ]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install -q evo
    evo=$work/venv/bin
fi

# RMSE after scale alignment, by evo.
evo_ate() { HOME=$work MPLBACKEND=Agg "$evo/evo_ape" tum "$1" "$2" -as 2>/dev/null | sed -n 's/^ *rmse[[:space:]]*//p'; }
field() { python3 -c 'import json,sys; v=json.load(open(sys.argv[1]))
for k in sys.argv[2].split("."): v=v[k] if v is not None else None
print("-" if v is None else f"{v:.4g}" if isinstance(v, float) else v)' "$1" "$2"; }

intrinsics=585,585,320,240
for profile in draft standard accurate; do
    for camera in given prior; do
        flags=(--profile "$profile" --sequence-fps 15 --gt "$kitchen/groundtruth.txt")
        [ "$camera" = given ] && flags+=(--intrinsics "$intrinsics")
        "$plumbline" slam "$kitchen/rgb" --out "$work/$profile-$camera" "${flags[@]}" 2>/dev/null
    done
done
"$plumbline" sample --out "$work/sample" --no-dense-truth 2>/dev/null
"$plumbline" score "$work/sample/videos" --out "$work/scores" --jobs 1 --format jsonl 2>/dev/null || [ $? = 3 ]
for clip in dolly_10 dolly_11; do
    "$plumbline" slam "$work/sample/videos/clean__$clip.mp4" --out "$work/$clip" 2>/dev/null
done

mkdir -p tests/benches/results
result=tests/benches/results/slam-$(date +%F).md
{
    echo "# Trajectories by dense adjustment of optical flow: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc --all) cores, load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker coordinator || echo ' with changes'), $("$evo/pip" show evo 2>/dev/null | sed -n 's/^Version: /evo /p')"
    echo "- command: \`tests/benches/slam.sh DATA\`; one thread computes; ATE in metres, RMSE after alignment with scale"
    echo
    echo "## 7-Scenes, red kitchen (80 frames, 640×480), truth by KinectFusion"
    echo
    echo "| profile | intrinsics | fx used | ATE, ours | ATE, evo | turns, ° | keyframes | residual px | flow s | adjustment s | all s |"
    echo "|---|---|---|---|---|---|---|---|---|---|---|"
    for profile in draft standard accurate; do
        for camera in given prior; do
            json=$work/$profile-$camera/slam.json
            all=$(python3 -c 'import json,sys; print("%.2f" % sum(json.load(open(sys.argv[1]))["seconds"].values()))' "$json")
            echo "| $profile | $(field "$json" intrinsics) | $(field "$json" intrinsics_px.fx) | $(field "$json" against_truth.ate_rmse) | $(evo_ate "$kitchen/groundtruth.txt" "$work/$profile-$camera/trajectory.txt") | $(field "$json" against_truth.rotation_rmse_deg) | $(field "$json" keyframes) | $(field "$json" residual_px) | $(field "$json" seconds.flow) | $(field "$json" seconds.adjustment) | $all |"
        done
    done
    echo
    echo "The true fx is 585; the prior (60° over the longer side) is 554."
    echo
    echo "## Our ATE and evo's on other trajectories (TUM fr1/xyz, estimates by others)"
    echo
    echo "| estimate | ours | evo |"
    echo "|---|---|---|"
    for estimate in ORB_kf_mono rgbdslam rgbdslam_drift; do
        file=$desk/freiburg1_xyz-$estimate.txt
        ours=$(cargo run --release -q -p plumbline-vision --example trajectory_error -- "$desk/groundtruth.txt" "$file")
        echo "| $estimate | $ours | $(evo_ate "$desk/groundtruth.txt" "$file") |"
    done
    echo
    echo "## Work saved in \`score\` at \`standard\` (rendered sample, 24 clips of 32 frames, one job)"
    echo
    echo "| scene | clips | adjustment steps | depths estimated | depths not estimated | geometry s per clip | all s per clip |"
    echo "|---|---|---|---|---|---|---|"
    python3 - "$work/scores" <<'PYTHON'
import collections, json, sys
def read(name):
    return {row["video"]: row for row in map(json.loads, open(f"{sys.argv[1]}/{name}.jsonl"))}
costs, rows = read("costs"), read("scores")
groups = collections.defaultdict(list)
for video, row in rows.items():
    groups[row["scene"]].append(costs[video])
for scene, members in sorted(groups.items()):
    total = lambda key: sum(cost[key] for cost in members)
    mean = lambda key: total(key) / len(members)
    print(f"| {scene} | {len(members)} | {total('adjustment_steps')} | {total('depth_cells')} | {total('depth_cells_saved')} | {mean('geometry_s'):.3f} | {mean('total_s'):.3f} |")
PYTHON
    echo
    echo "The sample's travelling cameras look at nearly planar scenes, which homographies explain from frame to"
    echo "frame. \`slam\` asks whether a *rotation* explains them nearly as well, and else estimates depth:"
    echo
    echo "| clip | depth | observable | residual px | flow s | adjustment s |"
    echo "|---|---|---|---|---|---|"
    for clip in dolly_10 dolly_11; do
        json=$work/$clip/slam.json
        echo "| $clip | $(field "$json" depth) | $(field "$json" observable_fraction) | $(field "$json" residual_px) | $(field "$json" seconds.flow) | $(field "$json" seconds.adjustment) |"
    done
} >"$result"
echo "$result"
