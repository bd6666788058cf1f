#!/usr/bin/env python3
"""Beside `plumbline reduce`: seeded rows, the same reduce in Polars and in NumPy, and a comparison.

    reduce_peers.py rows OUT.parquet N [--shuffled] [--lean]
    reduce_peers.py polars|numpy ROWS.parquet OUT RECIPE
    reduce_peers.py compare OUT OTHER
    reduce_peers.py versions

Both peers read the same Parquet and write the same files with the same columns: scores.parquet,
manifests/{keep,drop,review}.jsonl and .parquet, rewards.parquet, and the statistics of every signal
(n, min, max, mean, std, median, MAD, 30-bin histogram, entropy; weights) as corpus.json. Left out of
theirs: Freedman-Diaconis, winsorised and leave-one-out weights, exact sums, refusal of NaN and of
names given twice, intervals.
"""
import argparse
import json
import os

SIGNALS = ["reproj_px", "aepe_worldscore_px", "piecewise_residual", "appearance_ratio",
           "layer_acceleration_q25", "interior_shear", "detail_change_q25"]
PAPER = SIGNALS[:2]
FAMILIES = [SIGNALS[2:4], SIGNALS[4:]]
KEEP = 0.8


def make_rows(path, n, shuffled, lean):
    """Lognormal signals, one row in fifty without a score, names as of a fleet's rollouts. Lean rows have
    short names, the paper's two signals and nothing carried: for runs that must fit on a small disk."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq
    digest = "5f3a9c1e7b" * 6
    with_schema = None
    rng = np.random.default_rng(20261125)
    block = 1 << 20
    order = rng.permutation(n) if shuffled else None
    for start in range(0, n, block):
        index = np.arange(start, min(start + block, n))
        if order is not None:
            index = order[index]
        m = len(index)
        static = rng.random(m) < 0.02
        columns = {
            "video": [f"task_{i * 997 // n:03d}/rollout_{i:09d}.mp4" for i in index.tolist()],
            "group": None,
            "prompt": [f"pick up object {i % 997} and place it in the bin" for i in index.tolist()],
            "seed": index,
            "status": np.where(static, "static", "scored"),
            "frames": rng.integers(20, 200, m).astype(np.uint32),
            "fps": np.full(m, 10.0),
            "width": np.full(m, 256, np.uint32),
            "height": np.full(m, 256, np.uint32),
            "motion_px": rng.lognormal(0.5, 0.6, m),
        }
        columns["group"] = pa.nulls(m, pa.string())
        if lean:
            columns["video"] = [f"{i * 997 // n:03d}/{i:09d}" for i in index.tolist()]
            for name in ("prompt", "seed", "motion_px"):
                del columns[name]
        for k, signal in enumerate(PAPER if lean else SIGNALS):
            values = rng.lognormal(-1 + 0.2 * k, 0.4 + 0.05 * k, m)
            columns[signal] = pa.array(values, mask=static)
        columns["profile_digest"] = pa.array([digest] * m)
        table = pa.table(columns)
        if with_schema is None:
            with_schema = pq.ParquetWriter(path, table.schema, compression="zstd")
        with_schema.write_table(table, row_group_size=65_536)
    with_schema.close()


def by_polars(path, out, recipe):
    """Eager: every column is used more than once, and must be at hand for statistics first."""
    import math
    import polars as pl
    rows = pl.read_parquet(path)
    if not rows["video"].is_sorted():
        rows = rows.sort("video")
    scored = pl.col("status") == "scored"
    statistics, entropies = {}, []
    columns = rows.select([pl.when(scored).then(pl.col(s)).alias(s) for s in SIGNALS])
    basics = columns.select(
        [f(pl.col(s)).alias(f"{s}:{name}") for s in SIGNALS for name, f in {
            "n": lambda c: c.count(), "min": lambda c: c.min(), "max": lambda c: c.max(),
            "mean": lambda c: c.mean(), "std": lambda c: c.std(ddof=0), "median": lambda c: c.median(),
        }.items()]).row(0, named=True)
    mads = columns.select([(pl.col(s) - basics[f"{s}:median"]).abs().median().alias(s) for s in SIGNALS])
    for s in SIGNALS:
        values = columns[s].drop_nulls()
        b = {key: basics[f"{s}:{key}"] for key in ("n", "min", "max", "mean", "std", "median")}
        step = (b["max"] - b["min"]) / 30
        edges = [b["min"] + i * step for i in range(30)] + [b["max"]]
        counts = values.hist(bins=edges, include_breakpoint=False, include_category=False)
        counts = counts.to_series().to_list()
        n = sum(counts)
        b |= {"mad": mads[s][0], "edges": edges, "counts": counts,
              "entropy_nats": -sum(c / n * math.log(c / n) for c in counts if c)}
        statistics[s] = b
    powers = [math.exp(-statistics[s]["entropy_nats"]) for s in PAPER]
    weights = dict(zip(PAPER, [p / sum(powers) for p in powers]))

    def z(s):
        b = statistics[s]
        if s in PAPER:
            return (columns[s] - b["mean"]) / b["std"]
        return ((columns[s] - b["median"]) / b["mad"]).clip(-3, 6)
    zs = {f"z_{s}": z(s) for s in SIGNALS}
    del columns
    rows = rows.with_columns(**zs)
    if recipe == "paper":
        anomaly = sum(weights[s] * pl.col(f"z_{s}") for s in PAPER)
    else:
        anomaly = pl.mean_horizontal([pl.mean_horizontal([pl.col(f"z_{s}") for s in f]) for f in FAMILIES])
    rows = rows.with_columns(anomaly=anomaly)
    n = rows["anomaly"].count()
    rows = rows.with_columns(rank=pl.col("anomaly").rank("ordinal").cast(pl.UInt64))
    kept = -(-n * 80 // 100)
    rows = rows.with_columns(
        anomaly_lo=pl.lit(None, pl.Float64), anomaly_hi=pl.lit(None, pl.Float64),
        percentile=100 * (pl.col("rank").cast(pl.Float64) - 0.5) / n,
        decision=pl.when(pl.col("rank").is_null()).then(pl.lit("review"))
        .when(pl.col("rank") <= kept).then(pl.lit("keep")).otherwise(pl.lit("drop")),
        reward=-pl.col("anomaly"), recipe=pl.lit(recipe))
    os.makedirs(f"{out}/manifests", exist_ok=True)
    rows.write_parquet(f"{out}/scores.parquet", compression="zstd", compression_level=1)
    manifest = ["video", pl.lit(None, pl.String).alias("path"), "group", "anomaly", "rank", "decision",
                "status", pl.lit(None, pl.String).alias("status_reason"), "prompt", "seed"]
    for decision in ("keep", "drop", "review"):
        part = rows.filter(pl.col("decision") == decision).select(manifest)
        part.write_ndjson(f"{out}/manifests/{decision}.jsonl")
        part.write_parquet(f"{out}/manifests/{decision}.parquet", compression="zstd", compression_level=1)
    mean, std = rows["reward"].mean(), rows["reward"].std(ddof=0)
    rewards = rows.filter(pl.col("rank").is_not_null()).select(
        "video", "group", raw=pl.col("reward"), percentile=1 - (pl.col("rank").cast(pl.Float64) - 0.5) / n,
        soft=((pl.col("reward") - (mean - 2 * std)) / (4 * std + 1e-12)).clip(0, 1),
        group_rank=pl.col("rank"), group_size=pl.lit(n, pl.UInt64))
    rewards.write_parquet(f"{out}/rewards.parquet", compression="zstd", compression_level=1)
    finish(out, statistics, weights)


def by_numpy(path, out, recipe):
    """NumPy for the numbers, PyArrow for the files."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
    rows = pq.read_table(path)
    videos = rows["video"]
    if not pc.all(pc.less(videos[:-1], videos[1:])).as_py():
        rows = rows.take(pc.sort_indices(videos))
    scored = pc.equal(rows["status"], "scored").to_numpy()
    statistics, zs = {}, {}
    for s in SIGNALS:
        all_values = rows[s].to_numpy()
        values = all_values[scored & ~np.isnan(all_values)]
        counts, edges = np.histogram(values, 30)
        p = counts[counts > 0] / len(values)
        median = np.median(values)
        b = {"n": len(values), "min": values.min(), "max": values.max(), "mean": values.mean(),
             "std": values.std(), "median": median, "mad": np.median(np.abs(values - median)),
             "edges": edges.tolist(), "counts": counts.tolist(), "entropy_nats": -(p * np.log(p)).sum()}
        statistics[s] = b
        all_values = np.where(scored, all_values, np.nan)
        if s in PAPER:
            zs[s] = (all_values - b["mean"]) / b["std"]
        else:
            zs[s] = np.clip((all_values - median) / b["mad"], -3, 6)
    powers = [np.exp(-statistics[s]["entropy_nats"]) for s in PAPER]
    weights = {s: p / sum(powers) for s, p in zip(PAPER, powers)}
    if recipe == "paper":
        anomaly = sum(weights[s] * zs[s] for s in PAPER)
    else:
        anomaly = sum(sum(zs[s] for s in f) / len(f) for f in FAMILIES) / len(FAMILIES)
    order = np.argsort(anomaly, kind="stable")  # NaN last
    n = int((~np.isnan(anomaly)).sum())
    rank = np.empty(len(anomaly), np.uint64)
    rank[order] = np.arange(1, len(anomaly) + 1, dtype=np.uint64)
    none = np.isnan(anomaly)
    kept = -(-n * 80 // 100)
    decision = np.where(none, 2, np.where(rank <= kept, 0, 1)).astype(np.int8)
    names = pa.array(["keep", "drop", "review"])
    floats = {f"z_{s}": pa.array(zs[s], from_pandas=True) for s in SIGNALS}
    ranks = pa.array(rank, mask=none)
    numbers = {"anomaly": pa.array(anomaly, from_pandas=True), "anomaly_lo": pa.nulls(len(none), pa.float64()),
               "anomaly_hi": pa.nulls(len(none), pa.float64()), "rank": ranks,
               "percentile": pa.array(100 * (rank - 0.5) / n, mask=none),
               "decision": names.take(pa.array(decision)),
               "reward": pa.array(-anomaly, from_pandas=True),
               "recipe": pa.array([recipe]).take(pa.array(np.zeros(len(none), np.int8)))}
    for name, column in (floats | numbers).items():
        rows = rows.append_column(name, column)
    os.makedirs(f"{out}/manifests", exist_ok=True)
    options = {"compression": "zstd", "compression_level": 1, "row_group_size": 65_536}
    pq.write_table(rows, f"{out}/scores.parquet", **options)
    manifest = rows.select(["video", "group", "anomaly", "rank", "decision", "status", "prompt", "seed"])
    manifest = manifest.add_column(1, "path", pa.nulls(len(none), pa.string()))
    manifest = manifest.add_column(7, "status_reason", pa.nulls(len(none), pa.string()))
    import polars as pl  # PyArrow writes no JSON Lines; Polars does so fastest from Python
    for code, name in enumerate(("keep", "drop", "review")):
        part = manifest.filter(pa.array(decision == code))
        pl.from_arrow(part).write_ndjson(f"{out}/manifests/{name}.jsonl")
        pq.write_table(part, f"{out}/manifests/{name}.parquet", **options)
    reward = -anomaly[~none]
    low, width = reward.mean() - 2 * reward.std(), 4 * reward.std() + 1e-12
    there = pa.array(~none)
    rewards = pa.table({
        "video": rows["video"].filter(there), "group": rows["group"].filter(there), "raw": reward,
        "percentile": 1 - (rank[~none] - 0.5) / n, "soft": np.clip((reward - low) / width, 0, 1),
        "group_rank": rank[~none], "group_size": np.full(n, n, np.uint64)})
    pq.write_table(rewards, f"{out}/rewards.parquet", **options)
    finish(out, statistics, weights)


def finish(out, statistics, weights):
    plain = {s: {k: v if isinstance(v, (list, int)) else float(v) for k, v in b.items()} for s, b in statistics.items()}
    with open(f"{out}/corpus.json", "w") as file:
        json.dump({"corpus": {"signals": plain, "weights": {s: float(w) for s, w in weights.items()}}}, file)


def compare(ours, other):
    """The peers must have done the same work: statistics to 1e-9, the keep list but for ties in the last bits."""
    import pyarrow.parquet as pq
    a, b = (json.load(open(f"{out}/corpus.json"))["corpus"] for out in (ours, other))
    worst = 0.0
    for s in SIGNALS:
        for key in ("n", "min", "max", "mean", "std", "median", "mad", "entropy_nats"):
            x, y = a["signals"][s][key], b["signals"][s][key]
            worst = max(worst, abs(x - y) / max(abs(x), 1e-300))
    for s in PAPER:
        worst = max(worst, abs(a["weights"][s] - b["weights"][s]))
    ours_kept, kept = (set(pq.read_table(f"{out}/manifests/keep.parquet", columns=["video"])["video"].to_pylist()) for out in (ours, other))
    print(f"largest difference of a statistic {worst:.1e}; keep lists of {len(ours_kept)} differ in {len(ours_kept ^ kept)}")
    assert worst < 1e-9 and len(ours_kept ^ kept) <= 4


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("task", choices=["rows", "polars", "numpy", "compare", "versions"])
    parser.add_argument("words", nargs="*")
    parser.add_argument("--shuffled", action="store_true")
    parser.add_argument("--lean", action="store_true")
    args = parser.parse_args()
    match args.task:
        case "rows":
            make_rows(args.words[0], int(args.words[1]), args.shuffled, args.lean)
        case "polars":
            by_polars(*args.words)
        case "numpy":
            by_numpy(*args.words)
        case "compare":
            compare(*args.words)
        case "versions":
            import platform, numpy, polars, pyarrow
            print(f"Python {platform.python_version()}, Polars {polars.__version__}, NumPy {numpy.__version__}, PyArrow {pyarrow.__version__}")
