//! Answers into the journal: what is to be measured, and what is kept of it.

use std::time::Duration;

use plumbline_common::message::Job;
use plumbline_common::row::Status;
use plumbline_worker::profile::Profile;
use tokio::time::{MissedTickBehavior, interval};

use crate::answers::{Answer, Answers};
use crate::collect::{Journal, Record};
use crate::corpus::Entry;
use crate::progress::Progress;
use crate::run::{RunError, ScoreOptions};

/// Answers between two flushes to the disk at most: a crash repeats no more work than that...
const ANSWERS_PER_FLUSH: usize = 64;

/// ...and time between two, for slow answers: a fleet waits to hear that they are kept.
const FLUSH_EVERY: Duration = Duration::from_millis(500);

/// The readable entries that the journal does not answer, by index.
pub(crate) fn missing(entries: &[Entry], journal: &Journal) -> Vec<usize> {
    let readable = |entry: &Entry| entry.bytes.is_some() && entry.modified_ns.is_some();
    let indexed = entries.iter().enumerate();
    indexed
        .filter(|(_, entry)| readable(entry) && !journal.contains(&entry.video))
        .map(|(index, _)| index)
        .collect()
}

/// Takes answers until every missing entry has one; gives the compute time spent, seconds. Whatever was
/// taken is in the journal, however it ends.
///
/// # Errors
/// [`RunError`].
pub(crate) async fn collect(
    answers: &mut dyn Answers,
    options: &ScoreOptions,
    entries: &[Entry],
    journal: &mut Journal,
) -> Result<f64, RunError> {
    let total = journal.len() + missing(entries, journal).len();
    let mut progress = Progress::start(total as u64, journal.len() as u64);
    let collected = take_all(answers, options, entries, journal, &mut progress).await;
    progress.finish();
    let compute_s = collected?;
    if journal.len() < total {
        return Err(RunError::Unmeasured {
            missing: total - journal.len(),
            total: entries.len(),
        });
    }
    Ok(compute_s)
}

async fn take_all(
    answers: &mut dyn Answers,
    options: &ScoreOptions,
    entries: &[Entry],
    journal: &mut Journal,
    progress: &mut Progress,
) -> Result<f64, RunError> {
    let mut compute_s = 0.0;
    let mut unkept = 0;
    let mut ticks = interval(FLUSH_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            answer = answers.next() => {
                let Some(answer) = answer? else { break };
                let video = &answer.outcome.video;
                let Ok(index) = entries.binary_search_by(|entry| entry.video.cmp(video)) else {
                    continue;
                };
                if !journal.contains(video) {
                    progress.advance(answer.outcome.measurement.status == Status::Scored);
                }
                compute_s += answer.outcome.cost.total_s;
                journal.append(&record(&entries[index], answer, options))?;
                unkept += 1;
                if unkept >= ANSWERS_PER_FLUSH {
                    keep(answers, journal, &mut unkept).await?;
                }
            }
            _ = ticks.tick() => keep(answers, journal, &mut unkept).await?,
        }
    }
    keep(answers, journal, &mut unkept).await?;
    Ok(compute_s)
}

/// First the rows, then the word that they are kept.
async fn keep(
    answers: &mut dyn Answers,
    journal: &mut Journal,
    unkept: &mut usize,
) -> Result<(), RunError> {
    if *unkept > 0 {
        journal.sync()?;
        *unkept = 0;
    }
    answers.kept().await
}

/// What the journal keeps of an entry's measurement.
pub(crate) fn record(entry: &Entry, answer: Answer, options: &ScoreOptions) -> Record {
    Record {
        location: entry.location.clone(),
        bytes: entry.bytes,
        modified_ns: entry.modified_ns,
        profile_digest: options.reduce.profile_digest.clone(),
        intrinsics: entry.intrinsics(),
        attempts: answer.attempts,
        worker: answer.worker,
        outcome: answer.outcome,
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
