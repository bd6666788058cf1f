//! What can go wrong with a queue, by what the caller does next.

use crate::message::MAX_MESSAGE_BYTES;

/// Boxed cause of a queue's error.
pub(super) type Source = Box<dyn std::error::Error + Send + Sync>;

/// Why a broker did not do what it was asked. Addresses are told without their credentials.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// There is no such queue: for results, the run is finished or cancelled.
    #[error(
        "there is no queue {queue} to take the message; its run was finished or cancelled, or never started"
    )]
    Missing {
        /// The queue.
        queue: String,
    },
    /// Larger than a message may be.
    #[error("a message for {queue} has {bytes} bytes, more than the {MAX_MESSAGE_BYTES} allowed")]
    TooLarge {
        /// The queue.
        queue: String,
        /// Its size.
        bytes: usize,
    },
    /// The settlement came too late: the message is on its way to another receiver.
    #[error(
        "{queue}: the broker took message {message} back before it was settled; it comes again"
    )]
    Lost {
        /// The queue.
        queue: String,
        /// The message's id.
        message: String,
    },
    /// The queue is there with other properties: another version of the program made it.
    #[error(
        "the queue {queue} was made with other properties ({source}); finish or cancel the runs that use it and delete it, or choose another namespace"
    )]
    Mismatch {
        /// The queue.
        queue: String,
        /// What the broker said.
        source: Source,
    },
    /// Still out of reach after every retry.
    #[error(
        "{broker}: no answer after {attempts} attempts ({source}); check that the broker runs and its address, then run again"
    )]
    Unreachable {
        /// The broker, without credentials.
        broker: String,
        /// How often it was tried.
        attempts: u32,
        /// The last failure.
        source: Source,
    },
    /// The broker says no, and will again.
    #[error(
        "{broker} refuses: {source}; check user and password, the user's permissions, and the virtual host"
    )]
    Refused {
        /// The broker, without credentials.
        broker: String,
        /// What it said.
        source: Source,
    },
    /// The address is none.
    #[error(
        "the broker's address is not usable ({source}); write amqp://user:password@host:port/vhost"
    )]
    Address {
        /// Why.
        source: Source,
    },
}
