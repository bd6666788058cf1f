//! Objects as files below a directory: the store of one machine.
//!
//! A put writes a hidden partial file beside its place, flushes it to the disk and renames it; partial
//! files are never listed. Links are followed, as the corpus does. Unlike in a bucket, `a` and `a/b`
//! cannot both be objects.

use std::fs::{self, File, Metadata};
use std::io::{self, Read, Write};
use std::ops::Range;
use std::os::unix::fs::{FileExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::stream::{self, BoxStream, StreamExt};
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use walkdir::WalkDir;

use super::error::StoreError;
use super::key::{ObjectKey, PARTIAL_SUFFIX, is_partial};
use super::{ObjectMeta, ObjectStore, PAGE_OBJECTS};
use crate::file_time::modified_ns;

/// Pages walked ahead of the reader.
const PAGES_AHEAD: usize = 2;

/// Permissions of new files before the process' mask, as other programs create them.
const FILE_MODE: u32 = 0o666;

/// A directory of objects.
#[derive(Debug, Clone)]
pub struct DirStore {
    root: PathBuf,
}

impl DirStore {
    /// The store below `root`; nothing is touched before the first put makes the directory.
    #[must_use]
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Runs `work` on the file of `key`, off the async threads.
    async fn blocking<T: Send + 'static>(
        &self,
        key: &ObjectKey,
        work: impl FnOnce(&Path) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let path = self.root.join(key.to_relative_path()?);
        let name = path.display().to_string();
        spawn_blocking(move || work(&path))
            .await
            .unwrap_or_else(|panic| {
                Err(StoreError::Unusable {
                    object: name,
                    source: panic.into(),
                })
            })
    }
}

#[async_trait]
impl ObjectStore for DirStore {
    fn address(&self, key: &ObjectKey) -> String {
        self.root
            .join(key.as_str().trim_start_matches('/'))
            .display()
            .to_string()
    }

    fn list(&self, prefix: &str) -> BoxStream<'static, Result<Vec<ObjectMeta>, StoreError>> {
        let (pages, receiver) = mpsc::channel(PAGES_AHEAD);
        let (root, prefix) = (self.root.clone(), prefix.to_owned());
        spawn_blocking(move || walk(&root, &prefix, &pages));
        stream::unfold(receiver, async |mut receiver| {
            receiver.recv().await.map(|page| (page, receiver))
        })
        .boxed()
    }

    async fn head(&self, key: &ObjectKey) -> Result<ObjectMeta, StoreError> {
        let object = key.clone();
        self.blocking(key, move |path| {
            let metadata = fs::metadata(path).map_err(|source| io_error(path, source))?;
            describe(object, path, &metadata)
        })
        .await
    }

    async fn get_range(&self, meta: &ObjectMeta, range: Range<u64>) -> Result<Bytes, StoreError> {
        let expected = meta.clone();
        self.blocking(&meta.key, move |path| {
            let read = || -> io::Result<(Metadata, Vec<u8>)> {
                let file = File::open(path)?;
                let metadata = file.metadata()?;
                let mut content = vec![0; (range.end - range.start) as usize];
                file.read_exact_at(&mut content, range.start)?;
                Ok((metadata, content))
            };
            let changed = || StoreError::Changed {
                object: path.display().to_string(),
            };
            let (metadata, content) = read().map_err(|source| match source.kind() {
                io::ErrorKind::UnexpectedEof => changed(),
                _ => io_error(path, source),
            })?;
            if !describe(expected.key.clone(), path, &metadata)?.is_same_version(&expected) {
                return Err(changed());
            }
            Ok(content.into())
        })
        .await
    }

    async fn put(&self, key: &ObjectKey, content: Bytes) -> Result<(), StoreError> {
        self.blocking(key, move |path| {
            put_atomic(path, &mut &content[..]).map_err(|source| io_error(path, source))
        })
        .await
    }

    async fn put_file(&self, key: &ObjectKey, file: &Path) -> Result<(), StoreError> {
        let file = file.to_path_buf();
        self.blocking(key, move |path| {
            let mut content = File::open(&file).map_err(|source| io_error(&file, source))?;
            put_atomic(path, &mut content).map_err(|source| io_error(path, source))
        })
        .await
    }

    async fn delete(&self, key: &ObjectKey) -> Result<(), StoreError> {
        self.blocking(key, |path| match fs::remove_file(path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(io_error(path, source)),
            _ => Ok(()),
        })
        .await
    }
}

fn put_atomic(path: &Path, content: &mut dyn Read) -> io::Result<()> {
    let directory = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(directory)?;
    let mut partial = tempfile::Builder::new()
        .prefix(".")
        .suffix(PARTIAL_SUFFIX)
        .permissions(fs::Permissions::from_mode(FILE_MODE))
        .tempfile_in(directory)?;
    io::copy(content, &mut partial)?;
    partial.flush()?;
    partial.as_file().sync_all()?;
    partial.persist(path).map_err(|error| error.error)?;
    File::open(directory)?.sync_all()
}

/// Sends the objects below `root` whose keys begin with `prefix`, in key order, until the reader leaves.
fn walk(root: &Path, prefix: &str, pages: &mpsc::Sender<Result<Vec<ObjectMeta>, StoreError>>) {
    let mut page = Vec::new();
    for object in objects(root, prefix) {
        let failed = object.is_err();
        match object {
            Ok(object) => page.push(object),
            Err(error) => {
                let _reader_left = pages.blocking_send(Err(error));
            }
        }
        if failed
            || page.len() == PAGE_OBJECTS
                && pages.blocking_send(Ok(std::mem::take(&mut page))).is_err()
        {
            return;
        }
    }
    if !page.is_empty() {
        let _reader_left = pages.blocking_send(Ok(page));
    }
}

fn objects(root: &Path, prefix: &str) -> impl Iterator<Item = Result<ObjectMeta, StoreError>> {
    let walk = WalkDir::new(root)
        .min_depth(1)
        .follow_links(true)
        // By the bytes of the keys: what a directory holds sorts as if its name ended in a slash.
        .sort_by(|a, b| sort_key(a).cmp(&sort_key(b)));
    let may_hold = prefix.to_owned();
    let below = root.to_path_buf();
    let entries = walk.into_iter().filter_entry(move |entry| {
        let name = entry.path().strip_prefix(&below).unwrap_or(entry.path());
        let key = name.to_string_lossy();
        key.starts_with(&may_hold) || entry.file_type().is_dir() && may_hold.starts_with(&*key)
    });
    let (root, prefix) = (root.to_path_buf(), prefix.to_owned());
    entries.filter_map(move |entry| {
        let entry = match entry {
            Ok(entry) if entry.file_type().is_dir() => return None,
            Ok(entry) => entry,
            Err(error) => return walk_error(&root, error).map(Err),
        };
        let name = entry.path().strip_prefix(&root).unwrap_or(entry.path());
        let Some(key) = name.to_str() else {
            return Some(Err(unusable(
                entry.path(),
                "the name is not UTF-8; rename the file",
            )));
        };
        if !key.starts_with(&prefix) || is_partial(&entry.file_name().to_string_lossy()) {
            return None;
        }
        let listed = || {
            let metadata = fs::metadata(entry.path());
            let metadata = metadata.map_err(|source| io_error(entry.path(), source))?;
            describe(ObjectKey::new(key)?, entry.path(), &metadata)
        };
        match listed() {
            // Removed since the directory was read.
            Err(StoreError::NotFound { .. }) => None,
            listed => Some(listed),
        }
    })
}

fn sort_key(entry: &walkdir::DirEntry) -> Vec<u8> {
    let mut key = entry.file_name().as_encoded_bytes().to_vec();
    if entry.file_type().is_dir() {
        key.push(b'/');
    }
    key
}

/// An unfinished walk; `None` for what is no object: nothing there at all, a dangling link, a link back.
fn walk_error(root: &Path, error: walkdir::Error) -> Option<StoreError> {
    if error.loop_ancestor().is_some() {
        return None;
    }
    let path = error.path().unwrap_or(root).to_path_buf();
    match error.into_io_error() {
        Some(source) if source.kind() == io::ErrorKind::NotFound => None,
        Some(source) => Some(io_error(&path, source)),
        None => Some(unusable(&path, "cannot be walked")),
    }
}

fn describe(key: ObjectKey, path: &Path, metadata: &Metadata) -> Result<ObjectMeta, StoreError> {
    if !metadata.is_file() {
        return Err(StoreError::NotFound {
            object: path.display().to_string(),
        });
    }
    let modified_ns = modified_ns(metadata).map_err(|source| io_error(path, source))?;
    Ok(ObjectMeta {
        key,
        bytes: metadata.len(),
        // The inode tells apart two puts within one tick of the file system's clock.
        etag: Some(format!(
            "{modified_ns}-{}-{}",
            metadata.len(),
            metadata.ino()
        )),
        modified_s: i64::try_from(modified_ns.div_euclid(1_000_000_000)).ok(),
    })
}

fn io_error(path: &Path, source: io::Error) -> StoreError {
    let object = path.display().to_string();
    match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => StoreError::NotFound { object },
        io::ErrorKind::PermissionDenied => StoreError::Denied {
            object,
            source: source.into(),
        },
        _ => StoreError::Unusable {
            object,
            source: source.into(),
        },
    }
}

fn unusable(path: &Path, why: &str) -> StoreError {
    StoreError::Unusable {
        object: path.display().to_string(),
        source: why.into(),
    }
}
