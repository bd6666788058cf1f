"""Leave one source out: the recipe is chosen by the mean of the other sources, and its figure is that
on the source left out. In every resample the choice is made anew, so that the interval holds it."""

import numpy as np


def leave_one_out(figures, sources):
    """`figures`: recipe → source → (AUROC, [resamples]).

    Returns rows (source, chosen recipe, share of resamples that choose it, AUROC, samples).
    """
    recipes = list(figures)
    rows = []
    for left_out in sources:
        others = [s for s in sources if s != left_out]
        means = [np.mean([figures[r][s][0] for s in others]) for r in recipes]
        sampled = np.array([np.mean([figures[r][s][1] for s in others], axis=0) for r in recipes])
        best = np.nanargmax(np.where(np.isfinite(sampled), sampled, -1), axis=0)
        left = np.array([figures[r][left_out][1] for r in recipes])
        chosen = int(np.argmax(means))
        samples = left[best, np.arange(left.shape[1])]
        rows.append((left_out, recipes[chosen], float(np.mean(best == chosen)), figures[recipes[chosen]][left_out][0], samples))
    return rows
