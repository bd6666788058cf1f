//! Dead letters: jobs that no worker gets done, to look at and to try again.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use plumbline_common::id::RunId;
use plumbline_common::message::{self, FleetJob};
use plumbline_common::queue::{
    Broker, Consumer, Delivery, JobKind, Message, Queue, QueueError, Settlement,
};
use serde::Serialize;
use tokio::time::timeout;

/// A queue that gives nothing for so long has no more; counts are stale when they arrive.
const NO_MORE_AFTER: Duration = Duration::from_secs(1);

/// A dead letter, told to a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Letter {
    /// The run, where the message is a job that can be read.
    pub run: Option<RunId>,
    /// The video, likewise.
    pub video: Option<String>,
    /// Where its bytes are, likewise.
    pub address: Option<String>,
    /// The queue it was in.
    pub queue: Option<String>,
    /// Why it is here.
    pub reason: String,
    /// The message's id.
    pub id: String,
}

/// The dead letters of all runs, or of one; they stay where they are.
///
/// # Errors
/// [`QueueError`].
pub async fn letters(broker: &dyn Broker, run: Option<&RunId>) -> Result<Vec<Letter>, QueueError> {
    let mut hand = Hand::of(broker).await?;
    let mut letters = Vec::new();
    // Held unsettled until all are seen: they are back when the hand opens.
    while let Some(delivery) = hand.next().await? {
        letters.push(letter(&delivery, job(&delivery).as_ref()));
        hand.held.push(delivery);
    }
    letters.retain(|letter| run.is_none() || letter.run.as_ref() == run);
    letters.sort_by(|a, b| (&a.run, &a.video, &a.id).cmp(&(&b.run, &b.video, &b.id)));
    Ok(letters)
}

/// Puts the jobs among the dead letters of all runs, or of one, back into their queue, as if never tried;
/// how many, and of which runs.
///
/// # Errors
/// [`QueueError`]; a job is in its queue before it leaves the dead letters.
pub async fn retry(
    broker: &Arc<dyn Broker>,
    run: Option<&RunId>,
) -> Result<(u64, BTreeSet<RunId>), QueueError> {
    let mut hand = Hand::of(broker.as_ref()).await?;
    let mut runs = BTreeSet::new();
    let mut jobs = 0;
    while let Some(delivery) = hand.next().await? {
        let wanted = job(&delivery).filter(|job| run.is_none_or(|run| job.run == *run));
        let Some(wanted) = wanted else {
            hand.held.push(delivery);
            continue;
        };
        if runs.insert(wanted.run.clone()) {
            broker.declare(&Queue::Results(wanted.run.clone())).await?;
        }
        let from = delivery.dead.as_ref().and_then(|dead| dead.queue.clone());
        let queue = match from {
            Some(queue @ Queue::Jobs(_)) => queue,
            _ => Queue::Jobs(JobKind::Fused),
        };
        let again = Message {
            attempt: 1,
            ..delivery.message.clone()
        };
        broker.publish(&queue, again).await?;
        match delivery.settle(Settlement::Done).await {
            // Then it stays, and may be tried once more than needed.
            Ok(()) | Err(QueueError::Lost { .. }) => {}
            Err(error) => return Err(error),
        }
        jobs += 1;
    }
    Ok((jobs, runs))
}

/// Takes dead letters; those that are held go back when it is dropped.
struct Hand {
    consumer: Box<dyn Consumer>,
    held: Vec<Delivery>,
}

impl Hand {
    async fn of(broker: &dyn Broker) -> Result<Self, QueueError> {
        Ok(Self {
            consumer: broker.consume(&Queue::Dead, u16::MAX).await?,
            held: Vec::new(),
        })
    }

    async fn next(&mut self) -> Result<Option<Delivery>, QueueError> {
        // More than can be held at once stay unseen.
        match timeout(NO_MORE_AFTER, self.consumer.next()).await {
            Ok(delivery) => delivery.map(Some),
            Err(_nothing) => Ok(None),
        }
    }
}

fn job(delivery: &Delivery) -> Option<FleetJob> {
    let from = delivery.dead.as_ref().and_then(|dead| dead.queue.as_ref());
    // A result that was put away is no job, though one may decode as the other.
    if matches!(from, Some(Queue::Results(_))) {
        return None;
    }
    message::decode(&delivery.message.body).ok()
}

fn letter(delivery: &Delivery, job: Option<&FleetJob>) -> Letter {
    let dead = delivery.dead.as_ref();
    Letter {
        run: job.map(|job| job.run.clone()),
        video: job.map(|job| job.job.video.to_string()),
        address: job.map(|job| job.job.location.to_string()),
        queue: dead
            .and_then(|dead| dead.queue.as_ref())
            .map(Queue::to_string),
        reason: dead.map_or_else(String::new, |dead| dead.reason.clone()),
        id: delivery.message.id.clone(),
    }
}
