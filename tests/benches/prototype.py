#!/usr/bin/env python3
"""CPU seconds of the Python prototype on one clip: decoding, flow, the signals that `plumbline score`
computes at `standard`, and motion models, one thread.

    prototype.py measure PROTOTYPE CLIP...    prints clip,shared_s,own_s,decode_s,flow_s,frames for each
    prototype.py versions

shared_s: every signal once, flow once per pair and direction and shared by all that read it, as
`plumbline` does: the prototype's functions cut down to that (tests/parity/prototype.py).
own_s: the prototype's functions as they stand, script by script, each with the flow it computes itself.
Needs the packages of tests/parity/requirements.txt.
"""

import pathlib
import platform
import sys
import time
import warnings

import cv2
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "parity"))
import prototype

CLOCK = time.process_time
WHOLE_CLIP = 10**9


def measure(proto, path):
    start = CLOCK()
    frames = prototype.read_frames(path, 256, WHOLE_CLIP)
    decoded = CLOCK()
    clip = proto.feat.Clip(frames[1:], flow=prototype.FLOW)
    flow, spent = clip.fl, [0.0]

    def timed(a, b):
        begin = CLOCK()
        found = flow(a, b)
        spent[0] += CLOCK() - begin
        return found

    clip.fl = timed
    worldscore_errors(proto, clip)
    series = [*prototype.pair_signals(proto, clip), prototype.end_point_errors(clip)]
    series += prototype.bad_frame_and_jump(proto, clip)
    series += [prototype.appear_scores(clip), prototype.flicker_scores(clip), prototype.vanish_scores(clip)]
    series.append(prototype.grey_changes(clip.G))
    prototype.contact(proto, clip)
    _, *arc = prototype.constant_motion(proto, frames, clip)
    proto.feat.rigid(clip, range(clip.n - 1))
    for values in series + arc[1:]:
        prototype.median(values)
    return CLOCK() - start, decoded - start, spent[0], len(frames)


def measure_scripts(proto, path):
    """`feat.series`, `rigid` and `memory`, `detectors.sig3`, `lean2.work`, `arc.arc` and `lean.lean`."""
    start = CLOCK()
    frames = prototype.read_frames(path, 256, WHOLE_CLIP)
    clip = proto.feat.Clip(frames[1:], flow=prototype.FLOW)
    worldscore_errors(proto, clip)
    proto.feat.series(clip)
    proto.feat.rigid(clip, range(clip.n - 1))
    proto.feat.memory(clip)
    proto.detectors.sig3(clip)
    prototype.vanish_scores(clip)
    proto.lean2.D = [{"fr": frames[1:]}]
    proto.lean2.work((0, (prototype.FLOW, "")))
    proto.lean.lean([frames[i] for i in proto.arc.arc(frames)])
    return CLOCK() - start


def worldscore_errors(proto, clip):
    """WorldScore's error of each adjacent pair, which needs the flow before it is brought to the grid; the
    grid's share of it is put where the evidence looks for flow."""
    for t in range(clip.n - 1):
        forward, backward = clip.fl(clip.g[t], clip.g[t + 1]), clip.fl(clip.g[t + 1], clip.g[t])
        proto.core.ws_epe(forward, backward)
        on_grid = [cv2.resize(field, clip.hs, interpolation=cv2.INTER_AREA) for field in (forward, backward)]
        clip.c[t, t + 1] = proto.feat.dq(*on_grid, clip.N[t], clip.N[t + 1])
        clip.c[t + 1, t] = proto.feat.dq(*on_grid[::-1], clip.N[t + 1], clip.N[t])


def main():
    if sys.argv[1:] == ["versions"]:
        print(f"OpenCV {cv2.__version__}, NumPy {np.__version__}, Python {platform.python_version()}")
        return
    warnings.simplefilter("ignore")
    command, folder, *clips = sys.argv[1:]
    assert command == "measure", __doc__
    proto = prototype.load(folder)
    for clip in clips:
        shared, decode, flow, frames = measure(proto, clip)
        seconds = [shared, measure_scripts(proto, clip), decode, flow]
        print(pathlib.Path(clip).name, *(f"{value:.4f}" for value in seconds), frames, sep=",", flush=True)


if __name__ == "__main__":
    main()
