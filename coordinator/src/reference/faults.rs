//! `plumbline reference fit --faults`: thresholds for the fault detectors from clips known to be clean.
//!
//! Clips are measured in compute children like those of a score run, so that a threshold is compared
//! with the very scores it was fitted on. The fit depends on the set of clips alone, not on their order
//! or the number of jobs.

use std::collections::BTreeMap;
use std::path::PathBuf;

use plumbline_common::id::VideoId;
use plumbline_common::row::Status;
use plumbline_vision::faults::{FaultKind, FaultSeries, FaultThresholds, fit_thresholds};
use plumbline_vision::signals::median;
use plumbline_worker::child::SlotError;
use plumbline_worker::profile::Profile;

use super::file::{ReferenceError, directory_and_name};
use crate::corpus::{self, Choice, CorpusError};
use crate::fanout::{Detail, Fanout, Slots};
use crate::measuring::job;
use crate::progress::Progress;
use crate::publish::{OutDir, PublishError};
use crate::run::unreadable;
use crate::stop::StopSignals;
use crate::thresholds::{KindFit, ThresholdsError, ThresholdsFile};

/// Fewer clips say nothing of a high quantile: with 20, one more clean clip is above the largest of them
/// in one case of 21.
pub const MIN_CLIPS: usize = 20;

/// A usable `plumbline reference fit --faults`.
#[derive(Debug, Clone)]
pub struct FitOptions {
    /// Clean clips, as typed.
    pub sources: Vec<String>,
    /// The file to write.
    pub out: PathBuf,
    /// How they are measured.
    pub profile: Profile,
    /// Share of clean clips that stay below, 0..=1.
    pub quantile: f64,
    /// Who computes.
    pub slots: Slots,
}

/// A finished fit.
#[derive(Debug)]
pub struct Fitted {
    /// What was written.
    pub file: ThresholdsFile,
    /// Clips left out, with the reason.
    pub unused: Vec<(VideoId, String)>,
}

/// Why nothing was fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The list of clips is wrong.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// Too few clips for a quantile.
    #[error(
        "{usable} of {given} clips can be used, {MIN_CLIPS} are needed (100 for a 99th percentile that lies between clips); give more clean clips of the camera and codec to be judged{first_reason}"
    )]
    TooFew {
        /// Clips used.
        usable: usize,
        /// Clips given.
        given: usize,
        /// Why the first unused one was left out, if one was.
        first_reason: String,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The file has no name.
    #[error(transparent)]
    NoName(#[from] ReferenceError),
    /// The profile or the thresholds cannot be written down.
    #[error(transparent)]
    Thresholds(#[from] ThresholdsError),
    /// The quantile is out of range.
    #[error(transparent)]
    Quantile(#[from] plumbline_vision::faults::ThresholdError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted: nothing was written; run the same command again")]
    Interrupted,
}

/// Fits thresholds on clean clips and writes them.
///
/// # Errors
/// [`FitError`]; then nothing is written.
pub async fn fit(options: &FitOptions) -> Result<Fitted, FitError> {
    let (directory, name) = directory_and_name(&options.out)?;
    let entries = corpus::freeze(&options.sources, &Choice::default(), &options.out)?.entries;
    let mut unused: Vec<(VideoId, String)> = Vec::new();
    let mut jobs = Vec::new();
    for entry in &entries {
        match job(entry, &options.profile).map_err(ThresholdsError::Profile)? {
            Some(job) => jobs.push(Detail(job)),
            None => unused.push((
                entry.video.clone(),
                unreadable(entry).status_reason.unwrap_or_default(),
            )),
        }
    }
    let mut stop = StopSignals::listen();
    let mut progress = Progress::start(jobs.len() as u64, 0);
    let mut fanout = Fanout::start(jobs, &options.slots);
    let mut clean: Vec<FaultSeries> = Vec::new();
    loop {
        let detailed = tokio::select! {
            next = fanout.next() => match next {
                Some(detailed) => detailed?,
                None => break,
            },
            () = stop.recv() => {
                progress.finish();
                return Err(FitError::Interrupted);
            }
        };
        let row = detailed.outcome.measurement;
        // A cut or a broken frame is not clean; what was not decoded has no scores.
        let usable = matches!(row.status, Status::Scored | Status::Static);
        progress.advance(usable);
        if usable {
            clean.push(detailed.faults);
        } else {
            let reason = row.status_reason.unwrap_or_default();
            let status = row.status.as_str();
            unused.push((detailed.outcome.video, format!("{status}: {reason}")));
        }
    }
    progress.finish();
    unused.sort();
    if clean.len() < MIN_CLIPS {
        let first = unused.first();
        return Err(FitError::TooFew {
            usable: clean.len(),
            given: entries.len(),
            first_reason: first.map_or_else(String::new, |(video, reason)| {
                format!(" (left out: {video}: {reason})")
            }),
        });
    }
    let file = fitted(options, &clean)?;
    let mut bytes = serde_json::to_vec_pretty(&file).map_err(ThresholdsError::Profile)?;
    bytes.push(b'\n');
    OutDir::create(directory)?.put_atomic(name, &bytes)?;
    Ok(Fitted { file, unused })
}

fn fitted(options: &FitOptions, clean: &[FaultSeries]) -> Result<ThresholdsFile, FitError> {
    let mut thresholds = fit_thresholds(clean, 100.0 * options.quantile)?;
    let mut kinds = BTreeMap::new();
    for kind in FaultKind::ALL {
        let mut largest: Vec<f64> = clean
            .iter()
            .filter_map(|series| Some(series.largest(kind)?.score))
            .collect();
        if largest.len() < MIN_CLIPS && kind != FaultKind::Freeze {
            forget(&mut thresholds, kind);
        }
        kinds.insert(
            kind.as_str().to_owned(),
            KindFit {
                clips: largest.len(),
                largest: largest.iter().copied().reduce(f64::max),
                median: median(&mut largest),
            },
        );
    }
    Ok(ThresholdsFile::new(
        &options.profile,
        options.quantile,
        clean.len(),
        thresholds,
        kinds,
    )?)
}

/// A kind that too few clips could be judged by is not reported.
fn forget(thresholds: &mut FaultThresholds, kind: FaultKind) {
    match kind {
        FaultKind::BadFrame => thresholds.bad_frame = None,
        FaultKind::Jump => thresholds.jump = None,
        FaultKind::Appear => thresholds.appear = None,
        FaultKind::Vanish => thresholds.vanish = None,
        FaultKind::Flicker => thresholds.flicker = None,
        FaultKind::Freeze => thresholds.freeze = None,
    }
}
