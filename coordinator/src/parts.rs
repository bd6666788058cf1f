//! What has been measured so far, in an object store: `runs/RUN/parts/DIGEST.parquet` below OUT's state.
//!
//! A part holds some rows' records and is named by its content, so that it may be put twice. Parts of every
//! run of an OUT are read back: which of their records still answer the frozen list, the journal decides.

use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use arrow_array::{Array, StringArray};
use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD as BASE64;
use bytes::Bytes;
use futures_util::TryStreamExt;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use plumbline_common::frame;
use plumbline_common::id::RunId;
use plumbline_common::message;
use plumbline_common::store::{self, ObjectKey, ObjectStore};

use crate::collect::{JournalError, Record};
use crate::corpus::Entry;
use crate::publish::encode::{self, Format};
use crate::publish::table::{Column, Kind};
use crate::run::{RunError, STATE_DIRECTORY};

/// Larger parts than are ever put.
const MAX_PART_BYTES: u64 = 1 << 30;

/// Hexadecimal digits of the digest of its content that name a part: no two are the same, and keys stay short
/// enough for stores that make file names of them.
const NAME_DIGITS: usize = 32;

/// The column of whole records, encoded as messages are, as text.
const RECORD: &str = "record";

/// One row of a part; all but the record is for people.
struct PartRow {
    video: String,
    status: String,
    worker: String,
    attempts: u32,
    record: String,
}

/// Parts of one run on their way.
pub(crate) struct Parts {
    store: Arc<dyn ObjectStore>,
    prefix: String,
    pending: Vec<PartRow>,
}

impl Parts {
    /// Parts of `run` below OUT's `store`.
    pub(crate) fn new(store: Arc<dyn ObjectStore>, run: &RunId) -> Self {
        Self {
            store,
            prefix: format!("{}parts/", run_prefix(run)),
            pending: Vec::new(),
        }
    }

    pub(crate) fn push(&mut self, record: &Record) -> Result<(), RunError> {
        let encoded = message::encode(record).map_err(RunError::Message)?;
        let measurement = &record.outcome.measurement;
        let status = serde_json::to_value(measurement.status).map_err(RunError::Profile)?;
        self.pending.push(PartRow {
            video: record.outcome.video.to_string(),
            status: status.as_str().unwrap_or_default().to_owned(),
            worker: record.worker.clone(),
            attempts: record.attempts,
            record: BASE64.encode(encoded),
        });
        Ok(())
    }

    /// Puts what is pending, if anything is. Cancelled or failed, it is still pending.
    pub(crate) async fn put(&mut self) -> Result<(), RunError> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let columns = [
            Column::field("video", Kind::Text, |row: &PartRow| {
                row.video.as_str().into()
            }),
            Column::field("status", Kind::Text, |row| row.status.as_str().into()),
            Column::field("worker", Kind::Text, |row| row.worker.as_str().into()),
            Column::field("attempts", Kind::UInt32, |row| row.attempts.into()),
            Column::field(RECORD, Kind::Text, |row| row.record.as_str().into()),
        ];
        put_table(&*self.store, &columns, &self.pending, |bytes| {
            let digest = blake3::hash(bytes).to_hex();
            let name = digest.get(..NAME_DIGITS).unwrap_or_default();
            ObjectKey::new(format!("{}{name}.parquet", self.prefix))
        })
        .await?;
        self.pending.clear();
        Ok(())
    }
}

async fn put_table<R>(
    store: &dyn ObjectStore,
    columns: &[Column<R>],
    rows: &[R],
    key: impl FnOnce(&[u8]) -> Result<ObjectKey, store::KeyError>,
) -> Result<(), RunError> {
    let bytes = encode::to_bytes(Format::Parquet, columns, rows).map_err(RunError::Part)?;
    let key = key(&bytes).map_err(store::StoreError::from)?;
    Ok(store.put(&key, Bytes::from(bytes)).await?)
}

fn run_prefix(run: &RunId) -> String {
    format!("{STATE_DIRECTORY}/runs/{run}/")
}

/// The frozen list, before any job: what a person, or another program, finds of what the run is about.
pub(crate) async fn put_corpus(
    store: &dyn ObjectStore,
    run: &RunId,
    entries: &[Entry],
) -> Result<(), RunError> {
    struct Line {
        video: String,
        location: String,
        bytes: Option<u64>,
        entry: String,
    }
    let lines = entries.iter().map(|entry| {
        Ok(Line {
            video: entry.video.to_string(),
            location: entry.address(),
            bytes: entry.bytes,
            entry: serde_json::to_string(entry)?,
        })
    });
    let lines: Vec<Line> = lines.collect::<Result<_, _>>().map_err(RunError::Profile)?;
    let columns = [
        Column::field("video", Kind::Text, |line: &Line| {
            line.video.as_str().into()
        }),
        Column::field("location", Kind::Text, |line| line.location.as_str().into()),
        Column::field("bytes", Kind::UInt64, |line| line.bytes.into()),
        Column::field("entry", Kind::Text, |line| line.entry.as_str().into()),
    ];
    let key = format!("{}corpus.parquet", run_prefix(run));
    put_table(store, &columns, &lines, |_| ObjectKey::new(key)).await
}

/// Writes the records of all parts of an OUT to a journal at `journal`; or, with `keep` false, removes the
/// parts.
pub(crate) async fn restore(
    store: &dyn ObjectStore,
    journal: &Path,
    keep: bool,
) -> Result<(), RunError> {
    let io_error = |source| JournalError::Io {
        path: journal.to_path_buf(),
        source,
    };
    let mut out = BufWriter::new(std::fs::File::create(journal).map_err(io_error)?);
    let mut pages = store.list(&format!("{STATE_DIRECTORY}/runs/"));
    while let Some(page) = pages.try_next().await? {
        for meta in page {
            let key = meta.key.as_str();
            if !(key.contains("/parts/") && key.ends_with(".parquet")) {
                continue;
            }
            if !keep {
                store.delete(&meta.key).await?;
                continue;
            }
            let part = store::fetch(store, &meta, MAX_PART_BYTES).await?;
            let records = records(part).map_err(|why| RunError::PartUnreadable {
                part: store.address(&meta.key),
                why,
            })?;
            for record in records {
                frame::write(&mut out, &record)
                    .map_err(|error| io_error(std::io::Error::other(error)))?;
            }
        }
    }
    out.flush().map_err(io_error)?;
    Ok(())
}

/// The encoded records of a part.
fn records(part: Vec<u8>) -> Result<Vec<Vec<u8>>, String> {
    let batches = ParquetRecordBatchReaderBuilder::try_new(Bytes::from(part))
        .and_then(ParquetRecordBatchReaderBuilder::build)
        .map_err(|error| error.to_string())?;
    let mut records = Vec::new();
    for batch in batches {
        let batch = batch.map_err(|error| error.to_string())?;
        let column = batch.column_by_name(RECORD);
        let texts = column.and_then(|column| column.as_any().downcast_ref::<StringArray>());
        let texts = texts.ok_or_else(|| format!("it has no column {RECORD} of texts"))?;
        for text in texts.iter().flatten() {
            records.push(BASE64.decode(text).map_err(|error| error.to_string())?);
        }
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::Journal;
    use crate::corpus::file_entry as entry;
    use plumbline_common::message::Outcome;
    use plumbline_common::row::{Cost, Measurement, Status};
    use plumbline_common::store::DirStore;

    fn record(name: &str) -> Record {
        let mut measurement = Measurement::without_score(Status::Static, "why");
        measurement.aepe_px = Some(0.1 + 0.2);
        Record {
            location: entry(name).location,
            bytes: Some(3),
            modified_ns: Some(5),
            profile_digest: "p".into(),
            intrinsics: None,
            attempts: 2,
            worker: "w".into(),
            outcome: Outcome {
                video: entry(name).video,
                measurement,
                cost: Cost::default(),
                thumbnails: None,
            },
        }
    }

    #[tokio::test]
    async fn a_journal_comes_back_from_parts_and_no_part_is_put_twice() {
        let dir = tempfile::tempdir().unwrap();
        let store: Arc<dyn ObjectStore> = Arc::new(DirStore::new(dir.path().join("out")));
        let run = RunId::new("r").unwrap();
        let entries = [entry("a"), entry("b"), entry("c")];
        put_corpus(&*store, &run, &entries).await.unwrap();
        for names in [&["a", "b"][..], &["c"], &["c"]] {
            let mut parts = Parts::new(Arc::clone(&store), &run);
            for name in names {
                parts.push(&record(name)).unwrap();
            }
            parts.put().await.unwrap();
            parts.put().await.unwrap();
        }
        let listed: Vec<_> = store.list("").try_concat().await.unwrap();
        assert_eq!(listed.len(), 3, "the list and two parts: {listed:?}");
        let path = dir.path().join("journal");
        restore(&*store, &path, true).await.unwrap();
        let journal = Journal::open(&path, true, &entries, "p").unwrap();
        assert_eq!(journal.len(), 3);
        let found = journal.read(&entry("b").video).unwrap();
        assert_eq!(found, Some(record("b")));
        drop(journal);
        restore(&*store, &path, false).await.unwrap();
        assert!(
            Journal::open(&path, true, &entries, "p")
                .unwrap()
                .is_empty()
        );
        restore(&*store, &path, true).await.unwrap();
        assert!(
            Journal::open(&path, true, &entries, "p")
                .unwrap()
                .is_empty()
        );
    }

    #[tokio::test]
    async fn what_is_no_part_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let store = DirStore::new(dir.path().join("out"));
        let key = ObjectKey::new(".plumbline/runs/r/parts/x.parquet").unwrap();
        store.put(&key, Bytes::from_static(b"junk")).await.unwrap();
        let refused = restore(&store, &dir.path().join("journal"), true).await;
        let error = refused.unwrap_err().to_string();
        assert!(
            error.contains("x.parquet") && error.contains("remove it"),
            "{error}"
        );
    }
}
