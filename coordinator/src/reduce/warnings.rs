//! What a reader must know before trusting scores: plain sentences for `corpus.json` and the report.

use std::collections::{BTreeMap, BTreeSet};

use plumbline_common::row::{Row, Status};

use super::ReduceOptions;
use super::outcome::{NormaliseWithin, Population, Recipe, WeightSensitivity};
use super::recipe::signals_of;

/// Weights that differ by more than this under other choices are called fragile (design section 8).
const WEIGHT_DISAGREEMENT: f64 = 0.05;
/// z-scores of fewer rows mean nothing: of two they are always −1 and 1.
const FEWEST_ROWS: u64 = 3;

/// The warnings of a run. `populations` are those that rows were scored against, by a name to print.
#[must_use]
pub fn warnings(
    rows: &[Row],
    populations: &[(String, &Population)],
    corpus: &Population,
    sensitivity: Option<&WeightSensitivity>,
    options: &ReduceOptions,
    rejected: u64,
) -> Vec<String> {
    let (recipe, bins) = (options.recipe, options.bins.get());
    let mut warnings = Vec::new();
    if rejected > 0 {
        warnings.push(format!(
            "{rejected} measurements held a value that is not a finite number; they are failed rows"
        ));
    }
    for (name, population) in populations {
        warnings.extend(of_population(name, population, recipe, bins));
    }
    let scored = rows
        .iter()
        .filter(|row| row.measured.status == Status::Scored);
    let without_score = scored.clone().filter(|row| row.anomaly.is_none()).count();
    if without_score > 0 {
        warnings.push(format!(
            "{without_score} scored rows have none of the recipe's signals that count; they are left to review"
        ));
    }
    let partial = scored
        .filter(|row| row.anomaly.is_some())
        .filter(|row| signals_of(recipe).any(|signal| signal.of(&row.measured).is_none()))
        .count();
    if partial > 0 {
        warnings.push(format!(
            "{partial} rows lack a signal of the recipe; their score is combined from the others alone"
        ));
    }
    if let (Recipe::Paper, Some(sensitivity)) = (recipe, sensitivity) {
        warnings.extend(of_weights(corpus, sensitivity));
    }
    if options.normalise_within == NormaliseWithin::Corpus && groups_differ(rows) {
        warnings.push(
            "groups differ in picture size or frame rate, which scores follow too: compare within a \
             group, or use --normalise-within group"
                .to_owned(),
        );
    }
    warnings
}

fn of_population(name: &str, population: &Population, recipe: Recipe, bins: u16) -> Vec<String> {
    let mut warnings = Vec::new();
    let n = population.n;
    if n < FEWEST_ROWS {
        warnings.push(format!(
            "{name} has {n} scored rows: too few for scores to mean anything"
        ));
    } else if recipe == Recipe::Paper && n < u64::from(bins) {
        warnings.push(format!(
            "{name} has {n} scored rows for {bins} bins: entropies and weights are rough"
        ));
    }
    let mut absent_or_degenerate = 0;
    for signal in signals_of(recipe) {
        let Some(statistics) = population.signals.get(signal.column()) else {
            continue;
        };
        if statistics.degenerate {
            warnings.push(format!(
                "{} is degenerate in {name} (no spread): its z-scores are 0 and it does not count",
                signal.column()
            ));
        }
        absent_or_degenerate += u32::from(statistics.degenerate || statistics.n == 0);
    }
    let weightless = recipe == Recipe::Paper && population.weights.is_empty();
    if n > 0 && (weightless || absent_or_degenerate as usize == signals_of(recipe).count()) {
        warnings.push(format!(
            "no signal of the recipe tells the rows of {name} apart: every score is 0 and ranks follow names"
        ));
    }
    warnings
}

fn of_weights(corpus: &Population, sensitivity: &WeightSensitivity) -> Vec<String> {
    let change = |other: &BTreeMap<String, f64>| {
        let weight =
            |weights: &BTreeMap<String, f64>, column| weights.get(column).copied().unwrap_or(0.0);
        signals_of(Recipe::Paper)
            .map(|s| (weight(&corpus.weights, s.column()) - weight(other, s.column())).abs())
            .fold(0.0, f64::max)
    };
    let left_out = match &sensitivity.leave_one_out_video {
        Some(video) => format!("without {video}"),
        None => "without one row".to_owned(),
    };
    [
        (
            "with Freedman-Diaconis bins".to_owned(),
            change(&sensitivity.freedman_diaconis),
        ),
        (
            "with the winsorised range".to_owned(),
            change(&sensitivity.winsorised),
        ),
        (left_out, sensitivity.leave_one_out_max_change),
    ]
    .into_iter()
    .filter(|&(_, change)| change > WEIGHT_DISAGREEMENT)
    .map(|(how, change)| {
        format!("the entropy weights are fragile: {how} they change by {change:.2}")
    })
    .collect()
}

/// True where two groups have no picture size and frame rate (to 0.01/s) in common.
fn groups_differ(rows: &[Row]) -> bool {
    let mut shapes: BTreeMap<&str, BTreeSet<(u32, u32, i64)>> = BTreeMap::new();
    for row in rows
        .iter()
        .filter(|row| row.measured.status == Status::Scored)
    {
        let m = &row.measured;
        if let (Some(group), Some(width), Some(height), Some(fps)) =
            (row.group.as_deref(), m.width, m.height, m.fps)
        {
            shapes
                .entry(group)
                .or_default()
                .insert((width, height, (fps * 100.0).round() as i64));
        }
    }
    // Against the first group alone: many groups are compared in one pass, and where any two differ
    // from each other at least one of them rarely matches the first.
    let mut shapes = shapes.values();
    shapes
        .next()
        .is_some_and(|first| shapes.any(|other| first.is_disjoint(other)))
}
