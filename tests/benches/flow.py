#!/usr/bin/env python3
"""The tables of flow.sh, on standard output. Needs opencv-python-headless; see flow.sh for what is measured.

    flow.py BENCH PAIRS [--rounds N] [--repeat N]

BENCH is the built `worker/vision/benches/flow.rs`, which answers one job a line. OpenCV runs in this process.
Every job alternates: ours, OpenCV's, ours, ... A time is the median over the rounds of each round's median; a
ratio is the median over the rounds of ours / OpenCV's in that round, so that a machine that slows down for a
while slows both.
"""

import argparse
import pathlib
import platform
import re
import shutil
import statistics
import subprocess
import tempfile
import time

import cv2
import numpy

ULTRAFAST, FAST, MEDIUM = (
    cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    cv2.DISOPTICAL_FLOW_PRESET_FAST,
    cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
)
# Name, OpenCV's preset, finest scale.
PRESETS = [
    ("ultrafast", ULTRAFAST, 2),
    ("ultrafast", ULTRAFAST, 1),
    ("ultrafast", ULTRAFAST, 0),
    ("fast", FAST, 2),
    ("medium", MEDIUM, 1),
]
HEIGHTS = [64, 128, 256, 512, 1080]
STAGES = {
    "pyramid, gradients, tensors": "DisFrame::new",
    "inverse search": "Search::run",
    "densify": "Densifier::densify",
    "refine": "Refiner::refine",
    "upsample": "Upsampler::upsample",
}
CALLGRIND_PAIRS = 2  # every job has a first run that is not timed


class Ours:
    """The benchmark's process, kept from job to job."""

    def __init__(self, bench):
        self.process = subprocess.Popen([bench], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, preset, finest, repeat, first, second, truth):
        job = "\t".join(map(str, [preset, finest, repeat, first, second, truth or "-"]))
        self.process.stdin.write(job + "\n")
        self.process.stdin.flush()
        pair_ms, *accuracy = self.process.stdout.readline().split()
        return float(pair_ms), [float(a) for a in accuracy if a != "-"]


def run_opencv(preset, finest, repeat, first, second, truth):
    dis = cv2.DISOpticalFlow_create(preset)
    dis.setFinestScale(finest)
    a, b = (cv2.cvtColor(cv2.imread(str(f)), cv2.COLOR_BGR2GRAY) for f in (first, second))
    times_ms = []
    for run in range(repeat + 1):
        start = time.perf_counter()
        flow = dis.calc(a, b, None)
        if run > 0:  # the first run warms the buffers
            times_ms.append((time.perf_counter() - start) * 1e3)
    return sorted(times_ms)[len(times_ms) // 2], accuracy(flow, truth) if truth else []


def accuracy(flow, truth_path):
    words = numpy.fromfile(truth_path, numpy.float32)
    width, height = words[1:3].view(numpy.int32)
    truth = words[3:].reshape(height, width, 2)
    known = (numpy.abs(truth) <= 1e9).all(-1)
    error = numpy.linalg.norm(flow[known].astype(numpy.float64) - truth[known], axis=-1)
    return [error.mean(), (error > 1).mean(), (error > 3).mean()]


def compare(ours, preset, rounds, repeat, first, second, truth=None):
    """Times in ms, the ratio, and both accuracies."""
    name, opencv_preset, finest = preset
    times = []
    for _ in range(rounds):
        own, own_accuracy = ours.run(name, finest, repeat, first, second, truth)
        peer, peer_accuracy = run_opencv(opencv_preset, finest, repeat, first, second, truth)
        times.append((own, peer))
    own, peer = (statistics.median(column) for column in zip(*times))
    return own, peer, statistics.median(o / p for o, p in times), own_accuracy, peer_accuracy


def label(preset):
    name, _, finest = preset
    return f"{name} {finest}"


def accuracy_table(ours, pairs, rounds, repeat):
    print("\n## Pairs with ground truth\n")
    print("Each cell: ours / OpenCV's. EPE: mean end-point error, px; >1 px, >3 px: share of known pixels.\n")
    print("| preset, finest scale | pair | EPE | >1 px | >3 px | ms | time ratio |")
    print("|---|---|---|---|---|---|---|")
    for preset in PRESETS:
        rows = []
        for pair in pairs:
            files = [pair / name for name in ("frame1.png", "frame2.png", "gt.flo")]
            own, peer, ratio, own_accuracy, peer_accuracy = compare(ours, preset, rounds, repeat, *files)
            rows.append((*(x for both in zip(own_accuracy, peer_accuracy) for x in both), own, peer, ratio))
            print_row(preset, pair.name, rows[-1])
        print_row(preset, "**mean**", [statistics.mean(column) for column in zip(*rows)])


def print_row(preset, name, row):
    epe, epe_peer, one, one_peer, three, three_peer, own, peer, ratio = row
    print(
        f"| {label(preset)} | {name} | {epe:.4f} / {epe_peer:.4f} | {one:.2%} / {one_peer:.2%} | "
        f"{three:.2%} / {three_peer:.2%} | {own:.2f} / {peer:.2f} | {ratio:.2f} |"
    )


def size_table(ours, pair, folder, rounds, repeat):
    print("\n## Time by height\n")
    print(f"{pair.name}, grey, resized (area filter down, bicubic up). Each cell: ms ours / ms OpenCV's = ratio. "
          "At 64 px there is no scale 2: OpenCV then works at a finer scale, ours at the coarsest there is.\n")
    print("| px | " + " | ".join(map(label, PRESETS)) + " |")
    print("|---" * (len(PRESETS) + 1) + "|")
    for height in HEIGHTS:
        frames = resized(pair, folder, height)
        cells = []
        for preset in PRESETS:
            own, peer, ratio, _, _ = compare(ours, preset, rounds, repeat, *frames)
            cells.append(f"{own:.3f} / {peer:.3f} = {ratio:.2f}")
        print(f"| {height} | " + " | ".join(cells) + " |")


def resized(pair, folder, height):
    frames = []
    for name in ("frame1.png", "frame2.png"):
        grey = cv2.cvtColor(cv2.imread(str(pair / name)), cv2.COLOR_BGR2GRAY)
        width = round(grey.shape[1] * height / grey.shape[0])
        method = cv2.INTER_AREA if height < grey.shape[0] else cv2.INTER_CUBIC
        frames.append(folder / f"{height}_{name}")
        cv2.imwrite(str(frames[-1]), cv2.resize(grey, (width, height), interpolation=method))
    return frames


def stage_table(bench, frames, folder):
    print("\n## Instructions by stage\n")
    if not shutil.which("valgrind"):
        print("valgrind is not installed.")
        return
    print("Ours, millions per pair under callgrind (AVX2), the frames of 256 px above.\n")
    print("| preset, finest scale | " + " | ".join(STAGES) + " | sum |")
    print("|---" * (len(STAGES) + 2) + "|")
    for preset in PRESETS:
        name, _, finest = preset
        out = folder / f"{name}{finest}.callgrind"
        job = "\t".join(map(str, [name, finest, CALLGRIND_PAIRS - 1, *frames, "-"]))
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", bench]
        subprocess.run(command, input=job + "\n", text=True, check=True, capture_output=True)
        text = subprocess.run(
            ["callgrind_annotate", "--inclusive=yes", "--threshold=100", str(out)],
            text=True, check=True, capture_output=True,
        ).stdout
        counts = [stage_count(text, function) / CALLGRIND_PAIRS / 1e6 for function in STAGES.values()]
        print(f"| {label(preset)} | " + " | ".join(f"{c:.2f}" for c in [*counts, sum(counts)]) + " |")


def stage_count(text, function):
    """Inclusive instructions of a function; 0 where it is never called."""
    path = function.replace("::", r">?(?:::<[^>]*>)?::")
    for line in text.splitlines():
        found = re.match(r"\s*([\d,]+) .*" + path + r"\b", line)
        if found:
            return int(found.group(1).replace(",", ""))
    return 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bench")
    parser.add_argument("pairs", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pairs = sorted(gt.parent for gt in options.pairs.glob("*/gt.flo"))
    if not pairs:
        raise SystemExit(f"no pair with a gt.flo in {options.pairs}")
    print(f"- OpenCV {cv2.__version__}, NumPy {numpy.__version__}, Python {platform.python_version()}")
    print(f"- {options.rounds} rounds, alternating; each the median of {options.repeat} runs after one that warms the "
          "buffers; times are medians over the rounds, ratios medians of each round's ratio")
    print("- a pair is both frames prepared and the flow found (OpenCV's calc)")
    ours = Ours(options.bench)
    accuracy_table(ours, pairs, options.rounds, options.repeat)
    sized = next((pair for pair in pairs if "Grove" in pair.name), pairs[0])
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        size_table(ours, sized, folder, options.rounds, options.repeat)
        stage_table(options.bench, resized(sized, folder, 256), folder)


if __name__ == "__main__":
    main()
