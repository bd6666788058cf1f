//! What can go wrong with an object, by what the caller does next.

use super::key::KeyError;

/// Boxed cause of a store's error.
pub(super) type Source = Box<dyn std::error::Error + Send + Sync>;

/// Why a store did not do what it was asked; `object` is the whole address.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No such object: a row of its own.
    #[error("{object}: there is no such object; it was removed, or the key is wrong")]
    NotFound {
        /// The object.
        object: String,
    },
    /// The credentials do not allow it: nothing will go better by waiting.
    #[error(
        "{object}: access denied ({source}); check the credentials (AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_PROFILE, or the machine's role) and what they may do there"
    )]
    Denied {
        /// The object.
        object: String,
        /// What the store said.
        source: Source,
    },
    /// Not the version that was listed.
    #[error("{object}: changed after it was listed; run again to use what is there now")]
    Changed {
        /// The object.
        object: String,
    },
    /// Larger than the caller allows.
    #[error(
        "{object}: has {bytes} bytes, more than the {limit} allowed; raise the limit or leave it out"
    )]
    TooLarge {
        /// The object.
        object: String,
        /// Its size.
        bytes: u64,
        /// What is allowed.
        limit: u64,
    },
    /// Still failing after every retry; later it may work.
    #[error(
        "{object}: no answer after {attempts} attempts ({source}); check that the store runs and its address (AWS_ENDPOINT_URL), then run again"
    )]
    Transient {
        /// The object.
        object: String,
        /// How often it was tried.
        attempts: u32,
        /// The last failure.
        source: Source,
    },
    /// A file of this machine cannot be written: for want of room, mostly.
    #[error("{file}: cannot be written ({source}); make room, or choose another directory")]
    LocalFile {
        /// The file.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A name that this store cannot hold.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The store cannot be used as it is set up.
    #[error("{object}: {source}; check the address, the region and that the store is set up")]
    Unusable {
        /// The object or the store.
        object: String,
        /// Why.
        source: Source,
    },
}

impl StoreError {
    /// Whether the same call may succeed later.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        matches!(self, Self::Transient { .. })
    }
}
