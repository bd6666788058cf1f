//! `plumbline score --watch`: videos scored one by one as they arrive, against a frozen reference.
//!
//! The sources are looked through again and again. A video that two looks found the same is measured;
//! its row does not depend on the others, so that it is final and handed on at once. When the watch
//! ends, everything is published as by a run over the same videos, byte for byte. Every step can be
//! killed and run again: what is measured is in the journal, and its rows are handed on anew.

mod arrivals;
mod lines;

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_common::id::VideoId;
use plumbline_common::message::Job;
use plumbline_common::row::{Measurement, Status};
use plumbline_worker::child::Measured;
use tokio::time::MissedTickBehavior;

use crate::answers::Answer;
use crate::collect::Journal;
use crate::corpus::{self, CorpusError, Entry};
use crate::fanout::Fanout;
use crate::measuring::{job, record};
use crate::progress::say;
use crate::reduce::reference::Reference;
use crate::reduce::score_final;
use crate::run::{
    Finished, Journals, RunError, ScoreOptions, Workplace, finish, measured_video, write_frozen,
};
use crate::stop::StopSignals;
use arrivals::Arrivals;
use lines::Lines;

/// How a source is watched.
#[derive(Debug, Clone)]
pub struct WatchOptions {
    /// Time between two looks.
    pub poll: Duration,
    /// The watch ends when nothing has come for so long.
    pub idle: Option<Duration>,
    /// The watch ends when this file is there, and everything that came before it is scored.
    pub until: Option<PathBuf>,
    /// Whether rows go to standard output, too.
    pub to_stdout: bool,
}

/// Scores what arrives until the watch ends, then publishes. The first Ctrl-C or SIGTERM ends the watch,
/// the second one the run.
///
/// # Errors
/// [`RunError`]; whatever was measured is kept and taken over by the next run.
pub async fn watch(options: &ScoreOptions, watch: &WatchOptions) -> Result<Finished, RunError> {
    let started = Instant::now();
    let reference = options
        .reduce
        .reference
        .clone()
        .ok_or(RunError::NoReference)?;
    let first = listing(options).await?;
    let workplace = Workplace::take(&options.out)?;
    let journal = workplace.journal(options, options.resume, &first)?;
    let known = first.iter().filter(|entry| journal.contains(&entry.video));
    let mut run = Watching {
        options,
        reference: &reference,
        lines: Lines::start(&workplace.out, watch.to_stdout, &options.reduce)?,
        measured_before: known.map(|e| (e.video.clone(), e.clone())).collect(),
        journal,
        arrivals: Arrivals::default(),
        jobs: VecDeque::new(),
        in_work: 0,
        measured_now: 0,
        compute_s: 0.0,
    };
    let mut stop = StopSignals::listen();
    run.follow(watch, first, &mut stop).await?;

    let Watching {
        mut journal,
        arrivals,
        measured_now,
        compute_s,
        ..
    } = run;
    journal.sync()?;
    let entries = arrivals.into_entries();
    if entries.is_empty() {
        return Err(corpus::empty(&options.sources).into());
    }
    write_frozen(&workplace.state, &entries)?;
    let (done, total) = (journal.len(), entries.len());
    let published = tokio::select! {
        finished = finish(options, Arc::new(entries), Journals::Plain(journal), workplace.out.clone()) => finished?,
        () = stop.recv() => return Err(RunError::Interrupted { done, total }),
    };
    Ok(Finished {
        out: options.out.clone(),
        run: None,
        files: published.files,
        reduced: published.reduced,
        cascade: published.cascade,
        measured_now,
        elapsed_s: started.elapsed().as_secs_f64(),
        compute_s,
    })
}

/// What the sources hold now; nothing yet is no error.
async fn listing(options: &ScoreOptions) -> Result<Vec<Entry>, RunError> {
    let (sources, choice, out) = (
        options.sources.clone(),
        options.choice.clone(),
        options.out.clone(),
    );
    let looking = tokio::task::spawn_blocking(move || corpus::freeze(&sources, &choice, &out));
    match looking.await.map_err(RunError::Finishing)? {
        Ok(listing) => Ok(listing.entries),
        Err(CorpusError::Empty { .. }) => Ok(Vec::new()),
        Err(error) => Err(error.into()),
    }
}

struct Watching<'a> {
    options: &'a ScoreOptions,
    reference: &'a Reference,
    lines: Lines,
    /// Entries that the journal answered at the start.
    measured_before: BTreeMap<VideoId, Entry>,
    journal: Journal,
    arrivals: Arrivals,
    /// Whole, and waiting for a slot.
    jobs: VecDeque<Job>,
    /// Jobs without an answer.
    in_work: usize,
    measured_now: usize,
    compute_s: f64,
}

impl Watching<'_> {
    /// Looks and measures until the watch ends and all that was taken is measured.
    async fn follow(
        &mut self,
        watch: &WatchOptions,
        first: Vec<Entry>,
        stop: &mut StopSignals,
    ) -> Result<(), RunError> {
        let slots = &self.options.slots;
        let (sender, mut fanout) = Fanout::open(slots.count, slots);
        let mut ticks = tokio::time::interval(watch.poll);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        ticks.reset();
        self.look(first)?;
        let mut last_news = Instant::now();
        let mut last_problem = String::new();
        let mut ending = false;
        while !(ending && self.in_work == 0) {
            while let Some(job) = self.jobs.pop_front() {
                if let Err(full) = sender.try_send(job) {
                    self.jobs.push_front(full.into_inner());
                    break;
                }
            }
            tokio::select! {
                _ = ticks.tick(), if !ending => {
                    // Asked first: what came before the mark is in the listing.
                    let marked = watch.until.as_ref().is_some_and(|mark| mark.exists());
                    match listing(self.options).await {
                        Ok(entries) => if self.look(entries)? {
                            last_news = Instant::now();
                        },
                        // A directory may be gone for a while.
                        Err(RunError::Corpus(error)) => {
                            let problem = error.to_string();
                            if problem != last_problem {
                                say(&format!("note: {problem}"));
                                last_problem = problem;
                            }
                        }
                        Err(error) => return Err(error),
                    }
                    let idle = watch.idle.is_some_and(|idle| self.in_work == 0 && last_news.elapsed() >= idle);
                    ending = (marked || idle) && !self.arrivals.is_waiting();
                }
                answer = fanout.next() => {
                    let total = self.journal.len() + self.in_work;
                    let missing = RunError::Unmeasured { missing: self.in_work, total };
                    self.take(answer.ok_or(missing)??)?;
                    last_news = Instant::now();
                }
                () = stop.recv() => {
                    if ending {
                        self.journal.sync()?;
                        let done = self.journal.len();
                        return Err(RunError::Interrupted { done, total: done + self.in_work });
                    }
                    say(&format!("ending the watch: {} videos are still measured; stop again to leave them", self.in_work));
                    ending = true;
                }
            }
        }
        Ok(())
    }

    /// Takes what is whole; says whether anything has changed.
    fn look(&mut self, entries: Vec<Entry>) -> Result<bool, RunError> {
        let look = self.arrivals.look(entries);
        for video in look.changed {
            say(&format!(
                "note: {video} changed after it was scored; its row is of what it was before"
            ));
        }
        let news = look.news || !look.ready.is_empty();
        for entry in look.ready {
            // What changed since the start is measured anew.
            let before = self.measured_before.remove(&entry.video);
            let record = match before.is_some_and(|before| before == entry) {
                true => self.journal.read(&entry.video)?,
                false => None,
            };
            let job = job(&entry, &self.options.profile).map_err(RunError::Profile)?;
            match (record, job) {
                (Some(record), _) => self.hand_on(&entry, record.outcome.measurement)?,
                (None, Some(job)) => {
                    self.jobs.push_back(job);
                    self.in_work += 1;
                }
                // A whole entry has a size and a time.
                (None, None) => {}
            }
        }
        Ok(news)
    }

    /// Keeps an answer and hands its row on.
    fn take(&mut self, measured: Measured) -> Result<(), RunError> {
        self.in_work -= 1;
        let video = measured.outcome.video.clone();
        let Some(entry) = self.arrivals.taken(&video).cloned() else {
            return Ok(());
        };
        let failed = measured.outcome.measurement.status == Status::Failed;
        if failed && corpus::looked_at_again(&entry) != entry {
            // Not whole after all.
            self.arrivals.give_back(&video);
            return Ok(());
        }
        self.measured_now += 1;
        self.compute_s += measured.outcome.cost.total_s;
        let measurement = measured.outcome.measurement.clone();
        let answer = Answer::embedded(measured);
        self.journal.append(&record(&entry, answer, self.options))?;
        let kept = self.journal.len();
        self.options.metrics.answer(measurement.status, kept);
        self.hand_on(&entry, measurement)
    }

    fn hand_on(&mut self, entry: &Entry, measurement: Measurement) -> Result<(), RunError> {
        let video = measured_video(entry, measurement);
        self.lines
            .push(&score_final(video, self.reference, &self.options.reduce))
    }
}
