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
            AMQPErrorKind::Soft(AMQPSoftError::NOTFOUND) if is_there(&error.to_string()) => {
                Self::Passing(error.into())
            }
            AMQPErrorKind::Soft(AMQPSoftError::NOTFOUND) => Self::Missing,
            AMQPErrorKind::Soft(AMQPSoftError::RESOURCELOCKED) => Self::Locked,
            AMQPErrorKind::Soft(AMQPSoftError::PRECONDITIONFAILED) => Self::Mismatch(error.into()),
            AMQPErrorKind::Soft(AMQPSoftError::ACCESSREFUSED)
            | AMQPErrorKind::Hard(AMQPHardError::NOTALLOWED) => Self::Refused(error.into()),
            _ => Self::Passing(error.into()),
        }
    }
}

/// Whether the broker says of a queue that is there that it cannot be had just now: RabbitMQ's code for that is
/// the same as for none at all (`rabbit_amqqueue`, 3.10.8), and a job whose results queue is none is dropped.
fn is_there(said: &str) -> bool {
    [
        "down or inaccessible",
        "due to timeout",
        "stopped by supervisor",
        "crashed and failed to restart",
    ]
    .iter()
    .any(|words| said.contains(words))
}

#[cfg(test)]
mod tests {
    use lapin::protocol::AMQPError;

    use super::*;

    #[test]
    fn a_queue_that_is_down_is_not_missing() {
        let failure = |said: &str| {
            let kind = AMQPErrorKind::Soft(AMQPSoftError::NOTFOUND);
            let said = format!("NOT_FOUND - {said}");
            Failure::from(Error::from(ErrorKind::ProtocolError(AMQPError::new(
                kind,
                said.as_str().into(),
            ))))
        };
        assert!(matches!(
            failure("no queue 'a' in vhost '/'"),
            Failure::Missing
        ));
        for down in [
            "home node 'a@b' of durable queue 'a' in vhost '/' is down or inaccessible",
            "failed to perform operation on queue 'a' in vhost '/' due to timeout",
            "queue 'a' in vhost '/' process is stopped by supervisor",
            "queue 'a' in vhost '/' has crashed and failed to restart",
        ] {
            assert!(matches!(failure(down), Failure::Passing(_)), "{down}");
        }
    }
}
