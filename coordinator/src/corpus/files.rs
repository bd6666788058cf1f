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

use super::{CorpusError, Entry, Ignored};

/// File names that are taken for videos while walking; what a file really is, its bytes say later.
pub(super) const VIDEO_EXTENSIONS: [&str; 7] = ["mp4", "m4v", "mov", "webm", "mkv", "avi", "gif"];

/// A video found, before it has a name.
pub(super) struct Found {
    pub(super) path: PathBuf,
    pub(super) is_sequence: bool,
}

pub(super) fn absolute(path: &Path) -> PathBuf {
    std::fs::canonicalize(path)
        .or_else(|_| std::path::absolute(path))
        .unwrap_or_else(|_| path.to_path_buf())
}

/// Every video below `root`: files by extension, and directories of numbered images that hold no
/// video beside them. Hidden files and directories are passed over.
pub(super) fn walk(
    root: &Path,
    out: Option<&Path>,
    ignored: &mut Ignored,
) -> Result<Vec<Found>, CorpusError> {
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
pub(super) fn expand_glob(
    pattern: &str,
    out: Option<&Path>,
) -> Result<(PathBuf, Vec<Found>), CorpusError> {
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
    let mut name = String::new();
    for chunk in below.as_bytes().utf8_chunks() {
        name.push_str(chunk.valid());
        for byte in chunk.invalid() {
            name.push_str(&format!("%{byte:02X}"));
        }
    }
    name
}

pub(super) fn is_video_name(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(OsStr::to_str)
        .map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| VIDEO_EXTENSIONS.contains(&extension.as_str()))
}

pub(super) fn stat(video: VideoId, found: Found, carried: Map<String, Value>) -> Entry {
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
