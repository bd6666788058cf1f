//! How much the paper's entropy weights owe to the choice of bins and to single rows.
//!
//! Equal-width bins on [min, max] are fragile: one outlier moved a weight from .47 to .78
//! (evidence.md section 3). The weights are found again with Freedman-Diaconis bins, with the
//! winsorised range, and with each row left out in turn. No unit. Nothing fails.

use std::num::NonZeroU16;

use super::double::Double;
use super::histogram::Sorted;
use super::outcome::{Range, WeightSensitivity};
use super::population::{sorted_values, weighing_entropy, weights_by_column};
use super::recipe::{BySignal, PAPER, Yardstick};
use super::weights::entropy_weights;

/// With fewer rows, leaving one out leaves nothing to weigh.
const FEWEST_ROWS: usize = 3;

/// Up to here each row is left out in turn, O(n²) in all. Beyond, only the rows with an extreme value
/// are: any other takes one count from one bin, which changes an entropy by less than
/// (1 + ln n)/n < 0.005, while an extreme one changes the range of all bins.
const LEAVE_OUT_EACH_UP_TO: usize = 2000;

/// Rows beyond the third lowest or highest value of a signal count as extreme.
const EXTREMES: usize = 3;

type Weights = [f64; PAPER.len()];

/// One row of the population.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    /// Its name.
    pub video: &'a str,
    /// Its signals.
    pub values: BySignal<Option<f64>>,
}

/// The weights under other choices; `None` with fewer than 3 rows. `rows` in the order of `video`:
/// of rows that change the weights equally, the first is named.
#[must_use]
pub fn sensitivity(
    rows: &[Row<'_>],
    yardstick: &Yardstick,
    bins: NonZeroU16,
    range: Range,
) -> Option<WeightSensitivity> {
    if rows.len() < FEWEST_ROWS {
        return None;
    }
    let values: Vec<BySignal<Option<f64>>> = rows.iter().map(|row| row.values).collect();
    let samples = PAPER.map(|signal| sorted_values(signal, &values));
    let base = yardstick.paper_weights;
    let weigh = |entropy: &dyn Fn(usize) -> Option<Double>| -> Option<Weights> {
        let entropies: Vec<Option<Double>> = PAPER
            .iter()
            .enumerate()
            .map(|(k, &signal)| {
                if yardstick.rulers[signal].tells() {
                    entropy(k)
                } else {
                    None
                }
            })
            .collect();
        entropy_weights(&entropies)?.try_into().ok()
    };

    let freedman_diaconis = weigh(&|k| {
        // Where the rule says nothing, the run's own bins stand.
        let bins = samples[k].freedman_diaconis_bins().unwrap_or(bins);
        weighing_entropy(&samples[k], bins, Range::Full)
    });
    let winsorised = weigh(&|k| weighing_entropy(&samples[k], bins, Range::Winsorised));

    let entropies = samples
        .each_ref()
        .map(|sample| weighing_entropy(sample, bins, range));
    let mut worst = (0.0, None);
    for row in rows.iter().filter(|row| is_left_out(row, &samples)) {
        let without = weigh(&|k| match row.values[PAPER[k]] {
            Some(value) => weighing_entropy(&samples[k].without(value), bins, range),
            None => entropies[k],
        });
        let change = largest_change(base.as_ref(), without.as_ref());
        if change > worst.0 {
            worst = (change, Some(row.video.to_owned()));
        }
    }
    Some(WeightSensitivity {
        freedman_diaconis: freedman_diaconis
            .as_ref()
            .map(weights_by_column)
            .unwrap_or_default(),
        winsorised: winsorised
            .as_ref()
            .map(weights_by_column)
            .unwrap_or_default(),
        leave_one_out_max_change: worst.0,
        leave_one_out_video: worst.1,
    })
}

fn is_left_out(row: &Row<'_>, samples: &[Sorted; PAPER.len()]) -> bool {
    samples.iter().zip(PAPER).any(|(sample, signal)| {
        let values = sample.values();
        if values.len() <= LEAVE_OUT_EACH_UP_TO {
            return true;
        }
        // Strictly beyond: at most EXTREMES − 1 rows at either end, and every row that is alone at an
        // end is among them. One of several equal extremes leaves the range as it is.
        let (low, high) = (values[EXTREMES - 1], values[values.len() - EXTREMES]);
        row.values[signal].is_some_and(|value| value < low || value > high)
    })
}

/// The largest change of any weight; a weight that is missing counts as 0.
fn largest_change(a: Option<&Weights>, b: Option<&Weights>) -> f64 {
    let (a, b) = (
        a.copied().unwrap_or_default(),
        b.copied().unwrap_or_default(),
    );
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}
