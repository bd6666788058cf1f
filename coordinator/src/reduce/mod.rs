//! From measurements to decisions: pure functions over the rows of one run (design section 8).
//!
//! [`reduce`] reads as the paper does: entropy of each measure over the corpus, weights by softmax,
//! z-scores, their weighted sum S_r; then ranks, keep or drop, and rewards. In: one measurement per
//! video, in any order. Out: one row per video in the order of `video`, bit for bit the same for any
//! order of the input, since rows are sorted first and sums are exact. Pixel errors in px of a
//! 256-px-high picture; scores have no unit, lower is better. Nothing fails: what cannot be scored
//! goes to review with its reason, and what a reader must know stands in the warnings.

pub mod auroc;
pub mod double;
pub mod draw;
pub mod histogram;
pub mod interval;
pub mod moments;
mod natural;
pub mod order;
pub mod outcome;
pub mod population;
pub mod recipe;
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

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Measurement, Row, Status};
use serde_json::{Map, Value};

use interval::{IntervalParams, anomaly_interval};
use outcome::{CorpusStatistics, NormaliseWithin, Range, Recipe};
use population::{Surveyed, survey};
use recipe::{BySignal, PAPER, Signal, signals_of};
use rewards::{Reward, Scored, reward};
use select::{Candidate, KeepRule, Selected, select};
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
        .map(|video| (video, PAPER.map(|signal| signal.of(&video.measurement))))
        .filter(|(_, values)| sensitivity::is_left_out(&corpus, values))
        .map(|(video, values)| sensitivity::Row {
            video: video.video.as_str().to_owned(),
            values,
        })
        .collect();
    let Ok(fragility) = sensitivity(&corpus, &values, &left_out, options.bins, options.range);

    let mut rows: Vec<Row> = videos
        .into_iter()
        .map(|video| {
            let own = video
                .group
                .as_ref()
                .filter(|_| options.normalise_within == NormaliseWithin::Group);
            score(video_population(own, &groups, &corpus), video, options)
        })
        .collect();
    let selected = decide(&mut rows, &options.keep);
    let rewards = reward_rows(&rows, &selected);
    let tally = tally(&rows, &rejected, options);
    let groups = groups
        .into_iter()
        .map(|(name, group)| (name, group.population))
        .collect();
    Reduced {
        rows,
        statistics: tally.statistics(corpus.population, groups, fragility, options),
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
fn score(against: &Surveyed, video: MeasuredVideo, options: &ReduceOptions) -> Row {
    let MeasuredVideo {
        video,
        group,
        carried,
        measurement,
    } = video;
    let yardstick = &against.yardstick;
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
    }
}

/// Fills in rank, percentile and decision.
fn decide(rows: &mut [Row], keep: &KeepRule) -> Vec<Selected> {
    let candidates: Vec<Candidate<'_>> = rows
        .iter()
        .map(|row| Candidate {
            video: &row.video,
            group: row.group.as_deref(),
            anomaly: row.anomaly,
        })
        .collect();
    let selected = select(&candidates, keep);
    for (row, selected) in rows.iter_mut().zip(&selected) {
        row.rank = selected.place.map(|place| place.rank);
        row.percentile = selected.place.map(|place| place.percentile());
        row.decision = selected.decision;
    }
    selected
}

fn reward_rows(rows: &[Row], selected: &[Selected]) -> Vec<Reward> {
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
    rewards::rewards(&scored)
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
