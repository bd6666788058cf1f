//! A Parquet file of rows, read by column and row group from any thread.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader,
    ParquetRecordBatchReaderBuilder,
};
use parquet::errors::ParquetError;
use parquet::file::reader::{ChunkReader, Length};

use super::error::ReduceFilesError;

/// Rows per batch when columns are read.
pub(super) const BATCH_ROWS: usize = 8192;

/// Bytes read for the header of a page; its body is read by itself.
const READ_AHEAD_BYTES: usize = 1 << 12;

/// An open Parquet file.
#[derive(Debug, Clone)]
pub(super) struct TableFile {
    /// The name in messages.
    pub(super) name: String,
    place: Place,
    metadata: ArrowReaderMetadata,
}

/// Where a table lies. A file with a name is open only while it is read: there may be more parts than
/// a process may have open files.
#[derive(Debug, Clone)]
enum Place {
    Named(PathBuf),
    Scratch(Arc<File>),
}

impl Place {
    fn open(&self) -> io::Result<Positioned> {
        let file = match self {
            Self::Named(path) => Arc::new(File::open(path)?),
            Self::Scratch(file) => Arc::clone(file),
        };
        let len = file.metadata()?.len();
        Ok(Positioned { file, len })
    }
}

impl TableFile {
    /// A file of the user's.
    pub(super) fn named(path: &Path) -> Result<Self, ReduceFilesError> {
        Self::open(&path.display().to_string(), Place::Named(path.to_owned()))
    }

    /// A file of our own.
    pub(super) fn scratch(name: &str, file: File) -> Result<Self, ReduceFilesError> {
        Self::open(name, Place::Scratch(Arc::new(file)))
    }

    fn open(name: &str, place: Place) -> Result<Self, ReduceFilesError> {
        let failed = |error: &dyn std::fmt::Display| {
            ReduceFilesError::source(name, format!("is no readable Parquet file ({error})"))
        };
        let bytes = place.open().map_err(|error| failed(&error))?;
        // Types come from Parquet itself: what a writer calls large or viewed text is text.
        let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
        let metadata =
            ArrowReaderMetadata::load(&bytes, options).map_err(|error| failed(&error))?;
        Ok(Self {
            name: name.to_owned(),
            place,
            metadata,
        })
    }

    pub(super) fn schema(&self) -> &Schema {
        self.metadata.schema()
    }

    pub(super) fn rows(&self) -> u64 {
        self.row_groups().iter().sum()
    }

    /// Rows of each row group.
    pub(super) fn row_groups(&self) -> Vec<u64> {
        let groups = self.metadata.metadata().row_groups();
        groups
            .iter()
            .map(|group| u64::try_from(group.num_rows()).unwrap_or(0))
            .collect()
    }

    /// The named columns (those that there are) of some row groups, or of all.
    pub(super) fn read(
        &self,
        columns: &[&str],
        row_groups: Option<Vec<usize>>,
        batch_rows: usize,
    ) -> Result<Batches<'_>, ReduceFilesError> {
        let schema = self.metadata.parquet_schema();
        let roots = self.schema().fields().iter().enumerate();
        let wanted = roots
            .filter(|(_, field)| columns.contains(&field.name().as_str()))
            .map(|(index, _)| index);
        let mut builder = ParquetRecordBatchReaderBuilder::new_with_metadata(
            self.place
                .open()
                .map_err(|error| ReduceFilesError::source(&self.name, error))?,
            self.metadata.clone(),
        )
        .with_projection(ProjectionMask::roots(schema, wanted))
        .with_batch_size(batch_rows);
        if let Some(row_groups) = row_groups {
            builder = builder.with_row_groups(row_groups);
        }
        let reader = builder
            .build()
            .map_err(|error| ReduceFilesError::source(&self.name, error))?;
        Ok(Batches {
            name: &self.name,
            reader,
        })
    }
}

/// Batches of one file, in its order.
pub(super) struct Batches<'a> {
    name: &'a str,
    reader: ParquetRecordBatchReader,
}

impl Iterator for Batches<'_> {
    type Item = Result<RecordBatch, ReduceFilesError>;

    fn next(&mut self) -> Option<Self::Item> {
        let batch = self.reader.next()?;
        Some(batch.map_err(|error| {
            ReduceFilesError::source(
                self.name,
                format!("cannot be read ({error}); write it again"),
            )
        }))
    }
}

/// A file read at positions, so that threads do not move each other's place.
#[derive(Debug, Clone)]
struct Positioned {
    file: Arc<File>,
    len: u64,
}

/// A file read on from a position.
pub(super) struct ReadAt {
    file: Arc<File>,
    position: u64,
}

impl ReadAt {
    pub(super) fn new(file: Arc<File>, position: u64) -> Self {
        Self { file, position }
    }
}

impl Read for ReadAt {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read_at(buffer, self.position)?;
        self.position += n as u64;
        Ok(n)
    }
}

impl Length for Positioned {
    fn len(&self) -> u64 {
        self.len
    }
}

impl ChunkReader for Positioned {
    type T = BufReader<ReadAt>;

    fn get_read(&self, start: u64) -> Result<Self::T, ParquetError> {
        let from = ReadAt::new(Arc::clone(&self.file), start);
        Ok(BufReader::with_capacity(READ_AHEAD_BYTES, from))
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        let mut bytes = vec![0; length];
        self.file
            .read_exact_at(&mut bytes, start)
            .map_err(|error| ParquetError::External(Box::new(error)))?;
        Ok(bytes.into())
    }
}
