"""Tables of tradeoff.sh as Markdown: the points, and the plan against real runs. Standard library alone."""
import json
import os
import sys

work, jobs = sys.argv[1], int(sys.argv[2])
PROFILES = ("draft", "standard", "accurate")


def fixed(value, decimals):
    return "–" if value is None else f"{value:.{decimals}f}"


def get(value, *keys):
    for key in keys:
        value = None if value is None else value.get(key)
    return value


def flips(point):
    counts = point["agreement"]["flips"]
    return counts["keep_to_drop"] + counts["drop_to_keep"] + counts["review"]


def table(headings, rows):
    print("| " + " | ".join(headings) + " |")
    print("|" + "---|" * len(headings))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def held_out(profile):
    directory = os.path.join(work, f"held-out-{profile}")
    rows = {}
    for name in ("scores", "costs"):
        with open(os.path.join(directory, f"{name}.jsonl")) as lines:
            for line in lines:
                row = json.loads(line)
                rows.setdefault(row["video"], {}).update(row)
    with open(f"{directory}.json") as summary:
        return list(rows.values()), json.load(summary)["elapsed_s"]


found = json.load(open(os.path.join(work, "tradeoff.json")))
points = found["points"]
top = next(point for point in points if point["top"])
print(f"- sample {len(found['sample'])} of {found['corpus_videos']} clips in proportion to recorded and generated; recipe "
      f"{found['recipe']}, keep rule {found['keep']}; {found['top_uncertain']} of the top point's decisions lie within its own intervals")
print("- flow EPE: px of a 256-px-high picture, rendered scenes at 640×480; pose: trajectory error in % of the path; "
      "faults: AUROC / temporal hit on rendered clips; label AUROC: generated above recorded")
print()
print("## The front\n")
table(
    ["point", "front", "CPU s/clip", "cost", "decode, flow, signals, geometry s", "Spearman", "Kendall", "error 50%, 95%",
     "flips", "within intervals", "label AUROC", "flow EPE", "moving", "pose %", "depth", "faults"],
    [[p["name"] + (" (top)" if p["top"] else ""), "*" if p["on_front"] else "", fixed(p["cpu_s_per_video"], 3),
      fixed(p["relative_cost"], 3), ", ".join(fixed(p["stages_s"][s], 2) for s in ("decode", "flow", "signals", "geometry")),
      fixed(p["agreement"]["spearman"], 3), fixed(p["agreement"]["kendall"], 3),
      fixed(p["agreement"]["score_error_median"], 3) + ", " + fixed(p["agreement"]["score_error_p95"], 3),
      f"{flips(p)} of {p['agreement']['flips']['videos']}", str(p["agreement"]["flips_within_interval"]),
      fixed(get(p["auroc_failure"], "area"), 3), fixed(get(p["truth"], "flow_epe_px"), 3),
      fixed(get(p["truth"], "flow_epe_moving_px"), 3), fixed(get(p["truth"], "pose_error_percent"), 2),
      fixed(get(p["truth"], "depth_error"), 3),
      fixed(get(p["faults"], "auroc"), 2) + " / " + fixed(get(p["faults"], "temporal_hit"), 2)] for p in points])
print("## Which measures move (Spearman to the top point)\n")
signals = list(top["agreement"]["spearman_by_signal"])
table(
    ["point", "paper", "balanced"] + [f"`{signal}`" for signal in signals],
    [[p["name"], fixed(p["spearman_by_recipe"]["paper"], 3), fixed(p["spearman_by_recipe"]["balanced"], 3)]
     + [fixed(p["agreement"]["spearman_by_signal"][signal], 3) for signal in signals] for p in points])
print("## The plan against real runs\n")
print("Predicted from the sample; measured on clips that are not in it. \"by shape\" knows their lengths and sizes.\n")
rows = []
for profile in PROFILES:
    point = next(p for p in points if p["name"] == profile)
    clips, wall_s = held_out(profile)
    share = len(clips) / found["question"]["videos"]
    plan, model = point["plan"], point["cost_model"]
    cpu_s = sum(clip["cpu_s"] for clip in clips)
    planned_cpu_s = plan["cpu_s"] * share
    # The question's cores are the jobs; what the last videos leave idle does not depend on their number.
    planned_wall_s = planned_cpu_s / jobs + (plan["wall_s"] - plan["cpu_s"] / jobs)
    height = point["working_height_px"]
    shaped_s = sum(
        model["decode_s_per_mpx"] * clip["frames"] * clip["width"] * clip["height"] / 1e6
        + (model["measure_s_per_mpx"] + model["adjust_s_per_mpx"] * model["parallax_share"])
        * (clip["frames"] - 1) * height * height * clip["width"] / clip["height"] / 1e6
        for clip in clips if clip.get("frames"))
    off = lambda planned, real: f"{100 * (planned / real - 1):+.0f}%"
    lo, hi = (bound * share for bound in plan["cpu_interval_90_s"])
    rows.append([profile, str(len(clips)), f"{planned_cpu_s:.1f} ({lo:.1f}–{hi:.1f})", f"{cpu_s:.1f}", off(planned_cpu_s, cpu_s),
                 f"{shaped_s:.1f}", off(shaped_s, cpu_s), f"{planned_wall_s:.1f}", f"{wall_s:.1f}", off(planned_wall_s, wall_s)])
table(["profile", "clips", "CPU s planned", "real", "off", "by shape", "off", f"wall s planned, {jobs} jobs", "real", "off"], rows)
