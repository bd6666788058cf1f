#!/usr/bin/env python3
"""Runs the Python prototype and writes what it read and what it found, one .npz per clip, for
`worker/vision/tests/parity_prototype.rs`.

    export_prototype.py clips PROTOTYPE ROLLOUTS OUT     the ten clips named below, 256 × 256, 41 frames at most
    export_prototype.py fixture PROTOTYPE VIDEO OUT.npz  one small file: 128 × 128, grid of 64, flow in 1/8 px

Frame 0 is left out, as the prototype and `plumbline score` leave it out; arrays start at frame 1.
In a file, n frames on a grid of g × g cells, flow in pixels of the frames' height:
  rgb, grey             [n, s, s, 3] and [n, s, s]: the frames and the grey values flow was computed on (clips only)
  grid_rgb, grid_grey   [n, g, g, 3] and [n, g, g]: the frames on the grid, 8 bits, as the prototype rounds them
  full_flow             [s, s, 2]: the first pair's flow before it is brought to the grid (clips only)
  forward1, backward1   [n - 1, g, g, 2]: flow of adjacent pairs; forward2, backward2 [n - 2, ...] of t and t + 2
  kept                  [k]: positions of the kept frames; kept_forward, kept_backward [k - 1, g, g, 2] (clips only)
  P, T, aepe, xr        [n - 1] per pair; V, step, step_text, vanq, pers, pers_in_frame [n] per frame
  change, change_full   [n - 1]: mean |ΔI| on the grid and at full size
  accs [k - 2], Sd [k - 1], sh [(k - 3) / 2]; U, R_c; clip_*: medians
  rounded_*             the same with flow looked up at multiples of 1/32 px (see `prototype.look_up_exactly`)
Flow is float32, or int16 in units of `flow_unit_px`.
"""

import argparse
import pathlib
import warnings

import cv2
import numpy as np

import prototype

# Ten sources: five recorded, five generated; robots, cameras, sizes and rates differ.
CLIPS = [
    "real/bridge__sample_000000000__teleop.mp4",
    "real/openvla_widowx__put_eggplant_into_pot_clutter_2__openvla.mp4",
    "real/openvla_franka__flip_pot_upright__base_vlm.mp4",
    "real/openvla_rt1robot__move_banana_near_plate__openvla.mp4",
    "real/droid__0__ext.mp4",
    "generated/worldgym__ood_lang_pot_and_grapes__octo.mp4",
    "generated/ctrlworld__pickplace_01_ext__policy.mp4",
    "generated/ctrlworld_replay__sample0_wrist__ckpt100k.mp4",
    "generated/veo__nominal_banana__veo.mp4",
    "generated/wow__cubes_00000023.mp4",
]
FRAMES = 41
# Every second frame, so that there are steps of enough motion.
FIXTURE_FRAMES = 26
FIXTURE_STRIDE = 2
FIXTURE_SIZE = 128
# A mean of four such vectors is a multiple of 1/32.
FIXTURE_FLOW_STEP = 8
FIXTURE_FLOW_UNIT_PX = 1 / 32


# What looks flow up between cells: exported as the prototype computes it too, with rounded look-ups.
LOOKED_UP = ["P", "T", "V", "accs", "Sd", "sh"]


def export(proto, frames, with_frames, kept=None):
    prototype.look_up_exactly(False)
    rounded = measure(proto, frames, with_frames, kept)
    prototype.look_up_exactly(True)
    found = measure(proto, frames, with_frames, kept)
    found.update({f"rounded_{name}": rounded[name] for name in LOOKED_UP})
    return found


def measure(proto, frames, with_frames, kept):
    used = frames[1:]
    clip = proto.feat.Clip(used, flow=prototype.FLOW)
    n = clip.n
    out = {
        "grid_rgb": np.stack(clip.H)[..., ::-1],
        "grid_grey": np.stack(clip.G),
        "reference_height_px": float(clip.g[0].shape[0]),
    }
    if with_frames:
        out["rgb"] = np.stack(used)[..., ::-1]
        out["grey"] = np.stack(clip.g)
        out["full_flow"] = clip.fl(clip.g[0], clip.g[1])
    for span in (1, 2):
        out[f"forward{span}"] = np.stack([clip.d(t, t + span)["F"] for t in range(n - span)])
        out[f"backward{span}"] = np.stack([clip.d(t + span, t)["F"] for t in range(n - span)])
    out["P"], out["T"] = prototype.pair_signals(proto, clip)
    out["aepe"] = prototype.end_point_errors(clip)
    out["V"], out["xr"] = prototype.bad_frame_and_jump(proto, clip)
    out["step"] = prototype.appear_scores(clip)
    out["step_text"] = prototype.appear_scores(clip, cut_border=False)
    out["pers"] = prototype.flicker_scores(clip)
    out["pers_in_frame"] = prototype.flicker_scores(clip, cut_leavers=True)
    out["vanq"] = prototype.vanish_scores(clip)
    out["change"] = prototype.grey_changes(clip.G)
    out["change_full"] = prototype.grey_changes(clip.g)
    out["U"], out["R_c"] = prototype.contact(proto, clip)
    kept, steps, out["accs"], out["Sd"], out["sh"] = prototype.constant_motion(proto, frames, clip, kept)
    out["kept"] = np.array(kept) - 1
    if len(kept) > 1 and with_frames:
        out["kept_forward"] = np.stack([steps.f(t, t + 1) for t in range(steps.n - 1)])
        out["kept_backward"] = np.stack([steps.f(t + 1, t) for t in range(steps.n - 1)])
    for name in ("P", "T", "aepe", "accs", "Sd", "sh"):
        out[f"clip_{name}"] = prototype.median(out[name])
    check_against_prototype(proto, frames, clip, out)
    return out


def check_against_prototype(proto, frames, clip, out):
    """That what `prototype.py` repeats is what the prototype's own functions give."""
    same = lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9, equal_nan=True)
    proto.lean2.D = [{"fr": frames[1:]}]
    _, _, pairs, _ = proto.lean2.work((0, (prototype.FLOW, "")))
    same(out["P"], pairs["pw"])
    same(out["T"], pairs["rmv"] / pairs["rno"])
    same(out["aepe"], pairs["epe"])
    series = proto.feat.series(clip)
    same(out["V"], series["f_skipm_q"])
    same(out["xr"], series["p_xr"])
    same(out["change_full"], series["p_fd"])
    _, peaks = proto.detectors.sig3(clip)
    same(out["step"], np.maximum(peaks["step"][0], 0))
    same(out["pers"], np.maximum(peaks["pers"][0], 0))
    _, memory = proto.feat.memory(clip)
    same(out["R_c"], memory["revc_frac"])
    values, _ = proto.lean.lean([frames[i] for i in out["kept"] + 1])
    for name in ("accs", "Sd", "sh"):
        same(out[f"clip_{name}"], values[name])


def quantise_flow(proto):
    """Makes every flow of the prototype a multiple of 1/8 px, so that it packs well."""
    whole = cv2.DISOpticalFlow_create

    class Quantised:
        def __init__(self, preset):
            self.dis = whole(preset)

        def __getattr__(self, name):
            return getattr(self.dis, name)

        def calc(self, a, b, flow):
            return np.round(self.dis.calc(a, b, flow) * FIXTURE_FLOW_STEP) / np.float32(FIXTURE_FLOW_STEP)

    cv2.DISOpticalFlow_create = Quantised


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("clips", "fixture"):
        command = commands.add_parser(name)
        command.add_argument("prototype", type=pathlib.Path)
        command.add_argument("source", type=pathlib.Path)
        command.add_argument("out", type=pathlib.Path)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", "Mean of empty slice|invalid value|All-NaN")
    if options.command == "clips":
        proto = prototype.load(options.prototype)
        options.out.mkdir(parents=True, exist_ok=True)
        for clip in CLIPS:
            frames = prototype.read_frames(options.source / clip, 256, FRAMES)
            found = export(proto, frames, with_frames=True)
            np.savez(options.out / (pathlib.Path(clip).stem + ".npz"), **found)
            print(clip, len(frames), "frames,", len(found["kept"]), "kept", flush=True)
    else:
        quantise_flow(proto := prototype.load(options.prototype, grid=FIXTURE_SIZE // 2))
        frames = prototype.read_frames(options.source, FIXTURE_SIZE, FIXTURE_FRAMES)[::FIXTURE_STRIDE]
        # Every frame is kept: a small picture moves by too few pixels for steps.
        found = export(proto, frames, with_frames=False, kept=list(range(1, len(frames))))
        for name in [name for name in found if "ward" in name]:
            units = found[name] / FIXTURE_FLOW_UNIT_PX
            assert np.array_equal(units, np.round(units)), name
            found[name] = units.astype(np.int16)
        np.savez_compressed(options.out, flow_unit_px=FIXTURE_FLOW_UNIT_PX, **found)


if __name__ == "__main__":
    main()
