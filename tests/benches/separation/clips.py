"""The clips with their sides, and the recipes on their columns (as coordinator/src/reduce does them)."""

import csv
import json
import pathlib

import numpy as np

# Columns that are compared by themselves, with the name that the tables give them.
COLUMNS = {
    "frames": "frames",
    "motion_px": "motion_px",
    "aepe_worldscore_px": "aepe_worldscore_px",
    "aepe_px": "aepe_px",
    "reproj_px": "reproj_px",
    "layer_residual_px": "layer_residual_px",
    "piecewise_residual": "P",
    "appearance_ratio": "T",
    "layer_acceleration": "accs",
    "layer_acceleration_q25": "accs, quartile",
    "interior_shear": "Sd",
    "detail_change": "sh",
    "detail_change_q25": "sh, quartile",
}
MOVING = ["piecewise_residual", "appearance_ratio"]
MEANS = ["layer_acceleration", "interior_shear", "detail_change"]
QUARTILES = ["layer_acceleration_q25", "interior_shear", "detail_change_q25"]
# `balanced` is the product's; "of means" is what it was before: accs and sh as means over cells.
FAMILIES = {
    "P+T": [MOVING],
    "trio of means": [MEANS],
    "trio": [QUARTILES],
    "balanced of means": [MOVING, MEANS],
    "balanced": [MOVING, QUARTILES],
}
# Compared sides: source → (prefixes of recorded clips, prefixes of generated ones).
SOURCES = {
    "widowx": (["bridge", "openvla_widowx", "worldgymnast"], ["worldgym", "worldgymnast"]),
    "worldgym_pair": (["worldgym_pair"], ["worldgym_pair"]),
    "ctrlworld_replay": (["ctrlworld_replay"], ["ctrlworld_replay"]),
    "ctrlworld": (["ctrlworld"], ["ctrlworld"]),
    "veo": (["veo"], ["veo"]),
    "worldeval": (["worldeval"], ["worldeval"]),
}
# The sources whose mean is the headline; in the other two the sides differ in size and frame rate.
MAIN = ["widowx", "worldgym_pair", "ctrlworld_replay", "ctrlworld"]
# Sources in which recorded and generated clips show one sequence of actions, camera by camera.
MATCHED = ["worldgym_pair", "ctrlworld_replay"]
# Clipping of the robust z.
LOW, HIGH = -3.0, 6.0


class Clips:
    """Rows of one run with their labels; columns as arrays, NaN where a row has no value."""

    def __init__(self, rows, labels=None):
        self.rows = sorted(rows, key=lambda row: row["video"])
        self.stems = [stem(row["video"]) for row in self.rows]
        self.prefix = np.array([s.split("__")[0] for s in self.stems])
        self.scored = np.array([row["status"] == "scored" for row in self.rows])
        self.generated = np.array([labels[s] == "generated" for s in self.stems]) if labels else None

    def column(self, name):
        values = [row[name] for row in self.rows]
        return np.array([np.nan if v is None else float(v) for v in values])

    def side(self, source, generated):
        """Indices of one side's scored clips."""
        prefixes = SOURCES[source][int(generated)]
        label = self.generated if generated else ~self.generated
        return np.flatnonzero(np.isin(self.prefix, prefixes) & label & self.scored)

    def scene(self, index):
        """What a recorded and a generated clip of one scene and camera share: the name's middle."""
        return self.stems[index].split("__")[1]


def stem(video):
    return pathlib.PurePosixPath(video).stem


def load(path):
    with open(path) as file:
        return [json.loads(line) for line in file]


def labels(manifest):
    with open(manifest, newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["path"].startswith("rollouts/")]
    return {stem(row["path"]): row["label"] for row in rows}


def robust_z(values, reference):
    """(value − median)/MAD of the reference, clipped; None where the reference has no spread."""
    reference = reference[np.isfinite(reference)]
    if not len(reference):
        return None
    median = np.median(reference)
    mad = np.median(np.abs(reference - median))
    return np.clip((values - median) / mad, LOW, HIGH) if mad > 0 else None


def combine(columns, families, reference):
    """Mean over families of the mean of the robust z that a clip has.

    `columns`: name → values; `reference`: name → the values that give median and MAD.
    """
    means = []
    for family in families:
        z = [robust_z(columns[name], reference[name]) for name in family]
        means.append(mean_present([one for one in z if one is not None]))
    return mean_present(means)


def mean_present(arrays):
    """Mean along the arrays where there is a value; NaN where there is none."""
    table = np.stack(arrays)
    present = np.isfinite(table)
    count = present.sum(0)
    total = np.where(present, table, 0.0).sum(0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
