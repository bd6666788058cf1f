//! Where each video lies, for the manifests: from a column `path` of the rows, or from the frozen list
//! that the run left beside its scores.

use std::fs::File;
use std::io::{BufRead, BufReader, Lines};
use std::path::PathBuf;

use arrow_array::builder::StringBuilder;
use arrow_array::{Array, RecordBatch, StringArray};

use super::rows::texts;
use crate::corpus::Entry;
use crate::run::{FROZEN_FILE, STATE_DIRECTORY};

/// Frozen lists, gone through beside the rows: both ascend by `video`.
pub(super) struct Paths {
    lists: Vec<List>,
}

struct List {
    lines: Lines<BufReader<File>>,
    /// The first entry that no row has reached.
    next: Option<Entry>,
}

impl List {
    fn advance(&mut self) {
        // A list that does not read, or is no list of this version, ends here: paths are then null.
        let line = self.lines.next().and_then(Result::ok);
        self.next = line.and_then(|line| serde_json::from_str(&line).ok());
    }
}

impl Paths {
    /// The lists beside some files of rows.
    pub(super) fn beside(files: &[PathBuf]) -> Self {
        let mut directories: Vec<PathBuf> = files
            .iter()
            .filter_map(|file| Some(file.parent()?.join(STATE_DIRECTORY).join(FROZEN_FILE)))
            .collect();
        directories.sort();
        directories.dedup();
        let lists = directories.iter().filter_map(|path| {
            let mut list = List {
                lines: BufReader::new(File::open(path).ok()?).lines(),
                next: None,
            };
            list.advance();
            Some(list)
        });
        Self {
            lists: lists.collect(),
        }
    }

    /// The paths of some rows, those of the batch before being lower; null where nothing says one.
    pub(super) fn of(&mut self, batch: &RecordBatch) -> Option<StringArray> {
        if let Some(paths) = texts(batch, "path") {
            return Some(paths.clone());
        }
        if self.lists.is_empty() {
            return None;
        }
        let mut found = StringBuilder::new();
        for video in texts(batch, "video")?.iter() {
            let video = video.unwrap_or_default();
            let mut path = None;
            for list in &mut self.lists {
                while list
                    .next
                    .as_ref()
                    .is_some_and(|entry| entry.video.as_str() < video)
                {
                    list.advance();
                }
                if let Some(entry) = list.next.as_ref().filter(|e| e.video.as_str() == video) {
                    path = Some(entry.address());
                }
            }
            found.append_option(path);
        }
        let found = found.finish();
        (found.null_count() < found.len()).then_some(found)
    }
}
