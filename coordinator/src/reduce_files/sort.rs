//! Rows in the order of `video`, whatever order they come in: an external merge sort.
//!
//! Tables that are in order, one after the other, are taken as they are. Others are cut into runs
//! that fit into memory, each sorted and written to a scratch file, and the runs are merged.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::File;
use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::{Array, RecordBatch, StringArray};
use arrow_select::interleave::interleave_record_batch;
use parquet::arrow::ArrowWriter;
use parquet::file::properties::{EnabledStatistics, WriterProperties};

use super::columns::Columns;
use super::error::ReduceFilesError;
use super::table_file::{BATCH_ROWS, Batches, TableFile};

/// Rows read of each run at a time while runs are merged: many runs are open at once.
const MERGE_ROWS: usize = 1024;

/// Rows per row group of the merged table.
const ROW_GROUP_ROWS: usize = 65_536;

/// One table of all rows, ascending by `video`; runs of `run_bytes` are sorted in memory. The columns are those of the tables as read.
pub(super) fn sorted(
    tables: &[TableFile],
    columns: &Columns,
    scratch: &Path,
    run_bytes: usize,
) -> Result<TableFile, ReduceFilesError> {
    let mut runs = Vec::new();
    let mut batches: Vec<RecordBatch> = Vec::new();
    let mut bytes = 0;
    let names = columns.in_any(tables);
    for table in tables {
        for batch in table.read(&names, None, BATCH_ROWS)? {
            let batch = columns.conform(&batch?, &names, &table.name)?;
            bytes += batch.get_array_memory_size();
            batches.push(batch);
            if bytes >= run_bytes {
                runs.push(write_run(&batches, scratch)?);
                batches.clear();
                bytes = 0;
            }
        }
    }
    if !batches.is_empty() {
        runs.push(write_run(&batches, scratch)?);
    }
    drop(batches);
    merge(&runs, &names, scratch)
}

/// The names of a batch.
pub(super) fn videos<'a>(
    batch: &'a RecordBatch,
    file: &str,
) -> Result<&'a StringArray, ReduceFilesError> {
    let videos = batch
        .column_by_name("video")
        .and_then(|array| array.as_string_opt::<i32>());
    let videos =
        videos.filter(|videos| videos.null_count() == 0 && videos.iter().all(|v| v != Some("")));
    videos.ok_or_else(|| {
        ReduceFilesError::source(file, "the column `video` must name a video in every row")
    })
}

fn write_run(batches: &[RecordBatch], scratch: &Path) -> Result<TableFile, ReduceFilesError> {
    let names = batches
        .iter()
        .map(|batch| videos(batch, "the rows"))
        .collect::<Result<Vec<_>, _>>()?;
    let mut order: Vec<(usize, usize)> = batches
        .iter()
        .enumerate()
        .flat_map(|(k, batch)| (0..batch.num_rows()).map(move |row| (k, row)))
        .collect();
    order.sort_unstable_by(|a, b| names[a.0].value(a.1).cmp(names[b.0].value(b.1)));
    let batches: Vec<&RecordBatch> = batches.iter().collect();
    let mut run = ScratchTable::new(&batches[0].schema(), scratch)?;
    for order in order.chunks(MERGE_ROWS) {
        run.write(&interleave(&batches, order)?)?;
    }
    run.finish()
}

fn interleave(
    batches: &[&RecordBatch],
    order: &[(usize, usize)],
) -> Result<RecordBatch, ReduceFilesError> {
    interleave_record_batch(batches, order).map_err(|error| ReduceFilesError::Encode(error.into()))
}

/// A run as far as it is read.
struct Cursor<'a> {
    rest: Batches<'a>,
    /// Where its current batch lies among those of the merge.
    batch: usize,
    /// The names of that batch, checked once.
    videos: StringArray,
    row: usize,
}

fn merge(
    runs: &[TableFile],
    names: &[&str],
    scratch: &Path,
) -> Result<TableFile, ReduceFilesError> {
    let mut held: Vec<RecordBatch> = Vec::new();
    let mut cursors = Vec::new();
    let mut heap = BinaryHeap::new();
    for run in runs {
        let mut rest = run.read(names, None, MERGE_ROWS)?;
        if let Some(batch) = rest.next() {
            let batch = batch?;
            let videos = videos(&batch, &run.name)?.clone();
            heap.push(Reverse((videos.value(0).to_owned(), cursors.len())));
            cursors.push(Cursor {
                rest,
                batch: held.len(),
                videos,
                row: 0,
            });
            held.push(batch);
        }
    }
    let Some(first) = held.first() else {
        // Tables without rows are left out.
        return Err(ReduceFilesError::Thread);
    };
    let mut merged = ScratchTable::new(&first.schema(), scratch)?;
    let mut order: Vec<(usize, usize)> = Vec::with_capacity(BATCH_ROWS);
    let mut last: Option<String> = None;
    while let Some(Reverse((video, k))) = heap.pop() {
        if last.as_ref() == Some(&video) {
            return Err(ReduceFilesError::Duplicate { video });
        }
        let cursor = &mut cursors[k];
        order.push((cursor.batch, cursor.row));
        cursor.row += 1;
        if cursor.row == cursor.videos.len() {
            match cursor.rest.next() {
                Some(batch) => {
                    let batch = batch?;
                    cursor.batch = held.len();
                    cursor.videos = videos(&batch, "the rows")?.clone();
                    cursor.row = 0;
                    held.push(batch);
                }
                None => cursor.row = usize::MAX,
            }
        }
        if cursor.row != usize::MAX {
            heap.push(Reverse((cursor.videos.value(cursor.row).to_owned(), k)));
        }
        last = Some(video);
        if order.len() == BATCH_ROWS || heap.is_empty() {
            merged.write(&interleave(&held.iter().collect::<Vec<_>>(), &order)?)?;
            order.clear();
            // Only the batches that cursors stand in are still needed.
            held = cursors
                .iter_mut()
                .filter(|cursor| cursor.row != usize::MAX)
                .enumerate()
                .map(|(place, cursor)| held[std::mem::replace(&mut cursor.batch, place)].clone())
                .collect();
        }
    }
    merged.finish()
}

/// A table that only this process reads, and soon: nothing is compressed.
struct ScratchTable {
    writer: ArrowWriter<File>,
    file: File,
}

impl ScratchTable {
    fn new(schema: &arrow_schema::SchemaRef, scratch: &Path) -> Result<Self, ReduceFilesError> {
        let file = tempfile::tempfile_in(scratch)?;
        let properties = WriterProperties::builder()
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_write_batch_size(MERGE_ROWS)
            .set_data_page_row_count_limit(MERGE_ROWS)
            .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
            .build();
        let writer = ArrowWriter::try_new(file.try_clone()?, schema.clone(), Some(properties))
            .map_err(|error| ReduceFilesError::Encode(error.into()))?;
        Ok(Self { writer, file })
    }

    fn write(&mut self, batch: &RecordBatch) -> Result<(), ReduceFilesError> {
        self.writer
            .write(batch)
            .map_err(|error| ReduceFilesError::Encode(error.into()))
    }

    fn finish(self) -> Result<TableFile, ReduceFilesError> {
        self.writer
            .close()
            .map_err(|error| ReduceFilesError::Encode(error.into()))?;
        TableFile::scratch("the sorted rows", self.file)
    }
}
