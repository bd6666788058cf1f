//! Statistics of one population of scored rows, and the yardstick that they make.
//!
//! Per signal: exact mean and σ, median and MAD, histogram and entropy (design section 8); for the
//! paper's two signals the entropy weights. In the signals' own units, entropies in nats. Same bits
//! for any order of the rows. Nothing fails; values are finite (`reject`).

use std::collections::BTreeMap;
use std::num::NonZeroU16;

use super::double::Double;
use super::histogram::Sorted;
use super::moments::{Moments, Standard};
use super::outcome::{Population, Range, SignalStatistics};
use super::recipe::{BySignal, PAPER, Signal, Yardstick};
use super::standardise::{RobustStandard, Ruler};
use super::weights::{entropy, entropy_nats, entropy_weights};

/// A population: what is published of it, and what measures its rows.
#[derive(Debug, Clone)]
pub struct Surveyed {
    /// For `corpus.json`.
    pub population: Population,
    /// For the rows.
    pub yardstick: Yardstick,
}

/// Surveys scored rows by their signals.
#[must_use]
pub fn survey(rows: &[BySignal<Option<f64>>], bins: NonZeroU16, range: Range) -> Surveyed {
    let signals = Signal::ALL.map(|signal| survey_signal(signal, rows, bins, range));
    let paper_entropies = PAPER.map(|signal| signals[signal as usize].2);
    let paper_weights =
        entropy_weights(&paper_entropies).and_then(|weights| weights.try_into().ok());
    let columns = Signal::ALL.iter().map(|signal| signal.column().to_owned());
    Surveyed {
        population: Population {
            n: rows.len() as u64,
            signals: columns
                .zip(signals.iter().map(|(statistics, ..)| statistics.clone()))
                .collect(),
            weights: paper_weights
                .as_ref()
                .map(weights_by_column)
                .unwrap_or_default(),
        },
        yardstick: Yardstick {
            rulers: BySignal(signals.map(|(_, ruler, _)| ruler)),
            paper_weights,
        },
    }
}

/// Weights of the paper's signals by column name.
pub(super) fn weights_by_column(weights: &[f64; PAPER.len()]) -> BTreeMap<String, f64> {
    PAPER
        .iter()
        .map(|signal| signal.column().to_owned())
        .zip(weights.iter().copied())
        .collect()
}

/// The values of one signal, over the rows that have it.
pub(super) fn sorted_values(signal: Signal, rows: &[BySignal<Option<f64>>]) -> Sorted {
    Sorted::new(rows.iter().filter_map(|row| row[signal]).collect())
}

/// The entropy that a signal is weighed by; `None` where it says nothing: no values, no spread, or a
/// range without width (nearly all values equal, under the winsorised range). A constant would have
/// the smallest entropy and weigh most.
pub(super) fn weighing_entropy(sorted: &Sorted, bins: NonZeroU16, range: Range) -> Option<Double> {
    let (min, max) = sorted.range(range)?;
    if min == max {
        return None;
    }
    entropy(&sorted.histogram(bins, range)?.counts)
}

/// Statistics, ruler, and the entropy to weigh by.
fn survey_signal(
    signal: Signal,
    rows: &[BySignal<Option<f64>>],
    bins: NonZeroU16,
    range: Range,
) -> (SignalStatistics, Ruler, Option<Double>) {
    let sorted = sorted_values(signal, rows);
    // `Sorted` holds finite values only, so that no sum refuses one.
    let standard: Option<Standard> = Moments::of(sorted.values())
        .ok()
        .and_then(|moments| moments.standard());
    let robust = RobustStandard::of(&sorted);
    let ruler = match (standard, robust) {
        (_, Some(robust)) if signal.is_robust() => Ruler::Robust(robust),
        (Some(standard), _) => Ruler::Standard(standard),
        _ => Ruler::Absent,
    };
    let histogram = sorted.histogram(bins, range);
    let entropy = if ruler.tells() {
        weighing_entropy(&sorted, bins, range)
    } else {
        None
    };
    let statistics = SignalStatistics {
        n: sorted.values().len() as u64,
        min: sorted.values().first().copied(),
        max: sorted.values().last().copied(),
        mean: standard.map(|standard| standard.mean),
        std: standard.map(|standard| standard.std),
        median: robust.map(|robust| robust.median),
        mad: robust.map(|robust| robust.mad),
        entropy_nats: histogram
            .as_ref()
            .and_then(|histogram| entropy_nats(&histogram.counts)),
        edges: histogram
            .as_ref()
            .map(|histogram| histogram.edges.clone())
            .unwrap_or_default(),
        counts: histogram
            .map(|histogram| histogram.counts)
            .unwrap_or_default(),
        degenerate: ruler.is_degenerate(),
    };
    (statistics, ruler, entropy)
}
