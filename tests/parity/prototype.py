"""Runs the Python prototype on a clip: the same signals as `plumbline score` at `standard`, each once.

The prototype is a set of scripts that read a `data.pkl` beside them and compute more than is wanted.
Here its functions are called where they give just the wanted number; elsewhere its lines are repeated
on its own flow and evidence (`Clip.d`), without what is not wanted. `export_prototype.py` checks that
these repetitions give the prototype's own values. Two detectors are in the evidence text alone and are
written from it: `vanish_scores` and the share of moved area in `contact`.
"""

import importlib
import pathlib
import sys
import tempfile
import types

import cv2
import numpy as np

MARGIN = 4
FLOW = "dis_med1"  # the prototype's name for ultrafast with finest scale 1
MODULES = ["core", "feat", "lean2", "detectors", "ex", "ex2", "arc", "lean"]
REMAP = cv2.remap
ARC_MODULES = ["ex", "ex2", "arc", "lean"]


def load(folder, grid=128):
    """The prototype's modules. The ARC scripts have their grid of 128 cells written into them; for
    another grid they are read with that number in its place."""
    copy = tempfile.TemporaryDirectory(prefix="prototype-")
    for source in pathlib.Path(folder).glob("*.py"):
        # Two scripts open their data set when they are imported.
        text = source.read_text().replace("pickle.load(open('data.pkl','rb'))", "[]")
        if source.stem in ARC_MODULES and grid != 128:
            text = text.replace("128", str(grid)).replace("127", str(grid - 1))
        (pathlib.Path(copy.name) / source.name).write_text(text)
    sys.path.insert(0, copy.name)
    modules = {name: importlib.import_module(name) for name in MODULES}
    cv2.setNumThreads(1)
    return types.SimpleNamespace(**modules)


def look_up_exactly(exactly):
    """OpenCV's `remap` rounds coordinates to 1/32 px on pictures of two channels (flow), not on pictures of
    one. With `exactly`, channels are looked up one by one; the text's bilinear look-up is meant."""

    def by_channel(image, *rest, **options):
        if image.ndim == 2:
            return REMAP(image, *rest, **options)
        channels = [REMAP(np.ascontiguousarray(image[..., k]), *rest, **options) for k in range(image.shape[2])]
        return np.stack(channels, -1)

    cv2.remap = by_channel if exactly else REMAP


def read_frames(path, size, count):
    """The first `count` frames, BGR, brought to size × size by area as the prototype's `load` does."""
    video = cv2.VideoCapture(str(path))
    frames = []
    while len(frames) < count:
        ok, frame = video.read()
        if not ok:
            break
        frames.append(cv2.resize(frame, (size, size), interpolation=cv2.INTER_AREA))
    if not frames:
        raise SystemExit(f"{path}: no frame can be read")
    return frames


def inner(evidence):
    """In frame and inside the margin."""
    mask = evidence["ins"].copy()
    mask[:MARGIN] = mask[-MARGIN:] = False
    mask[:, :MARGIN] = mask[:, -MARGIN:] = False
    return mask


def end_point_errors(clip):
    """The corrected end-point error of each adjacent pair (`lean2.work`)."""
    return np.array([clip.d(t, t + 1)["e"][inner(clip.d(t, t + 1))].mean() for t in range(clip.n - 1)])


def pair_signals(proto, clip):
    """P and T of each adjacent pair (`lean2.work`)."""
    rng = np.random.default_rng(0)
    piecewise, appearance = [], []
    for t in range(clip.n - 1):
        evidence = clip.d(t, t + 1)
        consistent = inner(evidence) & (evidence["rho"] < 1)
        moving = consistent & (evidence["m"] > 1)
        residual = evidence["r"][moving].mean() if moving.sum() > 20 else np.nan
        appearance.append(residual / evidence["r"][consistent].mean() if consistent.any() else np.nan)
        piecewise.append(proto.lean2.pw(evidence, rng)[0])
    return np.array(piecewise), np.array(appearance)


def bad_frame_and_jump(proto, clip):
    """V of each frame and xr of each adjacent pair (`feat.series`)."""
    mean = proto.feat.mm
    bad = np.full(clip.n, np.nan)
    for t in range(1, clip.n - 1):
        around = [clip.d(t - 1, t), clip.d(t, t - 1), clip.d(t, t + 1), clip.d(t + 1, t)]
        least = np.minimum.reduce([evidence["q"] for evidence in around])
        across = np.maximum(clip.d(t - 1, t + 1)["q"], clip.d(t + 1, t - 1)["q"])
        bad[t] = mean(np.maximum(0, least - across))
    jump = [mean(clip.d(t, t + 1)["qr"] * clip.d(t + 1, t)["qr"]) for t in range(clip.n - 1)]
    return bad, np.array(jump)


def peak(values):
    """The largest mean over a box of 9 inside the margin."""
    box = cv2.blur(values.astype(np.float32), (9, 9))
    return float(box[MARGIN:-MARGIN, MARGIN:-MARGIN].max())


def median_and_range(window):
    low, middle, high = np.sort(window, 0)
    return middle, high - low


def appear_scores(clip, cut_border=True):
    """step of each frame (`detectors.sig3`). `cut_border` as there; the text does not have it."""
    smooth = np.stack([cv2.blur(frame, (3, 3)) for frame in clip.N])
    scores = np.zeros(clip.n)
    for t in range(3, clip.n - 2):
        before, range_before = median_and_range(smooth[t - 3 : t])
        after, range_after = median_and_range(smooth[t : t + 3])
        change = cv2.blur(np.maximum(0, np.abs(after - before) - range_before - range_after), (3, 3))
        if cut_border:
            change[:2] = change[-2:] = 0
            change[:, :2] = change[:, -2:] = 0
        scores[t] = peak(change)
    return scores


def flicker_scores(clip, cut_leavers=False):
    """pers of each frame (`detectors.sig3`). `cut_leavers` takes r as 0 where the flow leaves the frame."""
    blurred = []
    for t in range(clip.n - 1):
        evidence = clip.d(t, t + 1)
        blurred.append(cv2.blur(np.where(evidence["ins"], evidence["r"], 0) if cut_leavers else evidence["r"], (5, 5)))
    scores = np.zeros(clip.n)
    for t in range(clip.n - 4):
        scores[t + 2] = peak(np.minimum.reduce(blurred[t : t + 4]))
    return scores


def vanish_scores(clip):
    """vanq of each frame, from the text: quiet gate × loss of ln(2 + std7)."""
    texture = []
    for frame in clip.G:
        grey = frame.astype(np.float64)
        mean = cv2.blur(grey, (7, 7))
        texture.append(np.log(2 + np.sqrt(np.maximum(cv2.blur(grey * grey, (7, 7)) - mean * mean, 0))))
    texture = np.stack(texture)
    moving = [cv2.blur((clip.d(t, t + 1)["m"] > 0.8).astype(np.float32), (9, 9)) for t in range(clip.n - 1)]
    scores = np.zeros(clip.n)
    for t in range(3, clip.n - 2):
        before, range_before = median_and_range(texture[t - 3 : t])
        after, range_after = median_and_range(texture[t : t + 3])
        share = np.maximum.reduce([moving[s] for s in (t - 3, t - 2, t, t + 1)])
        scores[t] = peak(np.maximum(0, before - after - range_before - range_after) * np.exp(-share / 0.15))
    return scores


def grey_changes(frames):
    """Mean |ΔI| of each adjacent pair, of which the freeze rule is made."""
    return np.array([np.abs(a.astype(np.float32) - b).mean() for a, b in zip(frames, frames[1:])])


def contact(proto, clip):
    """U (from the text) and R_c (`feat.memory`: `revc_frac`)."""
    moved = np.zeros(clip.G[0].shape, bool)
    last_seen = np.full(moved.shape, -1)
    colours = [cv2.GaussianBlur(frame.astype(np.float32), (0, 0), 1.0) for frame in clip.H]
    last_colour = np.zeros_like(colours[0])
    revealed = changed = 0
    for t in range(clip.n):
        still = np.ones(moved.shape, bool)
        for other in (t - 1, t + 1):
            if 0 <= other < clip.n:
                evidence = clip.d(t, other)
                still &= (evidence["m"] < 0.7) & (evidence["q"] < 0.35)
                if other > t:
                    moved |= inner(evidence) & (evidence["rho"] < 1) & (evidence["m"] > 1)
        still = cv2.erode(still.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        known = still & (last_seen >= 0)
        back, stayed = known & (t - last_seen >= 3), known & (t - last_seen < 3)
        shift = float(np.median((colours[t] - last_colour)[stayed])) if stayed.sum() > 300 else 0
        difference = np.abs(colours[t] - last_colour - shift).mean(-1)
        revealed += back.sum()
        changed += (difference[back] > 20).sum()
        last_seen[still] = t
        last_colour[still] = colours[t][still]
    return float(moved[MARGIN:-MARGIN, MARGIN:-MARGIN].mean()), float(changed / (revealed + 125))


def constant_motion(proto, frames, pairs=None, kept=None):
    """Kept frames (`arc.arc`, from frame 1 on, unless given), their clip, and accs, Sd and sh of each step (`lean.lean`).

    Flow that `pairs`, the clip of frames[1:], already has is not computed again.
    """
    kept = kept or proto.arc.arc(frames)
    clip = proto.ex.C([frames[i] for i in kept])
    for a, i in enumerate(kept):
        for b, j in enumerate(kept):
            known = pairs.c.get((i - 1, j - 1)) if pairs and abs(a - b) == 1 else None
            if known:
                clip.c[a, b] = known["F"]
    mean = proto.ex.mean
    steps = [clip.d(t, t + 1) for t in range(clip.n - 1)]
    shear = np.full(max(clip.n - 1, 0), np.nan)
    acceleration = np.full(max(clip.n - 2, 0), np.nan)
    for t, a in enumerate(steps):
        consistent = a["v"] & (a["rho"] < 1)
        moving = consistent & (a["m"] > 1)
        deviation, _, _ = proto.ex.strain(a["F"])
        interior = cv2.erode(moving.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        shear[t] = mean(deviation, interior) / mean(a["m"], interior)
        if t + 1 < len(steps):
            flow, b = a["F"], steps[t + 1]
            later, rho = a["rm"](b["F"]), a["rm"](b["rho"])
            denominator = (a["m"] + np.linalg.norm(later, axis=-1)) / 2 + 1
            counted = consistent & (rho < 1) & (denominator > 2)
            weight = counted.astype(np.float32)
            smooth = lambda value: cv2.blur(value * weight, (15, 15))
            ratio = np.clip(smooth((later * flow).sum(-1)) / (smooth((flow * flow).sum(-1)) + 0.2), -2, 3)
            own = proto.ex2.hp(later - ratio[..., None] * flow, counted)
            relative = np.minimum(np.linalg.norm(own, axis=-1) / denominator, 4)
            acceleration[t] = mean(relative, counted)
    return kept, clip, acceleration, shear, detail_change(proto, clip, steps)


def detail_change(proto, clip, steps, span=4):
    """sh of the points that start at kept frame 0, 2, 4, ... (`lean.lean`)."""
    height, width = clip.G[0].shape
    x, y = proto.core.grid(height, width)
    detail = [cv2.blur(cv2.absdiff(frame, cv2.GaussianBlur(frame, (0, 0), 2)), (7, 7)) for frame in clip.G]
    change = []
    for t in range(0, clip.n - span, 2):
        to_x, to_y = x.copy(), y.copy()
        alive = np.zeros((height, width), bool)
        alive[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
        for step in steps[t : t + span]:
            flow = cv2.remap(step["F"], to_x, to_y, cv2.INTER_LINEAR)
            rho = cv2.remap(step["rho"], to_x, to_y, cv2.INTER_LINEAR)
            to_x, to_y = to_x + flow[..., 0] * 0.5, to_y + flow[..., 1] * 0.5
            alive &= (rho < 1) & (to_x >= MARGIN) & (to_x <= width - 1 - MARGIN)
            alive &= (to_y >= MARGIN) & (to_y <= height - 1 - MARGIN)
        moved = alive & (2 * np.hypot(to_x - x, to_y - y) > 3)
        after = cv2.remap(detail[t + span], to_x, to_y, cv2.INTER_LINEAR)
        change.append(proto.ex.mean(np.abs(np.log((after + 1) / (detail[t] + 1))), moved))
    return np.array(change)


def median(series):
    """A clip's value: the median of at least three defined ones."""
    return float(np.nanmedian(series)) if np.isfinite(series).sum() >= 3 else float("nan")
