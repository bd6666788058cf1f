"""Holds this converter's networks against the reference implementations' numbers.

    parity.py GOLDEN_DIR [--out DIR]

GOLDEN_DIR has sea_raft_small.npz and droid_nets.npz: seeded weights and what the reference computes with
them. The weights are converted as a user's are, the graphs run by ONNX Runtime, and the steps between the
graphs by plain NumPy below. --out keeps the converted sets (`sea-raft-small`, `droid`), for the tests of
the same steps in Rust.

Tolerances are the suggested ones of the numbers' authors, who saw float32 and float64 runs of the reference
differ by 4e-5 px (flow), 1.1e-4 (correlations up to 79) and below 1e-5 (DROID).
"""

import argparse
import pathlib
import sys

import numpy as np
import onnx

import model_set
import networks
import runtime

TOLERANCE = {"flow": 1e-3, "uncertainty": 1e-3, "correlation": 1e-3, "sea-raft": 1e-3, "droid": 1e-4}


class GoldenError(Exception):
    """The reference's numbers cannot be read."""


class Comparison:
    """Largest absolute differences by name, printed as a table."""

    def __init__(self):
        self.failed = False

    def hold(self, name, found, expected, tolerance):
        found, expected = np.asarray(found), np.asarray(expected)
        if found.shape != expected.shape:
            raise GoldenError(f"{name}: shape {found.shape}, the reference's is {expected.shape}")
        worst = float(np.abs(found.astype(np.float64) - expected).max())
        self.failed |= not worst <= tolerance
        print(f"  {name:<34} {worst:.1e} of {tolerance:g}{'' if worst <= tolerance else '  TOO MUCH'}")


def _tapped(model, name):
    """A session that also gives an inner tensor (`Graph` names them by their weights' key)."""
    tapped = onnx.ModelProto()
    tapped.CopyFrom(model)
    tapped.graph.output.append(onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None))
    return runtime.session(tapped.SerializeToString())


def _halved(x):
    """Means of 2x2 blocks of the last two axes; odd sizes lose their last row or column."""
    rows, columns = x.shape[-2] // 2, x.shape[-1] // 2
    x = x[..., : 2 * rows, : 2 * columns].reshape(*x.shape[:-2], rows, 2, columns, 2)
    return x.mean((-3, -1), dtype=np.float32)


def _look_up(first, second, at, radius, scale, levels=4):
    """Correlations [levels * (2 radius + 1)^2, h, w] of feature maps [c, h, w] around `at` [2, h, w]:
    per level the x offset is the slow index; bilinear, zero outside."""
    (channels, h, w), reach = first.shape, np.arange(-radius, radius + 1)
    flat = first.reshape(channels, -1).T * np.float32(scale)
    out = []
    for level in range(levels):
        rows, columns = second.shape[1:]
        volume = (flat @ second.reshape(channels, -1)).reshape(-1, rows, columns)
        x, y = (at.reshape(2, -1) / 2**level).astype(np.float32)
        left, top = np.floor(x), np.floor(y)
        fx, fy = x - left, y - top
        cells = np.zeros((2, 2, len(reach), len(reach), h * w), np.float32)
        for j in range(2):
            for i in range(2):
                cx = (left + i)[None, None] + reach[:, None, None]
                cy = (top + j)[None, None] + reach[None, :, None]
                inside = (cx >= 0) & (cx < columns) & (cy >= 0) & (cy < rows)
                ix = np.where(inside, cx, 0).astype(int)
                iy = np.where(inside, cy, 0).astype(int)
                cells[j, i] = np.where(inside, volume[np.arange(h * w), iy, ix], 0)
        upper = cells[0, 0] * (1 - fx) + cells[0, 1] * fx
        lower = cells[1, 0] * (1 - fx) + cells[1, 1] * fx
        out.append((upper * (1 - fy) + lower * fy).reshape(-1, h, w))
        second = _halved(second)
    return np.concatenate(out)


def _convex(values, logits):
    """Up-sampling by 8 of [c, h, w] with [576, h, w] logits: softmax over the 3x3 neighbours."""
    channels, h, w = values.shape
    weights = np.exp(logits - logits.max()).reshape(9, 8, 8, h, w)
    weights /= weights.sum(0)
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)))
    near = np.stack([padded[:, j : j + h, i : i + w] for j in range(3) for i in range(3)])
    up = np.einsum("kabyx,kcyx->cyaxb", weights, near)
    return up.reshape(channels, 8 * h, 8 * w)


def _padding(size):
    total = -size % 8
    return total // 2, total - total // 2


def _sea_raft_pair(held, golden, name, sessions, models):
    first, second = (
        2 * (golden[f"{name}/image{n}"].astype(np.float32).transpose(2, 0, 1) / 255) - 1 for n in (1, 2)
    )
    _, height, width = first.shape
    pad = ((0, 0), _padding(height), _padding(width))
    first, second = (np.pad(x, pad, mode="edge") for x in (first, second))
    maps = runtime.run(sessions["features"], picture=np.stack([first, second]))["features"]
    held.hold(f"{name} features", maps, np.concatenate([golden[f"{name}/fmap{n}"] for n in (1, 2)]), TOLERANCE["sea-raft"])
    pair = np.concatenate([first, second])[None]
    held.hold(
        f"{name} backbone of the context",
        runtime.run(_tapped(models["context"], "cnet.final_conv"), pair=pair)["cnet.final_conv"],
        golden[f"{name}/cnet_backbone"], TOLERANCE["sea-raft"],
    )
    start = runtime.run(sessions["context"], pair=pair)
    net, context, flow, uncertainty = (start[key] for key in ("net", "context", "flow", "uncertainty"))
    held.hold(f"{name} context", np.concatenate([net, context], 1), golden[f"{name}/cnet"], TOLERANCE["sea-raft"])
    flows, uncertainties, nets = [flow], [uncertainty], [net]
    grid = np.stack(np.meshgrid(np.arange(maps.shape[3]), np.arange(maps.shape[2]))).astype(np.float32)
    channels = maps.shape[1]
    for iteration in range(4):
        correlation = _look_up(maps[0], maps[1], grid + flow[0], 4, channels**-0.5)[None]
        if iteration == 0:
            held.hold(f"{name} correlation", correlation, golden[f"{name}/corr_iter1"], TOLERANCE["correlation"])
        step = runtime.run(sessions["update"], net=nets[-1], context=context, correlation=correlation, flow=flow)
        flow = flow + step["flow_change"]
        flows.append(flow), uncertainties.append(step["uncertainty"]), nets.append(step["next_net"])
    held.hold(f"{name} hidden states", np.concatenate(nets[1:]), golden[f"{name}/net_after_iter"], TOLERANCE["sea-raft"])
    held.hold(f"{name} flows at 1/8", np.concatenate(flows), golden[f"{name}/flow_8x"], TOLERANCE["flow"])
    held.hold(f"{name} uncertainties at 1/8", np.concatenate(uncertainties), golden[f"{name}/info_8x"], TOLERANCE["uncertainty"])
    for count in (0, 1, 4):
        logits = runtime.run(sessions["upsample"], net=nets[count])["logits"]
        if count == 0:
            expected = golden[f"{name}/upsample_logits_iter0"]
            held.hold(f"{name} logits", logits[..., : expected.shape[2], : expected.shape[3]], expected, TOLERANCE["sea-raft"])
        (top, _), (left, _) = _padding(height), _padding(width)
        for value, key, scale in ((flows, "flow", 8), (uncertainties, "info", 1)):
            up = _convex(scale * value[count][0], logits[0])[:, top : top + height, left : left + width]
            kind = "flow" if key == "flow" else "uncertainty"
            held.hold(f"{name} {kind}, {count} iterations", up[None], golden[f"{name}/iters{count}/{key}"], TOLERANCE[kind])


def hold_sea_raft(golden, out=None):
    """Compares; true if something is beyond its tolerance."""
    tensors = {key[3:]: golden[key] for key in golden if key.startswith("sd/")}
    configuration, weights, models = networks.sea_raft(tensors)
    if out:
        model_set.write(out / "sea-raft-small", "sea-raft", configuration, weights, models, {"file": "sea_raft_small.npz"})
    sessions = {name: runtime.session(model.SerializeToString()) for name, model in models.items()}
    held = Comparison()
    for name in ("pair0", "pair1"):
        _sea_raft_pair(held, golden, name, sessions, models)
    return held.failed


def hold_droid(golden, out=None):
    """Compares; true if something is beyond its tolerance."""
    tensors = {key[3:]: golden[key] for key in golden if key.startswith("sd/")}
    configuration, weights, models = networks.droid(tensors)
    if out:
        model_set.write(out / "droid", "droid", configuration, weights, models, {"file": "droid_nets.npz"})
    sessions = {name: runtime.session(model.SerializeToString()) for name, model in models.items()}
    held, tolerance = Comparison(), TOLERANCE["droid"]
    pictures = golden["images_bgr"][..., ::-1].astype(np.float32).transpose(0, 3, 1, 2) / 255
    mean, deviation = (np.array(v, np.float32)[:, None, None] for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    pictures = (pictures - mean) / deviation
    held.hold("normalised pictures", pictures, golden["inputs"], tolerance)
    maps = runtime.run(sessions["features"], picture=pictures)["features"]
    held.hold("features", maps, golden["fnet"], tolerance)
    raw = runtime.run(_tapped(models["context"], "cnet.conv2"), picture=pictures)
    held.hold("backbone of the context", raw["cnet.conv2"], golden["cnet_raw"], tolerance)
    held.hold("hidden state", raw["net"], golden["net0"], tolerance)
    held.hold("context", raw["context"], golden["inp0"], tolerance)

    ii, jj = golden["ii"], golden["jj"]
    at = golden["coords1"].transpose(0, 3, 1, 2)
    correlation = np.stack([_look_up(maps[i], maps[j], at[e], 3, 1 / 16) for e, (i, j) in enumerate(zip(ii, jj))])
    held.hold("correlation", correlation, golden["corr"], tolerance)
    gates = runtime.run(sessions["gates"], context=raw["context"])["gates"]
    edges = {"gates": gates[ii], "correlation": correlation, "motion": golden["motn"]}
    update = runtime.run(sessions["update"], net=raw["net"][ii], **edges)
    held.hold("update: hidden state", update["next_net"], golden["upd/net1"], tolerance)
    held.hold("update: change", update["target_change"].transpose(0, 2, 3, 1), golden["upd/delta"], tolerance)
    held.hold("update: weight", update["weight"].transpose(0, 2, 3, 1), golden["upd/weight"], tolerance)
    averages = (np.unique(ii)[:, None] == ii[None]).astype(np.float32)
    averages /= averages.sum(1, keepdims=True)
    aggregate = runtime.run(sessions["aggregate"], net=update["next_net"], averages=averages)
    held.hold("aggregate: damping", aggregate["damping"][:, 0], golden["upd/eta"], tolerance)
    logits = runtime.run(sessions["upsample"], aggregate=aggregate["aggregate"])["logits"]
    held.hold("aggregate: logits", logits, golden["upd/upmask"], tolerance)
    again = runtime.run(sessions["update"], net=update["next_net"], **edges)
    held.hold("second update: hidden state", again["next_net"], golden["upd2/net"], tolerance)
    held.hold("second update: change", again["target_change"].transpose(0, 2, 3, 1), golden["upd2/delta"], tolerance)
    held.hold("second update: weight", again["weight"].transpose(0, 2, 3, 1), golden["upd2/weight"], tolerance)

    grid = np.stack(np.meshgrid(np.arange(maps.shape[3]), np.arange(maps.shape[2]))).astype(np.float32)
    correlation = _look_up(maps[0], maps[1], grid, 3, 1 / 16)[None]
    still = np.zeros_like(golden["motn"][:1])
    step = runtime.run(
        sessions["update"], net=raw["net"][:1], gates=gates[:1], correlation=correlation, motion=still
    )
    held.hold("motion filter: correlation", correlation, golden["mf/corr"], tolerance)
    held.hold("motion filter: change", step["target_change"].transpose(0, 2, 3, 1), golden["mf/delta"], tolerance)
    held.hold("motion filter: weight", step["weight"].transpose(0, 2, 3, 1), golden["mf/weight"], tolerance)
    norm = np.sqrt((step["target_change"] ** 2).sum(1)).mean()
    held.hold("motion filter: mean change", norm, golden["mf/mean_norm"], tolerance)
    up = np.stack([_convex(d[None], l)[0] for d, l in zip(golden["cvx/disp"], logits)])
    held.hold("up-sampled disparity", up, golden["cvx/up"], tolerance)
    return held.failed


NETWORKS = {"sea-raft": ("sea_raft_small.npz", hold_sea_raft), "droid": ("droid_nets.npz", hold_droid)}


def report(directory, names, out=None):
    """Compares and prints; true if something is beyond its tolerance."""
    failed = False
    for network in names:
        name, compare = NETWORKS[network]
        path = pathlib.Path(directory) / name
        try:
            with np.load(path, allow_pickle=False) as archive:
                golden = {key: archive[key] for key in archive.files}
        except (OSError, ValueError) as error:
            raise GoldenError(f"{path}: {error}") from None
        print(f"{network} against the reference (largest absolute difference):")
        failed |= compare(golden, out)
    return failed


def main():
    parser = argparse.ArgumentParser(description="Compares the networks with the reference's numbers.")
    parser.add_argument("golden", type=pathlib.Path, help="directory of sea_raft_small.npz and droid_nets.npz")
    parser.add_argument("--out", type=pathlib.Path, help="keep the converted sets here")
    arguments = parser.parse_args()
    try:
        failed = report(arguments.golden, NETWORKS, arguments.out)
    except GoldenError as error:
        sys.exit(f"error: {error}")
    if failed:
        sys.exit("error: beyond the tolerance")


if __name__ == "__main__":
    main()
