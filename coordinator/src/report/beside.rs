//! What stands beside the report, a video each: its worst frame, where the error lies, and its series.
//! Browsers load them when they come into view; the page is whole without them.
//!
//! Names hold a digest of what decides their content, never a part of the video's name.

use std::collections::{BTreeMap, BTreeSet};

use plumbline_common::id::VideoId;
use plumbline_common::message::Thumbnails;
use plumbline_common::row::Row;
use serde_json::Value;

use super::{chart, clip, data};
use crate::publish::{OutDir, PublishError};

/// Where the files are, below OUT.
const DIRECTORY: &str = "videos";
/// Hexadecimal digits of a name.
const DIGITS: usize = 16;
/// What follows them: the frame, the heat map, the series.
const ENDINGS: [&str; 3] = [".jpg", "-heat.jpg", ".svg"];

/// The files of one video.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Beside {
    stem: String,
    /// Which of [`ENDINGS`] there are.
    there: [bool; 3],
}

/// Files by video.
pub type BesideReport = BTreeMap<VideoId, Beside>;

impl Beside {
    /// As the page's script reads it: which files (bits, the frame lowest), then the name.
    pub(super) fn told(&self) -> Value {
        let bits = self
            .there
            .iter()
            .rev()
            .fold(0, |bits, there| 2 * bits + u8::from(*there));
        Value::from(format!("{bits}{}", self.stem))
    }
}

/// Writes the files of the videos that the page lists, and removes those of others.
///
/// # Errors
/// [`PublishError`] naming the file and the remedy.
pub fn write(
    out: &OutDir,
    rows: &[Row],
    thumbnails: &dyn Fn(&VideoId) -> Option<Thumbnails>,
) -> Result<(BesideReport, Vec<String>), PublishError> {
    let mut beside = BesideReport::new();
    let mut written = BTreeSet::new();
    for row in data::listed(rows) {
        let stem = stem(row);
        let pictures = thumbnails(&row.video).unwrap_or_default();
        let series = clip::large(&row.measured).and_then(|svg| chart::standing_alone(&svg));
        let contents = [
            pictures.frame_jpeg,
            pictures.heat_jpeg,
            series.unwrap_or_default().into_bytes(),
        ];
        let mut there = [false; 3];
        for ((ending, content), there) in ENDINGS.iter().zip(&contents).zip(&mut there) {
            if content.is_empty() {
                continue;
            }
            let name = format!("{DIRECTORY}/{stem}{ending}");
            if std::fs::read(out.root().join(&name)).ok().as_ref() != Some(content) {
                out.put_unsynced(&name, content)?;
            }
            written.insert(name);
            *there = true;
        }
        if there.contains(&true) {
            beside.insert(row.video.clone(), Beside { stem, there });
        }
    }
    for name in left_in(out)? {
        if !written.contains(&name) {
            out.remove(&name)?;
        }
    }
    Ok((beside, written.into_iter().collect()))
}

fn stem(row: &Row) -> String {
    let mut hasher = blake3::Hasher::new();
    let content = row.measured.digest.as_deref().unwrap_or_default();
    for part in [
        row.video.as_str(),
        content,
        &row.profile_digest,
        env!("CARGO_PKG_VERSION"),
    ] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex().chars().take(DIGITS).collect()
}

/// Whether a file in OUT is one that [`write()`] names.
#[must_use]
pub fn is_ours(name: &str) -> bool {
    let below = name
        .strip_prefix(DIRECTORY)
        .and_then(|name| name.strip_prefix('/'));
    let Some((stem, ending)) = below.and_then(|name| name.split_at_checked(DIGITS)) else {
        return false;
    };
    stem.bytes().all(|c| c.is_ascii_hexdigit()) && ENDINGS.contains(&ending)
}

/// Our files in the directory.
fn left_in(out: &OutDir) -> Result<Vec<String>, PublishError> {
    let io_error = |source| PublishError::from_io(DIRECTORY, source);
    let entries = match std::fs::read_dir(out.root().join(DIRECTORY)) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(io_error)?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let name = entry.map_err(io_error)?.file_name();
        let name = format!("{DIRECTORY}/{}", name.to_string_lossy());
        if is_ours(&name) {
            names.push(name);
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::{rollouts, thumbnails};

    #[test]
    fn files_are_written_once_and_those_of_others_go() {
        let dir = tempfile::tempdir().unwrap();
        let out = OutDir::create(dir.path()).unwrap();
        let rows = rollouts(13, 2);
        let (beside, files) = write(&out, &rows, &thumbnails).unwrap();
        assert_eq!(
            (beside.len(), files.len()),
            (13, 13 * 3 - 1),
            "one is static, without series"
        );
        assert!(
            files
                .iter()
                .all(|file| is_ours(file) && dir.path().join(file).is_file())
        );
        let changed = |file: &str| {
            dir.path()
                .join(file)
                .metadata()
                .unwrap()
                .modified()
                .unwrap()
        };
        let before: Vec<_> = files.iter().map(|file| changed(file)).collect();
        std::fs::write(dir.path().join("videos/mine.jpg"), "mine").unwrap();
        assert_eq!(write(&out, &rows, &thumbnails).unwrap().1, files);
        let after: Vec<_> = files.iter().map(|file| changed(file)).collect();
        assert_eq!(before, after);
        let (_, fewer) = write(&out, &rows[..3], &|_| None).unwrap();
        assert_eq!(fewer.len(), 3);
        assert_eq!(left_in(&out).unwrap().len(), 3);
        assert!(dir.path().join("videos/mine.jpg").is_file());
    }

    #[test]
    fn names_are_told_from_those_of_others() {
        assert!(
            is_ours("videos/0123456789abcdef.jpg") && is_ours("videos/0123456789abcdef-heat.jpg")
        );
        for other in [
            "videos/mine.jpg",
            "videos/0123456789abcdef.png",
            "0123456789abcdef.jpg",
            "videos/é123456789abcdef.jpg",
        ] {
            assert!(!is_ours(other), "{other}");
        }
    }
}
