"""Clips with one broken frame: 26 frames from the middle of a clip, clean and with one frame replaced.

    make.py DATA OUT [CLIPS]

Takes CLIPS clips (default 3) of every source, recorded and generated ones each, spaced evenly over their
names, at most 256 px high (the working height; pixel noise is then as strong as it can be).
Writes OUT/KIND/STEM.mkv (FFV1, lossless RGB; KIND is `clean` or one of KINDS) and OUT/truth.csv. Frame and
noise depend on the seed, the kind and the file name alone. Frame 0 is never broken: it is left out of every
statistic.
"""

import csv
import hashlib
import pathlib
import subprocess
import sys

import numpy as np

FRAMES = 26
HEIGHT = 256
SEED = 20261125


def gaussian(sigma):
    return lambda frame, rng: np.clip(frame + rng.normal(0, sigma, frame.shape), 0, 255)


def uniform(frame, rng):
    return rng.integers(0, 256, frame.shape)


def blocks(frame, rng):
    """Squares of one colour each, a sixteenth of the height."""
    height, width, _ = frame.shape
    side = max(1, height // 16)
    coarse = rng.integers(0, 256, (-(-height // side), -(-width // side), 3))
    return coarse.repeat(side, axis=0).repeat(side, axis=1)[:height, :width]


def flat(level):
    return lambda frame, rng: np.full(frame.shape, level)


KINDS = {
    "uniform": uniform,
    "blocks": blocks,
    "black": flat(0),
    "white": flat(255),
    "grey": flat(128),
    "gauss40": gaussian(40),
    "gauss10": gaussian(10),
}


def read(path):
    width, height = size(path)
    if height > HEIGHT:
        width, height = round(width * HEIGHT / height), HEIGHT
    command = ["ffmpeg", "-v", "error", "-i", path, "-fps_mode", "passthrough", "-vf", f"scale={width}:{height}:flags=area"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    data = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    return np.frombuffer(data, np.uint8).reshape(-1, height, width, 3)


def size(path):
    command = ["ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries", "stream=width,height", "-of", "csv=p=0", path]
    words = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout.strip().strip(",").split(",")
    return int(words[0]), int(words[1])


def write(path, frames):
    _, height, width, _ = frames.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    command = ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", "10"]
    command += ["-i", "-", "-c:v", "ffv1", "-threads", "1", "-pix_fmt", "bgr0", path]
    subprocess.run(command, input=frames.astype(np.uint8).tobytes(), check=True)


def chosen(data, count):
    """Paths of `count` clips of each source and side."""
    with open(data / "manifest.csv", newline="") as manifest:
        paths = sorted(row["path"] for row in csv.DictReader(manifest) if row["path"].startswith("rollouts/"))
    sides = {}
    for path in paths:
        sides.setdefault(path.split("__")[0], []).append(path)
    for side in sides.values():
        number = min(count, len(side))
        yield from (side[k * len(side) // number] for k in range(number))


def main(data, out, count="3"):
    data, out = pathlib.Path(data), pathlib.Path(out)
    truth = []
    for path in chosen(data, int(count)):
        # One stem may be recorded and generated.
        stem = pathlib.Path(path).stem + "-" + path.split("/")[1]
        frames = read(data / path)
        start = max(0, (len(frames) - FRAMES) // 2)
        frames = frames[start : start + FRAMES]
        write(out / "clean" / f"{stem}.mkv", frames)
        for kind, make in KINDS.items():
            key = hashlib.sha256(f"{SEED} {kind} {stem}".encode()).digest()
            rng = np.random.default_rng(int.from_bytes(key[:8], "little"))
            broken = int(rng.integers(1, len(frames)))
            changed = frames.copy()
            changed[broken] = make(frames[broken].astype(float), rng)
            write(out / kind / f"{stem}.mkv", changed)
            truth.append([stem, kind, broken, len(frames)])
    with open(out / "truth.csv", "w", newline="") as file:
        csv.writer(file).writerows([["stem", "kind", "frame", "frames"], *truth])


if __name__ == "__main__":
    main(*sys.argv[1:])
