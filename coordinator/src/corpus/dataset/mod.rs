//! Datasets as trainers keep them: which files below a source are one, and the videos in them.
//!
//! - LeRobot ([`lerobot`]): a directory with `meta/info.json` that states a `codebase_version`.
//! - WebDataset ([`webdataset`]): every `*.tar`, a shard.
//! - Hugging Face video folders ([`folder`]): `metadata.{csv,jsonl,parquet}` with a column of file names.
//!
//! Each is read through a [`Tree`], so that it is the same in a directory and below a prefix of an object store.
//! What is wrong with one video becomes its row; what leaves open which videos there are is an error, or, of
//! one shard among many, a row of the shard's own.

mod folder;
mod lerobot;
#[cfg(test)]
mod tests;
mod tree;
mod webdataset;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use plumbline_common::id::VideoId;
use plumbline_common::message::{Location, Part, PartLocation, Whole};
use serde_json::{Map, Value};

use super::{CorpusError, Entry};
pub(super) use lerobot::CAMERA;
pub(super) use tree::{DirTree, ObjectTree, Tree, place_file, place_missing, place_object};

/// Where a video is, as it was found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placed {
    pub(super) location: Location,
    /// Size and time of the file (of all of it, where the video is a part).
    pub(super) bytes: Option<u64>,
    pub(super) modified_ns: Option<i128>,
    /// Why those are not known.
    pub(super) problem: Option<String>,
}

impl Placed {
    /// A part of what is placed so; an image sequence has none.
    pub(super) fn part(self, part: Part) -> Self {
        let whole = match self.location {
            Location::File(path) => Whole::File(path),
            Location::Object(object) => Whole::Object(object),
            Location::ImageSequence(_) | Location::Part(_) => return self,
        };
        Self {
            location: Location::Part(PartLocation { whole, part }),
            ..self
        }
    }

    /// The entry of a video that lies there.
    pub(super) fn into_entry(self, video: VideoId, carried: Map<String, Value>) -> Entry {
        Entry {
            video,
            location: self.location,
            bytes: self.bytes,
            modified_ns: self.modified_ns,
            problem: self.problem,
            group: None,
            carried,
        }
    }

    fn with_problem(self, problem: String) -> Self {
        Self {
            bytes: None,
            modified_ns: None,
            problem: Some(problem),
            ..self
        }
    }
}

/// A video of a dataset.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sample {
    /// Below the tree's root, with `/` between parts.
    pub(super) name: String,
    pub(super) placed: Placed,
    pub(super) carried: Map<String, Value>,
}

/// Files below a root that may be of a dataset, found by their names; each below the root.
#[derive(Debug, Default)]
pub(super) struct Marks {
    infos: Vec<String>,
    metadata: Vec<String>,
    shards: Vec<String>,
}

impl Marks {
    /// Takes note of a file, if its name says something.
    pub(super) fn note(&mut self, file: &str) -> bool {
        let of_its_kind = if file == lerobot::INFO || file.ends_with("/meta/info.json") {
            &mut self.infos
        } else if folder::is_metadata(file) {
            &mut self.metadata
        } else if is_shard(Path::new(file)) {
            &mut self.shards
        } else {
            return false;
        };
        of_its_kind.push(file.to_owned());
        true
    }

    pub(super) fn is_empty(&self) -> bool {
        self.infos.is_empty() && self.metadata.is_empty() && self.shards.is_empty()
    }
}

/// What datasets hold.
#[derive(Debug, Default)]
pub(super) struct Datasets {
    /// Their videos.
    pub(super) samples: Vec<Sample>,
    /// Directories (with a slash at the end, or empty) that are LeRobot datasets.
    pub(super) whole: Vec<String>,
    /// Files that samples or datasets are of.
    used: BTreeSet<String>,
}

impl Datasets {
    /// Whether the file is of a dataset, and so no video by itself.
    pub(super) fn owns(&self, file: &str) -> bool {
        self.is_within(file) || self.used.contains(file)
    }

    fn is_within(&self, file: &str) -> bool {
        self.whole
            .iter()
            .any(|directory| file.starts_with(directory))
    }
}

/// Reads the datasets that the marks are of.
///
/// # Errors
/// [`CorpusError`]: what leaves open which videos there are.
pub(super) fn read(tree: &dyn Tree, marks: &Marks) -> Result<Datasets, CorpusError> {
    let mut found = Datasets::default();
    for info in &marks.infos {
        if let Some(samples) = lerobot::read(tree, info)? {
            let directory = info.strip_suffix(lerobot::INFO).unwrap_or_default();
            found.whole.push(directory.to_owned());
            found.samples.extend(samples);
        }
    }
    let outside = |files: &[String]| -> Vec<String> {
        let outside = files.iter().filter(|file| !found.is_within(file));
        outside.cloned().collect()
    };
    let (mut metadata, shards) = (outside(&marks.metadata), outside(&marks.shards));
    // The nearest to a file counts: it is read last.
    metadata.sort_by_key(|file| file.matches('/').count());
    let mut columns = BTreeMap::new();
    for file in metadata {
        if let Some(of_folder) = folder::read(tree, &file)? {
            columns.extend(of_folder);
            found.used.insert(file);
        }
    }
    for (file, carried) in columns {
        found.samples.push(Sample {
            placed: tree.place(&file)?,
            name: file.clone(),
            carried,
        });
        found.used.insert(file);
    }
    for (file, samples) in webdataset::read(tree, &shards)? {
        if !samples.is_empty() {
            found.used.insert(file);
        }
        found.samples.extend(samples);
    }
    Ok(found)
}

/// Names a sample's shard below the whole run's root, of which `directory` is the source's own.
pub(super) fn name_shard(directory: &str, carried: &mut Map<String, Value>) {
    if let Some(Value::String(shard)) = carried.get_mut(webdataset::SHARD)
        && !directory.is_empty()
    {
        shard.insert_str(0, &format!("{directory}/"));
    }
}

/// Whether a file is named like a shard.
pub(super) fn is_shard(path: &Path) -> bool {
    ends_with(path, &[".tar"])
}

/// Whether a file is named like a shard that is compressed as a whole, which leaves no way to its members but
/// through all before them.
pub(super) fn is_compressed_shard(path: &Path) -> bool {
    const ENDINGS: [&str; 7] = [
        ".tar.gz", ".tgz", ".tar.zst", ".tar.bz2", ".tar.xz", ".tar.lz4", ".tar.z",
    ];
    ends_with(path, &ENDINGS)
}

fn ends_with(path: &Path, endings: &[&str]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.to_ascii_lowercase();
    endings.iter().any(|ending| name.ends_with(ending))
}

/// A name in a dataset's own metadata, below `directory` (with a slash at its end, or empty); `None` for one
/// that leads out of it.
fn below(directory: &str, name: &str) -> Option<String> {
    let parts = name.split('/').filter(|part| !matches!(*part, "" | "."));
    let leads_out =
        name.starts_with('/') || name.contains('\\') || name.split('/').any(|part| part == "..");
    let name = parts.collect::<Vec<_>>().join("/");
    (!leads_out && !name.is_empty()).then(|| format!("{directory}{name}"))
}
