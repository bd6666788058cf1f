//! A message and what becomes of it; its body is opaque here (see [`crate::message`]).

use std::time::Duration;

use bytes::Bytes;

use super::Queue;
use super::error::QueueError;
use crate::message::MAX_MESSAGE_BYTES;

/// What travels through a queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Names the work, the same on every copy: by it receivers recognise what they have done.
    pub id: String,
    /// The encoded payload.
    pub body: Bytes,
    /// From 1; one more after every retry.
    pub attempt: u32,
    /// The trace it belongs to, in the form of the W3C's `traceparent` header; the same on every copy.
    pub traceparent: Option<String>,
}

impl Message {
    /// A message that was not tried yet.
    #[must_use]
    pub fn new(id: impl Into<String>, body: impl Into<Bytes>) -> Self {
        Self {
            id: id.into(),
            body: body.into(),
            attempt: 1,
            traceparent: None,
        }
    }

    pub(super) fn check_size(&self, queue: &str) -> Result<(), QueueError> {
        if self.body.len() > MAX_MESSAGE_BYTES {
            return Err(QueueError::TooLarge {
                queue: queue.to_owned(),
                bytes: self.body.len(),
            });
        }
        Ok(())
    }

    pub(super) fn for_retry(self) -> Self {
        Self {
            attempt: self.attempt.saturating_add(1),
            ..self
        }
    }
}

/// What became of a delivery.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Settlement {
    /// Done: what came of it is safe elsewhere.
    Done,
    /// Could not be done now: to come again, its attempt counted, not before `after`. How long and how
    /// often is the receiver's to say (see [`crate::backoff::Backoff`]).
    Retry {
        /// The least wait.
        after: Duration,
    },
    /// Will never be done: to be kept in [`Queue::Dead`] for a person to look at.
    Reject {
        /// One sentence.
        reason: String,
    },
}

/// Why and whence a message is dead.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeadLetter {
    /// The queue it was in; `None` where that is none of the protocol's.
    pub queue: Option<Queue>,
    /// One sentence, or the broker's word (`delivery_limit`, `expired`).
    pub reason: String,
}
