//! From what was typed to the frozen list: directories, globs, single videos and lists.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use globset::GlobBuilder;
use plumbline_common::file_time::modified_ns;
use plumbline_common::id::VideoId;
use plumbline_common::message::Location;
use plumbline_worker::decode::{image_files, is_image_sequence};
use serde_json::{Map, Value};
use walkdir::{DirEntry, WalkDir};

use super::objects::{
    self, Address, Buckets, Looked, ObjectLine, ObjectLocationAndSize, OpenStores,
};
use super::{CorpusError, Entry, GroupBy, Ignored, camera, list};

/// File names that are taken for videos while walking; what a file really is, its bytes say later.
const VIDEO_EXTENSIONS: [&str; 7] = ["mp4", "m4v", "mov", "webm", "mkv", "avi", "gif"];

/// A frozen corpus and what was passed over on the way.
#[derive(Debug)]
pub struct Listing {
    /// The videos, sorted by name.
    pub entries: Vec<Entry>,
    /// Files passed over, by extension.
    pub ignored: Ignored,
}

/// A video found, before it has a name.
struct Found {
    path: PathBuf,
    is_sequence: bool,
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

fn absolute(path: &Path) -> PathBuf {
    std::fs::canonicalize(path)
        .or_else(|_| std::path::absolute(path))
        .unwrap_or_else(|_| path.to_path_buf())
}

pub(super) fn is_video_name(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(OsStr::to_str)
        .map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| VIDEO_EXTENSIONS.contains(&extension.as_str()))
}

/// Every video below `root`: files by extension, and directories of numbered images that hold no
/// video beside them. Hidden files and directories are passed over.
fn walk(root: &Path, out: Option<&Path>, ignored: &mut Ignored) -> Result<Vec<Found>, CorpusError> {
    let visible = |entry: &DirEntry| {
        entry.depth() == 0
            || !(entry.file_name().as_bytes().starts_with(b".") || Some(entry.path()) == out)
    };
    let mut found = Vec::new();
    let mut directories = vec![root.to_path_buf()];
    let mut directories_with_video = std::collections::BTreeSet::new();
    let mut other_files = Vec::new();
    for entry in WalkDir::new(root)
        .follow_links(true)
        .into_iter()
        .filter_entry(visible)
    {
        let entry = match entry {
            Ok(entry) => entry,
            // A link back to its own ancestor adds nothing new; a dangling link is a file that is
            // not there, and becomes a row if it is named like a video.
            Err(error) if error.loop_ancestor().is_some() => continue,
            Err(error) => match error.path() {
                Some(path) if path.is_symlink() && is_video_name(path) => {
                    found.push(Found {
                        path: path.to_path_buf(),
                        is_sequence: false,
                    });
                    continue;
                }
                Some(path) if path.is_symlink() => continue,
                path => {
                    return Err(CorpusError::Unlistable {
                        path: path.unwrap_or(root).display().to_string(),
                        source: error.into(),
                    });
                }
            },
        };
        let path = entry.path().to_path_buf();
        if entry.file_type().is_dir() {
            directories.push(path);
        } else if is_video_name(&path) {
            directories_with_video.extend(path.parent().map(Path::to_path_buf));
            found.push(Found {
                path,
                is_sequence: false,
            });
        } else {
            other_files.push(path);
        }
    }
    directories.dedup();
    let mut sequences = std::collections::BTreeSet::new();
    for directory in directories {
        if !directories_with_video.contains(&directory) && is_image_sequence(&directory) {
            sequences.insert(directory);
        }
    }
    for path in other_files {
        if !path
            .parent()
            .is_some_and(|parent| sequences.contains(parent))
        {
            let extension = path
                .extension()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            *ignored.entry(extension).or_default() += 1;
        }
    }
    found.extend(sequences.into_iter().map(|path| Found {
        path,
        is_sequence: true,
    }));
    Ok(found)
}

/// The files that a glob names, below the longest part of it without a wildcard. Unlike a walk, a
/// glob takes every file it matches, whatever its extension.
fn expand_glob(pattern: &str, out: Option<&Path>) -> Result<(PathBuf, Vec<Found>), CorpusError> {
    let mut base = PathBuf::new();
    let mut rest = PathBuf::new();
    for component in Path::new(pattern).components() {
        let text = component.as_os_str().to_string_lossy();
        if rest.as_os_str().is_empty() && !text.contains(['*', '?', '[']) {
            base.push(component);
        } else {
            rest.push(component);
        }
    }
    if base.as_os_str().is_empty() {
        base.push(".");
    }
    let base = absolute(&base);
    let glob_error = |reason: String| CorpusError::Glob {
        pattern: pattern.to_owned(),
        reason,
    };
    let matcher = GlobBuilder::new(&rest.to_string_lossy())
        .literal_separator(true)
        .build()
        .map_err(|error| glob_error(error.to_string()))?
        .compile_matcher();
    let mut found = Vec::new();
    for entry in WalkDir::new(&base).follow_links(true) {
        let Ok(entry) = entry else { continue };
        let below = entry.path().strip_prefix(&base).unwrap_or(entry.path());
        let in_out = out.is_some_and(|out| entry.path().starts_with(out));
        if !in_out && matcher.is_match(below) {
            let is_dir = entry.file_type().is_dir();
            if !is_dir || is_image_sequence(entry.path()) {
                found.push(Found {
                    path: entry.path().to_path_buf(),
                    is_sequence: is_dir,
                });
            }
        }
    }
    Ok((base, found))
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

fn stat(video: VideoId, found: Found, carried: Map<String, Value>) -> Entry {
    let bytes_of_path = found.path.as_os_str().as_bytes().to_vec();
    let (location, size_and_time) = if found.is_sequence {
        let images = image_files(&found.path).map_err(|error| error.to_string());
        let all = images.and_then(|images| {
            images
                .iter()
                .map(|image| size_and_time(image))
                .collect::<Result<Vec<_>, _>>()
        });
        let total = all.map(|all| {
            let bytes = all.iter().map(|(bytes, _)| bytes).sum();
            (
                bytes,
                all.iter()
                    .map(|(_, modified_ns)| *modified_ns)
                    .max()
                    .unwrap_or_default(),
            )
        });
        (Location::ImageSequence(bytes_of_path), total)
    } else {
        (Location::File(bytes_of_path), size_and_time(&found.path))
    };
    let (bytes, modified_ns, problem) = match size_and_time {
        Ok((bytes, modified_ns)) => (Some(bytes), Some(modified_ns), None),
        Err(problem) => (None, None, Some(problem)),
    };
    Entry {
        video,
        location,
        bytes,
        modified_ns,
        problem,
        group: None,
        carried,
    }
}

fn size_and_time(path: &Path) -> Result<(u64, i128), String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    if !metadata.is_file() {
        return Err("not a regular file".into());
    }
    let modified_ns = modified_ns(&metadata).map_err(|error| error.to_string())?;
    Ok((metadata.len(), modified_ns))
}

fn common_parent<'a>(mut roots: impl Iterator<Item = &'a Path>) -> PathBuf {
    let Some(first) = roots.next() else {
        return PathBuf::new();
    };
    let mut parent = first.to_path_buf();
    for root in roots {
        while !root.starts_with(&parent) {
            parent.pop();
        }
    }
    parent
}

/// The path below `root` with `/` between parts; a directory that is itself the root is named by
/// its own name. Bytes that are not UTF-8 are percent-encoded.
fn relative_name(path: &Path, root: &Path) -> String {
    let below = match path.strip_prefix(root) {
        Ok(below) if !below.as_os_str().is_empty() => below.as_os_str(),
        _ => path.file_name().unwrap_or(path.as_os_str()),
    };
    let mut name = String::new();
    for chunk in below.as_bytes().utf8_chunks() {
        name.push_str(chunk.valid());
        for byte in chunk.invalid() {
            name.push_str(&format!("%{byte:02X}"));
        }
    }
    name
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
