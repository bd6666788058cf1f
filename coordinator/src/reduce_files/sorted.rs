//! Rows in the order of `video`, whatever order they come in: an external distribution sort.
//!
//! Names drawn from all tables cut the range of names into buckets that fit into memory. The rows are
//! then read once and distributed: each piece of them is cut into buckets, and each cut appended to
//! one scratch file (Arrow IPC). The order of a bucket's names, 4 bytes a row, lies in a second file;
//! a bucket is put into it whenever it is read, so that rows are written once and nothing is merged.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Arc, Mutex};

use arrow_array::{Array, RecordBatch, UInt32Array};
use arrow_ipc::reader::StreamReader;
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{Schema, SchemaRef};
use arrow_select::concat::concat_batches;
use arrow_select::take::take_record_batch;

use super::columns::Columns;
use super::error::ReduceFilesError;
use super::names;
use super::rows::videos;
use super::table::{Batches, Table};
use super::table_file::{BATCH_ROWS, ReadAt};
use crate::in_parallel::in_parallel;

/// Names drawn for each bucket: the rows of a bucket are then as many as meant within some tenths.
const DRAWN_PER_BUCKET: u64 = 128;

/// Buckets, as long as that leaves each of them between [`super::Budget::bucket_bytes`] and
/// [`LARGEST_BUCKET`] of those: small ones are quick to handle, but many cut the rows into crumbs.
const BUCKETS: f64 = 256.0;
const LARGEST_BUCKET: f64 = 8.0;

/// Tables of which some rows are measured, to know how large a row is.
const MEASURED_TABLES: usize = 16;

/// The rows of some tables, ascending by `video`. A row group is a bucket.
#[derive(Debug)]
pub(super) struct Sorted {
    schema: SchemaRef,
    /// Cuts, in the order in which they were written.
    cuts: Arc<File>,
    buckets: Vec<Bucket>,
    /// For each row the place of the one that comes there, among the rows of its bucket.
    orders: File,
}

#[derive(Debug, Clone, Default)]
struct Bucket {
    rows: u64,
    /// Where its first row lies among all.
    first_row: u64,
    /// Where its cuts begin.
    cuts: Vec<u64>,
}

/// Sorts the rows of all tables by name; buckets hold `bucket_bytes` to eight times as much.
pub(super) fn sorted(
    tables: &[Table],
    columns: &Columns,
    scratch: &Path,
    bucket_bytes: usize,
    threads: usize,
) -> Result<Sorted, ReduceFilesError> {
    let names = columns.in_any(tables);
    let groups = row_groups(tables);
    let rows: u64 = groups.iter().map(|group| group.rows).sum();
    let bytes = rows as f64 * row_bytes(tables, columns, &names)?;
    let least = bucket_bytes as f64;
    let each = (bytes / BUCKETS).clamp(least, least * LARGEST_BUCKET);
    let buckets = ((bytes / each).ceil() as u64).clamp(1, rows.max(1));
    let splitters = splitters(tables, &groups, rows, buckets, threads)?;

    let cuts = Arc::new(tempfile::tempfile_in(scratch)?);
    let written = Mutex::new(Written {
        buckets: vec![Bucket::default(); splitters.len() + 1],
        end: 0,
    });
    let distribution = Distribution {
        schema: columns.schema_of(&names),
        splitters,
        cuts: &cuts,
        written: &written,
        piece_bytes: 2 * bucket_bytes,
    };
    in_parallel::<_, _, ReduceFilesError>(
        groups,
        threads,
        Held::default,
        |held, group| {
            let table = &tables[group.table];
            for batch in table.read(&names, Some(vec![group.row_group]), BATCH_ROWS)? {
                let batch = columns.conform(&batch?, &names, table.name())?;
                distribution.push(held, batch)?;
            }
            Ok(())
        },
        |mut held| distribution.cut(&mut held),
    )?;
    let schema = SchemaRef::clone(&distribution.schema);
    let written = written.into_inner().map_err(|_| ReduceFilesError::Thread)?;
    let mut buckets = written.buckets;
    buckets.retain(|bucket| bucket.rows > 0);
    let mut first_row = 0;
    for bucket in &mut buckets {
        bucket.first_row = first_row;
        first_row += bucket.rows;
    }
    let sorted = Sorted {
        schema,
        cuts,
        buckets,
        orders: tempfile::tempfile_in(scratch)?,
    };
    sorted.find_orders(threads)?;
    Ok(sorted)
}

/// A row group of one of the tables.
struct Group {
    table: usize,
    row_group: usize,
    first_row: u64,
    rows: u64,
}

fn row_groups(tables: &[Table]) -> Vec<Group> {
    let mut groups = Vec::new();
    let mut first_row = 0;
    for (table, rows) in tables.iter().enumerate() {
        for (row_group, rows) in rows.row_groups().into_iter().enumerate() {
            groups.push(Group {
                table,
                row_group,
                first_row,
                rows,
            });
            first_row += rows;
        }
    }
    groups
}

/// What a row takes in memory, in bytes, by the first rows of some tables.
fn row_bytes(tables: &[Table], columns: &Columns, names: &[&str]) -> Result<f64, ReduceFilesError> {
    let (mut rows, mut bytes) = (0, 0);
    for table in tables
        .iter()
        .step_by(tables.len().div_ceil(MEASURED_TABLES))
    {
        if let Some(batch) = table.read(names, Some(vec![0]), BATCH_ROWS)?.next() {
            let batch = columns.conform(&batch?, names, table.name())?;
            rows += batch.num_rows();
            bytes += batch.get_array_memory_size();
        }
    }
    Ok(bytes as f64 / rows.max(1) as f64)
}

/// Names between which about equally many rows lie, ascending.
fn splitters(
    tables: &[Table],
    groups: &[Group],
    rows: u64,
    buckets: u64,
    threads: usize,
) -> Result<Vec<String>, ReduceFilesError> {
    let step = (rows / (buckets * DRAWN_PER_BUCKET)).max(1);
    let drawn = Mutex::new(Vec::new());
    in_parallel::<_, _, ReduceFilesError>(
        groups.iter().collect(),
        threads,
        Vec::new,
        |found: &mut Vec<String>, group: &Group| {
            let table = &tables[group.table];
            let mut row = group.first_row;
            for batch in table.read(&["video"], Some(vec![group.row_group]), BATCH_ROWS)? {
                let batch = batch?;
                let names = videos(&batch, table.name())?;
                let end = row + names.len() as u64;
                let drawn = (row.next_multiple_of(step)..end).step_by(step as usize);
                found.extend(drawn.map(|at| names.value((at - row) as usize).to_owned()));
                row = end;
            }
            Ok(())
        },
        |found| {
            let mut drawn = drawn.lock().map_err(|_| ReduceFilesError::Thread)?;
            drawn.extend(found);
            Ok(())
        },
    )?;
    let mut drawn = drawn.into_inner().map_err(|_| ReduceFilesError::Thread)?;
    drawn.sort_unstable();
    let mut splitters: Vec<String> = (1..buckets)
        .filter_map(|k| {
            drawn
                .get((k as usize * drawn.len()) / buckets as usize)
                .cloned()
        })
        .collect();
    splitters.dedup();
    Ok(splitters)
}

/// Rows read, and not yet distributed.
#[derive(Default)]
struct Held {
    batches: Vec<RecordBatch>,
    bytes: usize,
}

struct Written {
    buckets: Vec<Bucket>,
    /// Where the next cut goes.
    end: u64,
}

struct Distribution<'a> {
    schema: SchemaRef,
    /// The lowest name of every bucket but the first.
    splitters: Vec<String>,
    cuts: &'a File,
    written: &'a Mutex<Written>,
    /// Bytes of rows that are distributed together.
    piece_bytes: usize,
}

impl Distribution<'_> {
    fn push(&self, held: &mut Held, batch: RecordBatch) -> Result<(), ReduceFilesError> {
        held.bytes += batch.get_array_memory_size();
        held.batches.push(batch);
        if held.bytes >= self.piece_bytes {
            self.cut(held)?;
        }
        Ok(())
    }

    /// Appends what is held to the buckets.
    fn cut(&self, held: &mut Held) -> Result<(), ReduceFilesError> {
        let held = std::mem::take(held);
        let piece = concat_batches(&self.schema, &held.batches).map_err(encode)?;
        drop(held);
        let names = videos(&piece, "the rows")?;
        let bucket_of: Vec<u32> = names
            .iter()
            .map(|name| {
                let name = name.unwrap_or_default();
                self.splitters.partition_point(|low| low.as_str() <= name) as u32
            })
            .collect();
        // By bucket, and as they come within one.
        let mut ends = vec![0; self.splitters.len() + 1];
        for &bucket in &bucket_of {
            ends[bucket as usize] += 1;
        }
        let counts = ends.clone();
        let mut next = 0;
        for end in &mut ends {
            next += std::mem::replace(end, next);
        }
        let mut rows = vec![0; bucket_of.len()];
        for (row, &bucket) in bucket_of.iter().enumerate() {
            let place = &mut ends[bucket as usize];
            rows[*place] = row as u32;
            *place += 1;
        }
        let piece = take_record_batch(&piece, &UInt32Array::from(rows)).map_err(encode)?;
        let mut cut = Vec::new();
        for (bucket, (&count, &end)) in counts.iter().zip(&ends).enumerate() {
            if count == 0 {
                continue;
            }
            cut.clear();
            let mut writer = StreamWriter::try_new(&mut cut, &self.schema).map_err(encode)?;
            writer
                .write(&piece.slice(end - count, count))
                .map_err(encode)?;
            writer.finish().map_err(encode)?;
            let mut written = self.written.lock().map_err(|_| ReduceFilesError::Thread)?;
            let position = written.end;
            written.end += cut.len() as u64;
            written.buckets[bucket].rows += count as u64;
            written.buckets[bucket].cuts.push(position);
            drop(written);
            self.cuts.write_all_at(&cut, position)?;
        }
        Ok(())
    }
}

impl Sorted {
    pub(super) fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Rows of each bucket.
    pub(super) fn row_groups(&self) -> Vec<u64> {
        self.buckets.iter().map(|bucket| bucket.rows).collect()
    }

    /// Finds the order of every bucket; two rows of one name are refused.
    fn find_orders(&self, threads: usize) -> Result<(), ReduceFilesError> {
        // The lowest one, whichever is found first.
        let twice: Mutex<Option<String>> = Mutex::new(None);
        in_parallel::<_, _, ReduceFilesError>(
            self.buckets.iter().collect(),
            threads,
            || (),
            |(), bucket| {
                let batch = self.load(bucket, &["video"])?;
                let names = videos(&batch, "the rows")?;
                let order = names::order(names);
                let name = |row: u32| names.value(row as usize);
                if let Some(pair) = order.windows(2).find(|pair| name(pair[0]) == name(pair[1])) {
                    let mut twice = twice.lock().map_err(|_| ReduceFilesError::Thread)?;
                    let lower = twice.as_deref().is_none_or(|found| name(pair[0]) < found);
                    if lower {
                        *twice = Some(name(pair[0]).to_owned());
                    }
                }
                let bytes: Vec<u8> = order.iter().flat_map(|row| row.to_le_bytes()).collect();
                Ok(self.orders.write_all_at(&bytes, bucket.first_row * 4)?)
            },
            |()| Ok(()),
        )?;
        match twice.into_inner().map_err(|_| ReduceFilesError::Thread)? {
            Some(video) => Err(ReduceFilesError::Duplicate { video }),
            None => Ok(()),
        }
    }

    /// The named columns of a bucket, in the order in which they were written.
    fn load(&self, bucket: &Bucket, columns: &[&str]) -> Result<RecordBatch, ReduceFilesError> {
        let fields = self.schema.fields().iter().enumerate();
        let projection: Vec<usize> = fields
            .filter(|(_, field)| columns.contains(&field.name().as_str()))
            .map(|(index, _)| index)
            .collect();
        let mut batches = Vec::with_capacity(bucket.cuts.len());
        for &cut in &bucket.cuts {
            let cut = ReadAt::new(Arc::clone(&self.cuts), cut);
            let reader = StreamReader::try_new(cut, Some(projection.clone())).map_err(encode)?;
            for batch in reader {
                batches.push(batch.map_err(encode)?);
            }
        }
        let schema = Arc::new(self.schema.project(&projection).map_err(encode)?);
        concat_batches(&schema, &batches).map_err(encode)
    }

    /// The named columns of some buckets, or of all, in order.
    pub(super) fn read<'a>(
        &'a self,
        columns: &[&str],
        buckets: Option<Vec<usize>>,
        batch_rows: usize,
    ) -> impl Iterator<Item = Result<RecordBatch, ReduceFilesError>> + use<'a> {
        let columns: Vec<String> = columns.iter().map(|&column| column.to_owned()).collect();
        let buckets = buckets.unwrap_or_else(|| (0..self.buckets.len()).collect());
        buckets.into_iter().flat_map(move |bucket| {
            let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
            match self.in_order(&self.buckets[bucket], &columns) {
                Err(error) => Box::new(std::iter::once(Err(error))) as Batches<'a>,
                Ok((rows, order)) => {
                    let starts = (0..order.len()).step_by(batch_rows);
                    Box::new(starts.map(move |start| {
                        let piece = order.slice(start, batch_rows.min(order.len() - start));
                        take_record_batch(&rows, &piece).map_err(encode)
                    }))
                }
            }
        })
    }

    /// Columns of a bucket as they were written, and the order to take them in.
    fn in_order(
        &self,
        bucket: &Bucket,
        columns: &[&str],
    ) -> Result<(RecordBatch, UInt32Array), ReduceFilesError> {
        let mut bytes = vec![0; bucket.rows as usize * 4];
        self.orders
            .read_exact_at(&mut bytes, bucket.first_row * 4)?;
        let order = bytes.as_chunks::<4>().0.iter();
        let order = order.map(|row| u32::from_le_bytes(*row)).collect();
        Ok((self.load(bucket, columns)?, order))
    }
}

fn encode(error: arrow_schema::ArrowError) -> ReduceFilesError {
    ReduceFilesError::Encode(error.into())
}
