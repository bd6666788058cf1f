//! From what was typed to the frozen list: directories, globs, single videos and lists.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use plumbline_common::id::VideoId;
use plumbline_common::message::Location;
use serde_json::Map;

use super::files::{
    Found, VIDEO_EXTENSIONS, absolute, common_parent, expand_glob, relative_name, stat, walk,
};
use super::objects::{
    self, Address, Buckets, Looked, ObjectLine, ObjectLocationAndSize, OpenStores,
};
use super::{CorpusError, Entry, GroupBy, Ignored, camera, list};

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
pub fn freeze(
    sources: &[String],
    group_by: Option<&GroupBy>,
    out: &Path,
) -> Result<Listing, CorpusError> {
    let mut freezing = Freezing::without(out);
    for source in sources {
        if source.contains("://") {
            return Err(CorpusError::ObjectStore {
                source_text: source.clone(),
            });
        }
        freezing.look_at_files(source)?;
    }
    if let Some(line) = freezing.object_lines.first() {
        return Err(CorpusError::ObjectStore {
            source_text: line.address.to_string(),
        });
    }
    freezing.finish(sources, group_by)
}

/// Freezes what the sources name, files and objects. `out`, a directory or an `s3://` address, is left
/// out of every walk and listing.
///
/// # Errors
/// [`CorpusError`]: what makes the list wrong, before any work.
pub async fn freeze_anywhere(
    sources: &[String],
    group_by: Option<&GroupBy>,
    out: &str,
    buckets: &dyn Buckets,
) -> Result<Listing, CorpusError> {
    let mut freezing = Freezing::without(Path::new(out));
    let mut stores = OpenStores::of(buckets);
    for source in sources {
        match (Address::parse(source), source.contains("://")) {
            (Some(address), _) => match objects::look(&address, out, &mut stores).await? {
                Looked::Objects(below) => {
                    for (extension, count) in below.ignored {
                        *freezing.ignored.entry(extension).or_default() += count;
                    }
                    freezing.listed.push((below.root, below.objects));
                }
                Looked::Lines(lines) => freezing.object_lines.extend(lines),
            },
            (None, true) => {
                return Err(CorpusError::UnknownStore {
                    source_text: source.clone(),
                });
            }
            (None, false) => freezing.look_at_files(source)?,
        }
    }
    let lines = std::mem::take(&mut freezing.object_lines);
    for (line, entry) in objects::look_up(lines, &mut stores).await? {
        freezing.add_line(&line.list, entry)?;
    }
    freezing.finish(sources, group_by)
}

/// What was found so far.
struct Freezing {
    out: Option<PathBuf>,
    ignored: Ignored,
    /// Files found in walks, and the directories walked.
    walked: Vec<(PathBuf, Vec<Found>)>,
    /// Objects found in listings, and the addresses listed.
    listed: Vec<(Address, Vec<ObjectLocationAndSize>)>,
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
            named: BTreeMap::new(),
            object_lines: Vec::new(),
        }
    }

    fn look_at_files(&mut self, source: &str) -> Result<(), CorpusError> {
        let path = Path::new(source);
        let out = self.out.as_deref();
        if path.is_dir() {
            let root = absolute(path);
            let found = walk(&root, out, &mut self.ignored)?;
            self.walked.push((root, found));
        } else if path.is_file() && list::is_list(path) {
            self.add_list(&absolute(path))?;
        } else if path.symlink_metadata().is_ok() {
            let file = absolute(path);
            let root = file.parent().map(Path::to_path_buf).unwrap_or_default();
            self.walked.push((
                root,
                vec![Found {
                    path: file,
                    is_sequence: false,
                }],
            ));
        } else if source.contains(['*', '?', '[']) {
            self.walked.push(expand_glob(source, out)?);
        } else {
            return Err(CorpusError::NoSuchSource {
                source_text: source.to_owned(),
            });
        }
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
                path: file,
                is_sequence,
            };
            let name = list::name_of(&line.video);
            let video = VideoId::new(name).map_err(|error| list_error(&list, error.to_string()))?;
            self.add_line(&list, stat(video, found, line.carried))?;
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

    fn finish(
        mut self,
        sources: &[String],
        group_by: Option<&GroupBy>,
    ) -> Result<Listing, CorpusError> {
        let root = common_parent(self.walked.iter().map(|(root, _)| root.as_path()));
        for found in self.walked.into_iter().flat_map(|(_, found)| found) {
            let name = relative_name(&found.path, &root);
            let video = VideoId::new(name).map_err(|error| {
                list_error(&found.path.display().to_string(), error.to_string())
            })?;
            add(&mut self.named, stat(video, found, Map::new()))?;
        }
        let root = objects::common_parent(self.listed.iter().map(|(root, _)| root));
        for object in self.listed.into_iter().flat_map(|(_, objects)| objects) {
            add(&mut self.named, object.into_entry(&root)?)?;
        }
        if self.named.is_empty() {
            return Err(empty(sources));
        }
        let mut entries: Vec<Entry> = self.named.into_values().collect();
        if let Some(rule) = group_by {
            for entry in &mut entries {
                entry.group = rule.group(&entry.video, &entry.carried)?;
            }
        }
        Ok(Listing {
            entries,
            ignored: self.ignored,
        })
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
    let (path, is_sequence) = match &entry.location {
        Location::File(path) => (path, false),
        Location::ImageSequence(path) => (path, true),
        Location::Object(_) => return entry.clone(),
    };
    let found = Found {
        path: OsStr::from_bytes(path).into(),
        is_sequence,
    };
    Entry {
        group: entry.group.clone(),
        ..stat(entry.video.clone(), found, entry.carried.clone())
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
        freeze(&sources, None, out)
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
