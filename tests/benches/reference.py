"""Splits a run's rows into halves, freezes one, scores the other against it with `plumbline reduce`,
and compares with the scores of the whole corpus: Spearman's rank correlation over the held-out half,
largest difference of a rank, agreement of decisions.

  reference.py BINARY ROWS SPLITS
"""

import json
import pathlib
import random
import subprocess
import sys
import tempfile

RECIPES = ("paper", "balanced")


def ranks(values):
    """Mean ranks of ties."""
    order = sorted(range(len(values)), key=values.__getitem__)
    found = [0.0] * len(values)
    start = 0
    while start < len(order):
        end = start
        while end < len(order) and values[order[end]] == values[order[start]]:
            end += 1
        for k in order[start:end]:
            found[k] = (start + end - 1) / 2
        start = end
    return found


def correlation(a, b):
    mean_a, mean_b = sum(a) / len(a), sum(b) / len(b)
    cov = sum((x - mean_a) * (y - mean_b) for x, y in zip(a, b))
    var = sum((x - mean_a) ** 2 for x in a) * sum((y - mean_b) ** 2 for y in b)
    return cov / var**0.5


def halves(rows, seed):
    """Half of each source, at random; of an odd one out, either side."""
    rng = random.Random(seed)
    by_source = {}
    for row in sorted(rows, key=lambda row: row["video"]):
        by_source.setdefault(pathlib.PurePath(row["video"]).name.split("__")[0], []).append(row)
    fitted, held = [], []
    for source in sorted(by_source):
        group = by_source[source]
        rng.shuffle(group)
        cut = len(group) // 2 + (len(group) % 2 and rng.random() < 0.5)
        fitted += group[:cut]
        held += group[cut:]
    return fitted, held


def read(path):
    return [json.loads(line) for line in path.open()]


def main(binary, rows_dir, splits):
    def run(*words):
        ended = subprocess.run([binary, *map(str, words)], capture_output=True, text=True)
        if ended.returncode not in (0, 3):
            sys.exit(ended.stderr)

    with tempfile.TemporaryDirectory() as name:
        place = pathlib.Path(name)
        whole = {}
        for recipe in RECIPES:
            run("reduce", rows_dir, "--out", place / recipe, "--recipe", recipe, "--format", "jsonl")
            whole[recipe] = {row["video"]: row for row in read(place / recipe / "scores.jsonl")}
        rows = list(whole["paper"].values())
        scored = sum(row["status"] == "scored" for row in rows)
        print(f"{len(rows)} rows, {scored} of them scored, {splits} splits. Corpus-wide scores against those by a reference of the other half, over the held-out half:\n")
        print("| split | recipe | held out | Spearman | largest change of rank | largest change of score | same decision at s<=0 | weight of reproj_px: half, whole |")
        print("|---|---|---|---|---|---|---|---|")
        worst = {recipe: 1.0 for recipe in RECIPES}
        for seed in range(1, splits + 1):
            fitted, held = halves(rows, seed)
            for part, content in (("fitted", fitted), ("held", held)):
                text = "".join(json.dumps(row) + "\n" for row in content)
                (place / f"{part}.jsonl").write_text(text)
            run("reference", "fit", place / "fitted.jsonl", "--out", place / "ref.json")
            frozen = json.loads((place / "ref.json").read_text())["statistics"]
            for recipe in RECIPES:
                out = place / f"against-{recipe}"
                run("reduce", place / "held.jsonl", "--out", out, "--recipe", recipe,
                    "--reference", place / "ref.json", "--format", "jsonl")
                pairs = [(whole[recipe][row["video"]]["anomaly"], row["anomaly"])
                         for row in read(out / "scores.jsonl") if row["anomaly"] is not None]
                a, b = [p[0] for p in pairs], [p[1] for p in pairs]
                rank_a, rank_b = ranks(a), ranks(b)
                rho = correlation(rank_a, rank_b)
                worst[recipe] = min(worst[recipe], rho)
                moved = max(abs(x - y) for x, y in zip(rank_a, rank_b))
                change = max(abs(x - y) for x, y in pairs)
                same = sum((x <= 0) == (y <= 0) for x, y in pairs)
                weight = ""
                if recipe == "paper":
                    own = json.loads((place / recipe / "corpus.json").read_text())["corpus"]["weights"]
                    weight = f"{frozen['population']['weights']['reproj_px']:.3f}, {own['reproj_px']:.3f}"
                print(f"| {seed} | {recipe} | {len(pairs)} | {rho:.4f} | {moved:g} | {change:.2f} | {same} of {len(pairs)} | {weight} |")
        print("\nSmallest: " + ", ".join(f"{recipe} {rho:.4f}" for recipe, rho in worst.items()) + " (goal 0.99).")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
