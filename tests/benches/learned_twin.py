"""SEA-RAFT and DROID-SLAM's networks in PyTorch, written from the same texts as Plumbline's graphs, with the
same weights (`deploy/models/seeded.py`): what `learned.sh` holds Plumbline's against.

    learned_twin.py WEIGHTS_DIR NAME REPEAT     one line per repeat: name, CPU s, wall s, mean |output|
    learned_twin.py versions

WEIGHTS_DIR has sea-raft-m.npz and droid.npz. Everything runs on one thread. Needs torch and numpy alone.
"""

import sys
import time

import numpy as np
import torch
import torch.nn.functional as F


class Net:
    """A state dict with the operations that are named by its keys."""

    def __init__(self, path):
        with np.load(path) as archive:
            self.sd = {key: torch.from_numpy(archive[key]) for key in archive.files}

    def conv(self, x, key, stride=1, groups=1):
        weight = self.sd[f"{key}.weight"]
        return F.conv2d(x, weight, self.sd[f"{key}.bias"], stride, weight.shape[-1] // 2, 1, groups)

    def linear(self, x, key):
        return F.linear(x, self.sd[f"{key}.weight"], self.sd[f"{key}.bias"])

    def bn(self, x, key):
        part = (self.sd[f"{key}.{name}"] for name in ("running_mean", "running_var", "weight", "bias"))
        return F.batch_norm(x, *part, eps=1e-5)


# SEA-RAFT


def backbone(n, x, key):
    x = F.relu(n.bn(n.conv(x, f"{key}.conv1", 2), f"{key}.bn1"))
    for layer, (blocks, stride) in enumerate(((3, 1), (4, 2), (6, 2)), 1):
        for block in range(blocks):
            name, step = f"{key}.layer{layer}.{block}", stride if block == 0 else 1
            y = F.relu(n.bn(n.conv(x, f"{name}.conv1", step), f"{name}.bn1"))
            y = F.relu(n.bn(n.conv(y, f"{name}.conv2"), f"{name}.bn2"))
            if step != 1:
                x = n.bn(n.conv(x, f"{name}.downsample.0", step), f"{name}.bn3")
            x = F.relu(x + y)
    return n.conv(x, f"{key}.final_conv")


def look_up(pyramid, at, radius):
    """Correlations of every cell around `at` [1, 2, h, w]; the x offset is the slow index."""
    _, _, h, w = at.shape
    reach = torch.arange(-radius, radius + 1, dtype=torch.float32)
    dx, dy = torch.meshgrid(reach, reach, indexing="ij")
    out = []
    for level, volume in enumerate(pyramid):
        centre = at.permute(0, 2, 3, 1).reshape(h * w, 1, 1, 2) / 2**level
        taps = centre + torch.stack((dx, dy), -1)
        high, wide = volume.shape[-2:]
        size = torch.tensor([wide - 1, high - 1], dtype=torch.float32)
        read = F.grid_sample(volume, 2 * taps / size - 1, align_corners=True)
        out.append(read.reshape(h, w, -1))
    return torch.cat(out, -1).permute(2, 0, 1)[None]


def convex(values, logits):
    n, c, h, w = values.shape
    weights = torch.softmax(logits.view(n, 1, 9, 8, 8, h, w), 2)
    near = F.unfold(values, 3, padding=1).view(n, c, 9, 1, 1, h, w)
    return (weights * near).sum(2).permute(0, 1, 4, 2, 5, 3).reshape(n, c, 8 * h, 8 * w)


def sea_raft(n, first, second):
    first, second = (2 * (x / 255) - 1 for x in (first, second))
    one, two = backbone(n, first, "fnet"), backbone(n, second, "fnet")
    both = n.conv(backbone(n, torch.cat((first, second), 1), "cnet"), "init_conv")
    net, context = both.chunk(2, 1)
    _, channels, h, w = one.shape
    volume = one.flatten(2)[0].T @ two.flatten(2)[0] / channels**0.5
    pyramid = [volume.view(h * w, 1, h, w)]
    for _ in range(3):
        pyramid.append(F.avg_pool2d(pyramid[-1], 2))
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    grid = torch.stack((x, y)).float()[None]

    def head(net):
        return n.conv(F.relu(n.conv(net, "flow_head.0")), "flow_head.2")

    flow = head(net)[:, :2]
    for _ in range(4):
        key = "update_block.encoder"
        c = F.relu(n.conv(look_up(pyramid, grid + flow, 4), f"{key}.convc1"))
        c = F.relu(n.conv(c, f"{key}.convc2"))
        f = F.relu(n.conv(F.relu(n.conv(flow, f"{key}.convf1")), f"{key}.convf2"))
        motion = torch.cat((F.relu(n.conv(torch.cat((c, f), 1), f"{key}.conv")), flow), 1)
        for block in range(2):
            key = f"update_block.refine.{block}"
            x = torch.cat((net, context, motion), 1)
            y = n.conv(x, f"{key}.dwconv", 1, x.shape[1]).permute(0, 2, 3, 1)
            y = F.layer_norm(y, y.shape[-1:], n.sd[f"{key}.norm.weight"], n.sd[f"{key}.norm.bias"], 1e-6)
            y = n.linear(F.gelu(n.linear(y, f"{key}.pwconv1")), f"{key}.pwconv2") * n.sd[f"{key}.gamma"]
            net = n.conv(x + y.permute(0, 3, 1, 2), f"{key}.final")
        flow = flow + head(net)[:, :2]
    logits = 0.25 * n.conv(F.relu(n.conv(net, "upsample_weight.0")), "upsample_weight.2")
    return convex(8 * flow, logits)


# DROID-SLAM


def encoder(n, x, key, norm):
    x = F.relu(norm(n.conv(x, f"{key}.conv1", 2)))
    for layer, stride in enumerate((1, 2, 2), 1):
        for block in range(2):
            name, step = f"{key}.layer{layer}.{block}", stride if block == 0 else 1
            y = F.relu(norm(n.conv(x, f"{name}.conv1", step)))
            y = F.relu(norm(n.conv(y, f"{name}.conv2")))
            if step != 1:
                x = norm(n.conv(x, f"{name}.downsample.0", step))
            x = F.relu(x + y)
    return n.conv(x, f"{key}.conv2")


def droid_features(n, x):
    return encoder(n, x, "fnet", lambda x: F.instance_norm(x, eps=1e-5))


def droid_context(n, x):
    net, context = encoder(n, x, "cnet", lambda x: x).chunk(2, 1)
    return torch.cat((torch.tanh(net), F.relu(context)), 1)


def droid_update(n, net, context, correlation, motion):
    c = F.relu(n.conv(F.relu(n.conv(correlation, "update.corr_encoder.0")), "update.corr_encoder.2"))
    f = F.relu(n.conv(F.relu(n.conv(motion, "update.flow_encoder.0")), "update.flow_encoder.2"))
    x, key = torch.cat((context, c, f), 1), "update.gru"
    mean = (torch.sigmoid(n.conv(net, f"{key}.w")) * net).mean((2, 3), keepdim=True)
    hx = torch.cat((net, x), 1)
    z = torch.sigmoid(n.conv(hx, f"{key}.convz") + n.conv(mean, f"{key}.convz_glo"))
    r = torch.sigmoid(n.conv(hx, f"{key}.convr") + n.conv(mean, f"{key}.convr_glo"))
    q = torch.tanh(n.conv(torch.cat((r * net, x), 1), f"{key}.convq") + n.conv(mean, f"{key}.convq_glo"))
    net = (1 - z) * net + z * q
    change = n.conv(F.relu(n.conv(net, "update.delta.0")), "update.delta.2")
    weight = torch.sigmoid(n.conv(F.relu(n.conv(net, "update.weight.0")), "update.weight.2"))
    return torch.cat((net, change, weight), 1)


# Inputs, as worker/examples/learned_times.rs makes them.


def picture(height, width, frame):
    """uint8 RGB [1, 3, H, W]: stripes that move by three columns and one row a frame."""
    y, x = np.mgrid[:height, :width].astype(np.int64)
    x, y = x + 3 * frame, y + frame
    planes = [(x * (7 + c) + y * (5 + 2 * c) + (x * y) // (11 + c)) % 256 for c in range(3)]
    return torch.from_numpy(np.stack(planes).astype(np.float32))[None]


def ramp(*shape):
    """Values in [-1, 1) that repeat after 1009 numbers."""
    return torch.from_numpy(((np.arange(np.prod(shape)) % 1009) / 504.5 - 1).astype(np.float32)).view(*shape)


def work(folder, name):
    """The network of a name as a call without arguments."""
    kind, size = name.split(" ")
    if kind.startswith("sea-raft-m"):
        n = Net(f"{folder}/sea-raft-m.npz")
        width, height = map(int, size.split("x"))
        frames = [picture(height, width, frame) for frame in (0, 1)]
        if kind == "sea-raft-m-clip":
            return lambda: torch.cat((sea_raft(n, *frames), sea_raft(n, *frames[::-1])))
        return lambda: sea_raft(n, *frames)
    n = Net(f"{folder}/droid.npz")
    if kind == "droid-update":
        edges = [ramp(int(size), channels, 48, 64) for channels in (128, 128, 196, 4)]
        return lambda: droid_update(n, *edges)
    x = picture(384, 512, 0) / 255
    mean, deviation = (torch.tensor(v)[:, None, None] for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    x = (x - mean) / deviation
    return lambda: (droid_features if kind == "droid-features" else droid_context)(n, x)


def main():
    if sys.argv[1] == "versions":
        print(f"PyTorch {torch.__version__}, NumPy {np.__version__}, Python {sys.version.split()[0]}")
        return
    folder, name, repeat = sys.argv[1], sys.argv[2], int(sys.argv[3])
    torch.set_num_threads(1)
    with torch.inference_mode():
        call = work(folder, name)
        call()
        for _ in range(repeat):
            cpu, wall = time.process_time(), time.perf_counter()
            out = call()
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            print(f"{name},{cpu:.4f},{wall:.4f},{float(out.double().abs().mean()):.9e}")


main()
