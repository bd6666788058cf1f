//! Jobs to compute slots and answers back, through bounded in-process queues.
//!
//! Memory is bounded whatever the size of the corpus: a few jobs wait for a slot, a few answers wait
//! for the collector. Dropping the returned receiver ends every slot and its child.

use std::future::Future;
use std::ops::ControlFlow;
use std::path::PathBuf;

use plumbline_common::id::VideoId;
use plumbline_common::message::Job;
use plumbline_worker::child::{ComputeLimits, ComputeSlot, Drawing, Measured, SlotError};
use plumbline_worker::explain::{DrawJob, Picture};
use plumbline_worker::fetch::Fetcher;
use plumbline_worker::measure::Detailed;
use plumbline_worker::measure::frames::{FramesJob, SampledFrames};
use plumbline_worker::slam::SlamOutcome;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// Jobs (and answers) that may wait per slot: enough that no slot idles, few enough to stay small.
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
    /// Brings objects here.
    pub fetcher: Fetcher,
}

impl Slots {
    /// One of them.
    #[must_use]
    pub fn slot(&self) -> ComputeSlot {
        ComputeSlot::new(self.program.clone(), self.limits, self.fetcher.clone())
    }
}

/// Something that a slot can do.
pub trait Work: Send + 'static {
    /// What comes of it.
    type Answer: Send + 'static;

    /// Has it done.
    fn ask(
        &self,
        slot: &mut ComputeSlot,
    ) -> impl Future<Output = Result<Self::Answer, SlotError>> + Send;
}

/// A row.
impl Work for Job {
    type Answer = Measured;

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Measured, SlotError> {
        slot.measure(self).await
    }
}

/// A row with what is behind it.
#[derive(Debug, Clone)]
pub struct Detail(pub Job);

impl Work for Detail {
    type Answer = Detailed;

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Detailed, SlotError> {
        slot.measure_in_detail(&self.0).await
    }
}

/// A camera's trajectory, and depths where they can be known.
#[derive(Debug, Clone)]
pub struct Tracking(pub Job);

impl Work for Tracking {
    type Answer = (VideoId, SlamOutcome);

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Self::Answer, SlotError> {
        Ok((self.0.video.clone(), slot.track(&self.0).await?))
    }
}

/// The pictures drawn of one video, held in memory: for a few heat maps.
#[derive(Debug)]
pub struct Drawn {
    /// The video.
    pub video: VideoId,
    /// The pictures.
    pub pictures: Vec<Picture>,
    /// How far the drawing came.
    pub drawing: Drawing,
}

impl Work for DrawJob {
    type Answer = Drawn;

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Drawn, SlotError> {
        let mut pictures = Vec::new();
        let mut take = |picture| {
            pictures.push(picture);
            ControlFlow::Continue(())
        };
        let drawing = slot.draw(self, &mut take).await?;
        Ok(Drawn {
            video: self.job.video.clone(),
            pictures,
            drawing,
        })
    }
}

/// Some frames of a video, or the reason for none.
impl Work for FramesJob {
    type Answer = (VideoId, Result<SampledFrames, String>);

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Self::Answer, SlotError> {
        Ok((self.job.video.clone(), slot.frames(self).await?))
    }
}

/// The running slots; answers arrive in the order of completion.
#[derive(Debug)]
pub struct Fanout<W: Work> {
    answers: mpsc::Receiver<Result<W::Answer, SlotError>>,
    tasks: JoinSet<()>,
}

impl<W: Work> Fanout<W> {
    /// Starts the slots on `jobs`. Must be called inside a tokio runtime.
    #[must_use]
    pub fn start(jobs: Vec<W>, slots: &Slots) -> Self {
        let count = slots.count.clamp(1, jobs.len().max(1));
        let (job_sender, mut fanout) = Self::open(count, slots);
        fanout.tasks.spawn(async move {
            for job in jobs {
                if job_sender.send(job).await.is_err() {
                    break;
                }
            }
        });
        fanout
    }

    /// Starts `count` slots on whatever is sent; they end when the sender is gone. Must be called inside
    /// a tokio runtime.
    #[must_use]
    pub fn open(count: usize, slots: &Slots) -> (async_channel::Sender<W>, Self) {
        let count = count.max(1);
        let (job_sender, job_receiver) = async_channel::bounded::<W>(count * QUEUED_PER_SLOT);
        let (answer_sender, answers) = mpsc::channel(count * QUEUED_PER_SLOT);
        let mut tasks = JoinSet::new();
        for _ in 0..count {
            let mut slot = slots.slot();
            let (job_receiver, answer_sender) = (job_receiver.clone(), answer_sender.clone());
            tasks.spawn(async move {
                while let Ok(job) = job_receiver.recv().await {
                    let answer = job.ask(&mut slot).await;
                    if answer_sender.send(answer).await.is_err() {
                        break;
                    }
                }
            });
        }
        (job_sender, Self { answers, tasks })
    }

    /// The next answer; `None` when every job is done.
    ///
    /// # Errors
    /// [`SlotError`], when no child can be started at all: the run cannot go on.
    pub async fn next(&mut self) -> Option<Result<W::Answer, SlotError>> {
        self.answers.recv().await
    }
}
