//! How jobs reach workers and results come back: at least once, settled by type.
//!
//! One trait, two homes: in this process ([`LocalBroker`]) and RabbitMQ ([`AmqpBroker`]). One suite of
//! tests asks both for the same guarantees; `design.md` beside this file says what happens at every
//! point where something can crash.

mod amqp;
mod error;
mod local;
mod message;

use std::fmt::Debug;

use async_trait::async_trait;
use futures_util::stream::{self, StreamExt, TryStreamExt};

pub use amqp::{AmqpBroker, AmqpOptions};
pub use error::QueueError;
pub use local::{LocalBroker, LocalOptions};
pub use message::{DeadLetter, Message, Settlement};

use crate::id::RunId;
use crate::observe::Pulse;

/// Deliveries of one message after which the broker itself puts it away as dead: a backstop behind the
/// worker's own, lower limit on [`Delivery::redeliveries`], since no row comes of it.
pub const MAX_DELIVERIES: u32 = 20;

/// What a job asks to be measured, and so the queue it waits in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum JobKind {
    /// Photometric consistency alone.
    Flow,
    /// 3D consistency alone.
    Slam,
    /// Everything that shares one flow field.
    Fused,
}

impl JobKind {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Flow, Self::Slam, Self::Fused];
}

/// A queue of the protocol.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Queue {
    /// Jobs of all runs; always there.
    Jobs(JobKind),
    /// Results of one run; there from [`Broker::declare`] to [`Broker::delete`].
    Results(RunId),
    /// What was rejected or could not be delivered; always there.
    Dead,
}

impl Queue {
    /// The queue that [`Queue`]'s text form names, if any.
    fn from_name(name: &str) -> Option<Self> {
        if let Some(run) = name.strip_prefix("results.") {
            return RunId::new(run).ok().map(Self::Results);
        }
        let jobs = JobKind::ALL.into_iter().map(Self::Jobs);
        jobs.chain([Self::Dead])
            .find(|queue| queue.to_string() == name)
    }
}

impl std::fmt::Display for Queue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Jobs(JobKind::Flow) => f.write_str("jobs.flow"),
            Self::Jobs(JobKind::Slam) => f.write_str("jobs.slam"),
            Self::Jobs(JobKind::Fused) => f.write_str("jobs.fused"),
            Self::Results(run) => write!(f, "results.{run}"),
            Self::Dead => f.write_str("dead"),
        }
    }
}

/// A message broker. All of it outlives a restart of the broker: calls wait and try again, a bounded
/// number of times.
#[async_trait]
pub trait Broker: Debug + Send + Sync {
    /// Makes a queue; one that is there stays as it is.
    ///
    /// # Errors
    /// [`QueueError`].
    async fn declare(&self, queue: &Queue) -> Result<(), QueueError>;

    /// Puts a message into a queue and returns once it is safe there. Many calls may be under way at
    /// once ([`publish_all`]). A message may come twice after a failure on the way; receivers
    /// recognise it by its id.
    ///
    /// # Errors
    /// [`QueueError`]; the message may or may not be in the queue, except for `Missing` and `TooLarge`,
    /// where it is not.
    async fn publish(&self, queue: &Queue, message: Message) -> Result<(), QueueError>;

    /// Receives from a queue, at most `slots` unsettled messages at a time.
    ///
    /// # Errors
    /// [`QueueError::Missing`] where there is no such queue.
    async fn consume(&self, queue: &Queue, slots: u16) -> Result<Box<dyn Consumer>, QueueError>;

    /// Messages that wait for a receiver: a figure for people and for scaling, stale when it arrives.
    ///
    /// # Errors
    /// [`QueueError::Missing`] where there is no such queue.
    async fn ready(&self, queue: &Queue) -> Result<u64, QueueError>;

    /// Consumers of a queue, likewise: 0 of a queue of jobs means that no worker is there.
    ///
    /// # Errors
    /// [`QueueError::Missing`] where there is no such queue.
    async fn consumers(&self, queue: &Queue) -> Result<u64, QueueError>;

    /// Removes a run's results queue with what is in it; none there is none removed.
    ///
    /// # Errors
    /// [`QueueError`].
    async fn delete(&self, run: &RunId) -> Result<(), QueueError>;

    /// Takes the lease of a run; `None` while another coordinator holds it. It ends with the holder's
    /// process or connection, so a holder must stop when [`Lease::lost`] returns.
    ///
    /// # Errors
    /// [`QueueError`].
    async fn lease(&self, run: &RunId) -> Result<Option<Box<dyn Lease>>, QueueError>;
}

/// The receiving end of a queue. What is unsettled when it is dropped comes to another receiver.
#[async_trait]
pub trait Consumer: Debug + Send {
    /// The next message, whenever it comes. May be cancelled without loss.
    ///
    /// # Errors
    /// [`QueueError`], when the broker stays out of reach or the queue is gone: the consumer is of no
    /// more use.
    async fn next(&mut self) -> Result<Delivery, QueueError>;

    /// Asks for no more messages; those in hand can still be settled. [`Self::next`] is not called again.
    async fn stop(&mut self);

    /// Whether messages come just now: not while the broker is out of reach, nor after [`Self::stop`].
    fn pulse(&self) -> Pulse;
}

/// The right to be a run's one coordinator, until dropped or lost.
#[async_trait]
pub trait Lease: Debug + Send {
    /// Returns when the lease is gone (the connection broke): another may hold it now.
    async fn lost(&mut self);

    /// Gives it back, so that the next one can take it at once.
    async fn release(self: Box<Self>);
}

/// A message in a receiver's hands, until it is settled. Dropped unsettled, it counts as in work until
/// its consumer goes, and then comes again.
#[derive(Debug)]
#[must_use = "a delivery that is not settled comes again"]
pub struct Delivery {
    /// The message.
    pub message: Message,
    /// Times it was handed out before without being settled: receivers that crashed or lost their
    /// connection with it. Not the same as `message.attempt`, which counts settled retries.
    pub redeliveries: u32,
    /// Why it is here, in [`Queue::Dead`].
    pub dead: Option<DeadLetter>,
    handle: Box<dyn Settle>,
}

impl Delivery {
    /// Says what became of it. What a retry or a rejection puts elsewhere is safe there before the
    /// message leaves this queue.
    ///
    /// # Errors
    /// [`QueueError::Lost`] where the broker had already taken the message back: it comes again, and
    /// whatever was done for it is recognised by its id then. Else [`QueueError`].
    pub async fn settle(self, settlement: Settlement) -> Result<(), QueueError> {
        self.handle.settle(self.message, settlement).await
    }
}

/// A broker's side of a delivery.
#[async_trait]
trait Settle: Debug + Send {
    async fn settle(
        self: Box<Self>,
        message: Message,
        settlement: Settlement,
    ) -> Result<(), QueueError>;
}

/// Publishes messages with up to `window` of them unconfirmed at a time; how many there were.
///
/// # Errors
/// The first [`QueueError`]; what is under way then may or may not be in the queue.
pub async fn publish_all(
    broker: &dyn Broker,
    queue: &Queue,
    messages: impl IntoIterator<Item = Message, IntoIter: Send>,
    window: usize,
) -> Result<u64, QueueError> {
    stream::iter(messages)
        .map(|message| broker.publish(queue, message))
        .buffer_unordered(window.max(1))
        .try_fold(0, async |published, ()| Ok(published + 1))
        .await
}
