"""Writes the tables from the rows of one set of runs, as Markdown on standard output.

    report.py MANIFEST.csv RUNS
"""

import pathlib
import sys

import numpy as np

import choice
import clips as C
import controls
import stats

PAPER = "paper"
# Recipes among which leave-one-source-out chooses.
CHOICES = [PAPER, "P+T", "trio of means", "trio", "balanced of means", "balanced"]
# A published score and its recomputation may differ by rounding only.
SAME_SCORE = 1e-9


def main(manifest, runs):
    runs = pathlib.Path(runs)
    labels = C.labels(manifest)
    original = C.Clips(C.load(runs / "original.balanced.jsonl"), labels)
    published = {
        recipe: C.Clips(C.load(runs / f"original.{recipe}.jsonl"), labels).column("anomaly")
        for recipe in (PAPER, "balanced")
    }
    columns = {name: original.column(name) for name in C.COLUMNS}
    corpus = {name: values[original.scored] for name, values in columns.items()}
    recipes = {name: C.combine(columns, families, corpus) for name, families in C.FAMILIES.items()}
    check_published(recipes["balanced"], published["balanced"], original.scored)
    recipes = {PAPER: published[PAPER], **recipes}

    print_sides(original)
    names = {**{C.COLUMNS[name]: values for name, values in columns.items()}, **recipes}
    figures = {name: by_source(original, values) for name, values in names.items()}
    print_separation(original, figures, columns)
    print_paired(original, names)
    print_controls(runs, original, columns, figures)
    print_choice(figures)


def check_published(ours, theirs, scored):
    """The analysis must be about the product's own score."""
    gap = np.nanmax(np.abs(ours - theirs)[scored])
    if not gap < SAME_SCORE or (np.isfinite(ours) != np.isfinite(theirs))[scored].any():
        raise SystemExit(f"the recomputed balanced score differs from the published one by {gap}")


def sided(original, source, values):
    """(real indices, generated indices) of the clips that have a value."""
    sides = (original.side(source, False), original.side(source, True))
    return tuple(side[np.isfinite(values[side])] for side in sides)


def by_source(original, values):
    """source → (AUROC, resamples)."""
    found = {}
    for source in C.SOURCES:
        real, generated = sided(original, source, values)
        found[source] = (
            stats.auroc(values[real], values[generated]),
            stats.bootstrap_auroc(values[real], values[generated]),
        )
    return found


def mean_of(figures, sources):
    return (
        float(np.mean([figures[s][0] for s in sources])),
        np.mean([figures[s][1] for s in sources], axis=0),
    )


def short(value):
    if not np.isfinite(value):
        return "n/a"
    text = f"{value:.2f}"
    return text.replace("0.", ".", 1) if text.startswith(("0.", "-0.")) else text


def cell(figure):
    value, samples = figure
    low, high = stats.interval(samples)
    return f"{short(value)} [{short(low)}–{short(high)}]"


def table(header, rows):
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(str(x) for x in row) + " |")
    print()


def print_sides(original):
    print("## Clips\n")
    rows = []
    for source in C.SOURCES:
        real, generated = original.side(source, False), original.side(source, True)
        rows.append((source, len(real), len(generated), "yes" if source in C.MATCHED else "no"))
    table(("source", "recorded", "generated", "same actions"), rows)
    unscored = [f"{row['video']} ({row['status']})" for row in original.rows if row["status"] != "scored"]
    print(f"{len(original.rows)} clips are the corpus; without a score and left out: {', '.join(unscored) or 'none'}.\n")


def print_separation(original, figures, columns):
    print("## AUROC, generated against recorded\n")
    print(
        "Above .50: generated clips have the larger value. 95% bootstrap intervals over clips "
        f"({stats.RESAMPLES} resamples, each side by itself); an interval of 1.00 says only "
        "that no resample can show an overlap. Calibration of the recipes: the whole corpus, as `plumbline score` does it. "
        "`frames` and `motion_px` are baselines: what they reach is length and amount of motion, not physics. "
        "The signals and their families were chosen on sets that overlap with these clips, so that these figures are no "
        "test on unseen data.\n"
    )
    header = ("", *C.MAIN, "mean of 4", *[s for s in C.SOURCES if s not in C.MAIN])
    rows = []
    for name, figure in figures.items():
        cells = [cell(figure[s]) for s in C.SOURCES]
        rows.append((name, *cells[:4], f"**{cell(mean_of(figure, C.MAIN))}**", *cells[4:]))
    table(header, rows)
    print("The same recipes measured by other clips: each source by itself (no labels used), and by its recorded clips alone (labels used).\n")
    rows = []
    for name, families in C.FAMILIES.items():
        for title, pick in (("source", (False, True)), ("recorded of the source", (False,))):
            figure = {}
            for source in C.SOURCES:
                chosen = np.concatenate([original.side(source, side) for side in pick])
                values = C.combine(columns, families, {n: v[chosen] for n, v in columns.items()})
                figure[source] = by_source_one(original, source, values)
            cells = [cell(figure[s]) for s in C.SOURCES]
            rows.append((f"{name}, {title}", *cells[:4], f"**{cell(mean_of(figure, C.MAIN))}**", *cells[4:]))
    table(header, rows)


def by_source_one(original, source, values):
    return by_source(original, values)[source]


def print_paired(original, names):
    print("## Pairs of one scene\n")
    print(
        "Pairs in which the generated clip has the larger value, of all pairs, with Clopper-Pearson 95% intervals. "
        "In ctrlworld_replay each recorded clip meets two generated ones, and two cameras see one scene: its pairs are not independent. "
        "The clips of ctrlworld share the start, not the actions. close_drawer: the recorded run of worldgymnast and the two generated from its actions.\n"
    )
    pairs = {source: scene_pairs(original, source) for source in (*C.MATCHED, "ctrlworld")}
    place = {stem: i for i, stem in enumerate(original.stems)}
    real = place["worldgymnast__close_drawer__real"]
    pairs["close_drawer"] = [(real, place[f"worldgymnast__close_drawer__{name}"]) for name in ("worldgym", "dyna")]
    rows = []
    for name, values in names.items():
        cells = []
        for source in pairs:
            known = [(r, g) for r, g in pairs[source] if np.isfinite(values[r]) and np.isfinite(values[g])]
            hits = sum(values[g] > values[r] for r, g in known)
            low, high = stats.binomial_interval(hits, len(known)) if known else (np.nan, np.nan)
            cells.append(f"{hits}/{len(known)} [{short(low)}–{short(high)}]")
        rows.append((name, *cells))
    table(("", *pairs), rows)


def scene_pairs(original, source):
    real = {original.scene(i): i for i in original.side(source, False)}
    return [(real[original.scene(i)], i) for i in original.side(source, True) if original.scene(i) in real]


def print_controls(runs, original, columns, figures):
    print("## Controls on recorded clips\n")
    files = {kind: runs / f"{kind}.balanced.jsonl" for kind in controls.KINDS}
    degraded = {kind: controls.Degraded(original, C.load(path)) for kind, path in files.items() if path.exists()}
    absent = [controls.KINDS[kind] for kind in controls.KINDS if kind not in degraded]
    if absent:
        print(f"Not measured in this run: {', '.join(absent)}; a kind below rests on the others.\n")
    if not degraded:
        return
    recorded = ~original.generated & original.scored
    reference = {n: v[recorded] for n, v in columns.items()}
    print(
        f"All {recorded.sum()} scored recorded clips and their copies. Each cell: mean shift in standard deviations of the recorded clips / in standard "
        "deviations within a source / AUROC of copies against originals of the same source (.50: blind to the degradation; copies that "
        "get no score are left out, and counted below). Recipes are calibrated on the recorded originals. Other source: recorded against recorded clips of "
        "another source, max(AUROC, 1 − AUROC), on average and at most over pairs of sources with four clips or more (.50 would be blind to camera and robot). "
        "Motion: rank correlation with `motion_px` over recorded clips.\n"
    )
    print(
        "Kind, by rule: `fingerprint` where some degradation moves the recorded clips as far from .50 as generation does, `physics` where none moves them by more than .10, "
        "`mixed` between.\n"
    )
    rows, missing = [], dict.fromkeys(degraded, 0)
    wanted = {C.COLUMNS[n]: [[n]] for n in C.COLUMNS} | C.FAMILIES
    for name, families in wanted.items():
        single = name not in C.FAMILIES
        score = (lambda v: v[families[0][0]]) if single else (lambda v: C.combine(v, families, reference))
        cells, aurocs = [], []
        for kind, copies in degraded.items():
            split = {n: copies.column(n) for family in families for n in family}
            pair = tuple(score({n: v[k] for n, v in split.items()}) for k in (0, 1))
            n, total, within, auroc = copies.compare(pair)
            cells.append(f"{total:+.2f} / {within:+.2f} / {short(auroc)}")
            aurocs.append(auroc)
            missing[kind] = max(missing[kind], int(recorded.sum()) - n) if name == "balanced" else missing[kind]
        values = score(columns)
        mean, most = controls.recorded_against_recorded(original, values)
        motion = controls.rank_correlation(values[recorded], columns["motion_px"][recorded])
        separation = mean_of(figures[name], C.MAIN)
        kind = "baseline" if name in ("frames", "motion_px") else controls.kind_of(separation[0], aurocs)
        rows.append((name, *cells, f"{short(mean)}, {short(most)}", f"{motion:+.2f}", cell(separation), kind))
    table(("", *(controls.KINDS[kind] for kind in degraded), "other source", "motion", "mean of 4", "kind"), rows)
    lost = ", ".join(f"{n} of {controls.KINDS[kind]}" for kind, n in missing.items() if n)
    print(f"Copies without a `balanced` score: {lost or 'none'}.\n")


def print_choice(figures):
    print("## Leave one source out\n")
    print(
        f"Among {', '.join(CHOICES)}, the recipe with the best mean on the other sources, and its AUROC on the source left out. "
        "Intervals choose anew in every resample.\n"
    )
    for title, sources in (("the four", C.MAIN), ("all six", list(C.SOURCES))):
        rows = choice.leave_one_out({name: figures[name] for name in CHOICES}, sources)
        total = (float(np.mean([row[3] for row in rows])), np.mean([row[4] for row in rows], axis=0))
        table(
            (f"left out of {title}", "chosen", "chosen in resamples", "AUROC there"),
            [(s, name, f"{share:.0%}", cell((value, samples))) for s, name, share, value, samples in rows]
            + [("mean", "", "", f"**{cell(total)}**")],
        )
    best = mean_of(figures["balanced"], C.MAIN)[1]
    rows = []
    for other in CHOICES[:-1]:
        gain = best - mean_of(figures[other], C.MAIN)[1]
        low, high = stats.interval(gain)
        rows.append((other, f"{np.mean(gain):+.2f} [{low:+.2f}–{high:+.2f}]"))
    print("What `balanced` gains over the others on the mean of the four, the same resamples for both:\n")
    table(("against", "gain in AUROC"), rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
