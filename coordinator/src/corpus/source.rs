//! From what was typed to the frozen list: directories, globs, single videos and lists.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use plumbline_common::id::VideoId;
use plumbline_common::message::{Location, PartLocation, Whole};
use serde_json::Value;

use super::dataset::{self, CAMERA, DirTree, Marks, place_file};
use super::files::{
    Found, VIDEO_EXTENSIONS, Walked, absolute, common_parent, expand_glob, ignore, relative_name,
    stat, walk,
};
use super::objects::{self, Address, Buckets, FoundObject, Looked, ObjectLine, OpenStores};
use super::pattern::expanded;
use super::{CorpusError, Entry, GroupBy, Ignored, camera, list};

/// A frozen corpus and what was passed over on the way.
#[derive(Debug)]
pub struct Listing {
    /// The videos, sorted by name.
    pub entries: Vec<Entry>,
    /// Files passed over, by extension.
    pub ignored: Ignored,
}

/// What is asked of a corpus beside its sources.
#[derive(Debug, Clone, Default)]
pub struct Choice {
    /// How videos are grouped.
    pub group_by: Option<GroupBy>,
    /// The cameras whose videos are taken (the column `camera`); all where none is named.
    pub cameras: Vec<String>,
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
    for source in all_expanded(sources)? {
        match (Address::parse(&source), source.contains("://")) {
            (Some(address), _) => match objects::look(&address, out, &mut stores).await? {
                Looked::Objects(below) => {
                    for (extension, count) in below.ignored {
                        *freezing.ignored.entry(extension).or_default() += count;
                    }
                    freezing.lerobot.extend(below.lerobot);
                    freezing.listed.push((below.root, below.objects));
                }
                Looked::Lines(lines) => freezing.object_lines.extend(lines),
            },
            (None, true) => {
                return Err(CorpusError::UnknownStore {
                    source_text: source,
                });
            }
            (None, false) => freezing.look_at_files(&source)?,
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
    lerobot: Vec<String>,
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
            lerobot: Vec::new(),
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
            self.lerobot
                .push(root.join(directory).display().to_string());
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
        camera::intrinsics(&entry.carried)
            .map_err(|reason| list_error(list, format!("{name}: {reason}")))?;
        add(&mut self.named, entry)
    }

    fn finish(mut self, sources: &[String], choice: &Choice) -> Result<Listing, CorpusError> {
        if let [first, second, ..] = &self.lerobot[..] {
            return Err(CorpusError::SeveralDatasets {
                first: first.clone(),
                second: second.clone(),
            });
        }
        let root = common_parent(self.walked.iter().map(|(root, _)| root.as_path()));
        for found in self.walked.into_iter().flat_map(|(_, found)| found) {
            let name = relative_name(&found.path, &root);
            let video = VideoId::new(name).map_err(|error| {
                list_error(&found.path.display().to_string(), error.to_string())
            })?;
            add(&mut self.named, stat(video, found))?;
        }
        let root = objects::common_parent(self.listed.iter().map(|(root, _)| root));
        for object in self.listed.into_iter().flat_map(|(_, objects)| objects) {
            add(&mut self.named, object.into_entry(&root)?)?;
        }
        if self.named.is_empty() {
            return Err(empty(sources));
        }
        let mut entries: Vec<Entry> = self.named.into_values().collect();
        choose_cameras(&mut entries, &choice.cameras)?;
        if let Some(rule) = &choice.group_by {
            group(&mut entries, rule)?;
        }
        Ok(Listing {
            entries,
            ignored: self.ignored,
        })
    }
}

/// Leaves the videos of the named cameras, each of which must be there.
fn choose_cameras(entries: &mut Vec<Entry>, cameras: &[String]) -> Result<(), CorpusError> {
    if cameras.is_empty() {
        return Ok(());
    }
    let camera = |entry: &Entry| {
        entry
            .carried
            .get(CAMERA)
            .and_then(Value::as_str)
            .map(str::to_owned)
    };
    let known: BTreeSet<String> = entries.iter().filter_map(camera).collect();
    if let Some(unknown) = cameras.iter().find(|&camera| !known.contains(camera)) {
        return Err(CorpusError::UnknownCamera {
            camera: unknown.clone(),
            known: match known.is_empty() {
                true => "no column camera (LeRobot datasets do, and lists may)".to_owned(),
                false => Vec::from_iter(known).join(", "),
            },
        });
    }
    entries.retain(|entry| camera(entry).is_some_and(|camera| cameras.contains(&camera)));
    Ok(())
}

/// Groups by a rule. Videos from elsewhere than a list's or dataset's columns have no group; a column that no
/// video has is an error.
fn group(entries: &mut [Entry], rule: &GroupBy) -> Result<(), CorpusError> {
    let mut unknown = None;
    let mut any = false;
    for entry in entries {
        match rule.group(&entry.video, &entry.carried) {
            Ok(group) => {
                any = true;
                entry.group = group;
            }
            Err(error) => unknown = unknown.or(Some(error)),
        }
    }
    match unknown {
        Some(error) if !any => Err(error),
        _ => Ok(()),
    }
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
mod tests {
    use super::*;
    use std::fs;

    fn names(listing: &Listing) -> Vec<&str> {
        listing
            .entries
            .iter()
            .map(|entry| entry.video.as_str())
            .collect()
    }

    fn touch(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, b"x").unwrap();
    }

    fn freeze_all(sources: &[&Path], out: &Path) -> Result<Listing, CorpusError> {
        let sources: Vec<String> = sources
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        freeze(&sources, &Choice::default(), out)
    }

    #[test]
    fn a_directory_is_walked_sorted_and_without_out_or_hidden_files() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        for name in [
            "b.mp4",
            "a/c d.MOV",
            "a/.hidden.mp4",
            "out/x.mp4",
            "notes.txt",
            "a/ü\n.webm",
            "-x.gif",
        ] {
            touch(&root.join(name));
        }
        let listing = freeze_all(&[root], &root.join("out")).unwrap();
        assert_eq!(
            names(&listing),
            ["-x.gif", "a/c d.MOV", "a/ü\n.webm", "b.mp4"]
        );
        assert_eq!(listing.ignored, BTreeMap::from([("txt".to_owned(), 1)]));
    }

    #[test]
    fn names_that_are_not_utf8_are_percent_encoded() {
        let dir = tempfile::tempdir().unwrap();
        touch(&dir.path().join(OsStr::from_bytes(b"a\xff.mp4")));
        let listing = freeze_all(&[dir.path()], Path::new("out")).unwrap();
        assert_eq!(names(&listing), ["a%FF.mp4"]);
    }

    #[test]
    fn several_sources_share_their_parent_and_overlaps_count_once() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["real/a.mp4", "generated/a.mp4"] {
            touch(&dir.path().join(name));
        }
        let (real, generated) = (dir.path().join("real"), dir.path().join("generated"));
        let listing =
            freeze_all(&[&real, &generated, &real.join("a.mp4")], Path::new("out")).unwrap();
        assert_eq!(names(&listing), ["generated/a.mp4", "real/a.mp4"]);
    }

    #[test]
    fn globs_take_what_they_match() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["x/a.mp4", "x/b.mp4", "y/c.bin"] {
            touch(&dir.path().join(name));
        }
        let listing = freeze_all(&[&dir.path().join("*/[ac].*")], Path::new("out")).unwrap();
        assert_eq!(names(&listing), ["x/a.mp4", "y/c.bin"]);
    }

    #[test]
    fn a_list_keeps_missing_videos_as_rows_and_refuses_duplicates() {
        let dir = tempfile::tempdir().unwrap();
        touch(&dir.path().join("a.mp4"));
        let list = dir.path().join("list.txt");
        fs::write(&list, "./a.mp4\nmissing.mp4\n").unwrap();
        let listing = freeze_all(&[&list], Path::new("out")).unwrap();
        assert_eq!(names(&listing), ["a.mp4", "missing.mp4"]);
        assert!(listing.entries[0].problem.is_none());
        assert!(listing.entries[1].problem.is_some());
        fs::write(&list, "a.mp4\n./a.mp4\n").unwrap();
        assert!(
            freeze_all(&[&list], Path::new("out"))
                .unwrap_err()
                .to_string()
                .contains("twice")
        );
    }

    #[test]
    fn nothing_there_is_an_error_that_names_it() {
        let dir = tempfile::tempdir().unwrap();
        let empty = freeze_all(&[dir.path()], Path::new("out")).unwrap_err();
        assert!(matches!(empty, CorpusError::Empty { .. }));
        let missing = freeze_all(&[&dir.path().join("nope")], Path::new("out")).unwrap_err();
        assert!(missing.to_string().contains("nope"), "{missing}");
    }
}
