//! A table of rows, read by column and by row group: a Parquet file, or rows put in order.

use arrow_array::RecordBatch;
use arrow_schema::Schema;

use super::error::ReduceFilesError;
use super::sorted::Sorted;
use super::table_file::TableFile;

/// Rows that can be read again and again, from any thread.
#[derive(Debug)]
pub(super) enum Table {
    /// As they lie in a file.
    File(TableFile),
    /// By `video`.
    Sorted(Sorted),
}

/// Batches in the order of their table.
pub(super) type Batches<'a> = Box<dyn Iterator<Item = Result<RecordBatch, ReduceFilesError>> + 'a>;

impl Table {
    /// The name in messages.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::File(file) => &file.name,
            Self::Sorted(_) => "the sorted rows",
        }
    }

    pub(super) fn schema(&self) -> &Schema {
        match self {
            Self::File(file) => file.schema(),
            Self::Sorted(sorted) => sorted.schema(),
        }
    }

    /// Rows of each row group.
    pub(super) fn row_groups(&self) -> Vec<u64> {
        match self {
            Self::File(file) => file.row_groups(),
            Self::Sorted(sorted) => sorted.row_groups(),
        }
    }

    /// The named columns (those that there are) of some row groups, or of all.
    pub(super) fn read(
        &self,
        columns: &[&str],
        row_groups: Option<Vec<usize>>,
        batch_rows: usize,
    ) -> Result<Batches<'_>, ReduceFilesError> {
        Ok(match self {
            Self::File(file) => Box::new(file.read(columns, row_groups, batch_rows)?),
            Self::Sorted(sorted) => Box::new(sorted.read(columns, row_groups, batch_rows)),
        })
    }
}
