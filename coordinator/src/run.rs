//! The story of a run: freeze the corpus, measure what is not measured yet, reduce, publish.
//!
//! Every step can be killed and run again. `corpus.json` disappears first and is written last, so
//! that it is there exactly when everything else is.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Instant;

use plumbline_common::id::VideoId;
use plumbline_common::message::Job;
use plumbline_common::row::{Measurement, Status};
use plumbline_worker::child::{Measured, SlotError};
use plumbline_worker::profile::Profile;

use crate::collect::{Journal, JournalError, Record};
use crate::corpus::{self, CorpusError, Entry, GroupBy, Ignored};
use crate::fanout::{Fanout, Slots};
use crate::heat_maps::{self, HeatMaps};
use crate::lease::Lease;
use crate::picture::PngError;
use crate::progress::{Progress, say};
use crate::publish::{
    self, CorpusFile, CostRow, Format, OutDir, ProfileRecord, Publication, PublishError,
};
use crate::reduce::{self, MeasuredVideo, ReduceOptions, Reduced};
use crate::report::{self, CostSummary, DEFAULT_RANKED, ReportInput};
use crate::stop::StopSignals;
use crate::thresholds::FaultCalibration;

/// Where a run keeps what it needs to resume, below OUT.
pub(crate) const STATE_DIRECTORY: &str = ".plumbline";

/// The frozen list of videos, below [`STATE_DIRECTORY`].
pub(crate) const FROZEN_FILE: &str = "corpus.jsonl";

/// Who measured, in `costs.*`, when no fleet is involved.
const EMBEDDED_WORKER: &str = "embedded";

/// A usable `plumbline score`.
#[derive(Debug, Clone)]
pub struct ScoreOptions {
    /// What to score, as typed.
    pub sources: Vec<String>,
    /// Where results go.
    pub out: PathBuf,
    /// How rows are grouped.
    pub group_by: Option<GroupBy>,
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
    /// Who computes.
    pub slots: Slots,
}

impl ScoreOptions {
    /// The options that a reader of the report may ask for.
    fn told(&self) -> Vec<(String, String)> {
        let group_by = self
            .group_by
            .as_ref()
            .map_or("none".to_owned(), GroupBy::to_string);
        vec![
            ("group by".to_owned(), group_by),
            (
                "deadline per video".to_owned(),
                format!("{} s", self.slots.limits.deadline_s),
            ),
            (
                "memory per compute process".to_owned(),
                format!("{} MiB", self.slots.limits.memory_mib),
            ),
        ]
    }
}

/// A finished run.
#[derive(Debug)]
pub struct Finished {
    /// Where it is.
    pub out: PathBuf,
    /// What was published.
    pub files: Vec<String>,
    /// Rows, statistics and rewards.
    pub reduced: Reduced,
    /// Videos measured now (the others were taken over).
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

/// Why a run did not finish.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The list of videos is wrong.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// Another run writes to the same place.
    #[error("{out}: another plumbline run is writing there; wait for it or choose another --out")]
    OutInUse {
        /// OUT.
        out: String,
    },
    /// A watch without a reference: scores would change with every video that arrives.
    #[error("a watch scores against a frozen reference; give --reference")]
    NoReference,
    /// Rows cannot be handed on.
    #[error(
        "rows cannot be written to standard output ({0}); what was measured is kept, and is in --out after the next run"
    )]
    Output(std::io::Error),
    /// The profile cannot be written down.
    #[error("the profile cannot be encoded: {0}")]
    Profile(serde_json::Error),
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The journal cannot be written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A heat map does not encode.
    #[error(transparent)]
    Png(#[from] PngError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// The slots ended before the jobs did, which only a defect of the program explains.
    #[error(
        "{missing} of {total} videos were not measured, since the program that measures them stopped; the others are kept: run the same command again, and report this if it comes back"
    )]
    Unmeasured {
        /// Videos without an outcome.
        missing: usize,
        /// Videos in the corpus.
        total: usize,
    },
    /// Reducing or publishing broke down.
    #[error(
        "the reduce broke down ({0}); what was measured is kept, and this is a defect to report"
    )]
    Finishing(tokio::task::JoinError),
    /// Ctrl-C or SIGTERM.
    #[error(
        "interrupted: {done} of {total} videos are measured and kept; run the same command again to go on"
    )]
    Interrupted {
        /// Videos measured.
        done: usize,
        /// Videos in the corpus.
        total: usize,
    },
}

/// Scores a corpus on this machine.
///
/// # Errors
/// [`RunError`]; whatever was measured is kept and taken over by the next run.
pub async fn score(options: &ScoreOptions) -> Result<Finished, RunError> {
    let started = Instant::now();
    let listing = corpus::freeze(&options.sources, options.group_by.as_ref(), &options.out)?;
    tell_ignored(&listing.ignored);
    let entries = listing.entries;

    let workplace = Workplace::take(options)?;
    write_frozen(&workplace.state, &entries)?;
    let mut journal = workplace.journal(options, &entries)?;
    let measured_before = journal.len();
    if measured_before > 0 {
        say(&format!(
            "{measured_before} of {} videos were measured by an earlier run",
            entries.len()
        ));
    }
    let mut stop = StopSignals::listen();
    let compute_s = measure_missing(options, &entries, &mut journal, &mut stop).await?;
    journal.sync()?;

    let (done, total) = (journal.len(), entries.len());
    let (reduced, files) = tokio::select! {
        finished = finish(options, entries, journal, workplace.out.clone()) => finished?,
        () = stop.recv() => return Err(RunError::Interrupted { done, total }),
    };
    Ok(Finished {
        out: options.out.clone(),
        files,
        measured_now: done - measured_before,
        reduced,
        elapsed_s: started.elapsed().as_secs_f64(),
        compute_s,
    })
}

/// OUT, held against other runs.
pub(crate) struct Workplace {
    pub(crate) out: OutDir,
    pub(crate) state: OutDir,
    _lease: Lease,
}

impl Workplace {
    /// Takes it, and the mark of a finished run away.
    pub(crate) fn take(options: &ScoreOptions) -> Result<Self, RunError> {
        let out = OutDir::create(&options.out)?;
        let state = OutDir::create(options.out.join(STATE_DIRECTORY))?;
        let lease = Lease::take(&state)?.ok_or_else(|| RunError::OutInUse {
            out: options.out.display().to_string(),
        })?;
        out.sweep_partials()?;
        out.remove(publish::CORPUS_FILE)?;
        Ok(Self {
            out,
            state,
            _lease: lease,
        })
    }

    pub(crate) fn journal(
        &self,
        options: &ScoreOptions,
        entries: &[Entry],
    ) -> Result<Journal, JournalError> {
        let path = self.state.root().join("journal");
        let digest = &options.reduce.profile_digest;
        Journal::open(&path, options.resume, entries, digest)
    }
}

/// Reduces what is measured, draws heat maps where asked, and publishes.
pub(crate) async fn finish(
    options: &ScoreOptions,
    entries: Vec<Entry>,
    journal: Journal,
    out: OutDir,
) -> Result<(Reduced, Vec<String>), RunError> {
    let reduce_options = options.reduce.clone();
    let reducing = tokio::task::spawn_blocking(move || -> Result<_, RunError> {
        let (videos, costs) = collected(&entries, &journal)?;
        let reduced = reduce::reduce(videos, &reduce_options);
        Ok((entries, journal, costs, reduced))
    });
    let (entries, journal, costs, reduced) = reducing.await.map_err(RunError::Finishing)??;
    let profile = &options.profile;
    let (most, slots) = (options.heat_maps, &options.slots);
    let heat_maps = heat_maps::draw(most, &reduced.rows, &entries, profile, slots, &out).await?;
    let options = options.clone();
    let publishing = tokio::task::spawn_blocking(move || -> Result<_, RunError> {
        let measured = Measurements {
            entries: &entries,
            journal: &journal,
            costs: &costs,
        };
        let mut files = publish_run(&options, &out, &measured, &reduced, &heat_maps)?;
        files.extend(heat_maps.into_values());
        Ok((reduced, files))
    });
    publishing.await.map_err(RunError::Finishing)?
}

/// Measures every readable entry that the journal does not answer; gives the compute time spent.
async fn measure_missing(
    options: &ScoreOptions,
    entries: &[Entry],
    journal: &mut Journal,
    stop: &mut StopSignals,
) -> Result<f64, RunError> {
    let jobs: Vec<Job> = entries
        .iter()
        .filter(|entry| !journal.contains(&entry.video))
        .filter_map(|entry| job(entry, &options.profile).transpose())
        .collect::<Result<_, _>>()
        .map_err(RunError::Profile)?;
    let by_video: std::collections::HashMap<&VideoId, &Entry> =
        entries.iter().map(|entry| (&entry.video, entry)).collect();
    let total = journal.len() + jobs.len();
    let mut progress = Progress::start(total as u64, journal.len() as u64);
    let mut compute_s = 0.0;
    let mut fanout = Fanout::start(jobs, &options.slots);
    loop {
        let measured = tokio::select! {
            next = fanout.next() => match next {
                Some(measured) => measured?,
                None => break,
            },
            () = stop.recv() => {
                progress.finish();
                journal.sync()?;
                return Err(RunError::Interrupted { done: journal.len(), total: entries.len() });
            }
        };
        let Some(entry) = by_video.get(&measured.outcome.video) else {
            continue;
        };
        progress.advance(measured.outcome.measurement.status == Status::Scored);
        compute_s += measured.outcome.cost.total_s;
        journal.append(&record(entry, measured, options))?;
    }
    progress.finish();
    if journal.len() < total {
        return Err(RunError::Unmeasured {
            missing: total - journal.len(),
            total: entries.len(),
        });
    }
    Ok(compute_s)
}

/// What the journal keeps of an entry's measurement.
pub(crate) fn record(entry: &Entry, measured: Measured, options: &ScoreOptions) -> Record {
    Record {
        location: entry.location.clone(),
        bytes: entry.bytes,
        modified_ns: entry.modified_ns,
        profile_digest: options.reduce.profile_digest.clone(),
        intrinsics: entry.intrinsics(),
        attempts: measured.attempts,
        outcome: measured.outcome,
    }
}

/// The job of an entry, with its own camera where the list tells it; none where the file could not even
/// be looked at.
pub(crate) fn job(entry: &Entry, profile: &Profile) -> Result<Option<Job>, serde_json::Error> {
    let (Some(bytes), Some(modified_ns)) = (entry.bytes, entry.modified_ns) else {
        return Ok(None);
    };
    let profile = Profile {
        intrinsics: entry.intrinsics().or(profile.intrinsics),
        ..profile.clone()
    };
    Ok(Some(Job {
        video: entry.video.clone(),
        location: entry.location.clone(),
        bytes,
        modified_ns,
        profile: profile.canonical()?,
    }))
}

/// Every entry with its measurement, in the corpus' order, so that nothing is lost; and what each
/// measurement cost.
fn collected(
    entries: &[Entry],
    journal: &Journal,
) -> Result<(Vec<MeasuredVideo>, Vec<CostRow>), JournalError> {
    let mut videos = Vec::with_capacity(entries.len());
    let mut costs = Vec::with_capacity(entries.len());
    for entry in entries {
        let measurement = match journal.read(&entry.video)? {
            Some(record) => {
                costs.push(CostRow {
                    video: entry.video.clone(),
                    cost: record.outcome.cost,
                    attempts: record.attempts,
                    worker: EMBEDDED_WORKER.to_owned(),
                });
                record.outcome.measurement
            }
            None => unreadable(entry),
        };
        videos.push(measured_video(entry, measurement));
    }
    Ok((videos, costs))
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

/// What was measured, and at what cost.
struct Measurements<'a> {
    entries: &'a [Entry],
    journal: &'a Journal,
    costs: &'a [CostRow],
}

fn publish_run(
    options: &ScoreOptions,
    out: &OutDir,
    measured: &Measurements<'_>,
    reduced: &Reduced,
    heat_maps: &HeatMaps,
) -> Result<Vec<String>, RunError> {
    let Measurements {
        entries,
        journal,
        costs,
    } = *measured;
    let parameters = serde_json::to_value(&options.profile).map_err(RunError::Profile)?;
    let corpus = CorpusFile {
        plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
        source: options.sources.clone(),
        profile: Some(ProfileRecord {
            name: Some(options.profile.name()),
            digest: options.reduce.profile_digest.clone(),
            parameters,
        }),
        conditioning_frames: Some(options.profile.conditioning_frames),
        fault_calibration: options.fault_calibration.clone(),
        statistics: reduced.statistics.clone(),
    };
    let locations: Vec<String> = entries.iter().map(Entry::address).collect();
    let thumbnails = |video: &VideoId| journal.read(video).ok()??.outcome.thumbnails;
    let report = report::render(&ReportInput {
        title: &options.sources.join(", "),
        corpus: &corpus,
        rows: &reduced.rows,
        thumbnails: &thumbnails,
        heat_maps,
        costs: Some(CostSummary::of(costs)),
        options: &options.told(),
        ranked: DEFAULT_RANKED,
    });
    let publication = Publication {
        rows: &reduced.rows,
        locations: &locations,
        costs,
        rewards: &reduced.rewards,
        report_html: Some(&report),
        corpus: &corpus,
    };
    Ok(publish::publish(out, &publication, &options.formats)?)
}

/// The frozen list beside the journal, for a person who asks what a run was about.
pub(crate) fn write_frozen(state: &OutDir, entries: &[Entry]) -> Result<(), RunError> {
    state.put_atomic_with(FROZEN_FILE, |writer| {
        for entry in entries {
            serde_json::to_writer(&mut *writer, entry)?;
            writer.write_all(b"\n")?;
        }
        Ok(())
    })?;
    Ok(())
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
