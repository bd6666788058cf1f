//! Whoever measures videos, as the run sees them: something that gives answers.

use async_trait::async_trait;
use plumbline_common::message::{Job, Outcome};
use plumbline_worker::child::Measured;

use crate::fanout::Fanout;
use crate::run::RunError;

/// Who measured, in `costs.*`, when no fleet is involved.
pub(crate) const EMBEDDED_WORKER: &str = "embedded";

/// A row, and who measured it.
#[derive(Debug)]
pub(crate) struct Answer {
    /// What came of it.
    pub(crate) outcome: Outcome,
    /// How often it was tried.
    pub(crate) attempts: u32,
    /// The worker's name.
    pub(crate) worker: String,
}

impl Answer {
    /// One of this machine's.
    pub(crate) fn embedded(measured: Measured) -> Self {
        Self {
            outcome: measured.outcome,
            attempts: measured.attempts,
            worker: EMBEDDED_WORKER.to_owned(),
        }
    }
}

/// Slots of this machine, or workers of a fleet.
#[async_trait]
pub(crate) trait Answers: Send {
    /// The next answer; `None` when every job is answered. A video may be answered again where a `failed`
    /// row becomes another: the last answer counts. May be cancelled without loss.
    ///
    /// # Errors
    /// [`RunError`], when nobody can measure any more.
    async fn next(&mut self) -> Result<Option<Answer>, RunError>;

    /// To be told when all that was answered so far is durable: nobody need answer it again.
    ///
    /// # Errors
    /// [`RunError`].
    async fn kept(&mut self) -> Result<(), RunError>;

    /// To be told when the run is published.
    ///
    /// # Errors
    /// [`RunError`].
    async fn finished(self: Box<Self>) -> Result<(), RunError>;
}

#[async_trait]
impl Answers for Fanout<Job> {
    async fn next(&mut self) -> Result<Option<Answer>, RunError> {
        let answer = Fanout::next(self).await.transpose()?;
        Ok(answer.map(Answer::embedded))
    }

    async fn kept(&mut self) -> Result<(), RunError> {
        Ok(())
    }

    async fn finished(self: Box<Self>) -> Result<(), RunError> {
        Ok(())
    }
}
