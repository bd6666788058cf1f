//! What is counted over the rows of a run, and `corpus.json` made of it.

use std::collections::{BTreeMap, BTreeSet};

use plumbline_common::row::{Decision, Status};

use super::drift::Comparison;
use super::outcome::{CorpusStatistics, NormaliseWithin, Population, WeightSensitivity};
use super::recipe::signals_of;
use super::select::KeepRule;
use super::{Recipe, ReduceOptions, decision_name, warnings};

/// Width, height, and frames per second in hundredths.
type Shape = (u32, u32, i64);

/// What is counted of one row.
#[derive(Debug, Clone, Copy)]
pub struct Facts<'a> {
    /// What became of it.
    pub status: Status,
    /// Its group.
    pub group: Option<&'a str>,
    /// Its score.
    pub anomaly: Option<f64>,
    /// The interval of it.
    pub interval: Option<(f64, f64)>,
    /// Whether it lacks a signal of the recipe.
    pub lacks_signal: bool,
    /// Width, height and frames per second.
    pub shape: Option<(u32, u32, f64)>,
    /// Keep, drop or review.
    pub decision: Decision,
    /// Whether its measurement held a value that is not finite.
    pub rejected: bool,
    /// The score that parts kept from dropped in its group, where rows of both kinds are.
    pub cut: Option<f64>,
}

/// Counts over rows; the same in any order.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// In the order of `Status`.
    statuses: [u64; Status::ALL.len()],
    /// In the order of `Decision`.
    decisions: [u64; 3],
    /// The group and shape noted last: most rows are like the one before.
    last_shape: Option<(String, Shape)>,
    shapes: BTreeMap<String, BTreeSet<Shape>>,
    intervals: u64,
    uncertain: u64,
    /// Rows with a value that is not finite.
    pub(super) rejected: u64,
    /// Scored rows without a score.
    pub(super) without_score: u64,
    /// Rows whose score lacks a signal.
    pub(super) partial: u64,
}

impl Tally {
    /// Counts one row.
    pub fn note(&mut self, row: &Facts<'_>) {
        self.statuses[row.status as usize] += 1;
        self.decisions[row.decision as usize] += 1;
        self.rejected += u64::from(row.rejected);
        if let Some((lo, hi)) = row.interval {
            self.intervals += 1;
            self.uncertain += u64::from(row.cut.is_some_and(|cut| match row.decision {
                Decision::Keep => hi > cut,
                Decision::Drop => lo <= cut,
                Decision::Review => false,
            }));
        }
        if row.status != Status::Scored {
            return;
        }
        self.without_score += u64::from(row.anomaly.is_none());
        self.partial += u64::from(row.anomaly.is_some() && row.lacks_signal);
        if let (Some(group), Some((width, height, fps))) = (row.group, row.shape) {
            let shape = (width, height, (fps * 100.0).round() as i64);
            if self
                .last_shape
                .as_ref()
                .is_some_and(|(g, s)| g == group && *s == shape)
            {
                return;
            }
            self.last_shape = Some((group.to_owned(), shape));
            match self.shapes.get_mut(group) {
                Some(shapes) => {
                    shapes.insert(shape);
                }
                None => {
                    self.shapes
                        .insert(group.to_owned(), BTreeSet::from([shape]));
                }
            }
        }
    }

    /// True where two groups have no picture size and frame rate (to 0.01/s) in common.
    pub(super) fn groups_differ(&self) -> bool {
        // Against the first group alone: many groups are compared in one pass, and where any two
        // differ from each other at least one of them rarely matches the first.
        let mut shapes = self.shapes.values();
        shapes
            .next()
            .is_some_and(|first| shapes.any(|other| first.is_disjoint(other)))
    }

    /// The content of `corpus.json`.
    #[must_use]
    pub fn statistics(
        self,
        corpus: Population,
        groups: BTreeMap<String, Population>,
        sensitivity: Option<WeightSensitivity>,
        reference: Option<Comparison>,
        options: &ReduceOptions,
    ) -> CorpusStatistics {
        let warnings = warnings::warnings(
            &self,
            &scored_against(&corpus, &groups, options),
            &corpus,
            sensitivity.as_ref(),
            reference.as_ref(),
            options,
        );
        CorpusStatistics {
            statuses: by_name(Status::ALL.map(|s| (s.as_str(), self.statuses[s as usize]))),
            decisions: by_name(
                [Decision::Keep, Decision::Drop, Decision::Review]
                    .map(|d| (decision_name(d), self.decisions[d as usize])),
            ),
            recipe: options.recipe,
            bins: options.bins.get().into(),
            range: options.range,
            normalised_within: options.normalise_within,
            keep: options.keep.to_string(),
            degenerate: options.reference.is_none() && tells_nothing(&corpus, options.recipe),
            uncertain_decisions: (self.intervals > 0).then_some(self.uncertain),
            corpus,
            groups,
            sensitivity,
            reference,
            warnings,
        }
    }
}

fn by_name<const N: usize>(counts: [(&str, u64); N]) -> BTreeMap<String, u64> {
    counts.map(|(name, count)| (name.to_owned(), count)).into()
}

/// True where a population has rows, and no signal of the recipe tells them apart.
pub(super) fn tells_nothing(population: &Population, recipe: Recipe) -> bool {
    let silent = signals_of(recipe).all(|signal| {
        let statistics = population.signals.get(signal.column());
        statistics.is_none_or(|s| s.degenerate || s.n == 0)
    });
    let weightless = recipe == Recipe::Paper && population.weights.is_empty();
    population.n > 0 && (weightless || silent)
}

/// The populations that rows were scored against, by a name to print.
fn scored_against<'a>(
    corpus: &'a Population,
    groups: &'a BTreeMap<String, Population>,
    options: &'a ReduceOptions,
) -> Vec<(String, &'a Population)> {
    if let Some(reference) = &options.reference {
        return vec![("the reference".to_owned(), &reference.frozen().population)];
    }
    if options.normalise_within == NormaliseWithin::Group && !groups.is_empty() {
        return groups
            .iter()
            .map(|(name, group)| (format!("group {name}"), group))
            .collect();
    }
    vec![("the corpus".to_owned(), corpus)]
}

/// Where each group is cut: between the worst score that is kept and the best that is dropped.
#[derive(Debug, Clone, Default)]
pub struct Cuts<K> {
    by_group: BTreeMap<K, (Option<f64>, Option<f64>)>,
}

impl<K: Ord> Cuts<K> {
    /// Takes note of a decision.
    pub fn note(&mut self, group: K, anomaly: f64, decision: Decision) {
        let (kept, dropped) = self.by_group.entry(group).or_default();
        match decision {
            Decision::Keep => *kept = Some(kept.map_or(anomaly, |worst| worst.max(anomaly))),
            Decision::Drop => *dropped = Some(dropped.map_or(anomaly, |best| best.min(anomaly))),
            Decision::Review => {}
        }
    }

    /// The cut of a group; `None` where all of it is kept, or all dropped, by a count or a share.
    #[must_use]
    pub fn cut(&self, group: &K, keep: &KeepRule) -> Option<f64> {
        if let KeepRule::AtMost(most) = keep {
            return Some(*most);
        }
        let (kept, dropped) = self.by_group.get(group).copied()?;
        Some(f64::midpoint(kept?, dropped?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_lies_between_kept_and_dropped() {
        let mut cuts = Cuts::default();
        for (group, anomaly, decision) in [
            ("x", 3.0, Decision::Drop),
            ("x", 1.0, Decision::Keep),
            ("x", 2.0, Decision::Keep),
            ("x", 9.0, Decision::Drop),
            ("y", 0.0, Decision::Keep),
        ] {
            cuts.note(group, anomaly, decision);
        }
        assert_eq!(cuts.cut(&"x", &KeepRule::Best(2)), Some(2.5));
        assert_eq!(cuts.cut(&"y", &KeepRule::Best(2)), None);
        assert_eq!(cuts.cut(&"y", &KeepRule::AtMost(7.0)), Some(7.0));
    }

    /// Cut at 2.5: kept rows may reach it, dropped ones too.
    #[test]
    fn decisions_within_reach_of_the_cut_are_uncertain() {
        let mut tally = Tally::default();
        for (decision, lo, hi) in [
            (Decision::Keep, 0.0, 2.5),
            (Decision::Keep, 0.0, 2.6),
            (Decision::Drop, 2.5, 9.0),
            (Decision::Drop, 2.6, 9.0),
        ] {
            tally.note(&Facts {
                status: Status::Scored,
                group: None,
                anomaly: Some(1.0),
                interval: Some((lo, hi)),
                lacks_signal: false,
                shape: None,
                decision,
                rejected: false,
                cut: Some(2.5),
            });
        }
        assert_eq!((tally.intervals, tally.uncertain), (4, 2));
    }
}
