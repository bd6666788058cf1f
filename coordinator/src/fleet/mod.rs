//! A run on a fleet: jobs into a queue, answers out of the run's own queue, whatever happens in between.
//!
//! What is promised by queues stands in `plumbline_common::queue`'s `design.md`: everything comes at least
//! once. Here it is made to count once. Whether the run is complete is decided by the frozen list, never by
//! counting messages; results are settled after their rows are durable; what a coordinator that was killed
//! had not settled comes again. Only so many jobs are without an answer at any time ([`FleetOptions`]),
//! which bounds both queues.

mod lease;
pub mod letters;
mod publisher;
mod run_name;
mod standings;

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use plumbline_common::id::RunId;
use plumbline_common::message::{self, FleetResult, Outcome};
use plumbline_common::queue::{Broker, Consumer, Delivery, JobKind, Queue, QueueError, Settlement};
use plumbline_common::row::{Cost, Measurement, Status};
use plumbline_worker::profile::Profile;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use crate::answers::{Answer, Answers};
use crate::corpus::Entry;
use crate::progress::say;
use crate::run::RunError;
use publisher::Publisher;
pub(crate) use run_name::run_name;
use standings::{Standing, Standings};

/// Results in the collector's hands at once: some flushes' worth, a few MiB each.
const RESULTS_IN_HAND: u16 = 1024;

/// A results queue that gives nothing for so long holds no more of what an earlier coordinator left.
const DRAINED_AFTER: Duration = Duration::from_secs(1);

/// How long without an answer until a person is told that jobs wait.
const HINT_AFTER: Duration = Duration::from_secs(60);

/// How often a job is published without any answer, until the video's row says so.
const MAX_PUBLICATIONS: u8 = 3;

/// The fleet that measures a run.
#[derive(Debug, Clone)]
pub struct FleetOptions {
    /// Its broker.
    pub broker: Arc<dyn Broker>,
    /// What the run is called, beside a digest of what it measures.
    pub name: Option<String>,
    /// Most jobs published and not answered: enough that no worker waits, few enough that a queue stays
    /// small and a cancelled run leaves little behind.
    pub window: usize,
    /// Where no answer has come for so long and no job waits in the queue, what is not answered is published
    /// again. Longer than any worker's deadline, or videos are measured twice (which changes no row).
    pub republish_after: Duration,
}

/// What the workers are asked, and what is known already.
pub(crate) struct Questions {
    /// The frozen corpus, sorted by name.
    pub(crate) entries: Arc<Vec<Entry>>,
    /// Those to be measured.
    pub(crate) missing: Vec<usize>,
    /// How.
    pub(crate) profile: Profile,
    /// Whether answers that an earlier coordinator left count.
    pub(crate) resume: bool,
}

/// The collecting end of a run on a fleet.
pub(crate) struct FleetRun {
    broker: Arc<dyn Broker>,
    run: RunId,
    consumer: Box<dyn Consumer>,
    publisher: Arc<Publisher>,
    standings: Arc<Standings>,
    entries: Arc<Vec<Entry>>,
    republish_after: Duration,
    /// Publishing, and holding the lease.
    tasks: JoinSet<Result<(), RunError>>,
    release: oneshot::Sender<()>,
    /// Results whose rows are not known to be durable, and what becomes of them then.
    unsettled: Vec<(Delivery, Settlement)>,
    /// While what is left in the results queue is read before anything is published.
    drained_at: Option<Instant>,
    last_news: Instant,
    last_look: Instant,
    /// The question how many jobs wait, under way.
    looking: JoinSet<Result<u64, QueueError>>,
    hinted: bool,
    /// Not answered, however often they were published.
    given_up: Vec<usize>,
}

impl FleetRun {
    /// Takes the run's lease and opens its results queue.
    ///
    /// # Errors
    /// [`RunError`]; `RunInUse` while another coordinator has the run.
    pub(crate) async fn start(
        options: &FleetOptions,
        run: RunId,
        questions: Questions,
    ) -> Result<Self, RunError> {
        let broker = Arc::clone(&options.broker);
        let lease = lease::take(broker.as_ref(), &run).await?;
        let mut tasks = JoinSet::new();
        let (release, released) = oneshot::channel();
        tasks.spawn(lease::hold(
            Arc::clone(&broker),
            run.clone(),
            lease,
            released,
        ));
        let results = Queue::Results(run.clone());
        if !questions.resume {
            broker.delete(&run).await?;
        }
        let was_there = match broker.ready(&results).await {
            Ok(_) => true,
            Err(QueueError::Missing { .. }) => false,
            Err(error) => return Err(error.into()),
        };
        broker.declare(&results).await?;
        let consumer = broker.consume(&results, RESULTS_IN_HAND).await?;
        let standings = Arc::new(Standings::of(questions.entries.len(), &questions.missing));
        let publisher = Arc::new(Publisher::new(
            Arc::clone(&broker),
            run.clone(),
            Arc::clone(&questions.entries),
            questions.profile,
            Arc::clone(&standings),
            options.window,
        ));
        let now = Instant::now();
        let mut fleet_run = Self {
            broker,
            run,
            consumer,
            publisher,
            standings,
            entries: questions.entries,
            republish_after: options.republish_after,
            tasks,
            release,
            unsettled: Vec::new(),
            drained_at: was_there.then(|| now + DRAINED_AFTER),
            last_news: now,
            last_look: now,
            looking: JoinSet::new(),
            hinted: false,
            given_up: Vec::new(),
        };
        if !was_there {
            fleet_run.publish_waiting();
        }
        Ok(fleet_run)
    }

    /// Publishes whatever is not answered and was not published.
    fn publish_waiting(&mut self) {
        self.drained_at = None;
        let waiting = self.standings.all(Standing::Waiting);
        self.tasks
            .spawn(Arc::clone(&self.publisher).publish(waiting));
    }

    /// The answer that a delivery holds, if it is news.
    fn take(&mut self, delivery: Delivery) -> Option<Answer> {
        self.last_news = Instant::now();
        if let Some(drained_at) = &mut self.drained_at {
            *drained_at = self.last_news + DRAINED_AFTER;
        }
        let result = match message::decode::<FleetResult>(&delivery.message.body) {
            Ok(result) if result.run == self.run => result,
            Ok(result) => {
                let reason = format!(
                    "a result of the run {} among those of {}",
                    result.run, self.run
                );
                self.reject(delivery, reason);
                return None;
            }
            Err(error) => {
                self.reject(delivery, format!("not a result: {error}"));
                return None;
            }
        };
        self.unsettled.push((delivery, Settlement::Done));
        let video = &result.outcome.video;
        let Ok(index) = self
            .entries
            .binary_search_by(|entry| entry.video.cmp(video))
        else {
            tracing::warn!(run = %self.run, %video, "a result of a video that is not in the corpus");
            return None;
        };
        let failed = result.outcome.measurement.status == Status::Failed;
        if !self.answered(index, failed) {
            return None;
        }
        Some(Answer {
            outcome: result.outcome,
            attempts: result.attempts,
            worker: result.worker,
        })
    }

    fn reject(&mut self, delivery: Delivery, reason: String) {
        tracing::warn!(run = %self.run, reason, "a message is put away");
        self.unsettled
            .push((delivery, Settlement::Reject { reason }));
    }

    /// Notes an answer; whether it counts.
    fn answered(&mut self, index: usize, failed: bool) -> bool {
        let answer = match failed {
            true => Standing::Failed,
            false => Standing::Answered,
        };
        match self.standings.get(index) {
            Standing::Answered => false,
            Standing::Failed if failed => false,
            _ => {
                if self.standings.put(index, answer) == Standing::Published {
                    self.publisher.one_less();
                }
                true
            }
        }
    }

    /// Nothing came for a while: asks how many jobs wait. On a task of its own, since whoever waits for an
    /// answer may stop waiting before the broker has told.
    fn look_around(&mut self) {
        if self.drained_at.is_some_and(|at| at <= Instant::now()) {
            self.publish_waiting();
            return;
        }
        self.last_look = Instant::now();
        let broker = Arc::clone(&self.broker);
        self.looking
            .spawn(async move { broker.ready(&Queue::Jobs(JobKind::Fused)).await });
    }

    /// Says that nothing comes while so many jobs wait, or publishes again what may be lost.
    fn looked(&mut self, ready: u64) {
        let quiet = self.last_news.elapsed();
        if !self.hinted && quiet >= HINT_AFTER {
            self.hinted = true;
            let out = self.standings.all(Standing::Published).len();
            say(&match ready {
                0 => format!(
                    "no answer for {} s, and no job waits in the queue: {out} are in work, or lost; after {} s without an answer they are published again (--republish-after)",
                    quiet.as_secs(),
                    self.republish_after.as_secs()
                ),
                ready => format!(
                    "no answer for {} s, and {ready} jobs wait in the queue: are workers running? (plumbline-worker --queue)",
                    quiet.as_secs()
                ),
            });
        }
        if quiet < self.republish_after {
            return;
        }
        self.last_news = Instant::now();
        if ready > 0 {
            return;
        }
        let lost = self.standings.all(Standing::Published);
        let (given_up, again): (Vec<usize>, Vec<usize>) = lost
            .into_iter()
            .partition(|&index| self.standings.publications(index) >= MAX_PUBLICATIONS);
        if !again.is_empty() {
            say(&format!(
                "no answer for {} s: {} jobs are published again",
                quiet.as_secs(),
                again.len()
            ));
            self.tasks
                .spawn(Arc::clone(&self.publisher).publish_again(again));
        }
        self.given_up = given_up;
    }

    /// The row of a video that no worker answers.
    fn give_up(&mut self, index: usize) -> Option<Answer> {
        let entry = self.entries.get(index)?.clone();
        if !self.answered(index, true) {
            return None;
        }
        let measurement = Measurement::without_score(
            Status::Failed,
            format!(
                "{}: no worker answered, though the job was published {MAX_PUBLICATIONS} times; `plumbline fleet dead` may say why",
                entry.address()
            ),
        );
        Some(Answer {
            outcome: Outcome {
                video: entry.video,
                measurement,
                cost: Cost::default(),
                thumbnails: None,
            },
            attempts: MAX_PUBLICATIONS.into(),
            worker: String::new(),
        })
    }

    fn next_look(&self) -> Instant {
        let republish = self.last_news + self.republish_after;
        let look = match self.hinted {
            true => republish,
            false => republish.min(self.last_news.max(self.last_look) + HINT_AFTER),
        };
        self.drained_at
            .map_or(look, |drained_at| drained_at.min(look))
    }
}

#[async_trait]
impl Answers for FleetRun {
    async fn next(&mut self) -> Result<Option<Answer>, RunError> {
        while self.standings.unanswered() > 0 {
            if let Some(index) = self.given_up.pop() {
                match self.give_up(index) {
                    Some(answer) => return Ok(Some(answer)),
                    None => continue,
                }
            }
            let next_look = self.next_look();
            tokio::select! {
                delivery = self.consumer.next() => match delivery {
                    Ok(delivery) => {
                        if let Some(answer) = self.take(delivery) {
                            return Ok(Some(answer));
                        }
                    }
                    Err(QueueError::Missing { .. }) => {
                        return Err(RunError::Cancelled { run: self.run.clone() });
                    }
                    Err(error) => return Err(error.into()),
                },
                Some(ended) = self.tasks.join_next() => ended.map_err(RunError::Finishing)??,
                Some(ready) = self.looking.join_next() => {
                    self.looked(ready.map_err(RunError::Finishing)??);
                }
                () = sleep_until(next_look), if self.looking.is_empty() => self.look_around(),
            }
        }
        Ok(None)
    }

    async fn kept(&mut self) -> Result<(), RunError> {
        for (delivery, settlement) in self.unsettled.drain(..) {
            match delivery.settle(settlement).await {
                // It comes again, and is no news then.
                Ok(()) | Err(QueueError::Lost { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    async fn finished(mut self: Box<Self>) -> Result<(), RunError> {
        self.kept().await?;
        drop(self.consumer);
        self.broker.delete(&self.run).await?;
        // Whoever holds the lease is gone if nobody listens.
        let _held = self.release.send(());
        while let Some(ended) = self.tasks.join_next().await {
            ended.map_err(RunError::Finishing)??;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
