//! The frozen corpus: every input video of a run, once, with its name, place, size and time.
//!
//! A source is a video, a directory (recursive), a glob, an object or all below a prefix of an object
//! store (`s3://`), or a list; datasets among them are read as such (`dataset`). Listing opens no video: what is
//! wrong with one becomes its row, not an error of the run. What makes the *list* wrong (no such
//! source, an unreadable directory, a duplicate name, an unknown column) is an error before any work.

mod camera;
mod choice;
mod dataset;
mod files;
mod group;
mod list;
mod objects;
mod pattern;
mod source;

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::message::Location;
use plumbline_common::store::StoreError;
use plumbline_vision::slam::intrinsics::Intrinsics;
use serde::{Deserialize, Serialize};

pub use choice::Choice;
pub use group::GroupBy;
pub(crate) use list::read_columns as read_list_columns;
pub use list::{Line, read as read_list};
pub use objects::Buckets;
pub use source::{Listing, freeze, freeze_anywhere};
pub(crate) use source::{empty, looked_at_again};

/// One input video as it was when the corpus was frozen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Its unique name in the run.
    pub video: VideoId,
    /// Where its bytes are.
    pub location: Location,
    /// Size in bytes (of all images, for a sequence; of the whole file, for a part); `None` where it could not
    /// be read.
    pub bytes: Option<u64>,
    /// Modification time, nanoseconds since the epoch (the latest, for a sequence).
    pub modified_ns: Option<i128>,
    /// Why its size could not be read, where it could not.
    pub problem: Option<String>,
    /// The value of `--group-by`.
    pub group: Option<String>,
    /// Columns carried through from a list or dataset.
    pub carried: serde_json::Map<String, serde_json::Value>,
}

impl Entry {
    /// Its camera, where the list tells; what it tells wrongly is no corpus.
    #[must_use]
    pub fn intrinsics(&self) -> Option<Intrinsics> {
        camera::intrinsics(&self.carried).ok().flatten()
    }

    /// Where its bytes are, for people: a path or the address of an object.
    #[must_use]
    pub fn address(&self) -> String {
        self.location.to_string()
    }
}

/// Why there is no corpus. Each text names the thing and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum CorpusError {
    /// The source does not exist.
    #[error("{source_text}: no such file or directory; check the path")]
    NoSuchSource {
        /// As typed.
        source_text: String,
    },
    /// An object store, where a command reads files alone.
    #[error(
        "{source_text}: only `plumbline score` (without --watch) reads object stores; copy the videos to a directory"
    )]
    ObjectStore {
        /// As typed.
        source_text: String,
    },
    /// An address of a kind that is not known.
    #[error("{source_text}: not a file, and of object stores only s3://BUCKET/PREFIX is read")]
    UnknownStore {
        /// As typed.
        source_text: String,
    },
    /// An object store cannot be listed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Nothing to score.
    #[error(
        "{sources}: no video found; check the path (in directories, files named {extensions} and numbered images count; lists and patterns take any file)"
    )]
    Empty {
        /// All sources as typed.
        sources: String,
        /// The extensions looked for.
        extensions: String,
    },
    /// A directory cannot be listed.
    #[error("{path}: cannot be listed ({source}); mend its permissions or leave it out")]
    Unlistable {
        /// The directory.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A glob does not parse.
    #[error("{pattern}: not a valid glob ({reason})")]
    Glob {
        /// As typed.
        pattern: String,
        /// Why.
        reason: String,
    },
    /// A list does not read.
    #[error("{path}: {reason}")]
    List {
        /// The list file.
        path: String,
        /// Where and why, with the remedy.
        reason: String,
    },
    /// Two different files would have the same name.
    #[error("{video}: named twice in the corpus ({first} and {second}); give the sources apart")]
    Duplicate {
        /// The name.
        video: String,
        /// One file.
        first: String,
        /// The other.
        second: String,
    },
    /// A shard without a way to its members.
    #[error(
        "{shard}: a compressed shard, of which no member can be read without all before it; unpack it (gunzip, unzstd) to a plain .tar, and compress its members where that is worth it"
    )]
    Compressed {
        /// As typed.
        shard: String,
    },
    /// Episodes of two datasets.
    #[error(
        "{first} and {second}: two LeRobot datasets, whose episodes have the same numbers; score each by itself, into an --out of its own"
    )]
    SeveralDatasets {
        /// One of them.
        first: String,
        /// Another.
        second: String,
    },
    /// `--camera` names none that there is.
    #[error("--camera {camera}: no such camera; the videos have {known}")]
    UnknownCamera {
        /// As typed.
        camera: String,
        /// What there is.
        known: String,
    },
    /// `--group-by` names no column.
    #[error("--group-by {column}: no such column; the list has {known}")]
    UnknownColumn {
        /// As typed.
        column: String,
        /// What there is.
        known: String,
    },
}

/// A file's entry, for tests that need any.
#[cfg(test)]
pub(crate) fn file_entry(name: &str) -> Entry {
    Entry {
        video: VideoId::new(name).unwrap(),
        location: Location::File(name.into()),
        bytes: Some(3),
        modified_ns: Some(5),
        problem: None,
        group: None,
        carried: serde_json::Map::new(),
    }
}

/// What was passed over while walking directories, by extension ("" for none).
pub type Ignored = BTreeMap<String, u64>;
