//! Why a run does not finish, by what a person does next.

use plumbline_common::id::{NotARunId, RunId};
use plumbline_common::message::MessageError;
use plumbline_common::queue::QueueError;
use plumbline_common::store::StoreError;
use plumbline_worker::child::SlotError;

use crate::collect::JournalError;
use crate::corpus::CorpusError;
use crate::picture::PngError;
use crate::publish::PublishError;
use crate::publish::encode::EncodeError;

/// Why a run did not finish.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The list of videos is wrong.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// Another run writes to the same place.
    #[error("{out}: another plumbline run is writing there; wait for it or choose another --out")]
    OutInUse {
        /// OUT.
        out: String,
    },
    /// A watch without a reference: scores would change with every video that arrives.
    #[error("a watch scores against a frozen reference; give --reference")]
    NoReference,
    /// Rows cannot be handed on.
    #[error(
        "rows cannot be written to standard output ({0}); what was measured is kept, and is in --out after the next run"
    )]
    Output(std::io::Error),
    /// The profile cannot be written down.
    #[error("the profile cannot be encoded: {0}")]
    Profile(serde_json::Error),
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The journal cannot be written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A heat map does not encode.
    #[error(transparent)]
    Png(#[from] PngError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// The broker does not do what it must.
    #[error("{0}; what was measured is kept: run the same command again to go on")]
    Queue(#[from] QueueError),
    /// An OUT in an object store cannot be used.
    #[error("{0}; what was measured is kept: run the same command again to go on")]
    Store(#[from] StoreError),
    /// Rows cannot be made a part.
    #[error("rows cannot be written as a part: {0}")]
    Part(EncodeError),
    /// What lies among the parts is none.
    #[error("{part}: not a part of a run ({why}); remove it, its videos are measured again")]
    PartUnreadable {
        /// The object.
        part: String,
        /// Why.
        why: String,
    },
    /// A job cannot be encoded.
    #[error(transparent)]
    Message(MessageError),
    /// The run's name is none.
    #[error("--run: {0}")]
    Name(#[from] NotARunId),
    /// Another coordinator has the run.
    #[error(
        "the run {run} has another coordinator; wait for it, or stop it and run the same command again (a machine that vanished is noticed within a minute)"
    )]
    RunInUse {
        /// The run.
        run: RunId,
    },
    /// Another coordinator took the run.
    #[error(
        "another coordinator took the run {run} while the broker was away; what was measured is kept: let one of them go on"
    )]
    LeaseLost {
        /// The run.
        run: RunId,
    },
    /// The results queue is gone.
    #[error(
        "the run {run} was cancelled, or its broker lost it; what was measured is kept: run the same command again to go on"
    )]
    Cancelled {
        /// The run.
        run: RunId,
    },
    /// The slots ended before the jobs did, which only a defect of the program explains.
    #[error(
        "{missing} of {total} videos were not measured, since the program that measures them stopped; the others are kept: run the same command again, and report this if it comes back"
    )]
    Unmeasured {
        /// Videos without an outcome.
        missing: usize,
        /// Videos in the corpus.
        total: usize,
    },
    /// A cascade asks for a rung that there is none of, which only a defect of the program explains.
    #[error("the cascade asks for a profile beyond its ladder; this is a defect to report")]
    Ladder,
    /// Reducing or publishing broke down.
    #[error(
        "the reduce broke down ({0}); what was measured is kept, and this is a defect to report"
    )]
    Finishing(tokio::task::JoinError),
    /// Ctrl-C or SIGTERM.
    #[error(
        "interrupted: {done} of {total} videos are measured and kept; run the same command again to go on"
    )]
    Interrupted {
        /// Videos measured.
        done: usize,
        /// Videos in the corpus.
        total: usize,
    },
}
