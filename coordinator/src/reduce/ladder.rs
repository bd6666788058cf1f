//! The reduce where rows come from different profiles: each is scored by the calibration of its own.
//!
//! z-scores, S_r and its interval follow the row's profile; ranks, decisions and rewards compare S_r of all
//! rows, which calibrations put on one scale. The statistics that are told are those of the last rung.

use std::collections::BTreeMap;

use plumbline_common::row::Row;

use super::population::Surveyed;
use super::{MeasuredVideo, ReduceOptions, Reduced, decide, reject, reward_rows, score, tally};

/// A profile that some rows come from.
#[derive(Debug, Clone)]
pub struct RungOfRows {
    /// Its name.
    pub name: String,
    /// Its digest.
    pub digest: String,
    /// What its rows are scored with.
    pub calibration: Surveyed,
}

/// A video, and the rung that its measurement comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct OnRung {
    /// The video.
    pub video: MeasuredVideo,
    /// By index.
    pub rung: usize,
    /// The probability that the last rung decides otherwise, where that is known.
    pub flip: Option<f64>,
}

/// Reduces rows of several profiles; `videos` in the order of their names.
#[must_use]
pub fn reduce(videos: Vec<OnRung>, rungs: &[RungOfRows], options: &ReduceOptions) -> Reduced {
    let mut rejected = Vec::with_capacity(videos.len());
    let rows = videos.into_iter().filter_map(|on_rung| {
        let OnRung {
            mut video,
            rung,
            flip,
        } = on_rung;
        let rung = rungs.get(rung)?;
        rejected.push(reject::reject_non_finite(&mut video.measurement));
        let mut row = score(&rung.calibration.yardstick, video, options);
        row.profile_digest.clone_from(&rung.digest);
        row.rung = Some(rung.name.clone());
        row.flip_probability = flip;
        Some(row)
    });
    let mut rows: Vec<Row> = rows.collect();
    let selected = decide(&mut rows, options);
    let rewards = reward_rows(&rows, &selected, options);
    let tally = tally(&rows, &rejected, options);
    let top = rungs.last().map(|rung| rung.calibration.population.clone());
    let top = top.unwrap_or_default();
    Reduced {
        statistics: tally.statistics(top, BTreeMap::new(), None, None, options),
        rows,
        rewards,
    }
}
