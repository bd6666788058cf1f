//! The bytes of a job's object, and the networks of its profile, brought to this machine before its child
//! measures them.
//!
//! Ranged, in the version that was listed, and never more than the profile allows. What is said of an
//! object in a row names its address and is the same text on every machine: neither the scratch file nor
//! the words of a service are in it.

mod kept;
mod scratch;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_common::message::{Job, ObjectLocation, Part};
use plumbline_common::row::Measurement;
use plumbline_common::store::{
    ObjectKey, ObjectMeta, ObjectStore, S3Options, S3Store, StoreError, fetch_ends_to_file,
    fetch_range_to_file,
};
use serde::Deserialize;
use tempfile::TempPath;
use tokio::sync::{Mutex, OnceCell};

use self::kept::Kept;
use self::scratch::Scratch;
use crate::learned::{ModelPlaces, ModelSettings, ModelSource, SourceError};
use crate::measure::read::{ReadError, byte_range};
use crate::profile::Profile;

/// Stores kept open: jobs name their bucket, and nobody says how many there are.
const MAX_OPEN_STORES: usize = 64;

/// Bytes read at either end of an object for its header alone: the index of an mp4 takes some twenty per frame,
/// the header of other containers less than a thousand in all.
const END_BYTES: u64 = 128 << 10;

/// Where objects are read from and put meanwhile. Clones share both.
#[derive(Debug, Clone)]
pub struct Fetcher {
    shared: Arc<Shared>,
    models: Arc<ModelSource>,
}

#[derive(Debug)]
struct Shared {
    s3: S3Options,
    kept: Kept,
    scratch_parent: PathBuf,
    scratch: OnceCell<Scratch>,
    /// By bucket.
    stores: Mutex<HashMap<String, Arc<dyn ObjectStore>>>,
}

/// A job whose bytes are on this machine.
#[derive(Debug)]
pub struct Fetched {
    /// The copy of an object, or of some of it, removed with its last job; files are read where they are.
    copy: Option<Arc<TempPath>>,
    /// Bytes read from a store for this job.
    pub bytes: u64,
    /// How long that took.
    pub took: Duration,
    /// Where the networks are that its profile needs.
    pub(crate) models: Option<ModelPlaces>,
}

impl Fetched {
    /// No video, only networks.
    pub(crate) fn of_models(models: Option<ModelPlaces>) -> Self {
        Self {
            copy: None,
            bytes: 0,
            took: Duration::ZERO,
            models,
        }
    }

    /// The copy, where the job is an object.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.copy.as_deref().map(AsRef::as_ref)
    }
}

/// What a failed fetch means for the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FetchFailure {
    /// The object is the reason: no machine will ever do better.
    Final,
    /// The store says no; another machine's credentials may do.
    Refused,
    /// The store is out of reach, or the copy cannot be written here: later it may work.
    Passing,
}

/// An object that was not fetched.
#[derive(Debug, thiserror::Error)]
#[error("{source}")]
pub struct FetchError {
    /// What it means.
    pub failure: FetchFailure,
    /// The row of the video, if this is the end of it.
    pub row: Box<Measurement>,
    /// What happened, in all detail.
    pub source: Box<dyn std::error::Error + Send + Sync>,
}

impl Fetcher {
    /// A fetcher of S3 objects, with its copies in a directory of its own below `scratch_parent`. Nothing is
    /// touched before the first object.
    #[must_use]
    pub fn new(s3: S3Options, scratch_parent: impl Into<PathBuf>) -> Self {
        Self {
            models: Arc::new(ModelSource::new(ModelSettings::default(), s3.clone())),
            shared: Arc::new(Shared {
                s3,
                kept: Kept::default(),
                scratch_parent: scratch_parent.into(),
                scratch: OnceCell::new(),
                stores: Mutex::default(),
            }),
        }
    }

    /// The same, with learned networks from where these settings say.
    #[must_use]
    pub fn with_models(self, settings: ModelSettings) -> Self {
        let s3 = self.shared.s3.clone();
        Self {
            models: Arc::new(ModelSource::new(settings, s3)),
            ..self
        }
    }

    /// Where model sets come from.
    #[must_use]
    pub fn model_source(&self) -> &ModelSource {
        &self.models
    }

    /// Where the networks of a profile (in its canonical form) are on this machine; brought here where they
    /// were not. `None` for a profile without any.
    pub(crate) async fn models(&self, profile: &[u8]) -> Result<Option<ModelPlaces>, SourceError> {
        // What does not decode is refused by whoever measures.
        let Ok(wanted) = serde_json::from_slice::<WantedModels>(profile) else {
            return Ok(None);
        };
        let [sea_raft, droid] = [&wanted.sea_raft, &wanted.droid]
            .map(|wanted| wanted.as_ref().and_then(|wanted| wanted.model.as_deref()));
        if sea_raft.is_none() && droid.is_none() {
            return Ok(None);
        }
        self.models.places(sea_raft, droid).await.map(Some)
    }

    /// How stores are spoken to.
    #[must_use]
    pub fn s3_options(&self) -> &S3Options {
        &self.shared.s3
    }

    /// Reads the objects of `bucket` from `store` instead of S3: for tests.
    pub async fn put_store(&self, bucket: &str, store: Arc<dyn ObjectStore>) {
        let mut stores = self.shared.stores.lock().await;
        stores.insert(bucket.to_owned(), store);
    }

    /// Brings the bytes of `job` here, if they are an object's: of a tar's member its own alone, of an episode
    /// in a longer video the whole video, unless another episode has left it here.
    ///
    /// # Errors
    /// [`FetchError`], with the row that the video gets if nobody tries again.
    pub async fn fetch(&self, job: &Job) -> Result<Fetched, FetchError> {
        let started = Instant::now();
        let models = self.models(&job.profile).await;
        let models = models.map_err(|error| no_models(job, error))?;
        let (copy, bytes) = match job.location.object() {
            None => (None, 0),
            Some(object) => {
                let whole = async || self.copy(job, object, u64::MAX).await;
                let is_episode = matches!(job.location.part(), Some(Part::Interval { .. }));
                // Without a mark of its version what is there now may be another.
                let (copy, was_fetched) = match &object.etag {
                    Some(_) if is_episode => self.shared.kept.get(object, whole).await?,
                    _ => (Arc::new(whole().await?), true),
                };
                let bytes = if was_fetched { job.bytes_read() } else { 0 };
                (Some(copy), bytes)
            }
        };
        Ok(Fetched {
            copy,
            bytes,
            took: started.elapsed(),
            models,
        })
    }

    /// Brings no more than the first and last bytes of the job's object, where containers have their headers,
    /// into a copy of its length with nothing between them.
    ///
    /// # Errors
    /// As [`Self::fetch`].
    pub(crate) async fn fetch_ends(&self, job: &Job) -> Result<Fetched, FetchError> {
        let mut fetched = Fetched::of_models(None);
        if let Some(object) = job.location.object() {
            fetched.copy = Some(Arc::new(self.copy(job, object, END_BYTES).await?));
        }
        Ok(fetched)
    }

    /// The same, given up after `limit`: a store that trickles must not hold a slot for ever.
    ///
    /// # Errors
    /// As [`Self::fetch`].
    pub async fn fetch_within(&self, job: &Job, limit: Duration) -> Result<Fetched, FetchError> {
        let elapsed = match tokio::time::timeout(limit, self.fetch(job)).await {
            Ok(fetched) => return fetched,
            Err(elapsed) => elapsed,
        };
        let said = ReadError::NotRead {
            object: match job.location.object() {
                Some(object) => object.to_string(),
                None => job.video.to_string(),
            },
            why: "was not read within the time given to a video; score it again later, or raise --deadline"
                .to_owned(),
        };
        Err(FetchError {
            failure: FetchFailure::Passing,
            row: Box::new(said.row(job)),
            source: format!("{said}: {elapsed}").into(),
        })
    }

    /// A copy of the object's bytes that the job reads, of no more than `end_bytes` at either end.
    async fn copy(
        &self,
        job: &Job,
        object: &ObjectLocation,
        end_bytes: u64,
    ) -> Result<TempPath, FetchError> {
        let ended = |error: ReadError| FetchError {
            failure: FetchFailure::Final,
            row: Box::new(error.row(job)),
            source: error.into(),
        };
        let failed = |error: StoreError| match row_error(object, &error) {
            (FetchFailure::Final, said) => ended(said),
            (failure, said) => FetchError {
                failure,
                row: Box::new(said.row(job)),
                source: error.into(),
            },
        };
        let profile: Profile = serde_json::from_slice(&job.profile)
            .map_err(|error| ended(ReadError::Profile(error)))?;
        // The words of a file that is too large.
        let limits = profile.limits;
        limits
            .check_bytes(job.bytes_read())
            .map_err(|error| ended(error.into()))?;
        let range = match job.location.part() {
            Some(Part::Bytes { offset, bytes }) => byte_range(offset, bytes, job.bytes)
                .ok_or_else(|| {
                    let path = object.to_string();
                    ended(ReadError::Outside { path })
                })?,
            Some(Part::Interval { .. }) | None => 0..job.bytes,
        };
        let key = ObjectKey::new(&object.key).map_err(|error| failed(error.into()))?;
        let meta = ObjectMeta {
            key,
            bytes: job.bytes,
            etag: object.etag.clone(),
            modified_s: object.modified_s,
        };
        let store = self.store(&object.bucket).await.map_err(failed)?;
        let parent = &self.shared.scratch_parent;
        let scratch = self
            .shared
            .scratch
            .get_or_try_init(|| Scratch::below(parent));
        let scratch = scratch.await.map_err(failed)?;
        let bytes = range.end - range.start;
        let attempt = async || {
            let path = scratch.new_path()?;
            let range = range.clone();
            if end_bytes < bytes.div_ceil(2) {
                fetch_ends_to_file(&*store, &meta, range, end_bytes, &path).await?;
            } else {
                fetch_range_to_file(&*store, &meta, range, limits.max_bytes, &path).await?;
            }
            Ok(path)
        };
        let copied = match attempt().await {
            // What is only kept must not be in the way of what is needed.
            Err(StoreError::LocalFile { .. }) if self.shared.kept.let_go() => attempt().await,
            copied => copied,
        };
        copied.map_err(failed)
    }

    async fn store(&self, bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
        let mut stores = self.shared.stores.lock().await;
        if let Some(store) = stores.get(bucket) {
            return Ok(Arc::clone(store));
        }
        if stores.len() >= MAX_OPEN_STORES {
            stores.clear();
        }
        let store: Arc<dyn ObjectStore> =
            Arc::new(S3Store::connect(bucket, "", &self.shared.s3).await?);
        stores.insert(bucket.to_owned(), Arc::clone(&store));
        Ok(store)
    }
}

/// Of a profile, what says which networks it needs.
#[derive(Deserialize)]
struct WantedModels {
    sea_raft: Option<WantedModel>,
    droid: Option<WantedModel>,
}

#[derive(Deserialize)]
struct WantedModel {
    model: Option<String>,
}

/// Another machine may have them.
fn no_models(job: &Job, error: SourceError) -> FetchError {
    let said = ReadError::Models(error.to_string());
    FetchError {
        failure: match error.is_passing() {
            true => FetchFailure::Passing,
            false => FetchFailure::Refused,
        },
        row: Box::new(said.row(job)),
        source: error.into(),
    }
}

/// What a store's error means, and the words for a row.
fn row_error(object: &ObjectLocation, error: &StoreError) -> (FetchFailure, ReadError) {
    let said = |what: &str| ReadError::NotRead {
        object: object.to_string(),
        why: what.to_owned(),
    };
    match error {
        StoreError::NotFound { .. } => (
            FetchFailure::Final,
            said("there is no such object; it was removed, or the key is wrong"),
        ),
        StoreError::Changed { .. } => (
            FetchFailure::Final,
            ReadError::Changed {
                path: object.to_string(),
            },
        ),
        StoreError::TooLarge { .. } => (
            FetchFailure::Final,
            said("is larger than max_bytes allows; re-encode it smaller or raise max_bytes"),
        ),
        StoreError::Key(_) => (
            FetchFailure::Final,
            said("the key is none that the store can hold; rename the object"),
        ),
        StoreError::Denied { .. } => (
            FetchFailure::Refused,
            said("access denied; check the credentials and what they may read there"),
        ),
        StoreError::Unusable { .. } => (
            FetchFailure::Refused,
            said("the store does not give it; check bucket, region and the object's storage class"),
        ),
        StoreError::Transient { .. } => (
            FetchFailure::Passing,
            said("the store did not answer, however often it was asked; score it again later"),
        ),
        StoreError::LocalFile { .. } => (
            FetchFailure::Passing,
            said(
                "no machine could keep a copy of it; make room for scratch files and score it again",
            ),
        ),
    }
}
