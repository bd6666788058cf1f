"""Tables of tradeoff.sh as Markdown: the points, and the plan against real runs. Standard library alone.

    tradeoff_report.py WORK JOBS [README.md]

With a README, writes its table between the two marks in it instead, of the rungs and the points of the front."""
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


BEGIN, END = "<!-- tradeoff_report.py: begin -->", "<!-- tradeoff_report.py: end -->"


def readme(path, found):
    points = [p for p in found["points"] if p["name"] in PROFILES or p["on_front"]]
    lines = [
        f"On {len(found['sample'])} recorded and generated clips (Spearman's ρ to `accurate`; AUROC: generated above recorded, "
        f"by the {found['recipe']} recipe; `h128-f2-e1`: 128 px, finest scale 2, edges of up to 1 frame):", "",
        "| point | CPU s/clip | cost | ρ paper | ρ balanced | AUROC |", "|---|---|---|---|---|---|"]
    lines += [f"| `{p['name']}` | {fixed(p['cpu_s_per_video'], 2)} | {fixed(p['relative_cost'], 2)} | "
              f"{fixed(p['spearman_by_recipe']['paper'], 2)} | {fixed(p['spearman_by_recipe']['balanced'], 2)} | "
              f"{fixed(get(p['auroc_failure'], 'area'), 2)} |" for p in points]
    with open(path) as file:
        text = file.read()
    before, rest = text.split(BEGIN + "\n")
    after = rest.split(END + "\n")[1]
    with open(path, "w") as file:
        file.write(before + "\n".join([BEGIN, *lines, END, after]))


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
if len(sys.argv) > 3:
    readme(sys.argv[3], found)
    sys.exit()
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
print("Planned for clips that are not sampled, by their headers; then measured. \"by the mean\": were they like the sample.\n")
off = lambda planned, real: f"{100 * (planned / real - 1):+.0f}%"
rows = []
for profile in PROFILES:
    told = json.load(open(os.path.join(work, f"plan-{profile}.json")))
    point = next(p for p in told["points"] if p["name"] == profile)
    clips, wall_s = held_out(profile)
    if len(clips) != told["question"]["videos"]:
        sys.exit(f"{profile}: planned for {told['question']['videos']} clips, measured {len(clips)}")
    plan = point["plan"]
    cpu_s = sum(clip["cpu_s"] for clip in clips)
    mean_s = point["cpu_s_per_video"] * len(clips)
    lo, hi = plan["cpu_interval_90_s"]
    rows.append([profile, str(len(clips)), plan["basis"], f"{plan['cpu_s']:.1f} ({lo:.1f}–{hi:.1f})", f"{cpu_s:.1f}",
                 off(plan["cpu_s"], cpu_s), off(mean_s, cpu_s), f"{plan['wall_s']:.1f}", f"{wall_s:.1f}", off(plan["wall_s"], wall_s)])
table(["profile", "clips", "by", "CPU s planned (90%)", "real", "off", "by the mean", f"wall s planned, {jobs} jobs", "real", "off"], rows)
