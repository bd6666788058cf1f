//! Why a run's outputs could not be published, named for the caller's next move: each message
//! names the file and the remedy.

use std::io::{self, ErrorKind};

use crate::publish::encode::EncodeError;

/// Why something could not be published. Nothing partial is left behind under the final name.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The disk, or the quota, is full.
    #[error(
        "no space left to write {file}: free some space or choose another --out, then run again to resume"
    )]
    NoSpace {
        /// The file as named below OUT.
        file: String,
        /// What the operating system said.
        #[source]
        source: io::Error,
    },
    /// The directory may not be written to.
    #[error(
        "may not write {file}: make the directory writable or choose another --out, then run again to resume"
    )]
    NotWritable {
        /// The file as named below OUT.
        file: String,
        /// What the operating system said.
        #[source]
        source: io::Error,
    },
    /// Something else stands where the file or its folder belongs.
    #[error(
        "cannot put {file} in its place: a folder or another file stands in the way; move it or choose another --out"
    )]
    InTheWay {
        /// The file as named below OUT.
        file: String,
        /// What the operating system said.
        #[source]
        source: io::Error,
    },
    /// Any other failure of the file system.
    #[error(
        "cannot write {file}: {source}; choose another --out, or run again to resume once that can be written"
    )]
    Io {
        /// The file as named below OUT.
        file: String,
        /// What the operating system said.
        #[source]
        source: io::Error,
    },
    /// The rows could not be put into the format.
    #[error("cannot encode {file}: {source}")]
    Encode {
        /// The file as named below OUT.
        file: String,
        /// What the encoder said.
        #[source]
        source: EncodeError,
    },
    /// A name that is no plain relative path.
    #[error("{file:?} is no plain path below the output directory")]
    Name {
        /// The name.
        file: String,
    },
    /// Rows and locations do not belong together.
    #[error("{rows} rows, but {locations} locations: the lists must be parallel")]
    Locations {
        /// Rows given.
        rows: usize,
        /// Locations given.
        locations: usize,
    },
    /// The statistics hold an infinity or a NaN.
    #[error("{field} of corpus.json is not finite")]
    NotFinite {
        /// Dotted name of the first such field.
        field: String,
    },
}

impl PublishError {
    /// Sorts an error of the operating system by what the caller can do about it.
    #[must_use]
    pub fn from_io(file: &str, source: io::Error) -> Self {
        let file = file.to_owned();
        match source.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
                Self::NoSpace { file, source }
            }
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
                Self::NotWritable { file, source }
            }
            ErrorKind::IsADirectory
            | ErrorKind::NotADirectory
            | ErrorKind::DirectoryNotEmpty
            | ErrorKind::AlreadyExists => Self::InTheWay { file, source },
            _ => Self::Io { file, source },
        }
    }
}
