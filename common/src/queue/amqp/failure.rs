//! What a failed call means: whether a new connection may help, and the error it becomes.

use lapin::protocol::{AMQPErrorKind, AMQPHardError, AMQPSoftError};
use lapin::{Error, ErrorKind};

use crate::queue::error::{QueueError, Source};

/// One failed attempt.
#[derive(Debug)]
pub(super) enum Failure {
    /// A later attempt may succeed.
    Passing(Source),
    /// No such queue, or none that takes the message.
    Missing,
    /// Another connection holds the exclusive queue.
    Locked,
    /// The queue or exchange is there with other properties.
    Mismatch(Source),
    /// The broker says no.
    Refused(Source),
}

impl Failure {
    /// The error after so many attempts; `queue` and `broker` are their names.
    pub(super) fn of(self, queue: String, broker: String, attempts: u32) -> QueueError {
        match self {
            Self::Passing(source) => QueueError::Unreachable {
                broker,
                attempts,
                source,
            },
            Self::Missing => QueueError::Missing { queue },
            Self::Mismatch(source) => QueueError::Mismatch { queue, source },
            Self::Refused(source) => QueueError::Refused { broker, source },
            Self::Locked => QueueError::Refused {
                broker,
                source: format!("another connection holds {queue}").into(),
            },
        }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let kind = match error.kind() {
            ErrorKind::ProtocolError(said) => said.kind().clone(),
            _ => return Self::Passing(error.into()),
        };
        match kind {
            AMQPErrorKind::Soft(AMQPSoftError::NOTFOUND) => Self::Missing,
            AMQPErrorKind::Soft(AMQPSoftError::RESOURCELOCKED) => Self::Locked,
            AMQPErrorKind::Soft(AMQPSoftError::PRECONDITIONFAILED) => Self::Mismatch(error.into()),
            AMQPErrorKind::Soft(AMQPSoftError::ACCESSREFUSED)
            | AMQPErrorKind::Hard(AMQPHardError::NOTALLOWED) => Self::Refused(error.into()),
            _ => Self::Passing(error.into()),
        }
    }
}
