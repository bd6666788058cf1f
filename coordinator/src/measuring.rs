//! Answers into the journal: what is to be measured, and what is kept of it.

use plumbline_common::message::Job;
use plumbline_common::row::Status;
use plumbline_worker::profile::Profile;
use tokio::time::{MissedTickBehavior, interval};

use crate::answers::{Answer, Answers};
use crate::collect::{Journal, Record};
use crate::corpus::Entry;
use crate::keep::Keep;
use crate::progress::Progress;
use crate::run::{RunError, ScoreOptions};

/// Whether an entry could be looked at.
pub(crate) fn is_readable(entry: &Entry) -> bool {
    entry.bytes.is_some() && entry.modified_ns.is_some()
}

/// The readable entries that the journal does not answer, by index.
pub(crate) fn missing(entries: &[Entry], journal: &Journal) -> Vec<usize> {
    let indexed = entries.iter().enumerate();
    indexed
        .filter(|(_, entry)| is_readable(entry) && !journal.contains(&entry.video))
        .map(|(index, _)| index)
        .collect()
}

/// What answers have cost, seconds over all slots.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Spent {
    /// Wall time.
    pub(crate) compute_s: f64,
    /// Processor time.
    pub(crate) cpu_s: f64,
}

/// Takes answers until every one that was `asked` for has come, or more than `most_cpu_s` is spent on them.
/// Whatever was taken is in the journal, however it ends.
///
/// # Errors
/// [`RunError`].
pub(crate) async fn collect(
    answers: &mut dyn Answers,
    options: &ScoreOptions,
    entries: &[Entry],
    asked: usize,
    most_cpu_s: f64,
    keep: &mut Keep,
) -> Result<Spent, RunError> {
    let before = keep.journal.len();
    let total = before + asked;
    let mut progress = Progress::start(total as u64, before as u64);
    options.metrics.corpus(entries.len(), before);
    let collected = take_all(answers, options, entries, most_cpu_s, keep, &mut progress).await;
    progress.finish();
    let spent = collected?;
    let done = keep.journal.len();
    if done < total && spent.cpu_s < most_cpu_s {
        return Err(RunError::Unmeasured {
            missing: total - done,
            total: entries.len(),
        });
    }
    Ok(spent)
}

async fn take_all(
    answers: &mut dyn Answers,
    options: &ScoreOptions,
    entries: &[Entry],
    most_cpu_s: f64,
    keep: &mut Keep,
    progress: &mut Progress,
) -> Result<Spent, RunError> {
    let mut spent = Spent::default();
    let mut unflushed = 0;
    let flushing = keep.flushing();
    let mut ticks = interval(flushing.every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while spent.cpu_s < most_cpu_s {
        tokio::select! {
            answer = answers.next() => {
                let Some(answer) = answer? else { break };
                let outcome = &answer.outcome;
                let video = &outcome.video;
                let Ok(index) = entries.binary_search_by(|entry| entry.video.cmp(video)) else {
                    continue;
                };
                if !keep.journal.contains(video) {
                    progress.advance(outcome.measurement.status == Status::Scored);
                }
                spent.compute_s += outcome.cost.total_s;
                spent.cpu_s += outcome.cost.cpu_s;
                let status = outcome.measurement.status;
                keep.append(&record(&entries[index], answer, options))?;
                options.metrics.answer(status, keep.journal.len());
                unflushed += 1;
                if unflushed >= flushing.answers {
                    flush(answers, keep, &mut unflushed).await?;
                }
            }
            _ = ticks.tick() => flush(answers, keep, &mut unflushed).await?,
        }
    }
    flush(answers, keep, &mut unflushed).await?;
    Ok(spent)
}

/// First the rows, then the word that they are kept.
async fn flush(
    answers: &mut dyn Answers,
    keep: &mut Keep,
    unflushed: &mut usize,
) -> Result<(), RunError> {
    if *unflushed > 0 {
        keep.flush().await?;
        *unflushed = 0;
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
