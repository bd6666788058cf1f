//! What has been measured so far, durable: the run's journal.
//!
//! One frame (`plumbline_common::frame`) per measured video, appended in the order of completion. A
//! killed run leaves at most one torn frame at the end, which the next run cuts off. A record counts
//! for a video only while path, size, modification time and profile digest are all the same.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use plumbline_common::frame::{self, FrameError, HEADER_BYTES};
use plumbline_common::id::VideoId;
use plumbline_common::message::{self, Location, MessageError, Outcome};
use plumbline_common::row::Status;
use plumbline_vision::slam::intrinsics::Intrinsics;
use serde::{Deserialize, Serialize};

use crate::answers::EMBEDDED_WORKER;
use crate::corpus::Entry;

/// Records between two flushes to the disk where nobody asks for one: a power cut repeats at most this
/// much work.
const RECORDS_PER_SYNC: u32 = 64;

/// One measured video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Where its bytes were.
    pub location: Location,
    /// Their size when the corpus was frozen.
    pub bytes: Option<u64>,
    /// Their time when the corpus was frozen.
    pub modified_ns: Option<i128>,
    /// The profile that measured it.
    pub profile_digest: String,
    /// Its camera, where the list told.
    #[serde(default)]
    pub intrinsics: Option<Intrinsics>,
    /// How often it was tried.
    pub attempts: u32,
    /// Who measured it.
    #[serde(default = "embedded")]
    pub worker: String,
    /// What came of it.
    pub outcome: Outcome,
}

fn embedded() -> String {
    EMBEDDED_WORKER.to_owned()
}

impl Record {
    /// Whether this record is what measuring `entry` again would give. A `failed` one is not: its
    /// cause may be gone.
    fn answers(&self, entry: &Entry, profile_digest: &str) -> bool {
        self.location == entry.location
            && self.bytes == entry.bytes
            && self.modified_ns == entry.modified_ns
            && self.profile_digest == profile_digest
            && self.intrinsics == entry.intrinsics()
            && self.outcome.measurement.status != Status::Failed
    }
}

/// Why the journal cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The disk said no.
    #[error(
        "{path}: {source}; what was measured so far is kept: make room or mend the permissions, then run the same command again"
    )]
    Io {
        /// The journal.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A record cannot be written.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// A record cannot be read back.
    #[error("{path}: {source}; run with --no-resume to measure again")]
    Frame {
        /// The journal.
        path: PathBuf,
        /// Why.
        source: FrameError,
    },
}

/// The open journal of one run, with the place of every record that answers an entry.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    end: u64,
    unsynced: u32,
    places: HashMap<VideoId, u64>,
}

impl Journal {
    /// Opens (or creates) the journal at `path` and finds the records that answer `entries`; with
    /// `resume` false everything in it is forgotten.
    ///
    /// # Errors
    /// [`JournalError::Io`].
    pub fn open(
        path: &Path,
        resume: bool,
        entries: &[Entry],
        profile_digest: &str,
    ) -> Result<Self, JournalError> {
        let io_error = |source| JournalError::Io {
            path: path.to_path_buf(),
            source,
        };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(!resume)
            .open(path)
            .map_err(io_error)?;
        let wanted: HashMap<&VideoId, &Entry> =
            entries.iter().map(|entry| (&entry.video, entry)).collect();
        let mut places = HashMap::new();
        let mut end = 0;
        let mut reader = BufReader::new(&file);
        loop {
            let payload = match frame::read(&mut reader) {
                Ok(Some(payload)) => payload,
                // A torn frame ends what can be trusted; so does one of another wire version.
                Ok(None) | Err(FrameError::Torn | FrameError::TooLarge(_)) => break,
                // A disk that does not answer is no reason to cut the journal off.
                Err(FrameError::Io(source)) => return Err(io_error(source)),
            };
            let Ok(record) = message::decode::<Record>(&payload) else {
                break;
            };
            let video = &record.outcome.video;
            if wanted
                .get(video)
                .is_some_and(|entry| record.answers(entry, profile_digest))
            {
                places.insert(video.clone(), end);
            }
            end += (HEADER_BYTES + payload.len()) as u64;
        }
        file.set_len(end).map_err(io_error)?;
        Ok(Self {
            path: path.to_path_buf(),
            file,
            end,
            unsynced: 0,
            places,
        })
    }

    /// Whether a video is measured.
    #[must_use]
    pub fn contains(&self, video: &VideoId) -> bool {
        self.places.contains_key(video)
    }

    /// Videos measured.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether nothing is measured.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Adds a record.
    ///
    /// # Errors
    /// [`JournalError`]; the journal stays readable up to the record before.
    pub fn append(&mut self, record: &Record) -> Result<(), JournalError> {
        let payload = message::encode(record)?;
        let mut framed = Vec::with_capacity(HEADER_BYTES + payload.len());
        frame::write(&mut framed, &payload).map_err(|source| self.frame_error(source))?;
        self.file
            .seek(SeekFrom::Start(self.end))
            .and_then(|_| self.file.write_all(&framed))
            .map_err(|source| self.io_error(source))?;
        self.places.insert(record.outcome.video.clone(), self.end);
        self.end += framed.len() as u64;
        self.unsynced += 1;
        if self.unsynced >= RECORDS_PER_SYNC {
            self.sync()?;
        }
        Ok(())
    }

    /// Makes everything appended durable.
    ///
    /// # Errors
    /// [`JournalError::Io`].
    pub fn sync(&mut self) -> Result<(), JournalError> {
        self.unsynced = 0;
        self.file
            .sync_data()
            .map_err(|source| self.io_error(source))
    }

    /// Reads a video's record back; `None` where it is not measured.
    ///
    /// # Errors
    /// [`JournalError`].
    pub fn read(&self, video: &VideoId) -> Result<Option<Record>, JournalError> {
        let Some(&place) = self.places.get(video) else {
            return Ok(None);
        };
        let mut at_place = ReadAt {
            file: &self.file,
            offset: place,
        };
        let payload = frame::read(&mut at_place).map_err(|source| self.frame_error(source))?;
        let payload = payload.ok_or_else(|| self.frame_error(FrameError::Torn))?;
        Ok(Some(message::decode(&payload)?))
    }

    fn io_error(&self, source: std::io::Error) -> JournalError {
        JournalError::Io {
            path: self.path.clone(),
            source,
        }
    }

    fn frame_error(&self, source: FrameError) -> JournalError {
        JournalError::Frame {
            path: self.path.clone(),
            source,
        }
    }
}

/// Positioned reads, so that reading a record back does not move the place of the next append.
struct ReadAt<'a> {
    file: &'a File,
    offset: u64,
}

impl Read for ReadAt<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        use std::os::unix::fs::FileExt;
        let n = self.file.read_at(buffer, self.offset)?;
        self.offset += n as u64;
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::corpus::file_entry as entry;
    use plumbline_common::row::{Cost, Measurement};

    fn record(name: &str, status: Status) -> Record {
        let entry = entry(name);
        Record {
            location: entry.location,
            bytes: entry.bytes,
            modified_ns: entry.modified_ns,
            profile_digest: "p".into(),
            intrinsics: None,
            attempts: 1,
            worker: embedded(),
            outcome: Outcome {
                video: entry.video,
                measurement: Measurement::without_score(status, "why"),
                cost: Cost::default(),
                thumbnails: None,
            },
        }
    }

    fn reopen(path: &Path, digest: &str) -> Journal {
        Journal::open(path, true, &[entry("a"), entry("b")], digest).unwrap()
    }

    #[test]
    fn records_come_back_after_reopening() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        let mut journal = reopen(&path, "p");
        journal.append(&record("a", Status::Static)).unwrap();
        journal.append(&record("b", Status::TooShort)).unwrap();
        drop(journal);
        let journal = reopen(&path, "p");
        assert_eq!(journal.len(), 2);
        assert_eq!(
            journal.read(&entry("b").video).unwrap(),
            Some(record("b", Status::TooShort))
        );
    }

    #[test]
    fn another_profile_a_changed_file_and_a_failure_are_measured_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        let mut journal = reopen(&path, "p");
        journal.append(&record("a", Status::Static)).unwrap();
        journal.append(&record("b", Status::Failed)).unwrap();
        drop(journal);
        assert!(reopen(&path, "other").is_empty());
        let journal = reopen(&path, "p");
        assert!(journal.contains(&entry("a").video) && !journal.contains(&entry("b").video));
        let mut touched = entry("a");
        touched.modified_ns = Some(6);
        let mut with_camera = entry("a");
        for column in ["fx", "fy", "cx", "cy"] {
            with_camera.carried.insert(column.to_owned(), 9.into());
        }
        for changed in [touched, with_camera] {
            assert!(
                Journal::open(&path, true, &[changed], "p")
                    .unwrap()
                    .is_empty()
            );
        }
    }

    #[test]
    fn a_torn_tail_costs_only_its_own_record() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        let mut journal = reopen(&path, "p");
        journal.append(&record("a", Status::Static)).unwrap();
        let whole = journal.end;
        journal.append(&record("b", Status::Static)).unwrap();
        let full = journal.end;
        drop(journal);
        let bytes = std::fs::read(&path).unwrap();
        for cut in whole..full {
            std::fs::write(&path, &bytes[..cut as usize]).unwrap();
            let mut journal = reopen(&path, "p");
            assert_eq!(journal.len(), 1, "cut at {cut}");
            journal.append(&record("b", Status::Static)).unwrap();
            drop(journal);
            assert_eq!(reopen(&path, "p").len(), 2, "appended after a cut at {cut}");
        }
    }

    #[test]
    fn without_resume_nothing_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        reopen(&path, "p")
            .append(&record("a", Status::Static))
            .unwrap();
        assert!(
            Journal::open(&path, false, &[entry("a")], "p")
                .unwrap()
                .is_empty()
        );
    }
}
