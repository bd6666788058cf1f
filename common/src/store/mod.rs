//! Where objects lie: videos that are read, parts and reports that are written.
//!
//! One trait, two homes: a directory ([`DirStore`]) and any S3-compatible service ([`S3Store`]). Both
//! keep the same contract, which one suite of tests asks of both:
//!
//! - A put replaces the object whole or not at all, and may be repeated: nothing here relies on
//!   conditional puts, which services ignore or race on. Writers use keys that are functions of the
//!   content ([`ObjectKey::of_content`]).
//! - A read names the object as it was listed ([`ObjectMeta`]); one that changed since is
//!   [`StoreError::Changed`], never a mixture of two versions.
//! - What can pass by waiting is tried again inside, with jitter, a bounded number of times; what comes
//!   out as [`StoreError::Transient`] has outlasted that.

mod dir;
mod error;
mod fetch;
mod key;
mod probe;
mod s3;

use std::fmt::Debug;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::stream::BoxStream;

pub use dir::DirStore;
pub use error::StoreError;
pub use fetch::{fetch, fetch_range_to_file, fetch_to_file};
pub use key::{KeyError, MAX_KEY_BYTES, ObjectKey};
pub use probe::{Access, probe};
pub use s3::{S3Options, S3Store};

/// Most objects in one page of a listing.
pub const PAGE_OBJECTS: usize = 1000;

/// An object as it was listed or looked up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObjectMeta {
    /// Its name.
    pub key: ObjectKey,
    /// Its size.
    pub bytes: u64,
    /// The store's mark of this version of the content; not every service lists it.
    pub etag: Option<String>,
    /// When it was last written, seconds since the epoch: the finest that every answer carries.
    pub modified_s: Option<i64>,
}

impl ObjectMeta {
    /// Whether both describe the same version: by etag where both have one, else by time.
    #[must_use]
    pub fn is_same_version(&self, other: &Self) -> bool {
        let marks_agree = match (&self.etag, &other.etag) {
            (Some(a), Some(b)) => a == b,
            _ => match (self.modified_s, other.modified_s) {
                (Some(a), Some(b)) => a == b,
                _ => true,
            },
        };
        self.key == other.key && self.bytes == other.bytes && marks_agree
    }
}

/// A place for objects; every error names the object and what to do.
#[async_trait]
pub trait ObjectStore: Debug + Send + Sync {
    /// The whole address of an object, for people.
    fn address(&self, key: &ObjectKey) -> String;

    /// The objects whose keys begin with `prefix`, in the order of their bytes, page by page.
    fn list(&self, prefix: &str) -> BoxStream<'static, Result<Vec<ObjectMeta>, StoreError>>;

    /// Size and version of an object.
    ///
    /// # Errors
    /// [`StoreError`]; `NotFound` where there is none.
    async fn head(&self, key: &ObjectKey) -> Result<ObjectMeta, StoreError>;

    /// The bytes `range` of the object that `meta` describes; the range is not empty and lies within
    /// its size. For whole objects see [`fetch()`].
    ///
    /// # Errors
    /// [`StoreError`]; `Changed` where the object is another than `meta` says.
    async fn get_range(&self, meta: &ObjectMeta, range: Range<u64>) -> Result<Bytes, StoreError>;

    /// Puts `content` under `key`, replacing what is there.
    ///
    /// # Errors
    /// [`StoreError`]; what was there is untouched.
    async fn put(&self, key: &ObjectKey, content: Bytes) -> Result<(), StoreError>;

    /// Puts a file's content under `key`, in bounded memory whatever its size.
    ///
    /// # Errors
    /// [`StoreError`]; what was there is untouched.
    async fn put_file(&self, key: &ObjectKey, file: &Path) -> Result<(), StoreError>;

    /// Removes an object; none there is none removed.
    ///
    /// # Errors
    /// [`StoreError`].
    async fn delete(&self, key: &ObjectKey) -> Result<(), StoreError>;
}

/// Opens the store that `place` names: `s3://bucket`, `s3://bucket/prefix`, or a directory. Keys are
/// relative to it.
///
/// # Errors
/// [`StoreError::Unusable`] where an `s3://` address names no bucket.
pub async fn open(place: &str, s3: &S3Options) -> Result<Arc<dyn ObjectStore>, StoreError> {
    match place.strip_prefix("s3://") {
        None => Ok(Arc::new(DirStore::new(place))),
        Some(rest) => {
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            Ok(Arc::new(S3Store::connect(bucket, prefix, s3).await?))
        }
    }
}
