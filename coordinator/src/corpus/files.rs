//! Videos of this machine: walked directories, globs, and what a file is frozen by.

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

use super::dataset::{Placed, place_file};
use super::{CorpusError, Entry, Ignored};

/// File names that are taken for videos while walking; what a file really is, its bytes say later.
pub(super) const VIDEO_EXTENSIONS: [&str; 7] = ["mp4", "m4v", "mov", "webm", "mkv", "avi", "gif"];

/// A video found, before it has a name.
pub(super) struct Found {
    /// Its path; of one in a dataset the path that it would have as a file, from which it is named.
    pub(super) path: PathBuf,
    pub(super) is_sequence: bool,
    /// Columns that a dataset has for it.
    pub(super) carried: Map<String, Value>,
    /// Where it is, if not at its path.
    pub(super) placed: Option<Placed>,
}

impl Found {
    pub(super) fn at(path: PathBuf, is_sequence: bool) -> Self {
        Self {
            path,
            is_sequence,
            carried: Map::new(),
            placed: None,
        }
    }
}

pub(super) fn absolute(path: &Path) -> PathBuf {
    std::fs::canonicalize(path)
        .or_else(|_| std::path::absolute(path))
        .unwrap_or_else(|_| path.to_path_buf())
}

/// What is below a directory.
pub(super) struct Walked {
    pub(super) found: Vec<Found>,
    /// Files that are not named like videos.
    pub(super) others: Vec<PathBuf>,
}

/// Counts a file that is passed over.
pub(super) fn ignore(ignored: &mut Ignored, path: &Path) {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    *ignored.entry(extension.into_owned()).or_default() += 1;
}

/// Every video below `root`: files by extension, and directories of numbered images that hold no
/// video beside them. Hidden files and directories are passed over.
pub(super) fn walk(root: &Path, out: Option<&Path>) -> Result<Walked, CorpusError> {
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
                    found.push(Found::at(path.to_path_buf(), false));
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
            found.push(Found::at(path, false));
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
    let is_frame = |path: &Path| {
        path.parent()
            .is_some_and(|parent| sequences.contains(parent))
    };
    let others = other_files.into_iter().filter(|path| !is_frame(path));
    let others = others.collect();
    found.extend(sequences.into_iter().map(|path| Found::at(path, true)));
    Ok(Walked { found, others })
}

/// The files that a glob names, below the longest part of it without a wildcard. Unlike a walk, a
/// glob takes every file it matches, whatever its extension.
pub(super) fn expand_glob(
    pattern: &str,
    out: Option<&Path>,
) -> Result<(PathBuf, Vec<Found>), CorpusError> {
    let mut base = PathBuf::new();
    let mut rest = PathBuf::new();
    for component in Path::new(pattern).components() {
        let text = component.as_os_str().to_string_lossy();
        if rest.as_os_str().is_empty() && !text.contains(['*', '?', '[', '{']) {
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
                found.push(Found::at(entry.path().to_path_buf(), is_dir));
            }
        }
    }
    Ok((base, found))
}

pub(super) fn size_and_time(path: &Path) -> Result<(u64, i128), String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    if !metadata.is_file() {
        return Err("not a regular file".into());
    }
    let modified_ns = modified_ns(&metadata).map_err(|error| error.to_string())?;
    Ok((metadata.len(), modified_ns))
}

pub(super) fn common_parent<'a>(mut roots: impl Iterator<Item = &'a Path>) -> PathBuf {
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
pub(super) fn relative_name(path: &Path, root: &Path) -> String {
    let below = match path.strip_prefix(root) {
        Ok(below) if !below.as_os_str().is_empty() => below.as_os_str(),
        _ => path.file_name().unwrap_or(path.as_os_str()),
    };
    text_of(below.as_bytes())
}

/// Bytes as text; those that are not UTF-8 percent-encoded.
pub(super) fn text_of(bytes: &[u8]) -> String {
    let mut text = String::new();
    for chunk in bytes.utf8_chunks() {
        text.push_str(chunk.valid());
        for byte in chunk.invalid() {
            text.push_str(&format!("%{byte:02X}"));
        }
    }
    text
}

pub(super) fn is_video_name(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(OsStr::to_str)
        .map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| VIDEO_EXTENSIONS.contains(&extension.as_str()))
}

/// The entry of what was found, as it is now.
pub(super) fn stat(video: VideoId, found: Found) -> Entry {
    let placed = match found.placed {
        Some(placed) => placed,
        None if found.is_sequence => place_images(&found.path),
        None => place_file(&found.path),
    };
    placed.into_entry(video, found.carried)
}

fn place_images(directory: &Path) -> Placed {
    let images = image_files(directory).map_err(|error| error.to_string());
    let all = images.and_then(|images| {
        let all = images.iter().map(|image| size_and_time(image));
        all.collect::<Result<Vec<_>, _>>()
    });
    let (bytes, modified_ns, problem) = match all {
        Ok(all) => {
            let bytes = all.iter().map(|(bytes, _)| bytes).sum();
            let latest = all.iter().map(|(_, modified_ns)| *modified_ns).max();
            (Some(bytes), Some(latest.unwrap_or_default()), None)
        }
        Err(problem) => (None, None, Some(problem)),
    };
    Placed {
        location: Location::ImageSequence(directory.as_os_str().as_bytes().to_vec()),
        bytes,
        modified_ns,
        problem,
    }
}
