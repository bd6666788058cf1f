"""Helper of reference_effort.sh: frames to score, work per stage, tables. Needs onnxruntime and numpy alone."""

import json
import pathlib
import struct
import sys
import tempfile
import zlib

import numpy as np
import onnxruntime

CELL = 8


def frames(out, count):
    """Writes `count` pictures of 512 x 512 in which something moves."""
    out.mkdir()
    y, x = np.mgrid[:512, :512]
    for n in range(count):
        planes = [((x + 3 * n) * (7 + c) + (y + n) * (5 + 2 * c)) % 256 for c in range(3)]
        rows = np.stack(planes, -1).astype(np.uint8)
        raw = b"".join(b"\0" + row.tobytes() for row in rows)

        def chunk(kind, data):
            return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

        head = struct.pack(">IIBBBBB", 512, 512, 8, 2, 0, 0, 0)
        png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw, 1)) + chunk(b"IEND", b"")
        (out / f"{n:04}.png").write_bytes(png)


def gmac(path, height, width):
    """Multiplications of one run of a graph, for one picture, pair or edge: convolutions and products, as they are
    run (a 3x3 convolution in tiles takes a quarter of a plain one's). Sizes are those that a run tells."""
    sizes = {"height": height, "width": width, "rows": height // CELL, "columns": width // CELL}
    with tempfile.TemporaryDirectory() as work:
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.enable_profiling = True
        options.profile_file_prefix = f"{work}/profile"
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        kinds = {"tensor(float)": np.float32, "tensor(int64)": np.int64}
        shape = lambda value: [sizes.get(d, 1) if isinstance(d, str) else d for d in value.shape]
        session.run(None, {i.name: np.zeros(shape(i), kinds[i.type]) for i in session.get_inputs()})
        events = json.loads(pathlib.Path(session.end_profiling()).read_text())
    total = 0
    for event in events:
        about = event.get("args", {})
        if about.get("op_name") not in ("Conv", "MatMul", "Gemm") or "output_type_shape" not in about:
            continue
        # Weights that were packed beforehand are not listed; those of convolutions are not packed.
        (first, *rest) = (next(iter(value.values())) for value in about["input_type_shape"])
        (out,) = (next(iter(value.values())) for value in about["output_type_shape"])
        total += np.prod(out) * (np.prod(rest[0][1:]) if about["op_name"] == "Conv" else first[-1])
    return float(total) / 1e9


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def sets(models):
    found = {}
    for sidecar in models.glob("*/model.json"):
        found[json.loads(sidecar.read_text())["network"]] = sidecar.parent
    return found


def stages(run, models):
    """Rows of the table of stages, one clip each."""
    droid, sea_raft = (sets(models)[name] for name in ("droid", "sea-raft"))
    profile = json.loads((run / "corpus.json").read_text())["profile"]["parameters"]
    rows = {row["video"]: row for row in lines(run / "scores.jsonl")}
    for cost in lines(run / "costs.jsonl"):
        row = rows[cost["video"]]
        n, (h, w) = row["frames"], (row["height"], row["width"])
        half = [-(-(side // 2) // CELL) * CELL for side in (h, w)]
        part = {name: gmac(sea_raft / f"{name}.onnx", *half) for name in ("features", "context", "update", "upsample")}
        iterations = json.loads((sea_raft / "model.json").read_text())["configuration"]["iterations"]
        flow = n * part["features"] + 2 * (n - 1) * (part["context"] + iterations * part["update"] + part["upsample"])
        scale = (profile["droid"]["area_px"] / (h * w)) ** 0.5
        grid = [int(side * scale) // CELL * CELL for side in (h, w)]
        part = {name: gmac(droid / f"{name}.onnx", *grid) for name in ("features", "context", "gates", "update", "aggregate")}
        edges = cost["edge_updates"]
        track = n * (part["features"] + part["context"] + part["gates"]) + edges * (part["update"] + part["aggregate"])
        yield row, cost, flow, track


def table(work, models, names):
    print("| clip | frames | stage | GMAC | wall s | MAC/s, 1e9 |")
    print("|---|---|---|---|---|---|")
    for row, cost, flow, track in stages(work / names[0], models):
        video = row["video"]
        other = cost["total_s"] - cost["photometric_s"] - cost["tracking_s"]
        print(f"| {video} | {row['frames']} | SEA-RAFT, both ways | {flow:.0f} | {cost['photometric_s']:.0f} | {flow / cost['photometric_s']:.0f} |")
        print(f"| | | DROID-SLAM, {cost['edge_updates']} updates of edges | <= {track:.0f} | {cost['tracking_s']:.0f} | {track / cost['tracking_s']:.0f} |")
        print(f"| | | all else | | {other:.1f} | |")
        print(f"| | | all: {cost['cpu_s']:.0f} CPU s, peak {cost['peak_memory_mib']} MiB | {flow + track:.0f} | {cost['total_s']:.0f} | |")
    print()
    print("| variant | CPU s per clip | of reference | updates of edges | reproj_droid_px, change | aepe_worldscore_px, change |")
    print("|---|---|---|---|---|---|")
    base = {row["video"]: row for row in lines(work / names[0] / "scores.jsonl")}
    base_s = np.mean([cost["cpu_s"] for cost in lines(work / names[0] / "costs.jsonl")])
    for name in names:
        costs, rows = lines(work / name / "costs.jsonl"), lines(work / name / "scores.jsonl")
        cpu_s = np.mean([cost["cpu_s"] for cost in costs])

        def change(column):
            changes = [abs(row[column] / base[row["video"]][column] - 1) for row in rows]
            mean = np.mean([row[column] for row in rows])
            return f"{mean:.4f}" + ("" if name == names[0] else f", {100 * np.mean(changes):.1f}%")

        updates = np.mean([cost["edge_updates"] for cost in costs])
        print(f"| {name.replace('_', ' ')} | {cpu_s:.0f} | {cpu_s / base_s:.2f} | {updates:.0f} | {change('reproj_droid_px')} | {change('aepe_worldscore_px')} |")


def memory(run):
    (row,), (cost,) = lines(run / "scores.jsonl"), lines(run / "costs.jsonl")
    edges = cost["edge_updates"] - (row["frames"] - 1)
    print(f"{row['frames']} keyframes, {edges} edges at once: {row['status']}, peak {cost['peak_memory_mib']} MiB, "
          f"{cost['cpu_s']:.0f} CPU s")


def main():
    command, path, *rest = sys.argv[1:]
    path = pathlib.Path(path)
    match command:
        case "frames":
            frames(path, int(rest[0]))
        case "memory":
            memory(path)
        case "table":
            table(path, pathlib.Path(rest[0]), rest[1:])


main()
