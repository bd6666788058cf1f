//! From what was typed to the frozen list: directories, globs, single videos and lists.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use plumbline_common::id::VideoId;
use plumbline_common::message::{Location, PartLocation, Whole};

use super::choice::Choice;
use super::dataset::{self, DirTree, Marks, place_file};
use super::files::{
    Found, VIDEO_EXTENSIONS, Walked, absolute, common_parent, expand_glob, ignore, relative_name,
    stat, text_of, walk,
};
use super::objects::{self, Address, Buckets, FoundObject, Looked, ObjectLine, OpenStores};
use super::pattern::expanded;
use super::{CorpusError, Entry, Ignored, camera, list};

/// A frozen corpus and what was passed over on the way.
#[derive(Debug)]
pub struct Listing {
    /// The videos, sorted by name.
    pub entries: Vec<Entry>,
    /// Files passed over, by extension.
    pub ignored: Ignored,
}

/// Freezes what the sources name, files alone. `out` is left out of every walk.
///
/// # Errors
/// [`CorpusError`]: what makes the list wrong, before any work; `ObjectStore` for a source or a listed
/// video in an object store (see [`freeze_anywhere`]).
pub fn freeze(sources: &[String], choice: &Choice, out: &Path) -> Result<Listing, CorpusError> {
    let mut freezing = Freezing::without(out);
    for source in all_expanded(sources)? {
        if source.contains("://") {
            return Err(CorpusError::ObjectStore {
                source_text: source,
            });
        }
        freezing.look_at_files(&source)?;
    }
    if let Some(line) = freezing.object_lines.first() {
        return Err(CorpusError::ObjectStore {
            source_text: line.address.to_string(),
        });
    }
    freezing.finish(sources, choice)
}

fn all_expanded(sources: &[String]) -> Result<Vec<String>, CorpusError> {
    let expanded: Result<Vec<_>, _> = sources.iter().map(|source| expanded(source)).collect();
    Ok(expanded?.concat())
}

/// Freezes what the sources name, files and objects. `out`, a directory or an `s3://` address, is left
/// out of every walk and listing.
///
/// # Errors
/// [`CorpusError`]: what makes the list wrong, before any work.
pub async fn freeze_anywhere(
    sources: &[String],
    choice: &Choice,
    out: &str,
    buckets: &dyn Buckets,
) -> Result<Listing, CorpusError> {
    let mut freezing = Freezing::without(Path::new(out));
    let mut stores = OpenStores::of(buckets);
    let mut addresses = Vec::new();
    for source in all_expanded(sources)? {
        match (Address::parse(&source), source.contains("://")) {
            (Some(address), _) => addresses.push(address),
            (None, true) => {
                return Err(CorpusError::UnknownStore {
                    source_text: source,
                });
            }
            (None, false) => freezing.look_at_files(&source)?,
        }
    }
    for looked in objects::look_at_all(addresses, out, &mut stores).await? {
        match looked {
            Looked::Objects(below) => {
                for (extension, count) in below.ignored {
                    *freezing.ignored.entry(extension).or_default() += count;
                }
                freezing.lerobot.extend(below.lerobot);
                freezing.listed.push((below.root, below.objects));
            }
            Looked::Lines(lines) => freezing.object_lines.extend(lines),
        }
    }
    let lines = std::mem::take(&mut freezing.object_lines);
    for (line, entry) in objects::look_up(lines, &mut stores).await? {
        freezing.add_line(&line.list, entry)?;
    }
    freezing.finish(sources, choice)
}

/// What was found so far.
struct Freezing {
    out: Option<PathBuf>,
    ignored: Ignored,
    /// Files found in walks, and the directories walked.
    walked: Vec<(PathBuf, Vec<Found>)>,
    /// Objects found in listings, and the addresses listed.
    listed: Vec<(Address, Vec<FoundObject>)>,
    /// The LeRobot datasets among all of them.
    lerobot: BTreeSet<String>,
    /// What lists name has its name already...
    named: BTreeMap<VideoId, Entry>,
    /// ...but objects were not looked up yet.
    object_lines: Vec<ObjectLine>,
}

impl Freezing {
    fn without(out: &Path) -> Self {
        Self {
            out: std::fs::canonicalize(out).ok(),
            ignored: Ignored::new(),
            walked: Vec::new(),
            listed: Vec::new(),
            lerobot: BTreeSet::new(),
            named: BTreeMap::new(),
            object_lines: Vec::new(),
        }
    }

    fn look_at_files(&mut self, source: &str) -> Result<(), CorpusError> {
        let path = Path::new(source);
        let out = self.out.as_deref();
        if path.is_dir() {
            let root = absolute(path);
            let Walked { found, others } = walk(&root, out)?;
            self.take_walked(root, found, others)?;
        } else if path.is_file() && list::is_list(path) {
            self.add_list(&absolute(path))?;
        } else if path.symlink_metadata().is_ok() {
            if dataset::is_compressed_shard(path) {
                return Err(CorpusError::Compressed {
                    shard: source.to_owned(),
                });
            }
            let file = absolute(path);
            let root = file.parent().map(Path::to_path_buf).unwrap_or_default();
            self.take_named(root, vec![Found::at(file, false)])?;
        } else if source.contains(['*', '?', '[', '{']) {
            let (root, found) = expand_glob(source, out)?;
            self.take_named(root, found)?;
        } else {
            return Err(CorpusError::NoSuchSource {
                source_text: source.to_owned(),
            });
        }
        Ok(())
    }

    /// Takes files that were named, whatever their extension; shards among them are opened.
    fn take_named(&mut self, root: PathBuf, found: Vec<Found>) -> Result<(), CorpusError> {
        let is_shard = |found: &Found| !found.is_sequence && dataset::is_shard(&found.path);
        let (shards, videos): (Vec<_>, Vec<_>) = found.into_iter().partition(is_shard);
        let shards = shards.into_iter().map(|found| found.path).collect();
        self.take_walked(root, videos, shards)
    }

    /// Takes videos, and those of the datasets that `others` are of.
    fn take_walked(
        &mut self,
        root: PathBuf,
        mut found: Vec<Found>,
        others: Vec<PathBuf>,
    ) -> Result<(), CorpusError> {
        // A dataset's files have names in UTF-8.
        let name = |path: &Path| path.strip_prefix(&root).ok()?.to_str().map(str::to_owned);
        let mut marks = Marks::default();
        for other in &others {
            if let Some(name) = name(other) {
                marks.note(&name);
            }
        }
        let datasets = dataset::read(&DirTree { root: &root }, &marks)?;
        let owned = |path: &Path| name(path).is_some_and(|name| datasets.owns(&name));
        for other in others.iter().filter(|other| !owned(other)) {
            ignore(&mut self.ignored, other);
        }
        found.retain(|found| !owned(&found.path));
        for directory in &datasets.whole {
            let dataset = root.join(directory);
            self.lerobot.insert(dataset.display().to_string());
        }
        found.extend(datasets.samples.into_iter().map(|sample| Found {
            path: root.join(sample.name),
            is_sequence: false,
            carried: sample.carried,
            placed: Some(sample.placed),
        }));
        self.walked.push((root, found));
        Ok(())
    }

    fn add_list(&mut self, path: &Path) -> Result<(), CorpusError> {
        let directory = path.parent().unwrap_or(Path::new("."));
        let list = path.display().to_string();
        for line in list::read(path)? {
            if let Some(address) = Address::parse(&line.video) {
                self.object_lines.push(ObjectLine {
                    list: list.clone(),
                    name: line.video,
                    address,
                    carried: line.carried,
                });
                continue;
            }
            if line.video.contains("://") {
                return Err(CorpusError::UnknownStore {
                    source_text: line.video,
                });
            }
            let file = directory.join(&line.video);
            let is_sequence = file.is_dir();
            let found = Found {
                carried: line.carried,
                ..Found::at(file, is_sequence)
            };
            let name = list::name_of(&line.video);
            let video = VideoId::new(name).map_err(|error| list_error(&list, error.to_string()))?;
            self.add_line(&list, stat(video, found))?;
        }
        Ok(())
    }

    /// A list names each video once and tells its camera rightly.
    fn add_line(&mut self, list: &str, entry: Entry) -> Result<(), CorpusError> {
        let name = &entry.video;
        if self.named.contains_key(name) {
            let reason = format!("{name} stands in the list twice: name each video once");
            return Err(list_error(list, reason));
        }
        check_camera(list, &entry)?;
        add(&mut self.named, entry)
    }

    fn finish(mut self, sources: &[String], choice: &Choice) -> Result<Listing, CorpusError> {
        let mut lerobot = self.lerobot.iter();
        if let (Some(first), Some(second)) = (lerobot.next(), lerobot.next()) {
            return Err(CorpusError::SeveralDatasets {
                first: first.clone(),
                second: second.clone(),
            });
        }
        let root = common_parent(self.walked.iter().map(|(root, _)| root.as_path()));
        for (own_root, found) in self.walked {
            let below = own_root.strip_prefix(&root).unwrap_or(&own_root);
            let below = text_of(below.as_os_str().as_bytes());
            for mut found in found {
                let name = relative_name(&found.path, &root);
                dataset::name_shard(&below, &mut found.carried);
                let video = VideoId::new(name).map_err(|error| {
                    list_error(&found.path.display().to_string(), error.to_string())
                })?;
                add_found(&mut self.named, stat(video, found))?;
            }
        }
        let root = objects::common_parent(self.listed.iter().map(|(root, _)| root));
        for (own_root, objects) in self.listed {
            let own_root = own_root.to_string();
            let below = own_root.strip_prefix(&root).unwrap_or(&own_root);
            for mut object in objects {
                dataset::name_shard(below.trim_end_matches('/'), &mut object.carried);
                add_found(&mut self.named, object.into_entry(&root)?)?;
            }
        }
        if self.named.is_empty() {
            return Err(empty(sources));
        }
        let mut entries: Vec<Entry> = self.named.into_values().collect();
        choice.apply(&mut entries)?;
        Ok(Listing {
            entries,
            ignored: self.ignored,
        })
    }
}

/// What the columns of a list, or dataset, at `place` tell of the camera must be right.
fn check_camera(place: &str, entry: &Entry) -> Result<(), CorpusError> {
    camera::intrinsics(&entry.carried)
        .map_err(|reason| list_error(place, format!("{}: {reason}", entry.video)))?;
    Ok(())
}

/// Adds what was found, whose columns are a dataset's.
fn add_found(named: &mut BTreeMap<VideoId, Entry>, entry: Entry) -> Result<(), CorpusError> {
    check_camera(&entry.address(), &entry)?;
    add(named, entry)
}

fn list_error(list: &str, reason: String) -> CorpusError {
    CorpusError::List {
        path: list.to_owned(),
        reason,
    }
}

/// What is said of sources without a video.
pub(crate) fn empty(sources: &[String]) -> CorpusError {
    CorpusError::Empty {
        sources: sources.join(", "),
        extensions: VIDEO_EXTENSIONS.join(", "),
    }
}

/// The entry as it is now; an object stays as it was listed, since reading it asks for that version.
pub(crate) fn looked_at_again(entry: &Entry) -> Entry {
    let path = |bytes: &[u8]| PathBuf::from(OsStr::from_bytes(bytes));
    let (found, part) = match &entry.location {
        Location::File(file) => (Found::at(path(file), false), None),
        Location::ImageSequence(directory) => (Found::at(path(directory), true), None),
        Location::Part(PartLocation {
            whole: Whole::File(file),
            part,
        }) => (Found::at(path(file), false), Some(*part)),
        Location::Object(_) | Location::Part(_) => return entry.clone(),
    };
    let placed = part.map(|part| place_file(&found.path).part(part));
    let found = Found {
        carried: entry.carried.clone(),
        placed,
        ..found
    };
    Entry {
        group: entry.group.clone(),
        ..stat(entry.video.clone(), found)
    }
}

fn add(named: &mut BTreeMap<VideoId, Entry>, entry: Entry) -> Result<(), CorpusError> {
    if let Some(earlier) = named.get(&entry.video) {
        if earlier.location == entry.location {
            return Ok(());
        }
        return Err(CorpusError::Duplicate {
            video: entry.video.to_string(),
            first: earlier.address(),
            second: entry.address(),
        });
    }
    named.insert(entry.video.clone(), entry);
    Ok(())
}

#[cfg(test)]
mod tests;
