//! Statistics of one population of scored rows, and the yardstick that they make.
//!
//! Per signal: exact mean and σ, median and MAD, histogram and entropy (design section 8); for the
//! paper's two signals the entropy weights. In the signals' own units, entropies in nats. Same bits
//! for any order of the rows, and wherever the values lie ([`Values`]). Only reading them can fail.

use std::collections::BTreeMap;
use std::num::NonZeroU16;

use super::double::Double;
use super::histogram::{Edges, QUARTILES, WINSORISED_QUANTILES, range_of, range_overflows};
use super::moments::Moments;
use super::order::OrderStatistics;
use super::outcome::{FEWEST_ROWS, Population, Range, SignalStatistics};
use super::recipe::{BySignal, PAPER, Signal, Yardstick};
use super::standardise::{RobustStandard, Ruler};
use super::values::{Distances, InMemory, Values};
use super::weights::{entropy, entropy_weights};

/// Order statistics kept at either end: a row beyond the third is extreme (`sensitivity`).
pub(super) const EXTREMES: u64 = 3;

/// A population: what is published of it, and what measures its rows.
#[derive(Debug, Clone)]
pub struct Surveyed {
    /// For `corpus.json`.
    pub population: Population,
    /// For the rows.
    pub yardstick: Yardstick,
    /// The order of each signal's values, as far as it was needed.
    pub order: BySignal<OrderStatistics>,
}

/// The values of each signal, over the rows that have it.
#[must_use]
pub fn in_memory(rows: &[BySignal<Option<f64>>]) -> BySignal<InMemory> {
    BySignal::from_fn(|signal| rows.iter().filter_map(|row| row[signal]).collect())
}

/// Surveys `n` scored rows by the values of their signals.
///
/// # Errors
/// Where the values cannot be read.
pub fn survey<V: Values>(
    n: u64,
    signals: &BySignal<V>,
    bins: NonZeroU16,
    range: Range,
) -> Result<Surveyed, V::Error> {
    let mut population = Population {
        n,
        too_few: n < FEWEST_ROWS,
        signals: BTreeMap::new(),
        weights: BTreeMap::new(),
    };
    let mut rulers = BySignal([Ruler::Absent; Signal::ALL.len()]);
    let mut order = BySignal::default();
    let mut entropies = BySignal::<Option<Double>>::default();
    for signal in Signal::ALL {
        let surveyed = survey_signal(signal, &signals[signal], bins, range)?;
        rulers[signal] = surveyed.ruler;
        order[signal] = surveyed.order;
        entropies[signal] = surveyed.weighing_entropy;
        population
            .signals
            .insert(signal.column().to_owned(), surveyed.statistics);
    }
    let paper_weights = entropy_weights(&PAPER.map(|signal| entropies[signal]))
        .and_then(|weights| weights.try_into().ok());
    population.weights = paper_weights
        .as_ref()
        .map(weights_by_column)
        .unwrap_or_default();
    Ok(Surveyed {
        population,
        yardstick: Yardstick {
            rulers,
            paper_weights,
        },
        order,
    })
}

/// Weights of the paper's signals by column name.
pub(super) fn weights_by_column(weights: &[f64; PAPER.len()]) -> BTreeMap<String, f64> {
    PAPER
        .iter()
        .map(|signal| signal.column().to_owned())
        .zip(weights.iter().copied())
        .collect()
}

/// The entropy that a signal is weighed by; `None` where it says nothing: no values, no spread, or a
/// range without width (nearly all values equal, under the winsorised range). A constant would have
/// the smallest entropy and weigh most.
pub(super) fn weighing_entropy(edges: &Edges, counts: &[u64]) -> Option<Double> {
    let (min, max) = edges.range();
    if min == max { None } else { entropy(counts) }
}

struct SurveyedSignal {
    statistics: SignalStatistics,
    ruler: Ruler,
    weighing_entropy: Option<Double>,
    order: OrderStatistics,
}

fn survey_signal<V: Values>(
    signal: Signal,
    values: &V,
    bins: NonZeroU16,
    range: Range,
) -> Result<SurveyedSignal, V::Error> {
    let moments = values.fold(
        &Moments::default,
        &|moments, piece| {
            for &value in piece {
                // `Values` are finite, so that no sum refuses one.
                let _ = moments.add(value);
            }
        },
        &|moments, more| moments.merge(&more),
    )?;
    let n = moments.n();
    let (winsorised, quartiles) = (WINSORISED_QUANTILES, QUARTILES);
    let quantiles = [winsorised.0, winsorised.1, quartiles.0, quartiles.1];
    let order = OrderStatistics::find(values, n, &quantiles, EXTREMES)?;
    let standard = moments.standard();
    let robust = match order.median() {
        None => None,
        Some(median) => {
            let distances = Distances {
                values,
                centre: median,
            };
            OrderStatistics::find(&distances, n, &[], 0)?
                .median()
                .map(|mad| RobustStandard { median, mad })
        }
    };
    let ruler = match (standard, robust) {
        (_, Some(robust)) if signal.is_robust() => Ruler::Robust(robust),
        (Some(standard), _) => Ruler::Standard(standard),
        _ => Ruler::Absent,
    };
    let edges = range_of(&order, range).map(|range| Edges::equal_width(range, bins));
    let counts = match &edges {
        None => Vec::new(),
        Some(edges) => Edges::count(std::slice::from_ref(edges), values)?.remove(0),
    };
    let (min, max) = (order.min(), order.max());
    Ok(SurveyedSignal {
        statistics: SignalStatistics {
            n,
            min,
            max,
            mean: standard.map(|standard| standard.mean),
            std: standard.map(|standard| standard.std),
            median: robust.map(|robust| robust.median),
            mad: robust.map(|robust| robust.mad),
            entropy_nats: entropy(&counts).map(Double::value),
            edges: edges
                .as_ref()
                .map(|edges| edges.edges().to_vec())
                .unwrap_or_default(),
            degenerate: ruler.is_degenerate(),
            range_overflow: min
                .zip(max)
                .is_some_and(|(min, max)| range_overflows(min, max)),
            counts: counts.clone(),
        },
        ruler,
        weighing_entropy: edges
            .filter(|_| ruler.tells())
            .and_then(|edges| weighing_entropy(&edges, &counts)),
        order,
    })
}
