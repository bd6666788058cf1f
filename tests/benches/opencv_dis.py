#!/usr/bin/env python3
"""Times OpenCV's DISOpticalFlow, one thread, on the frames and presets of `worker/vision/benches/dis.rs`.

    opencv_dis.py frames DIR A.png B.png      writes <size>_a.png and <size>_b.png, grey, for every size
    opencv_dis.py time DIR [--repeat N] [--only PRESET] [--size NAME]
                                              prints preset,size,pair_ms: the median over the repetitions
    opencv_dis.py versions                    prints the versions of OpenCV, NumPy and Python

Needs opencv-python-headless. Ultrafast's finest scale is 2; ultrafast1 and ultrafast0 change only that.
"""

import argparse
import pathlib
import platform
import statistics
import time

import cv2
import numpy

SIZES = {"64": (64, 64), "128": (128, 128), "256": (256, 256), "512": (512, 512), "1080": (1920, 1080)}
PRESETS = {
    "ultrafast0": (cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST, 0),
    "ultrafast1": (cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST, 1),
    "ultrafast": (cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST, 2),
    "fast": (cv2.DISOPTICAL_FLOW_PRESET_FAST, 2),
    "medium": (cv2.DISOPTICAL_FLOW_PRESET_MEDIUM, 1),
}


def write_frames(folder, sources):
    folder.mkdir(parents=True, exist_ok=True)
    for side, source in zip("ab", sources):
        grey = cv2.imread(source, cv2.IMREAD_GRAYSCALE)
        if grey is None:
            raise SystemExit(f"cannot read {source}")
        for name, (width, height) in SIZES.items():
            smaller = width < grey.shape[1]
            method = cv2.INTER_AREA if smaller else cv2.INTER_CUBIC
            cv2.imwrite(str(folder / f"{name}_{side}.png"), cv2.resize(grey, (width, height), interpolation=method))


def time_pair(a, b, preset, finest_scale, repeat):
    dis = cv2.DISOpticalFlow_create(preset)
    dis.setFinestScale(finest_scale)
    times_ms = []
    for run in range(max(repeat, 2)):
        start = time.perf_counter()
        dis.calc(a, b, None)
        if run > 0:  # the first run warms the buffers
            times_ms.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times_ms)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    frames = commands.add_parser("frames")
    frames.add_argument("folder", type=pathlib.Path)
    frames.add_argument("sources", nargs=2)
    timing = commands.add_parser("time")
    timing.add_argument("folder", type=pathlib.Path)
    timing.add_argument("--repeat", type=int, default=15)
    timing.add_argument("--only", choices=PRESETS)
    timing.add_argument("--size", choices=SIZES)
    commands.add_parser("versions")
    options = parser.parse_args()

    cv2.setNumThreads(1)
    if options.command == "versions":
        print(f"OpenCV {cv2.__version__}, NumPy {numpy.__version__}, Python {platform.python_version()}")
    elif options.command == "frames":
        write_frames(options.folder, options.sources)
    else:
        for size in SIZES:
            if options.size not in (None, size):
                continue
            a, b = (cv2.imread(str(options.folder / f"{size}_{side}.png"), cv2.IMREAD_GRAYSCALE) for side in "ab")
            for name, (preset, finest_scale) in PRESETS.items():
                if options.only in (None, name):
                    print(f"{name},{size},{time_pair(a, b, preset, finest_scale, options.repeat):.4f}")


if __name__ == "__main__":
    main()
