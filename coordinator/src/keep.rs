//! Answers made durable: in the journal of a local OUT, or in parts of an OUT in an object store, where the
//! journal is a copy on this machine's disk.

use std::time::Duration;

use crate::collect::{Journal, Record};
use crate::parts::Parts;
use crate::run::RunError;

/// When answers are made durable.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Flushing {
    /// Answers between two flushes at most: a crash repeats no more work than that...
    pub(crate) answers: usize,
    /// ...and time between two, for slow answers: a fleet waits to hear that they are kept.
    pub(crate) every: Duration,
}

/// A flush to the disk is cheap.
const TO_DISK: Flushing = Flushing {
    answers: 64,
    every: Duration::from_millis(500),
};

/// An object each; half of what a fleet hands over at once.
const TO_STORE: Flushing = Flushing {
    answers: 512,
    every: Duration::from_secs(5),
};

/// Where answers go.
pub(crate) struct Keep {
    pub(crate) journal: Journal,
    pub(crate) parts: Option<Parts>,
}

impl Keep {
    pub(crate) fn flushing(&self) -> Flushing {
        match self.parts {
            None => TO_DISK,
            Some(_) => TO_STORE,
        }
    }

    /// Takes an answer; durable after the next [`Self::flush`].
    pub(crate) fn append(&mut self, record: &Record) -> Result<(), RunError> {
        if let Some(parts) = &mut self.parts {
            parts.push(record)?;
        }
        Ok(self.journal.append(record)?)
    }

    /// Makes all that was taken durable.
    pub(crate) async fn flush(&mut self) -> Result<(), RunError> {
        match &mut self.parts {
            None => self.journal.sync()?,
            Some(parts) => parts.put().await?,
        }
        Ok(())
    }
}
