//! The worker's life: receive as long as a slot is free, until told to stop, then drain.

use std::sync::Arc;
use std::time::Duration;

use plumbline_common::backoff::Backoff;
use plumbline_common::observe::Pulse;
use plumbline_common::queue::{Broker, Consumer, Delivery, QueueError};
use tokio::sync::watch;
use tokio::task::{JoinError, JoinSet};
use tokio::time::{sleep, timeout};

use super::metrics::Metrics;
use super::stop::Stop;
use super::work::{Computer, Worker};
use super::{JOBS, WorkerOptions};
use crate::child::SlotError;

/// How long handing back may take, once the grace is over.
const HAND_BACK_TIME: Duration = Duration::from_secs(5);

/// Waits before a consumer is set up again whose queue was gone. The broker's own outages are waited for
/// below, by the consumer.
const REBUILDS: Backoff = Backoff {
    first: Duration::from_millis(500),
    longest: Duration::from_secs(15),
    attempts: 8,
};

/// Why a worker ends before it is told to.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The broker is lost.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// A task of the worker broke down.
    #[error("the worker broke down ({0}); its jobs go to others, and this is a defect to report")]
    Defect(#[from] JoinError),
}

/// Does jobs until `stop` says otherwise: drained, everything in work is answered or handed back. `ready` is
/// told how to see whether jobs come.
///
/// # Errors
/// [`ServeError`]; jobs in work come again.
pub async fn serve(
    broker: Arc<dyn Broker>,
    options: WorkerOptions,
    metrics: Metrics,
    mut stop: watch::Receiver<Stop>,
    ready: watch::Sender<Option<Pulse>>,
) -> Result<(), ServeError> {
    let worker = Arc::new(Worker::new(broker, options, metrics));
    let slots = worker.options.slots.max(1);
    worker.metrics.slots.set(slots.into());
    let mut receiver = Receiver {
        worker: Arc::clone(&worker),
        slots,
        ready,
        consumer: None,
        rebuilds: 0,
    };
    let mut life = Life {
        idle: (0..slots).map(|_| worker.computer()).collect(),
        tasks: JoinSet::new(),
        hand_back: watch::channel(false).0,
        worker,
    };
    while !is_told(&stop) {
        tokio::select! {
            _ = stop.changed() => {}
            Some(done) = life.tasks.join_next() => life.take_back(done)?,
            delivery = receiver.next(), if !life.idle.is_empty() => life.start(delivery?),
        }
    }
    if let Some(consumer) = &mut receiver.consumer {
        consumer.stop().await;
    }
    life.drain(&mut stop).await
}

/// Receives jobs, from a queue that is made where it is missing.
struct Receiver {
    worker: Arc<Worker>,
    slots: u16,
    ready: watch::Sender<Option<Pulse>>,
    consumer: Option<Box<dyn Consumer>>,
    /// Since the last job.
    rebuilds: u32,
}

impl Receiver {
    /// The next job. May be cancelled without loss.
    async fn next(&mut self) -> Result<Delivery, QueueError> {
        loop {
            let received = match &mut self.consumer {
                Some(consumer) => consumer.next().await,
                None => match subscribe(&self.worker, self.slots, &self.ready).await {
                    Ok(consumer) => {
                        self.consumer = Some(consumer);
                        continue;
                    }
                    Err(error) => Err(error),
                },
            };
            match received {
                Ok(delivery) => {
                    self.rebuilds = 0;
                    return Ok(delivery);
                }
                Err(QueueError::Missing { queue }) => {
                    self.consumer = None;
                    self.rebuilds += 1;
                    let Some(wait) = REBUILDS.after_with_jitter(self.rebuilds) else {
                        return Err(QueueError::Missing { queue });
                    };
                    tracing::warn!(queue, "the queue of jobs is gone; it is made again");
                    sleep(wait).await;
                }
                Err(error) => return Err(error),
            }
        }
    }
}

async fn subscribe(
    worker: &Worker,
    slots: u16,
    ready: &watch::Sender<Option<Pulse>>,
) -> Result<Box<dyn Consumer>, QueueError> {
    worker.broker.declare(&JOBS).await?;
    let consumer = worker.broker.consume(&JOBS, slots).await?;
    ready.send_replace(Some(consumer.pulse()));
    Ok(consumer)
}

/// The slots, busy and idle.
struct Life {
    worker: Arc<Worker>,
    idle: Vec<Computer>,
    tasks: JoinSet<(Computer, Result<(), ServeError>)>,
    hand_back: watch::Sender<bool>,
}

impl Life {
    fn start(&mut self, delivery: Delivery) {
        let Some(mut computer) = self.idle.pop() else {
            return; // never: a delivery is taken only for an idle slot; unsettled, it would come again
        };
        let worker = Arc::clone(&self.worker);
        let hand_back = self.hand_back.subscribe();
        worker.metrics.in_work.inc();
        self.tasks.spawn(async move {
            let worked = worker.work(&mut computer, delivery, hand_back).await;
            worker.metrics.in_work.dec();
            (computer, worked)
        });
    }

    fn take_back(
        &mut self,
        done: Result<(Computer, Result<(), ServeError>), JoinError>,
    ) -> Result<(), ServeError> {
        let (computer, worked) = done?;
        self.idle.push(computer);
        worked
    }

    async fn drain(mut self, stop: &mut watch::Receiver<Stop>) -> Result<(), ServeError> {
        let (grace, in_work) = (self.worker.options.grace, self.tasks.len());
        tracing::info!(in_work, grace_s = grace.as_secs_f64(), "draining");
        let finished = tokio::select! {
            finished = timeout(grace, self.all_done()) => finished.ok(),
            () = told_now(stop) => return Ok(()),
        };
        if let Some(finished) = finished {
            return finished;
        }
        tracing::warn!(
            in_work = self.tasks.len(),
            "the grace is over; the rest is handed back"
        );
        self.hand_back.send_replace(true);
        tokio::select! {
            // What cannot be handed back in time comes again, since it is unsettled.
            handed_back = timeout(HAND_BACK_TIME, self.all_done()) => handed_back.unwrap_or(Ok(())),
            () = told_now(stop) => Ok(()),
        }
    }

    async fn all_done(&mut self) -> Result<(), ServeError> {
        while let Some(done) = self.tasks.join_next().await {
            self.take_back(done)?;
        }
        Ok(())
    }
}

/// A sender that is gone says nothing more.
fn is_told(stop: &watch::Receiver<Stop>) -> bool {
    *stop.borrow() != Stop::No
}

async fn told_now(stop: &mut watch::Receiver<Stop>) {
    if stop.wait_for(|stop| *stop == Stop::Now).await.is_err() {
        std::future::pending::<()>().await;
    }
}
