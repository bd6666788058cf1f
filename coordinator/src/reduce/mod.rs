//! From measurements to decisions: pure functions over the rows of one run (design section 8).
//!
//! [`reduce`] reads as the paper does: entropy of each measure over the corpus, weights by softmax,
//! z-scores, their weighted sum S_r; then ranks, keep or drop, and rewards. In: one measurement per
//! video, in any order. Out: one row per video in the order of `video`, bit for bit the same for any
//! order of the input, since rows are sorted first and sums are exact. Pixel errors in px of a
//! 256-px-high picture; scores have no unit, lower is better. Nothing fails: what cannot be scored
//! goes to review with its reason, and what a reader must know stands in the warnings.
//!
//! With a frozen reference, rows are scored against that instead, each by itself ([`score_final`]);
//! ranks, and keep rules by number or share, are still of the corpus.

pub mod auroc;
pub mod distribution;
pub mod double;
pub mod draw;
pub mod drift;
pub mod histogram;
pub mod interval;
pub mod ladder;
pub mod moments;
mod natural;
pub mod order;
pub mod outcome;
pub mod population;
pub mod recipe;
pub mod reference;
pub mod reject;
pub mod rewards;
pub mod select;
pub mod sensitivity;
pub mod standardise;
pub mod success;
pub mod sum;
pub mod tally;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod twin;
pub mod values;
pub mod warnings;
pub mod weights;

use std::collections::BTreeMap;
use std::num::NonZeroU16;
use std::sync::Arc;

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Measurement, Row, Status};
use serde_json::{Map, Value};

use interval::{IntervalParams, anomaly_interval};
use outcome::{CorpusStatistics, NormaliseWithin, Range, Recipe};
use population::{Surveyed, survey};
use recipe::{BySignal, PAPER, Signal, Yardstick, signals_of};
use reference::Reference;
use rewards::{Reward, Scored, Spread, reward};
use select::{Candidate, KeepRule, Place, Selected, Standing, select};
use sensitivity::sensitivity;
use tally::{Cuts, Facts, Tally};

/// The paper's number of histogram bins.
pub const PAPER_BINS: NonZeroU16 = NonZeroU16::MIN.saturating_add(29);

/// How a corpus is reduced.
#[derive(Debug, Clone, PartialEq)]
pub struct ReduceOptions {
    /// Which signals make the score.
    pub recipe: Recipe,
    /// Histogram bins; the paper's 30 are [`PAPER_BINS`].
    pub bins: NonZeroU16,
    /// Histogram range.
    pub range: Range,
    /// What to keep of each group.
    pub keep: KeepRule,
    /// Digest of the profile that measured the rows.
    pub profile_digest: String,
    /// Which population a row is scored against (rows without a group: always the corpus).
    pub normalise_within: NormaliseWithin,
    /// What rows are scored against instead of their population; bins and range are then its own.
    pub reference: Option<Arc<Reference>>,
}

impl ReduceOptions {
    /// What a row is measured with, where its own population would be `population`.
    pub(crate) fn yardstick<'a>(&'a self, population: &'a Yardstick) -> &'a Yardstick {
        self.reference
            .as_deref()
            .map_or(population, Reference::yardstick)
    }

    /// Where a score stands: in the reference, or else in the corpus.
    pub(crate) fn standing(&self, place: &Place, anomaly: f64) -> Standing {
        let reference = self.reference.as_deref();
        reference
            .and_then(|reference| reference.standing(self.recipe, anomaly))
            .unwrap_or_else(|| place.standing())
    }

    /// What soft rewards are relative to, where that is not the corpus.
    pub(crate) fn reward_spread(&self) -> Option<Spread> {
        let scores = self.reference.as_deref()?.scores(self.recipe)?;
        Some(scores.rewards())
    }
}

/// One video's measurement, with what the source says of it.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredVideo {
    /// Unique in the corpus.
    pub video: VideoId,
    /// Value of `--group-by`.
    pub group: Option<String>,
    /// Columns carried through from a list.
    pub carried: Map<String, Value>,
    /// What the worker says.
    pub measurement: Measurement,
}

/// What a run comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduced {
    /// One per video, by video.
    pub rows: Vec<Row>,
    /// The content of `corpus.json`.
    pub statistics: CorpusStatistics,
    /// One per row that has a score, by video.
    pub rewards: Vec<Reward>,
}

/// Reduces a run.
#[must_use]
pub fn reduce(mut videos: Vec<MeasuredVideo>, options: &ReduceOptions) -> Reduced {
    videos.sort_by(|a, b| a.video.cmp(&b.video));
    let rejected: Vec<bool> = videos
        .iter_mut()
        .map(|video| reject::reject_non_finite(&mut video.measurement))
        .collect();

    let scored: Vec<&MeasuredVideo> = videos
        .iter()
        .filter(|video| video.measurement.status == Status::Scored)
        .collect();
    let values = population::in_memory(&values_of(&scored));
    let Ok(corpus) = survey(scored.len() as u64, &values, options.bins, options.range);
    let groups = survey_groups(&scored, options);
    let left_out: Vec<sensitivity::Row> = scored
        .iter()
        .filter(|_| options.reference.is_none())
        .map(|video| (video, PAPER.map(|signal| signal.of(&video.measurement))))
        .filter(|(_, values)| sensitivity::is_left_out(&corpus, values))
        .map(|(video, values)| sensitivity::Row {
            video: video.video.as_str().to_owned(),
            values,
        })
        .collect();
    let fragility = match options.reference {
        // Its weights do not depend on these rows.
        Some(_) => None,
        None => {
            let Ok(found) = sensitivity(&corpus, &values, &left_out, options.bins, options.range);
            found
        }
    };

    let mut rows: Vec<Row> = videos
        .into_iter()
        .map(|video| {
            let own = video
                .group
                .as_ref()
                .filter(|_| options.normalise_within == NormaliseWithin::Group);
            let population = &video_population(own, &groups, &corpus).yardstick;
            score(options.yardstick(population), video, options)
        })
        .collect();
    let selected = decide(&mut rows, options);
    let rewards = reward_rows(&rows, &selected, options);
    let comparison = options.reference.as_deref().map(|reference| {
        let anomalies = rows.iter().filter_map(|row| row.anomaly).collect();
        let Ok(found) = reference.compare(options.recipe, &values, &anomalies);
        found
    });
    let tally = tally(&rows, &rejected, options);
    let groups = groups
        .into_iter()
        .map(|(name, group)| (name, group.population))
        .collect();
    Reduced {
        rows,
        statistics: tally.statistics(corpus.population, groups, fragility, comparison, options),
        rewards,
    }
}

fn tally(rows: &[Row], rejected: &[bool], options: &ReduceOptions) -> Tally {
    let mut cuts = Cuts::default();
    for row in rows {
        if let Some(anomaly) = row.anomaly {
            cuts.note(row.group.as_deref(), anomaly, row.decision);
        }
    }
    let mut tally = Tally::default();
    for (row, &rejected) in rows.iter().zip(rejected) {
        let m = &row.measured;
        let shape = (m.width, m.height, m.fps);
        tally.note(&Facts {
            status: m.status,
            group: row.group.as_deref(),
            anomaly: row.anomaly,
            interval: row.anomaly_lo.zip(row.anomaly_hi),
            lacks_signal: signals_of(options.recipe).any(|signal| signal.of(m).is_none()),
            shape: match shape {
                (Some(width), Some(height), Some(fps)) => Some((width, height, fps)),
                _ => None,
            },
            decision: row.decision,
            rejected,
            cut: cuts.cut(&row.group.as_deref(), &options.keep),
        });
    }
    tally
}

fn values_of(videos: &[&MeasuredVideo]) -> Vec<BySignal<Option<f64>>> {
    videos
        .iter()
        .map(|video| BySignal::of(&video.measurement))
        .collect()
}

fn survey_groups(scored: &[&MeasuredVideo], options: &ReduceOptions) -> BTreeMap<String, Surveyed> {
    let mut members: BTreeMap<&str, Vec<&MeasuredVideo>> = BTreeMap::new();
    for video in scored {
        if let Some(group) = &video.group {
            members.entry(group).or_default().push(video);
        }
    }
    members
        .into_iter()
        .map(|(group, videos)| {
            let values = population::in_memory(&values_of(&videos));
            let Ok(surveyed) = survey(videos.len() as u64, &values, options.bins, options.range);
            (group.to_owned(), surveyed)
        })
        .collect()
}

fn video_population<'a>(
    group: Option<&String>,
    groups: &'a BTreeMap<String, Surveyed>,
    corpus: &'a Surveyed,
) -> &'a Surveyed {
    group.and_then(|group| groups.get(group)).unwrap_or(corpus)
}

/// z, S_r and its interval for a scored row; every other row keeps its raw values alone.
fn score(yardstick: &Yardstick, video: MeasuredVideo, options: &ReduceOptions) -> Row {
    let MeasuredVideo {
        video,
        group,
        carried,
        measurement,
    } = video;
    let is_scored = measurement.status == Status::Scored;
    let values = if is_scored {
        BySignal::of(&measurement)
    } else {
        BySignal::default()
    };
    let z = yardstick.z(&values);
    let anomaly = yardstick.anomaly(options.recipe, &values);
    let interval = anomaly.and_then(|anomaly| {
        anomaly_interval(
            &measurement.series,
            &values,
            anomaly,
            yardstick,
            options.recipe,
            measurement
                .digest
                .as_deref()
                .unwrap_or(video.as_str())
                .as_bytes(),
            &IntervalParams::default(),
        )
    });
    Row {
        video,
        group,
        carried,
        measured: measurement,
        z_reproj_px: z[Signal::ReprojPx],
        z_aepe_worldscore_px: z[Signal::AepeWorldscorePx],
        z_piecewise_residual: z[Signal::PiecewiseResidual],
        z_appearance_ratio: z[Signal::AppearanceRatio],
        z_layer_acceleration_q25: z[Signal::LayerAcceleration],
        z_interior_shear: z[Signal::InteriorShear],
        z_detail_change_q25: z[Signal::DetailChange],
        anomaly,
        anomaly_lo: interval.map(|(lo, _)| lo),
        anomaly_hi: interval.map(|(_, hi)| hi),
        rank: None,
        percentile: None,
        decision: Decision::Review,
        reward: anomaly.map(reward),
        recipe: recipe_name(options.recipe).to_owned(),
        profile_digest: options.profile_digest.clone(),
        rung: None,
        flip_probability: None,
    }
}

/// A row scored against the reference by itself, with everything that does not depend on other rows:
/// all but the rank and, unless the keep rule is a threshold, the decision (`review` here).
#[must_use]
pub fn score_final(
    mut video: MeasuredVideo,
    reference: &Reference,
    options: &ReduceOptions,
) -> Row {
    reject::reject_non_finite(&mut video.measurement);
    let mut row = score(reference.yardstick(), video, options);
    let Some(anomaly) = row.anomaly else {
        return row;
    };
    row.percentile = reference
        .standing(options.recipe, anomaly)
        .map(|standing| standing.percentile());
    if let KeepRule::AtMost(_) = options.keep {
        row.decision = options.keep.decide(&NO_PLACE, anomaly);
    }
    row
}

/// Of a row whose place is not asked for.
const NO_PLACE: Place = Place {
    rank: 0,
    ranked: 0,
    group_rank: 0,
    group_size: 0,
};

/// Fills in rank, percentile and decision.
fn decide(rows: &mut [Row], options: &ReduceOptions) -> Vec<Selected> {
    let candidates: Vec<Candidate<'_>> = rows
        .iter()
        .map(|row| Candidate {
            video: &row.video,
            group: row.group.as_deref(),
            anomaly: row.anomaly,
        })
        .collect();
    let selected = select(&candidates, &options.keep);
    for (row, selected) in rows.iter_mut().zip(&selected) {
        row.rank = selected.place.map(|place| place.rank);
        let standing = selected.place.zip(row.anomaly);
        row.percentile =
            standing.map(|(place, anomaly)| options.standing(&place, anomaly).percentile());
        row.decision = selected.decision;
    }
    selected
}

fn reward_rows(rows: &[Row], selected: &[Selected], options: &ReduceOptions) -> Vec<Reward> {
    let scored: Vec<Scored<'_>> = rows
        .iter()
        .zip(selected)
        .filter_map(|(row, selected)| {
            Some(Scored {
                video: &row.video,
                group: row.group.as_deref(),
                anomaly: row.anomaly?,
                place: selected.place?,
            })
        })
        .collect();
    rewards::rewards(&scored, options)
}

/// The name used in every output.
#[must_use]
pub fn decision_name(decision: Decision) -> &'static str {
    match decision {
        Decision::Keep => "keep",
        Decision::Drop => "drop",
        Decision::Review => "review",
    }
}

/// The name used in every output.
#[must_use]
pub fn recipe_name(recipe: Recipe) -> &'static str {
    match recipe {
        Recipe::Paper => "paper",
        Recipe::Balanced => "balanced",
    }
}
