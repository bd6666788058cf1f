//! The sample at one point: what a run of `score` would measure, into a journal of the point's own, so that
//! a killed command goes on where it was and nothing is measured twice.

use std::sync::Arc;

use plumbline_common::row::Cost;

use super::{GridPoint, TradeoffOptions};
use crate::collect::Journal;
use crate::corpus::{Choice, Entry};
use crate::fanout::Fanout;
use crate::keep::Keep;
use crate::measuring;
use crate::metrics::Metrics;
use crate::publish::OutDir;
use crate::reduce::{MeasuredVideo, ReduceOptions};
use crate::run::{RunError, ScoreOptions, collected};

/// What was measured, aligned with the entries.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Measured {
    pub(super) videos: Vec<MeasuredVideo>,
    pub(super) costs: Vec<Cost>,
}

/// Measures `entries` (readable, by video) at `point`, but for what its journal below `state` already
/// answers.
///
/// # Errors
/// [`RunError`]; whatever was measured is kept.
pub(super) async fn measure(
    point: &GridPoint,
    entries: &Arc<Vec<Entry>>,
    options: &TradeoffOptions,
    state: &OutDir,
) -> Result<Measured, RunError> {
    let profile_digest = point.profile.digest().map_err(RunError::Profile)?;
    let place = OutDir::create(state.root().join("points").join(short(&profile_digest)))?;
    let run = ScoreOptions {
        sources: options.sources.clone(),
        out: place.root().to_path_buf(),
        choice: Choice::default(),
        profile: point.profile.clone(),
        reduce: ReduceOptions {
            profile_digest,
            ..options.reduce.clone()
        },
        resume: options.resume,
        formats: std::collections::BTreeSet::new(),
        fault_calibration: None,
        heat_maps: 0,
        slots: options.slots.clone(),
        cascade: None,
        fleet: None,
        metrics: Metrics::default(),
        command: String::new(),
    };
    let path = place.root().join("journal");
    let journal = Journal::open(&path, run.resume, entries, &run.reduce.profile_digest)?;
    let jobs = measuring::missing(entries, &journal)
        .into_iter()
        .filter_map(|index| measuring::job(&entries[index], &run.profile).transpose())
        .collect::<Result<Vec<_>, _>>()
        .map_err(RunError::Profile)?;
    let mut keep = Keep {
        journal,
        parts: None,
    };
    if !jobs.is_empty() {
        let asked = jobs.len();
        let mut slots = Fanout::start(jobs, &run.slots);
        measuring::collect(&mut slots, &run, entries, asked, f64::INFINITY, &mut keep).await?;
    }
    let (videos, costs) = collected(entries, &keep.journal)?;
    Ok(Measured {
        videos,
        costs: costs.into_iter().map(|row| row.cost).collect(),
    })
}

/// Enough of a digest to tell the points of one command apart.
pub(super) fn short(digest: &str) -> &str {
    const CHARS: usize = 16;
    digest.get(..CHARS).unwrap_or(digest)
}
