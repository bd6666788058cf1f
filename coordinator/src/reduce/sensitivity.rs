//! How much the paper's entropy weights owe to the choice of bins and to single rows.
//!
//! Equal-width bins on [min, max] are fragile: one outlier moved a weight from .47 to .78
//! (evidence.md section 3). The weights are found again with Freedman-Diaconis bins, with the
//! winsorised range, and with each row left out in turn. No unit. Only reading the values can fail.

use std::num::NonZeroU16;

use super::double::Double;
use super::histogram::{Edges, freedman_diaconis_bins, range_of, range_without};
use super::order::OrderStatistics;
use super::outcome::{FEWEST_ROWS, Range, WeightSensitivity};
use super::population::{EXTREMES, Surveyed, weighing_entropy, weights_by_column};
use super::recipe::{BySignal, PAPER};
use super::values::Values;
use super::weights::entropy_weights;

/// Up to so many values of a signal each row that has one is left out in turn. Beyond, only the rows
/// with an extreme value are: any other takes one count from one bin, which changes an entropy by
/// less than (1 + ln n)/n < 0.005, while an extreme one changes the range of all bins.
const LEAVE_OUT_EACH_UP_TO: u64 = 2000;

type Weights = [f64; PAPER.len()];

/// One row of the population.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Its name.
    pub video: String,
    /// The paper's signals of it.
    pub values: [Option<f64>; PAPER.len()],
}

/// True for a row that is to be left out in turn.
#[must_use]
pub fn is_left_out(corpus: &Surveyed, values: &[Option<f64>; PAPER.len()]) -> bool {
    PAPER.into_iter().zip(values).any(|(signal, value)| {
        let n = corpus
            .population
            .signals
            .get(signal.column())
            .map_or(0, |s| s.n);
        let Some(value) = *value else { return false };
        if n <= LEAVE_OUT_EACH_UP_TO {
            return true;
        }
        // Strictly beyond: at most EXTREMES − 1 rows at either end, and every row that is alone at an
        // end is among them. One of several equal extremes leaves the range as it is.
        let order = &corpus.order[signal];
        let (low, high) = (order.nth(EXTREMES - 1), order.nth(n - EXTREMES));
        low.is_some_and(|low| value < low) || high.is_some_and(|high| value > high)
    })
}

/// One signal under the histograms in question.
struct Weighed<'a, V> {
    values: &'a V,
    order: &'a OrderStatistics,
    n: u64,
    tells: bool,
    bins: NonZeroU16,
    range: Range,
    /// Bins as the run has them, counted.
    own: Option<(Edges, Vec<u64>)>,
}

/// The weights under other choices; `None` with fewer than 3 rows. `left_out` are the rows that
/// [`is_left_out`] names, in the order of `video`: of rows that change the weights equally, the first
/// is named.
///
/// # Errors
/// Where the values cannot be read.
pub fn sensitivity<V: Values>(
    corpus: &Surveyed,
    signals: &BySignal<V>,
    left_out: &[Row],
    bins: NonZeroU16,
    range: Range,
) -> Result<Option<WeightSensitivity>, V::Error> {
    if corpus.population.n < FEWEST_ROWS {
        return Ok(None);
    }
    let weighed = PAPER.map(|signal| {
        let statistics = corpus.population.signals.get(signal.column());
        let order = &corpus.order[signal];
        Weighed {
            values: &signals[signal],
            order,
            n: statistics.map_or(0, |s| s.n),
            tells: corpus.yardstick.rulers[signal].tells(),
            bins,
            range,
            own: range_of(order, range)
                .map(|range| Edges::equal_width(range, bins))
                .zip(statistics.map(|s| s.counts.clone())),
        }
    });

    let [a, b] = &weighed;
    let [fd_a, fd_b] = [a.freedman_diaconis()?, b.freedman_diaconis()?];
    let [wins_a, wins_b] = [a.winsorised()?, b.winsorised()?];
    let without_a = a.without_each(left_out, 0)?;
    let without_b = b.without_each(left_out, 1)?;
    let base = corpus.yardstick.paper_weights.unwrap_or_default();
    let mut worst = (0.0, None);
    for ((row, a), b) in left_out.iter().zip(without_a).zip(without_b) {
        let change = largest_change(&base, &weights([a, b]).unwrap_or_default());
        if change > worst.0 {
            worst = (change, Some(row.video.clone()));
        }
    }
    let by_column =
        |weights: Option<Weights>| weights.as_ref().map(weights_by_column).unwrap_or_default();
    let fd_bins = PAPER.iter().zip(&weighed).filter_map(|(signal, weighed)| {
        Some((
            signal.column().to_owned(),
            freedman_diaconis_bins(weighed.order, weighed.n)?.get(),
        ))
    });
    Ok(Some(WeightSensitivity {
        freedman_diaconis: by_column(weights([fd_a, fd_b])),
        freedman_diaconis_bins: fd_bins.collect(),
        winsorised: by_column(weights([wins_a, wins_b])),
        leave_one_out_max_change: worst.0,
        leave_one_out_video: worst.1,
    }))
}

fn weights(entropies: [Option<Double>; PAPER.len()]) -> Option<Weights> {
    entropy_weights(&entropies)?.try_into().ok()
}

impl<V: Values> Weighed<'_, V> {
    fn entropy(&self, range: Range, bins: NonZeroU16) -> Result<Option<Double>, V::Error> {
        let Some(range) = range_of(self.order, range).filter(|_| self.tells) else {
            return Ok(None);
        };
        let edges = Edges::equal_width(range, bins);
        let counts = Edges::count(std::slice::from_ref(&edges), self.values)?.remove(0);
        Ok(weighing_entropy(&edges, &counts))
    }

    fn freedman_diaconis(&self) -> Result<Option<Double>, V::Error> {
        // Where the rule says nothing, the run's own bins stand.
        let bins = freedman_diaconis_bins(self.order, self.n).unwrap_or(self.bins);
        self.entropy(Range::Full, bins)
    }

    fn winsorised(&self) -> Result<Option<Double>, V::Error> {
        self.entropy(Range::Winsorised, self.bins)
    }

    /// The entropy with each row left out, the signal being the `k`-th of the paper's.
    fn without_each(&self, left_out: &[Row], k: usize) -> Result<Vec<Option<Double>>, V::Error> {
        let Some((own_edges, own_counts)) = self.own.as_ref().filter(|_| self.tells) else {
            return Ok(vec![None; left_out.len()]);
        };
        // Few rows change the range, and many of those to the same: each range is counted once.
        let mut ranges: Vec<(f64, f64)> = left_out
            .iter()
            .filter_map(|row| range_without(self.order, self.range, row.values[k]?))
            .filter(|&range| range != own_edges.range())
            .collect();
        ranges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        ranges.dedup();
        let other_edges: Vec<Edges> = ranges
            .iter()
            .map(|&range| Edges::equal_width(range, self.bins))
            .collect();
        let other_counts = if other_edges.is_empty() {
            Vec::new()
        } else {
            Edges::count(&other_edges, self.values)?
        };
        let histograms = other_edges.iter().zip(&other_counts);
        let own_entropy = weighing_entropy(own_edges, own_counts);
        Ok(left_out
            .iter()
            .map(|row| {
                let Some(value) = row.values[k] else {
                    return own_entropy;
                };
                let range = range_without(self.order, self.range, value)?;
                let (edges, counts) = std::iter::once((own_edges, own_counts))
                    .chain(histograms.clone())
                    .find(|(edges, _)| edges.range() == range)?;
                let mut counts = counts.clone();
                let bin = edges.bin(value);
                counts[bin] = counts[bin].saturating_sub(1);
                weighing_entropy(edges, &counts)
            })
            .collect())
    }
}

/// The largest change of any weight; a weight that is missing counts as 0.
fn largest_change(a: &Weights, b: &Weights) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}
