//! The story of a run: freeze the corpus, measure what is not measured yet, reduce, publish.
//!
//! Every step can be killed and run again. `corpus.json` disappears first and is written last, so
//! that it is there exactly when everything else is.

mod cascade;
mod error;
mod finish;
mod journals;
mod workplace;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use plumbline_common::id::{NotARunId, RunId};
use plumbline_common::row::{Measurement, Status};
use plumbline_worker::profile::Profile;

use crate::answers::Answers;
use crate::cascade::record::CascadeRecord;
use crate::collect::Journal;
use crate::corpus::{self, Choice, Entry, GroupBy, Ignored};
use crate::fanout::{Fanout, Slots};
use crate::fleet::{self, FleetOptions, FleetRun, Questions};
use crate::keep::Keep;
use crate::measuring::{self, Spent, job};
use crate::metrics::Metrics;
use crate::parts::{self, Parts};
use crate::progress::say;
use crate::publish::Format;
use crate::reduce::{MeasuredVideo, ReduceOptions, Reduced};
use crate::remote_out::RemoteOut;
use crate::stop::StopSignals;
use crate::thresholds::FaultCalibration;

pub use cascade::CascadeOptions;
use cascade::Climbed;
pub use error::RunError;
pub(crate) use finish::finish;
pub(crate) use journals::{Journals, collected};
pub(crate) use workplace::{
    FROZEN_FILE, JOURNAL_FILE, STATE_DIRECTORY, Workplace, path_below, write_frozen,
};
use workplace::{RUN_FILE, journal_below};

/// A usable `plumbline score`.
#[derive(Debug, Clone)]
pub struct ScoreOptions {
    /// What to score, as typed.
    pub sources: Vec<String>,
    /// Where results go.
    pub out: PathBuf,
    /// Which of their videos, and how rows are grouped.
    pub choice: Choice,
    /// How videos are measured.
    pub profile: Profile,
    /// How rows become decisions.
    pub reduce: ReduceOptions,
    /// Whether an earlier run's measurements count.
    pub resume: bool,
    /// Formats of the tables.
    pub formats: BTreeSet<Format>,
    /// Where the profile's fault thresholds come from, if not from the profile itself.
    pub fault_calibration: Option<FaultCalibration>,
    /// How many of the most anomalous videos get a heat map.
    pub heat_maps: usize,
    /// Who computes here.
    pub slots: Slots,
    /// Only uncertain videos are measured with the profile, the others with cheaper ones.
    pub cascade: Option<CascadeOptions>,
    /// Who measures instead, where a fleet does.
    pub fleet: Option<FleetOptions>,
    /// Where the run is counted.
    pub metrics: Metrics,
    /// What was typed, for the record.
    pub command: String,
}

impl ScoreOptions {
    /// What the run is called, on a fleet and in an OUT in a store.
    fn run_name(&self, entries: &[Entry]) -> Result<RunId, NotARunId> {
        let name = self.fleet.as_ref().and_then(|fleet| fleet.name.as_deref());
        fleet::run_name(name, entries, &self.reduce.profile_digest)
    }

    /// The same, if a fleet measures it.
    fn run_on_fleet(&self, entries: &[Entry]) -> Result<Option<RunId>, NotARunId> {
        let name = self.fleet.as_ref().map(|_| self.run_name(entries));
        name.transpose()
    }

    /// The options that a reader of the report may ask for.
    fn told(&self) -> Vec<(String, String)> {
        let group_by = self
            .choice
            .group_by
            .as_ref()
            .map_or("none".to_owned(), GroupBy::to_string);
        let mut told = vec![
            ("command".to_owned(), self.command.clone()),
            ("group by".to_owned(), group_by),
        ];
        if self.fleet.is_some() {
            let theirs = "a fleet, each worker within limits of its own".to_owned();
            told.push(("measured by".to_owned(), theirs));
        } else {
            let limits = &self.slots.limits;
            told.push((
                "deadline per video".to_owned(),
                format!(
                    "{} s",
                    match self.profile.is_learned() {
                        true => limits.learned_deadline_s,
                        false => limits.deadline_s,
                    }
                ),
            ));
            told.push((
                "memory per compute process".to_owned(),
                format!("{} MiB", limits.memory_mib),
            ));
        }
        told
    }
}

/// A finished run.
#[derive(Debug)]
pub struct Finished {
    /// Where it is.
    pub out: PathBuf,
    /// What it was called on a fleet.
    pub run: Option<RunId>,
    /// What was published.
    pub files: Vec<String>,
    /// Rows, statistics and rewards.
    pub reduced: Reduced,
    /// What a cascade came to.
    pub cascade: Option<CascadeRecord>,
    /// Measurements made now (the others were taken over).
    pub measured_now: usize,
    /// Wall time of the run, seconds.
    pub elapsed_s: f64,
    /// Compute time of the videos measured now, seconds over all slots.
    pub compute_s: f64,
}

impl Finished {
    /// Whether every row is scored or static.
    #[must_use]
    pub fn complete(&self) -> bool {
        let mut statuses = self.reduced.rows.iter().map(|row| row.measured.status);
        statuses.all(|status| matches!(status, Status::Scored | Status::Static))
    }
}

/// Scores a corpus on this machine.
///
/// # Errors
/// [`RunError`]; whatever was measured is kept and taken over by the next run.
pub async fn score(options: &ScoreOptions) -> Result<Finished, RunError> {
    let started = Instant::now();
    let out = options.out.to_string_lossy();
    let s3 = options.slots.fetcher.s3_options();
    let remote = RemoteOut::open(&out, s3).await?;
    let listing = corpus::freeze_anywhere(&options.sources, &options.choice, &out, s3).await?;
    tell_ignored(&listing.ignored);
    let entries = Arc::new(listing.entries);

    let local_out = remote.as_ref().map_or(&*options.out, RemoteOut::staging);
    let workplace = Workplace::take(local_out)?;
    write_frozen(&workplace.state, &entries)?;
    let run = options.run_on_fleet(&entries)?;
    if let Some(run) = &run {
        let line = format!("{run}\n");
        workplace.state.put_atomic(RUN_FILE, line.as_bytes())?;
    }
    if let Some(remote) = &remote {
        take_remote(remote, options, &entries, &workplace).await?;
    }
    let site = Site {
        options,
        entries: Arc::clone(&entries),
        workplace: &workplace,
        remote: remote.as_ref(),
    };
    let mut stop = StopSignals::listen();
    let (climbed, answers) = match &options.cascade {
        None => site.measure_all(run, &mut stop).await?,
        Some(cascade) => (cascade::climb(&site, cascade, &mut stop).await?, None),
    };

    let done = entries.len();
    let finishing = async {
        let out = workplace.out.clone();
        let published = finish(options, entries, climbed.measured, out).await?;
        if let Some(remote) = &remote {
            remote.upload(&published.files).await?;
        }
        if let Some(answers) = answers {
            answers.finished().await?;
        }
        Ok::<_, RunError>(published)
    };
    let published = tokio::select! {
        finished = finishing => finished?,
        () = stop.recv() => return Err(RunError::Interrupted { done, total: done }),
    };
    Ok(Finished {
        out: options.out.clone(),
        run: climbed.run,
        files: published.files,
        measured_now: climbed.measured_now,
        reduced: published.reduced,
        cascade: published.cascade,
        elapsed_s: started.elapsed().as_secs_f64(),
        compute_s: climbed.compute_s,
    })
}

/// Where a run measures, and what.
struct Site<'a> {
    options: &'a ScoreOptions,
    entries: Arc<Vec<Entry>>,
    workplace: &'a Workplace,
    remote: Option<&'a RemoteOut>,
}

impl Site<'_> {
    /// Where answers to the questions of `options` go.
    fn keep(&self, options: &ScoreOptions, is_top: bool) -> Result<Keep, RunError> {
        let resume = options.resume || self.remote.is_some();
        let digest = &options.reduce.profile_digest;
        let path = self.workplace.journal_path();
        let path = match is_top {
            true => path,
            false => journal_below(&path, digest, resume)?,
        };
        let parts = match self.remote {
            None => None,
            Some(remote) => {
                let run = options.run_name(&self.entries)?;
                Some(Parts::new(Arc::clone(remote.store()), &run))
            }
        };
        Ok(Keep {
            journal: Journal::open(&path, resume, &self.entries, digest)?,
            parts,
        })
    }

    /// Measures everything with one profile; whoever answered is to be told when that is published.
    async fn measure_all(
        &self,
        run: Option<RunId>,
        stop: &mut StopSignals,
    ) -> Result<(Climbed, Option<Box<dyn Answers>>), RunError> {
        let Self {
            options, entries, ..
        } = self;
        let mut keep = self.keep(options, true)?;
        let measured_before = keep.journal.len();
        if measured_before > 0 {
            say(&format!(
                "{measured_before} of {} videos were measured by an earlier run",
                entries.len()
            ));
        }
        let missing = measuring::missing(entries, &keep.journal);
        let (keeping, all) = (&mut keep, f64::INFINITY);
        let (spent, answers) =
            measure(options, entries, missing, all, keeping, run.as_ref(), stop).await?;
        let climbed = Climbed {
            measured_now: keep.journal.len() - measured_before,
            compute_s: spent.compute_s,
            measured: Journals::Plain(keep.journal),
            run,
        };
        Ok((climbed, Some(answers)))
    }
}

/// Has the `asked` entries measured, and keeps the answers.
async fn measure(
    options: &ScoreOptions,
    entries: &Arc<Vec<Entry>>,
    asked: Vec<usize>,
    most_cpu_s: f64,
    keep: &mut Keep,
    run: Option<&RunId>,
    stop: &mut StopSignals,
) -> Result<(Spent, Box<dyn Answers>), RunError> {
    let interrupted = |keep: &Keep| RunError::Interrupted {
        done: keep.journal.len(),
        total: entries.len(),
    };
    let count = asked.len();
    let mut answers = tokio::select! {
        answers = ask(options, entries, asked, run) => answers?,
        () = stop.recv() => return Err(interrupted(keep)),
    };
    let collecting = measuring::collect(&mut *answers, options, entries, count, most_cpu_s, keep);
    let collected = tokio::select! {
        collected = collecting => collected,
        () = stop.recv() => Err(interrupted(keep)),
    };
    if collected.is_err() {
        keep.flush().await?;
        if let Some(run) = run {
            say(&format!(
                "workers go on with what is in the queue, unless told not to: plumbline fleet cancel {run}"
            ));
        }
    }
    Ok((collected?, answers))
}

/// What earlier runs left in an OUT in a store, as this machine's journal; the frozen list, put there.
async fn take_remote(
    remote: &RemoteOut,
    options: &ScoreOptions,
    entries: &[Entry],
    workplace: &Workplace,
) -> Result<(), RunError> {
    let store = remote.store();
    let run = options.run_name(entries)?;
    remote.withdraw().await?;
    parts::put_corpus(&**store, &run, entries).await?;
    parts::restore(&**store, &workplace.journal_path(), options.resume).await
}

/// Has entries measured: here, or by the fleet.
async fn ask(
    options: &ScoreOptions,
    entries: &Arc<Vec<Entry>>,
    missing: Vec<usize>,
    run: Option<&RunId>,
) -> Result<Box<dyn Answers>, RunError> {
    let (Some(fleet), Some(run)) = (&options.fleet, run) else {
        let jobs = missing.iter().filter_map(|&index| entries.get(index));
        let jobs = jobs.filter_map(|entry| job(entry, &options.profile).transpose());
        let jobs: Vec<_> = jobs.collect::<Result<_, _>>().map_err(RunError::Profile)?;
        return Ok(Box::new(Fanout::start(jobs, &options.slots)));
    };
    say(&format!(
        "run {run}: {} videos for the fleet",
        missing.len()
    ));
    let questions = Questions {
        entries: Arc::clone(entries),
        missing,
        profile: options.profile.clone(),
        resume: options.resume,
    };
    Ok(Box::new(
        FleetRun::start(fleet, run.clone(), questions).await?,
    ))
}

/// An entry with its measurement.
pub(crate) fn measured_video(entry: &Entry, measurement: Measurement) -> MeasuredVideo {
    MeasuredVideo {
        video: entry.video.clone(),
        group: entry.group.clone(),
        carried: entry.carried.clone(),
        measurement,
    }
}

/// The row of an entry that cannot be looked at.
pub(crate) fn unreadable(entry: &Entry) -> Measurement {
    let problem = entry.problem.as_deref().unwrap_or("not measured");
    Measurement::without_score(
        Status::Failed,
        format!(
            "{}: cannot be read ({problem}); mend it and run again",
            entry.address()
        ),
    )
}

fn tell_ignored(ignored: &Ignored) {
    if ignored.is_empty() {
        return;
    }
    let by_extension: Vec<String> = ignored
        .iter()
        .map(|(extension, count)| match extension.as_str() {
            "" => format!("{count} without extension"),
            extension => format!("{count} .{extension}"),
        })
        .collect();
    say(&format!(
        "passed over files that are not named like videos: {} (a list or a glob takes any file)",
        by_extension.join(", ")
    ));
}
