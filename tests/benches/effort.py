"""Tables of `effort.sh`: costs by camera and profile, and how the rows of a full measurement differ.

    effort.py DIR

DIR holds `<profile>.jsonl` as `worker/examples/effort.rs` prints them: of each clip a line in full, then one with
the flow followed.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from statistics import mean

FULL = {}
STAGES = ["decode_s", "flow_s", "signals_s", "geometry_s"]
# What decides about a clip, other than its score.
DECISIONS = ["status", "scene", "fault_frames", "fault_kinds", "peak_frame"]


def pairs(path):
    """(clip, in full, with the flow followed)."""
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    for full, some in zip(lines[::2], lines[1::2], strict=True):
        assert full["clip"] == some["clip"] and json.loads(full["knobs"]) == FULL
        yield Path(full["clip"]).stem, full, some


def main():
    profiles = [p for p in ("draft", "standard", "accurate") if (Path(sys.argv[1]) / f"{p}.jsonl").exists()]
    measured = {p: list(pairs(Path(sys.argv[1]) / f"{p}.jsonl")) for p in profiles}
    print("\n## Rendered clips of 60 frames, 256×256: CPU seconds by camera\n")
    print("| profile | camera | in full | followed | share of parallax | flow pairs | not searched |")
    print("|---|---|---|---|---|---|---|")
    for profile, clips in measured.items():
        groups = defaultdict(list)
        for clip, full, some in clips:
            camera = clip.split("__")[0]
            if camera in ("static", "rotation", "parallax"):
                groups[camera].append((full["cost"], some["cost"]))
        seconds = {camera: mean(s["cpu_s"] for _, s in members) for camera, members in groups.items()}
        for camera, members in groups.items():
            full = mean(f["cpu_s"] for f, _ in members)
            count = lambda key: sum(s[key] for _, s in members)
            share = seconds[camera] / seconds["parallax"]
            print(f"| {profile} | {camera} | {full:.3f} | {seconds[camera]:.3f} | {share:.0%} | {count('flow_pairs')} | {count('flow_pairs_saved')} |")
    print("\n## All clips: cost and agreement with the full measurement\n")
    print("| profile | scene | clips | in full, s | followed, s | saved | decode, flow, signals, geometry | decisions that differ | reproj_px: largest change | mean change |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for profile, clips in measured.items():
        groups = defaultdict(list)
        for _, full, some in clips:
            groups[full["row"]["scene"] or "none"].append((full, some))
        for scene, members in sorted(groups.items()):
            full, seconds = (mean(m[k]["cost"]["cpu_s"] for m in members) for k in (0, 1))
            total = sum(some["cost"][s] for _, some in members for s in STAGES)
            shares = [sum(some["cost"][s] for _, some in members) / total for s in STAGES]
            differ = sum(any(f["row"][d] != s["row"][d] for d in DECISIONS) for f, s in members)
            changes = [
                s["row"]["reproj_px"] / f["row"]["reproj_px"] - 1
                for f, s in members
                if f["row"]["reproj_px"] and s["row"]["reproj_px"]
            ]
            worst = max(changes, key=abs, default=0.0)
            print(
                f"| {profile} | {scene} | {len(members)} | {full:.3f} | {seconds:.3f} | {1 - seconds / full:.0%} "
                f"| {', '.join(f'{s:.0%}' for s in shares)} | {differ} | {worst:+.2%} | {mean(changes or [0.0]):+.2%} |"
            )


if __name__ == "__main__":
    main()
