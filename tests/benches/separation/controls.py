"""Controls: what the signals say of recorded clips that were only degraded, or filmed elsewhere.

A signal of physics must not rise when a recorded clip is compressed, shrunk or thinned out.
"""

import itertools

import numpy as np

import clips as C
import stats

KINDS = {"half_rate": "half rate", "half_size": "half size", "crf28": "crf 28", "crf35": "crf 35"}


class Degraded:
    """One kind of degraded copies beside the recorded clips they were made from."""

    def __init__(self, original, rows):
        self.by_stem = {C.stem(row["video"]): row for row in rows}
        self.index = np.flatnonzero(~original.generated & original.scored)
        self.original = original

    def column(self, name):
        """(values of the originals, values of the copies); NaN where a copy is not scored."""
        copies = [self.by_stem.get(self.original.stems[i]) for i in self.index]
        values = [
            row[name] if row and row["status"] == "scored" and row[name] is not None else np.nan
            for row in copies
        ]
        return self.original.column(name)[self.index], np.array(values, dtype=float)

    def compare(self, values_of):
        """(n, mean shift in SD of the originals, the same in SD within prefixes, AUROC copy against
        original within prefixes)."""
        before, after = values_of
        prefix = self.original.prefix[self.index]
        both = np.isfinite(before) & np.isfinite(after)
        before, after, prefix = before[both], after[both], prefix[both]
        shift = np.mean(after - before)
        groups = [prefix == p for p in np.unique(prefix)]
        within = np.sqrt(sum(((before[g] - before[g].mean()) ** 2).sum() for g in groups) / (len(before) - len(groups)))
        pairs = [(stats.wins(before[g], after[g]).sum(), g.sum() ** 2) for g in groups]
        auroc = sum(won for won, _ in pairs) / sum(count for _, count in pairs)
        return len(before), shift / before.std(ddof=1), shift / within, auroc


def kind_of(separation, degraded):
    """What a signal measures, by the AUROC of generated against recorded clips and those of the copies.

    fingerprint: some degradation moves recorded clips as far as generation does, or generation moves
    nothing. physics: no degradation moves them by more than .10. mixed: in between.
    """
    gain, worst = separation - 0.5, max(abs(one - 0.5) for one in degraded)
    if gain <= worst:
        return "fingerprint"
    return "physics" if worst <= 0.10 else "mixed"


def rank_correlation(a, b):
    """Spearman's, over the places where both have a value; ties share their mean rank."""
    both = np.isfinite(a) & np.isfinite(b)

    def ranks(values):
        return (values[:, None] > values[None, :]).sum(1) + 0.5 * (values[:, None] == values[None, :]).sum(1)

    return float(np.corrcoef(ranks(a[both]), ranks(b[both]))[0, 1])


def recorded_against_recorded(original, values, least=4):
    """Mean over pairs of recorded sources of max(AUROC, 1 − AUROC): .50 would be blind to the camera."""
    usable = ~original.generated & original.scored & np.isfinite(values)
    prefixes = [p for p in np.unique(original.prefix[usable]) if (usable & (original.prefix == p)).sum() >= least]
    found = []
    for a, b in itertools.combinations(prefixes, 2):
        one = stats.auroc(values[usable & (original.prefix == a)], values[usable & (original.prefix == b)])
        found.append(max(one, 1 - one))
    return float(np.mean(found)), float(np.max(found))
