//! Where model sets come from: a directory, or a prefix of an object store; found by digest, verified, kept.
//!
//! A place holds sets side by side (`PLACE/sea-raft-m/model.json`, `PLACE/droid/model.json`), or is one set
//! itself. A job names sets by digest, and every machine finds them in its own place. Sets of a store are
//! copied once, verified, to a directory named by their digest below the cache.

use std::path::{Path, PathBuf};

use futures_util::TryStreamExt;
use plumbline_common::store::{self, ObjectKey, ObjectMeta, ObjectStore, S3Options, StoreError};
use serde::{Deserialize, Serialize};
use tokio::sync::Mutex;

use super::model_set::{
    MOST_GRAPH_BYTES, MOST_SIDECAR_BYTES, ModelError, ModelSet, SIDECAR, digest_of,
};

/// What every message about missing models ends with.
const REMEDY: &str = "Convert the official checkpoints once, by `deploy/models/setup.sh` and `deploy/models/convert.py sea-raft Tartan-C-T-TSKH-spring540x960-M.pth --out MODELS/sea-raft-m` and `convert.py droid droid.pth --out MODELS/droid`, then give --models MODELS (a directory, or s3://BUCKET/PREFIX; setting models.place) and --onnxruntime FILE, the library whose path setup.sh prints (setting models.runtime)";

/// What is set about models; `plumbline.toml`'s section `models`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelSettings {
    /// Directory or `s3://BUCKET/PREFIX` with converted model sets.
    pub place: Option<String>,
    /// ONNX Runtime's shared library.
    pub runtime: Option<PathBuf>,
    /// Where sets of a store are kept; the system's directory for temporary files where not given.
    pub cache: Option<PathBuf>,
}

/// A network that a profile may need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// SEA-RAFT.
    SeaRaft,
    /// DROID-SLAM.
    Droid,
}

impl Kind {
    /// As a set's sidecar says.
    #[must_use]
    pub fn network(self) -> &'static str {
        match self {
            Self::SeaRaft => "sea-raft",
            Self::Droid => "droid",
        }
    }
}

/// Where a compute child finds what it needs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelPlaces {
    /// ONNX Runtime's shared library.
    pub runtime: PathBuf,
    /// Verified set of SEA-RAFT.
    pub sea_raft: Option<PathBuf>,
    /// Verified set of DROID-SLAM.
    pub droid: Option<PathBuf>,
}

/// Models are not to be had; says what to do.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// No place was named.
    #[error(
        "this profile runs learned networks ({networks}), whose weights Plumbline does not ship. {REMEDY}"
    )]
    NoPlace {
        /// Which.
        networks: String,
    },
    /// The library was not named.
    #[error(
        "this profile runs learned networks through ONNX Runtime, and no library is named. `deploy/models/setup.sh` installs one and prints its path: give it as --onnxruntime FILE (setting models.runtime)"
    )]
    NoRuntime,
    /// The place does not hold the set.
    #[error("{place} holds no converted model set of {wanted}{there}. {REMEDY}")]
    NoSet {
        /// The place.
        place: String,
        /// Network, and digest where one is asked for.
        wanted: String,
        /// What there is instead.
        there: String,
    },
    /// It holds several.
    #[error(
        "{place} holds several model sets of {network} ({found}): name one in a profile file (`plumbline profile show reference`), as {key}.model = \"DIGEST\", or leave one there"
    )]
    Several {
        /// The place.
        place: String,
        /// The network.
        network: &'static str,
        /// Directories with digests.
        found: String,
        /// The profile's section.
        key: &'static str,
    },
    /// A set is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The store does not give it.
    #[error("model sets at {place}: {source}")]
    Store {
        /// The place.
        place: String,
        /// Why.
        source: Box<StoreError>,
    },
    /// The cache cannot be written.
    #[error("{path}: a model set cannot be kept there ({source}); name another directory by the setting models.cache", path = path.display())]
    Cache {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl SourceError {
    /// Whether trying again later may help.
    #[must_use]
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Store { source, .. } if source.is_transient())
    }
}

/// One set of a place.
#[derive(Debug, Clone)]
struct Found {
    network: String,
    digest: String,
    /// Relative to the place; empty where the place is the set.
    name: String,
}

/// Finds sets by digest. Remembers what it found.
#[derive(Debug)]
pub struct ModelSource {
    settings: ModelSettings,
    s3: S3Options,
    /// Verified sets: digest and directory.
    verified: Mutex<Vec<(String, PathBuf)>>,
}

impl ModelSource {
    /// A source; nothing is touched before the first question.
    #[must_use]
    pub fn new(settings: ModelSettings, s3: S3Options) -> Self {
        Self {
            settings,
            s3,
            verified: Mutex::default(),
        }
    }

    /// The digest of the place's only set of a network.
    ///
    /// # Errors
    /// [`SourceError`].
    pub async fn only(&self, kind: Kind) -> Result<String, SourceError> {
        let place = self.place(kind)?;
        let found = self.sets(place).await?;
        let mut fitting: Vec<&Found> = found
            .iter()
            .filter(|set| set.network == kind.network())
            .collect();
        // The same set twice is one.
        fitting.sort_by(|a, b| a.digest.cmp(&b.digest));
        fitting.dedup_by(|a, b| a.digest == b.digest);
        match fitting[..] {
            [set] => Ok(set.digest.clone()),
            [] => Err(no_set(place, kind, None, &found)),
            _ => Err(SourceError::Several {
                place: place.to_owned(),
                network: kind.network(),
                found: told(fitting.into_iter()),
                key: match kind {
                    Kind::SeaRaft => "sea_raft",
                    Kind::Droid => "droid",
                },
            }),
        }
    }

    /// The library, and the verified sets of these digests.
    ///
    /// # Errors
    /// [`SourceError`].
    pub async fn places(
        &self,
        sea_raft: Option<&str>,
        droid: Option<&str>,
    ) -> Result<ModelPlaces, SourceError> {
        let runtime = self.settings.runtime.clone();
        let mut places = ModelPlaces {
            runtime: PathBuf::new(),
            sea_raft: None,
            droid: None,
        };
        if let Some(digest) = sea_raft {
            places.sea_raft = Some(self.verified(Kind::SeaRaft, digest).await?);
        }
        if let Some(digest) = droid {
            places.droid = Some(self.verified(Kind::Droid, digest).await?);
        }
        places.runtime = runtime.ok_or(SourceError::NoRuntime)?;
        Ok(places)
    }

    fn place(&self, kind: Kind) -> Result<&str, SourceError> {
        self.settings
            .place
            .as_deref()
            .ok_or_else(|| SourceError::NoPlace {
                networks: match kind {
                    Kind::SeaRaft => "SEA-RAFT".to_owned(),
                    Kind::Droid => "DROID-SLAM".to_owned(),
                },
            })
    }

    async fn verified(&self, kind: Kind, digest: &str) -> Result<PathBuf, SourceError> {
        let place = self.place(kind)?;
        // Held while a set is copied: two slots of one process copy it once.
        let mut verified = self.verified.lock().await;
        if let Some((_, directory)) = verified.iter().find(|(known, _)| known == digest) {
            return Ok(directory.clone());
        }
        let cached = self.cache().join(digest);
        let directory = if is_remote(place) && verify(&cached, digest).await? {
            cached
        } else {
            let sets = self.sets(place).await?;
            let set = sets
                .iter()
                .find(|set| set.digest == digest)
                .ok_or_else(|| no_set(place, kind, Some(digest), &sets))?;
            if is_remote(place) {
                self.copy(place, set, &cached).await?;
                cached
            } else {
                let directory = Path::new(place).join(&set.name);
                let path = directory.clone();
                blocking(move || ModelSet::read(&path)?.verify()).await?;
                directory
            }
        };
        let directory = std::path::absolute(&directory).map_err(|source| SourceError::Cache {
            path: directory,
            source,
        })?;
        verified.push((digest.to_owned(), directory.clone()));
        Ok(directory)
    }

    fn cache(&self) -> PathBuf {
        let own = self.settings.cache.clone();
        own.unwrap_or_else(|| std::env::temp_dir().join("plumbline-models"))
    }

    async fn sets(&self, place: &str) -> Result<Vec<Found>, SourceError> {
        if is_remote(place) {
            self.remote_sets(place).await
        } else {
            let place = PathBuf::from(place);
            blocking(move || local_sets(&place)).await
        }
    }

    async fn open(&self, place: &str) -> Result<std::sync::Arc<dyn ObjectStore>, SourceError> {
        let failed = |source| store_error(place, source);
        store::open(place, &self.s3).await.map_err(failed)
    }

    async fn remote_sets(&self, place: &str) -> Result<Vec<Found>, SourceError> {
        let failed = |source| store_error(place, source);
        let store = self.open(place).await?;
        let pages: Vec<Vec<ObjectMeta>> = store.list("").try_collect().await.map_err(failed)?;
        let mut found = Vec::new();
        for meta in pages.into_iter().flatten() {
            let key = meta.key.as_str();
            let name = match key.strip_suffix(SIDECAR) {
                Some("") => "",
                Some(rest) if rest.ends_with('/') && !rest.trim_end_matches('/').contains('/') => {
                    rest.trim_end_matches('/')
                }
                _ => continue,
            };
            let bytes = store::fetch(&*store, &meta, MOST_SIDECAR_BYTES)
                .await
                .map_err(failed)?;
            let path = Path::new(place).join(key);
            found.push(Found {
                network: ModelSet::parse(&path, &bytes)?.network().to_owned(),
                digest: digest_of(&bytes),
                name: name.to_owned(),
            });
        }
        Ok(found)
    }

    /// Copies a set beside its place in the cache, verifies it, and moves it there whole.
    async fn copy(&self, place: &str, set: &Found, cached: &Path) -> Result<(), SourceError> {
        let failed = |source| store_error(place, source);
        let store = self.open(place).await?;
        let cache = self.cache();
        let unkept = |source| SourceError::Cache {
            path: cache.clone(),
            source,
        };
        std::fs::create_dir_all(&cache).map_err(unkept)?;
        let beside = tempfile::tempdir_in(&cache).map_err(unkept)?;
        let bring = async |name: &str, most: u64| {
            let key = match set.name.as_str() {
                "" => name.to_owned(),
                directory => format!("{directory}/{name}"),
            };
            let key = ObjectKey::new(key).map_err(|error| failed(error.into()))?;
            let meta = store.head(&key).await.map_err(failed)?;
            store::fetch_to_file(&*store, &meta, most, &beside.path().join(name))
                .await
                .map_err(failed)
        };
        bring(SIDECAR, MOST_SIDECAR_BYTES).await?;
        let copied = ModelSet::read(beside.path())?;
        for name in copied.files()? {
            bring(name, MOST_GRAPH_BYTES).await?;
        }
        copied.verify()?;
        if std::fs::exists(cached).map_err(unkept)? {
            // Damaged, or another process was first: verified sets of one digest are the same.
            std::fs::remove_dir_all(cached).map_err(unkept)?;
        }
        match std::fs::rename(beside.path(), cached) {
            Ok(()) => Ok(()),
            Err(_) if verify(cached, &set.digest).await? => Ok(()),
            Err(source) => Err(unkept(source)),
        }
    }
}

fn is_remote(place: &str) -> bool {
    place.starts_with("s3://")
}

fn store_error(place: &str, source: StoreError) -> SourceError {
    SourceError::Store {
        place: place.to_owned(),
        source: Box::new(source),
    }
}

/// Reading some eighty megabytes is no matter for a runtime's thread.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, ModelError> + Send + 'static,
) -> Result<T, SourceError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => Ok(done?),
        Err(panic) => Err(SourceError::Cache {
            path: PathBuf::from("model set"),
            source: std::io::Error::other(panic),
        }),
    }
}

/// Whether the set of this digest lies there, undamaged.
async fn verify(directory: &Path, digest: &str) -> Result<bool, SourceError> {
    let (directory, digest) = (directory.to_owned(), digest.to_owned());
    blocking(move || {
        let whole = ModelSet::read(&directory)
            .is_ok_and(|set| set.digest() == digest && set.verify().is_ok());
        Ok(whole)
    })
    .await
}

/// The place itself, and the directories in it.
fn local_sets(place: &Path) -> Result<Vec<Found>, ModelError> {
    let mut names = vec![String::new()];
    if let Ok(entries) = std::fs::read_dir(place) {
        for entry in entries.flatten() {
            names.extend(entry.file_name().to_str().map(str::to_owned));
        }
    }
    names.sort();
    let mut found = Vec::new();
    for name in names {
        match ModelSet::read(&place.join(&name)) {
            Ok(set) => found.push(Found {
                network: set.network().to_owned(),
                digest: set.digest().to_owned(),
                name,
            }),
            Err(ModelError::Missing { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(found)
}

fn no_set(place: &str, kind: Kind, digest: Option<&str>, found: &[Found]) -> SourceError {
    SourceError::NoSet {
        place: place.to_owned(),
        wanted: match digest {
            Some(digest) => format!("{} with the digest {digest}", kind.network()),
            None => kind.network().to_owned(),
        },
        there: match found.is_empty() {
            true => String::new(),
            false => format!(", only {}", told(found.iter())),
        },
    }
}

fn told<'a>(found: impl Iterator<Item = &'a Found>) -> String {
    let one = |set: &Found| {
        let name = if set.name.is_empty() {
            &set.network
        } else {
            &set.name
        };
        format!("{name}: {}", set.digest)
    };
    found.map(one).collect::<Vec<_>>().join(", ")
}
