//! The files below one root, a directory or a prefix of an object store, for whoever reads datasets in them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use plumbline_common::message::{Location, ObjectLocation};
use plumbline_common::store::{self, ObjectKey, ObjectMeta, ObjectStore, StoreError};
use tokio::runtime::Handle;

use super::Placed;
use crate::corpus::CorpusError;
use crate::corpus::files::size_and_time;

/// Largest file of metadata that is read, bytes: millions of rows.
const MAX_METADATA_BYTES: u64 = 1 << 30;

/// Bytes of an object read at once while headers are looked for: what costs one round trip anyway, and holds a
/// sample's small files with the header of the next.
const LOOK_BYTES: u64 = 64 << 10;

/// Bytes of a file read at once, likewise.
const LOOK_BYTES_OF_FILE: usize = 4 << 10;

/// What can be read at any place.
pub(in crate::corpus) trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

/// Files below a root, named with `/` between parts.
pub(in crate::corpus) trait Tree: Sync {
    /// The whole path or address of a file, for people.
    fn address(&self, file: &str) -> String;

    /// The content of a small file; `None` where there is none.
    ///
    /// # Errors
    /// [`CorpusError`], where it is there but does not read.
    fn read(&self, file: &str) -> Result<Option<Vec<u8>>, CorpusError>;

    /// The files below a directory, sorted.
    ///
    /// # Errors
    /// [`CorpusError`].
    fn files_below(&self, directory: &str) -> Result<Vec<String>, CorpusError>;

    /// Where a file is, or why nobody can tell.
    ///
    /// # Errors
    /// [`CorpusError`], of a store that does not answer.
    fn place(&self, file: &str) -> Result<Placed, CorpusError>;

    /// Opens a file in the version that [`Self::place`] tells. An error that holds a [`StoreError`] is the
    /// store's.
    ///
    /// # Errors
    /// As the system or the store said.
    fn open(&self, file: &str) -> io::Result<Box<dyn ReadSeek + '_>>;
}

/// A directory.
pub(in crate::corpus) struct DirTree<'a> {
    pub(in crate::corpus) root: &'a Path,
}

impl DirTree<'_> {
    fn path(&self, file: &str) -> PathBuf {
        self.root.join(file)
    }
}

impl Tree for DirTree<'_> {
    fn address(&self, file: &str) -> String {
        self.path(file).display().to_string()
    }

    fn read(&self, file: &str) -> Result<Option<Vec<u8>>, CorpusError> {
        let mut content = Vec::new();
        let read = File::open(self.path(file))
            .and_then(|opened| opened.take(MAX_METADATA_BYTES).read_to_end(&mut content));
        match read {
            Ok(_) => Ok(Some(content)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(CorpusError::List {
                path: self.address(file),
                reason: format!("{error}; mend it or leave it out"),
            }),
        }
    }

    fn files_below(&self, directory: &str) -> Result<Vec<String>, CorpusError> {
        let walk = walkdir::WalkDir::new(self.path(directory)).follow_links(true);
        let mut files = Vec::new();
        for entry in walk.sort_by_file_name() {
            let entry = match entry {
                Ok(entry) => entry,
                Err(error) if error.depth() == 0 => return Ok(files),
                Err(error) => {
                    return Err(CorpusError::Unlistable {
                        path: self.address(directory),
                        source: error.into(),
                    });
                }
            };
            let below = entry.path().strip_prefix(self.root).ok();
            if let Some(name) = below.and_then(Path::to_str)
                && !entry.file_type().is_dir()
            {
                files.push(name.to_owned());
            }
        }
        Ok(files)
    }

    fn place(&self, file: &str) -> Result<Placed, CorpusError> {
        Ok(place_file(&self.path(file)))
    }

    fn open(&self, file: &str) -> io::Result<Box<dyn ReadSeek + '_>> {
        let opened = File::open(self.path(file))?;
        Ok(Box::new(BufReader::with_capacity(
            LOOK_BYTES_OF_FILE,
            opened,
        )))
    }
}

/// A file as it is now.
pub(in crate::corpus) fn place_file(path: &Path) -> Placed {
    let location = Location::File(path.as_os_str().as_bytes().to_vec());
    match size_and_time(path) {
        Ok((bytes, modified_ns)) => Placed {
            location,
            bytes: Some(bytes),
            modified_ns: Some(modified_ns),
            problem: None,
        },
        Err(problem) => Placed {
            location,
            bytes: None,
            modified_ns: None,
            problem: Some(problem),
        },
    }
}

/// The objects below a prefix; asked from threads that may wait.
pub(in crate::corpus) struct ObjectTree {
    pub(in crate::corpus) store: Arc<dyn ObjectStore>,
    pub(in crate::corpus) bucket: String,
    /// With a slash at its end, or empty.
    pub(in crate::corpus) prefix: String,
    /// What was listed, by name below the prefix; others are looked up.
    pub(in crate::corpus) listed: BTreeMap<String, ObjectMeta>,
    pub(in crate::corpus) runtime: Handle,
}

impl ObjectTree {
    fn location(&self, file: &str) -> ObjectLocation {
        ObjectLocation {
            bucket: self.bucket.clone(),
            key: format!("{}{file}", self.prefix),
            etag: None,
            modified_s: None,
        }
    }

    fn meta(&self, file: &str) -> Result<ObjectMeta, StoreError> {
        if let Some(meta) = self.listed.get(file) {
            return Ok(meta.clone());
        }
        let key = ObjectKey::new(self.location(file).key)?;
        self.runtime.block_on(self.store.head(&key))
    }
}

impl Tree for ObjectTree {
    fn address(&self, file: &str) -> String {
        self.location(file).to_string()
    }

    fn read(&self, file: &str) -> Result<Option<Vec<u8>>, CorpusError> {
        let meta = match self.meta(file) {
            Ok(meta) => meta,
            Err(StoreError::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let fetching = store::fetch(&*self.store, &meta, MAX_METADATA_BYTES);
        Ok(Some(self.runtime.block_on(fetching)?))
    }

    fn files_below(&self, directory: &str) -> Result<Vec<String>, CorpusError> {
        let from = self.listed.range(directory.to_owned()..);
        let below = from.take_while(|(file, _)| file.starts_with(directory));
        Ok(below.map(|(file, _)| file.clone()).collect())
    }

    fn place(&self, file: &str) -> Result<Placed, CorpusError> {
        match self.meta(file) {
            Ok(meta) => Ok(place_object(&self.bucket, meta)),
            Err(error) => place_missing(self.location(file), error),
        }
    }

    fn open(&self, file: &str) -> io::Result<Box<dyn ReadSeek + '_>> {
        Ok(Box::new(ObjectReader {
            tree: self,
            meta: self.meta(file).map_err(io::Error::other)?,
            at: 0,
            buffer: Bytes::new(),
            buffer_at: 0,
        }))
    }
}

/// An object in the version that was listed.
pub(in crate::corpus) fn place_object(bucket: &str, meta: ObjectMeta) -> Placed {
    let modified_s = meta.modified_s.unwrap_or_default();
    Placed {
        bytes: Some(meta.bytes),
        modified_ns: Some(i128::from(modified_s) * 1_000_000_000),
        problem: None,
        location: Location::Object(ObjectLocation {
            bucket: bucket.to_owned(),
            key: meta.key.to_string(),
            etag: meta.etag,
            modified_s: meta.modified_s,
        }),
    }
}

/// An object that is not there, or may not be looked at; a store that does not answer is an error.
pub(in crate::corpus) fn place_missing(
    object: ObjectLocation,
    error: StoreError,
) -> Result<Placed, CorpusError> {
    let problem = match error {
        StoreError::NotFound { .. } => "there is no such object".to_owned(),
        error @ (StoreError::Denied { .. } | StoreError::Key(_)) => error.to_string(),
        error => return Err(error.into()),
    };
    Ok(Placed {
        location: Location::Object(object),
        bytes: None,
        modified_ns: None,
        problem: Some(problem),
    })
}

/// Reads an object by ranges, some bytes ahead.
struct ObjectReader<'a> {
    tree: &'a ObjectTree,
    meta: ObjectMeta,
    at: u64,
    buffer: Bytes,
    /// Where the buffer is in the object.
    buffer_at: u64,
}

impl Read for ObjectReader<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let buffered = self.buffer_at..self.buffer_at + self.buffer.len() as u64;
        if !buffered.contains(&self.at) {
            let end = self.meta.bytes.min(self.at.saturating_add(LOOK_BYTES));
            if self.at >= end || into.is_empty() {
                return Ok(0);
            }
            let getting = self.tree.store.get_range(&self.meta, self.at..end);
            self.buffer = self
                .tree
                .runtime
                .block_on(getting)
                .map_err(io::Error::other)?;
            self.buffer_at = self.at;
        }
        let start = (self.at - self.buffer_at) as usize;
        let rest = self.buffer.get(start..).unwrap_or_default();
        let count = rest.len().min(into.len());
        into[..count].copy_from_slice(&rest[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for ObjectReader<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.meta.bytes.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}
