//! The last pass: rows again, with what they came to, into every table at once.
//!
//! One thread reads and completes the rows in pieces of a fixed size; each file has a thread that
//! encodes it. Pieces are cut by row index, so that neither the parts nor the threads show in a file.

mod complete;
mod made;
mod tables;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use arrow_array::RecordBatch;
use arrow_select::coalesce::BatchCoalescer;
use plumbline_common::row::Status;

use super::columns::Columns;
use super::error::{ReduceFilesError, joined};
use super::float_file::FloatFile;
use super::intake::GroupFile;
use super::paths::Paths;
use super::places::Places;
use super::rows::check;
use super::scoring::Yardsticks;
use super::table::Table;
use super::trainer_lists::Lists;
use crate::publish::encode::Format;
use crate::publish::encode::batches::BatchWriter;
use crate::publish::manifests::DECISIONS;
use crate::publish::trainer_lists::TrainerLists;
use crate::publish::{OutDir, PublishError};
use crate::reduce::ReduceOptions;
use crate::reduce::rewards::Spread;
use crate::reduce::tally::Tally;
use tables::{Sink, Tables};

/// Rows completed at a time: a few MB in every column table.
const PIECE_ROWS: usize = 1 << 15;

/// Pieces that wait for a writer.
const WAITING: usize = 1;

/// Everything that the rows are completed with.
pub(super) struct Completion<'a> {
    pub(super) tables: &'a [Table],
    pub(super) groups: Option<&'a GroupFile>,
    pub(super) columns: &'a Columns,
    pub(super) yardsticks: &'a Yardsticks<'a>,
    pub(super) anomalies: &'a FloatFile,
    pub(super) rewards: Option<Spread>,
    pub(super) places: &'a Places,
    pub(super) options: &'a ReduceOptions,
}

/// One piece in every table.
#[derive(Clone)]
struct Piece {
    scores: RecordBatch,
    /// In the order of [`DECISIONS`].
    manifests: [RecordBatch; DECISIONS.len()],
    rewards: RecordBatch,
}

/// Writes scores, manifests, rewards and lists for trainers; says which files and counts the rows.
pub(super) fn write(
    out: &OutDir,
    completion: &Completion<'_>,
    paths: Paths,
    formats: &BTreeSet<Format>,
) -> Result<(Vec<String>, Tally), ReduceFilesError> {
    let tables = Tables::of(completion.columns);
    let (sinks, stale) = tables.sinks(formats);
    let mut written: Vec<String> = sinks.iter().map(|sink| sink.name.clone()).collect();
    for name in stale {
        out.remove(&name)?;
    }
    let (tally, lists) = std::thread::scope(|scope| {
        let (senders, writers): (Vec<_>, Vec<_>) = sinks
            .into_iter()
            .map(|sink| {
                let (sender, receiver) = sync_channel(WAITING);
                (sender, scope.spawn(move || drain(out, &sink, &receiver)))
            })
            .unzip();
        let completed = completion.complete_all(out, &tables, paths, &senders);
        // The writers end when nobody sends any more.
        drop(senders);
        for writer in writers {
            joined(writer.join())?;
        }
        completed
    })?;
    written.extend(lists.publish(out)?);
    Ok((written, tally))
}

fn drain(out: &OutDir, sink: &Sink, pieces: &Receiver<Arc<Piece>>) -> Result<(), ReduceFilesError> {
    let put: Result<(), PublishError> = out.put_atomic_with(&sink.name, |writer| {
        let mut table = BatchWriter::new(sink.format, &sink.schema, writer)?;
        for piece in pieces {
            table.write((sink.of)(&piece))?;
        }
        table.finish()
    });
    Ok(put?)
}

impl Completion<'_> {
    /// Reads all rows, completes them and sends them to every writer.
    fn complete_all(
        &self,
        out: &OutDir,
        tables: &Tables,
        mut paths: Paths,
        writers: &[SyncSender<Arc<Piece>>],
    ) -> Result<(Tally, TrainerLists), ReduceFilesError> {
        let names = self.columns.in_any(self.tables);
        let mut tally = Tally::default();
        let mut lists = Lists::of(out, self.columns);
        let mut row = 0;
        let mut send = |batch: RecordBatch, file: &str| -> Result<bool, ReduceFilesError> {
            let rows = batch.num_rows() as u64;
            let paths = paths.of(&batch);
            let checked = check(batch, file)?;
            let piece = self.complete(tables, checked, row, paths, &mut tally, &mut lists)?;
            row += rows;
            let piece = Arc::new(piece);
            // A writer that is gone has failed, and says so itself.
            Ok(writers
                .iter()
                .all(|writer| writer.send(Arc::clone(&piece)).is_ok()))
        };
        let mut pieces: Option<BatchCoalescer> = None;
        for table in self.tables {
            for batch in table.read(&names, None, PIECE_ROWS)? {
                let batch = self.columns.conform(&batch?, &names, table.name())?;
                let pieces =
                    pieces.get_or_insert_with(|| BatchCoalescer::new(batch.schema(), PIECE_ROWS));
                if pieces.is_empty() && batch.num_rows() == PIECE_ROWS {
                    // A whole piece as it is; anything else is cut and joined, which copies it.
                    if !send(batch, table.name())? {
                        return Ok((tally, lists.lists));
                    }
                    continue;
                }
                pieces
                    .push_batch(batch)
                    .map_err(|error| ReduceFilesError::source(table.name(), error))?;
                while let Some(piece) = pieces.next_completed_batch() {
                    if !send(piece, table.name())? {
                        return Ok((tally, lists.lists));
                    }
                }
            }
        }
        if let Some(mut pieces) = pieces {
            let finished = pieces.finish_buffered_batch();
            finished.map_err(|error| ReduceFilesError::source("the rows", error))?;
            while let Some(piece) = pieces.next_completed_batch() {
                if !send(piece, "the rows")? {
                    return Ok((tally, lists.lists));
                }
            }
        }
        Ok((tally, lists.lists))
    }
}

/// Statuses that leave a row without a remark in the exit code.
pub(super) fn complete(statuses: &std::collections::BTreeMap<String, u64>) -> bool {
    let fine = [Status::Scored, Status::Static].map(Status::as_str);
    statuses
        .iter()
        .all(|(name, &count)| count == 0 || fine.contains(&name.as_str()))
}
