"""Tables of clips with one broken frame against their clean twins.

    report.py TRUTH ROWS [ROWS_BEFORE]

Scores are made from statistics of the clean clips alone, frozen: the same for a clip and its broken twin.
"""

import collections
import csv
import pathlib
import sys

import numpy as np

sys.path.append(str(pathlib.Path(__file__).parent.parent / "separation"))
from clips import FAMILIES, combine, load  # noqa: E402

PAPER = ["reproj_px", "aepe_worldscore_px"]
BINS = 30
# Adjacent frames are one place.
NEAR = 1
SHOWN = ["reproj_px", "aepe_px", "aepe_worldscore_px", "layer_residual_px"]


def values(rows, name):
    return np.array([np.nan if row.get(name) is None else float(row[name]) for row in rows])


def paper(columns, reference):
    """Entropy weights of the reference (design, section 8), population z."""
    entropies, z = [], []
    for name in PAPER:
        known = reference[name][np.isfinite(reference[name])]
        counts, _ = np.histogram(known, BINS)
        share = counts[counts > 0] / len(known)
        entropies.append(-(share * np.log(share)).sum())
        z.append((columns[name] - known.mean()) / known.std())
    weights = np.exp(-np.array(entropies))
    return sum(w * one for w, one in zip(weights / weights.sum(), z))


def balanced(columns, reference):
    return combine(columns, FAMILIES["balanced"], reference)


class Run:
    """Rows by kind and stem, with both scores."""

    def __init__(self, path):
        rows = load(path)
        for row in rows:
            row["kind"], row["stem"] = pathlib.PurePosixPath(row["video"]).with_suffix("").parts[-2:]
        clean = [row for row in rows if row["kind"] == "clean" and row["status"] == "scored"]
        names = sorted({name for family in FAMILIES["balanced"] for name in family} | set(PAPER))
        columns = {name: values(rows, name) for name in names}
        reference = {name: values(clean, name) for name in names}
        for recipe in (paper, balanced):
            for row, score in zip(rows, recipe(columns, reference)):
                row[recipe.__name__] = float(score)
        self.rows = {(row["kind"], row["stem"]): row for row in rows}
        self.clean = [row for row in rows if row["kind"] == "clean"]


class Outcome:
    """One broken clip beside its clean twin."""

    def __init__(self, run, truth):
        self.clean, self.broken = run.rows["clean", truth["stem"]], run.rows[truth["kind"], truth["stem"]]
        self.frame, self.last = int(truth["frame"]), int(truth["frames"]) - 1

    def said(self):
        """The verdict says so, where it did not of the clean twin."""
        return self.broken["status"] == "collapsed" and self.clean["status"] != "collapsed"

    def worse(self, recipe):
        """No score, or a larger one."""
        return self.broken["status"] != "scored" or not self.broken[recipe] <= self.clean[recipe]

    def near(self, column):
        found = self.broken.get(column)
        return found is not None and abs(found - self.frame) <= NEAR

    def flagged(self):
        frames = self.broken.get("fault_frames") or []
        return any(abs(frame - self.frame) <= NEAR for frame in frames)

    def grows(self, column):
        before, after = self.clean.get(column), self.broken.get(column)
        return None if before is None or after is None else after > before


def share(hits):
    hits = list(hits)
    return f"{sum(hits)}/{len(hits)}" if hits else "–"


def table(title, groups):
    print(f"| {title} | clips | collapsed | not better, paper | not better, balanced | fault at the frame | peak_frame | paper's t* |")
    print("|---|---|---|---|---|---|---|---|")
    for name, group in groups.items():
        # t* looks at frames after the warm-up only.
        late = [o for o in group if o.frame > 7]
        cells = [
            len(group),
            share(o.said() for o in group),
            share(o.worse("paper") for o in group),
            share(o.worse("balanced") for o in group),
            share(o.flagged() for o in group),
            share(o.near("peak_frame") for o in group),
            share(o.near("paper_peak_frame") for o in late),
        ]
        print(f"| {name} | " + " | ".join(map(str, cells)) + " |")
    print()


def by(outcomes, key):
    groups = collections.OrderedDict()
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    groups["all"] = outcomes
    return groups


def where(outcome):
    if outcome.frame == 1:
        return "first measured frame"
    return "last frame" if outcome.frame == outcome.last else "inside"


def report(title, run, truths):
    # What has no score when clean (too little motion, a cut of its own) cannot become worse.
    pairs = [Outcome(run, truth) for truth in truths]
    outcomes = [o for o in pairs if o.clean["status"] == "scored"]
    states = collections.Counter(row["status"] for row in run.clean)
    print(f"## {title}\n")
    print("Clean clips: " + ", ".join(f"{n} {status}" for status, n in sorted(states.items())) + ".")
    flagged = sum(bool(row.get("fault_frames")) for row in run.clean)
    print(f"With a fault of any kind: {flagged} of {len(run.clean)} clean clips.\n")
    table("kind", by(outcomes, lambda o: o.broken["kind"]))
    table("where", by(outcomes, where))
    strong = [o for o in outcomes if not o.broken["kind"].startswith("gauss")]
    print("Replaced frames (all kinds but gauss) by source:\n")
    table("source", by(strong, lambda o: o.broken["stem"].split("__")[0] + " " + o.broken["stem"].rsplit("-", 1)[1]))
    print("Clips in which a measure grows, of those that have it:\n")
    print("| kind | " + " | ".join(SHOWN) + " |")
    print("|---|" + "---|" * len(SHOWN))
    for kind, group in by(outcomes, lambda o: o.broken["kind"]).items():
        cells = [share(g for g in (o.grows(column) for o in group) if g is not None) for column in SHOWN]
        print(f"| {kind} | " + " | ".join(cells) + " |")
    print()
    for recipe in ("paper", "balanced"):
        for o in outcomes:
            if not o.worse(recipe):
                print(
                    f"- better by {recipe}: {o.broken['stem']}, {o.broken['kind']} at {o.frame} of {o.last + 1}: "
                    f"{o.clean[recipe]:.3f} → {o.broken[recipe]:.3f}, faults {o.broken.get('fault_kinds')} at {o.broken.get('fault_frames')}"
                )
    print()


def main(truth, rows, before=None):
    with open(truth, newline="") as file:
        truths = list(csv.DictReader(file))
    report("As it is", Run(rows), truths)
    if before:
        report("Before", Run(before), truths)


if __name__ == "__main__":
    main(*sys.argv[1:])
