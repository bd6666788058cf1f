//! Jobs to compute slots and outcomes back, through bounded in-process queues.
//!
//! Memory is bounded whatever the size of the corpus: a few jobs wait for a slot, a few outcomes
//! wait for the collector. Dropping the returned receiver ends every slot and its child.

use std::path::PathBuf;

use plumbline_common::message::Job;
use plumbline_worker::child::{ComputeLimits, ComputeSlot, Measured, SlotError};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// Jobs (and outcomes) that may wait per slot: enough that no slot idles, few enough to stay small.
const QUEUED_PER_SLOT: usize = 2;

/// How embedded work is spread.
#[derive(Debug, Clone)]
pub struct Slots {
    /// The program that compute children run: a Plumbline binary.
    pub program: PathBuf,
    /// Children at work at once.
    pub count: usize,
    /// What one video may cost.
    pub limits: ComputeLimits,
}

/// The running slots; outcomes arrive in the order of completion.
#[derive(Debug)]
pub struct Fanout {
    outcomes: mpsc::Receiver<Result<Measured, SlotError>>,
    _tasks: JoinSet<()>,
}

impl Fanout {
    /// Starts the slots on `jobs`. Must be called inside a tokio runtime.
    #[must_use]
    pub fn start(jobs: Vec<Job>, slots: &Slots) -> Self {
        let count = slots.count.clamp(1, jobs.len().max(1));
        let (job_sender, job_receiver) = async_channel::bounded::<Job>(count * QUEUED_PER_SLOT);
        let (outcome_sender, outcomes) = mpsc::channel(count * QUEUED_PER_SLOT);
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            for job in jobs {
                if job_sender.send(job).await.is_err() {
                    break;
                }
            }
        });
        for _ in 0..count {
            let mut slot = ComputeSlot::new(slots.program.clone(), slots.limits);
            let (job_receiver, outcome_sender) = (job_receiver.clone(), outcome_sender.clone());
            tasks.spawn(async move {
                while let Ok(job) = job_receiver.recv().await {
                    if outcome_sender.send(slot.measure(&job).await).await.is_err() {
                        break;
                    }
                }
            });
        }
        Self {
            outcomes,
            _tasks: tasks,
        }
    }

    /// The next outcome; `None` when every job is done.
    ///
    /// # Errors
    /// [`SlotError`], when no child can be started at all: the run cannot go on.
    pub async fn next(&mut self) -> Option<Result<Measured, SlotError>> {
        self.outcomes.recv().await
    }
}
