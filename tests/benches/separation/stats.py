"""AUROC, its bootstrap, and intervals of a share.

AUROC is P(generated > recorded) + P(equal)/2. Clips are resampled with replacement, each side by
itself. (Resampling whole scenes would weigh pairs of one scene more than the AUROC does, and so lift
it; leaving the pairing out makes the interval wider, if anything.)
"""

import math

import numpy as np

RESAMPLES = 4000
SEED = 20261125


def wins(real, generated):
    """[real, generated] matrix: 1 where the generated value is larger, 1/2 where they are equal."""
    real, generated = np.asarray(real)[:, None], np.asarray(generated)[None, :]
    return (generated > real) + 0.5 * (generated == real)


def auroc(real, generated):
    """NaN where a side is empty."""
    table = wins(real, generated)
    return float(table.mean()) if table.size else math.nan


def draws(count, random):
    """[RESAMPLES, count]: how often each of `count` units is drawn in each resample."""
    return random.multinomial(count, np.full(count, 1 / count), size=RESAMPLES).astype(float)


def bootstrap_auroc(real, generated):
    """AUROC of every resample; NaN where a side is empty."""
    if not len(real) or not len(generated):
        return np.full(RESAMPLES, np.nan)
    random = np.random.default_rng(SEED)
    w_real, w_generated = draws(len(real), random), draws(len(generated), random)
    summed = np.einsum("ri,ij,rj->r", w_real, wins(real, generated), w_generated, optimize=True)
    return summed / (len(real) * len(generated))


def interval(samples, level=0.95):
    """Percentile interval."""
    tail = 50 * (1 - level)
    return tuple(float(x) for x in np.nanpercentile(samples, [tail, 100 - tail]))


def binomial_interval(hits, n, level=0.95):
    """Clopper and Pearson (1934), by bisection."""
    tail = (1 - level) / 2

    def at_least(k, p):
        return sum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(k, n + 1))

    def solve(k, target):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if at_least(k, middle) < target else (low, middle)
        return (low + high) / 2

    return (0.0 if hits == 0 else solve(hits, tail), 1.0 if hits == n else solve(hits + 1, 1 - tail))
