//! Why rows in files could not be reduced: each text names the file and the remedy.

use std::io;

use crate::in_parallel::BrokenThread;
use crate::publish::PublishError;
use crate::publish::encode::EncodeError;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum ReduceFilesError {
    /// A source that cannot be rows.
    #[error("{path}: {reason}")]
    Source {
        /// The file.
        path: String,
        /// What is wrong, with the remedy.
        reason: String,
    },
    /// No row anywhere.
    #[error(
        "{sources}: no row found; name scores.parquet, scores.jsonl, or a directory that holds them"
    )]
    Empty {
        /// As typed.
        sources: String,
    },
    /// Two rows of one video.
    #[error("{video}: two rows bear this name; leave one of the parts out")]
    Duplicate {
        /// The name.
        video: String,
    },
    /// Rows of two profiles.
    #[error("rows of two profiles ({first} and {second}) share no statistics: reduce them apart")]
    Profiles {
        /// One digest.
        first: String,
        /// Another.
        second: String,
    },
    /// The reference belongs to another profile.
    #[error(
        "the rows were measured by profile {rows}, the reference is of profile {fitted}: their signals differ; fit a reference on rows of the same profile with `plumbline reference fit`"
    )]
    ReferenceProfile {
        /// Digest of the rows' profile.
        rows: String,
        /// Digest of the reference's.
        fitted: String,
    },
    /// Too few rows to freeze.
    #[error(
        "{rows} scored rows: a reference needs at least {least} (a hundred are better); name more"
    )]
    TooFewRows {
        /// Scored rows.
        rows: u64,
        /// Needed.
        least: u64,
    },
    /// `--group-by` cannot be applied.
    #[error(transparent)]
    Group(#[from] crate::corpus::CorpusError),
    /// OUT is the directory of the rows.
    #[error(
        "{out}: the rows lie there, and would be overwritten while they are read; choose another --out"
    )]
    OutIsSource {
        /// OUT.
        out: String,
    },
    /// Another run writes to the same place.
    #[error("{out}: another plumbline run is writing there; wait for it or choose another --out")]
    OutInUse {
        /// OUT.
        out: String,
    },
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The scratch files cannot be used.
    #[error("scratch files below --out: {0}; make room there, then run again")]
    Scratch(#[from] io::Error),
    /// Rows do not fit their columns.
    #[error("scratch files below --out: {0}")]
    Encode(#[from] EncodeError),
    /// A defect of the program.
    #[error("a thread of the reduce broke down, which is a defect to report")]
    Thread,
}

impl From<BrokenThread> for ReduceFilesError {
    fn from(_: BrokenThread) -> Self {
        Self::Thread
    }
}

impl ReduceFilesError {
    /// A file that cannot be read, and why.
    pub(super) fn source(path: &str, reason: impl std::fmt::Display) -> Self {
        Self::Source {
            path: path.to_owned(),
            reason: reason.to_string(),
        }
    }

    /// True where the caller typed something unusable, rather than the machine failing.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        !matches!(
            self,
            Self::Publish(_) | Self::Scratch(_) | Self::Encode(_) | Self::Thread
        )
    }
}

/// What is said of a thread that panicked.
pub(super) fn joined<T>(
    result: std::thread::Result<Result<T, ReduceFilesError>>,
) -> Result<T, ReduceFilesError> {
    result.unwrap_or(Err(ReduceFilesError::Thread))
}
