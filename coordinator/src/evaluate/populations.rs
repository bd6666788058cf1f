//! Populations side by side, each with entropies and weights of its own (the paper's Table 2).

use std::collections::BTreeMap;

use serde::Serialize;

use super::input::{Input, ScoreRow};
use super::{EvaluateError, EvaluateOptions, sets};
use crate::reduce::auroc::{Auroc, auroc};
use crate::reduce::outcome::Range;
use crate::reduce::population::{in_memory, survey};
use crate::reduce::recipe::PAPER;

/// Populations by a column.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Populations {
    /// The column.
    pub column: String,
    /// Histogram bins.
    pub bins: u16,
    /// Histogram range.
    pub range: Range,
    /// Each by itself, by name.
    pub populations: Vec<PopulationStatistics>,
    /// Scored rows without a value in the column.
    pub without: usize,
    /// With exactly two populations: how often the anomaly of the first lies above that of the second.
    pub auroc_first_above_second: Option<Auroc>,
}

/// One population.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PopulationStatistics {
    /// Its name.
    pub population: String,
    /// Scored rows.
    pub n: u64,
    /// The paper's two measures, in their order.
    pub measures: Vec<Measure>,
    /// Mean anomaly as scored, over the rows that have one.
    pub anomaly_mean: Option<f64>,
}

/// A measure over one population.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measure {
    /// Column.
    pub measure: String,
    /// Rows that have it.
    pub n: u64,
    /// Mean, px of a 256-px-high picture.
    pub mean: Option<f64>,
    /// Population standard deviation.
    pub std: Option<f64>,
    /// H, nats.
    pub entropy_nats: Option<f64>,
    /// Entropy weight.
    pub weight: Option<f64>,
}

pub(super) fn side_by_side(
    input: &Input,
    column: &str,
    options: &EvaluateOptions,
) -> Result<Populations, EvaluateError> {
    let mut by_name: BTreeMap<String, Vec<&ScoreRow>> = BTreeMap::new();
    let mut without = 0;
    for row in input.rows.values().filter(|row| row.signals().is_some()) {
        match row.text(column) {
            Some(name) => by_name.entry(name).or_default().push(row),
            None => without += 1,
        }
    }
    if by_name.is_empty() {
        return Err(EvaluateError::Content {
            path: options.scores.display().to_string(),
            reason: format!(
                "no scored row has a value in the column `{column}`; name a column that was carried through, or `group`"
            ),
        });
    }
    let anomalies =
        |rows: &[&ScoreRow]| -> Vec<f64> { rows.iter().filter_map(|row| row.anomaly).collect() };
    let auroc_first_above_second = match by_name.values().collect::<Vec<_>>().as_slice() {
        [first, second] => auroc(
            &anomalies(first),
            &anomalies(second),
            sets::seed_of(options.seed, column),
        ),
        _ => None,
    };
    let populations = by_name
        .into_iter()
        .map(|(population, rows)| {
            let anomalies = anomalies(&rows);
            statistics(population, &rows, &anomalies, options)
        })
        .collect();
    Ok(Populations {
        column: column.to_owned(),
        bins: options.bins.get(),
        range: options.range,
        populations,
        without,
        auroc_first_above_second,
    })
}

fn statistics(
    population: String,
    rows: &[&ScoreRow],
    anomalies: &[f64],
    options: &EvaluateOptions,
) -> PopulationStatistics {
    let values: Vec<_> = rows.iter().filter_map(|row| row.signals()).collect();
    let n = values.len() as u64;
    let Ok(surveyed) = survey(n, &in_memory(&values), options.bins, options.range);
    let measures = PAPER.map(|signal| {
        let column = signal.column();
        let found = surveyed.population.signals.get(column);
        Measure {
            measure: column.to_owned(),
            n: found.map_or(0, |signal| signal.n),
            mean: found.and_then(|signal| signal.mean),
            std: found.and_then(|signal| signal.std),
            entropy_nats: found.and_then(|signal| signal.entropy_nats),
            weight: surveyed.population.weights.get(column).copied(),
        }
    });
    PopulationStatistics {
        population,
        n,
        measures: measures.into(),
        anomaly_mean: (!anomalies.is_empty())
            .then(|| anomalies.iter().sum::<f64>() / anomalies.len() as f64),
    }
}
