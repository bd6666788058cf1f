//! What a reader must know before trusting scores: plain sentences for `corpus.json` and the report.

use std::collections::BTreeMap;

use super::ReduceOptions;
use super::drift::{Comparison, Drift, PSI_LEVELS, Verdict};
use super::outcome::{FEWEST_ROWS, NormaliseWithin, Population, Recipe, WeightSensitivity};
use super::recipe::signals_of;
use super::tally::{Tally, tells_nothing};

/// Weights that differ by more than this under other choices are called fragile (design section 8).
const WEIGHT_DISAGREEMENT: f64 = 0.05;

/// The warnings of a run. `populations` are those that rows were scored against, by a name to print.
#[must_use]
pub fn warnings(
    tally: &Tally,
    populations: &[(String, &Population)],
    corpus: &Population,
    sensitivity: Option<&WeightSensitivity>,
    comparison: Option<&Comparison>,
    options: &ReduceOptions,
) -> Vec<String> {
    let (recipe, bins) = (options.recipe, options.bins.get());
    let mut warnings = Vec::new();
    if tally.rejected > 0 {
        warnings.push(format!(
            "{} measurements held a value that is not a finite number; they are failed rows",
            tally.rejected
        ));
    }
    for (name, population) in populations {
        warnings.extend(of_population(name, population, recipe, bins));
    }
    if tally.without_score > 0 {
        warnings.push(format!(
            "{} scored rows have none of the recipe's signals that count; they are left to review",
            tally.without_score
        ));
    }
    if tally.partial > 0 {
        warnings.push(format!(
            "{} rows lack a signal of the recipe; their score is combined from the others alone",
            tally.partial
        ));
    }
    if let (Recipe::Paper, Some(sensitivity)) = (recipe, sensitivity) {
        warnings.extend(of_weights(corpus, sensitivity));
    }
    warnings.extend(
        comparison
            .into_iter()
            .flat_map(|comparison| of_drift(comparison, recipe)),
    );
    if options.normalise_within == NormaliseWithin::Corpus && tally.groups_differ() {
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
        if statistics.range_overflow {
            warnings.push(format!(
                "{} spans more than the largest float in {name}: look at its outliers",
                signal.column()
            ));
        }
    }
    if tells_nothing(population, recipe) {
        warnings.push(format!(
            "no signal of the recipe tells the rows of {name} apart: every score is 0 and ranks follow names"
        ));
    }
    warnings
}

/// Signals of the recipe, and scores, that have moved away from the reference.
fn of_drift(comparison: &Comparison, recipe: Recipe) -> Vec<String> {
    let names = signals_of(recipe).map(|s| s.column()).chain(["anomaly"]);
    let known: Vec<(&str, &Drift)> = names
        .filter_map(|name| Some((name, comparison.drift.get(name)?)))
        .collect();
    let (moderate, major) = PSI_LEVELS;
    let mut warnings: Vec<String> = known
        .iter()
        .filter_map(|(name, drift)| {
            let by_index = drift.psi.filter(|_| drift.psi_by_chance.is_some_and(|c| c < major));
            let how = match (drift.verdict, by_index, drift.ks) {
                (Verdict::Moderate, Some(psi), _) => {
                    format!("has moved from the reference (stability index {psi:.2}, from {moderate} on)")
                }
                (Verdict::Major, Some(psi), _) if psi >= major => {
                    format!("has moved far from the reference (stability index {psi:.2}, from {major} on)")
                }
                (Verdict::Major, _, Some(ks)) => {
                    format!("has moved far from the reference (Kolmogorov-Smirnov distance {ks:.2})")
                }
                _ => return None,
            };
            Some(format!("{name} {how}: scores may not mean what they meant there"))
        })
        .collect();
    if !known.is_empty()
        && known
            .iter()
            .all(|(_, drift)| drift.verdict == Verdict::TooFew)
    {
        let n = known.iter().map(|(_, drift)| drift.n).max().unwrap_or(0);
        warnings.push(format!(
            "with {n} rows against {} it cannot be judged whether the corpus is like the reference",
            comparison.n
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
