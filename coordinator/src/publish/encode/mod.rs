//! Rows into bytes: JSON Lines, CSV and Parquet from the same column table.
//!
//! Each writer is a function of the columns and the records alone, so that equal rows give equal
//! bytes: no time stamps, no hash order.

pub mod batches;
mod csv;
mod jsonl;
mod parquet;

use std::borrow::Cow;
use std::io::{self, Write};

use serde_json::Value;

use crate::publish::table::{Cell, Column};
pub use parquet::{data_type, to_batch};

/// A table format.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    serde::Serialize,
    serde::Deserialize,
    clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Columns, compressed, typed.
    Parquet,
    /// One JSON object per line.
    Jsonl,
    /// RFC 4180; an empty field is null.
    Csv,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::Parquet, Self::Jsonl, Self::Csv];

    /// The file name's extension.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Jsonl => "jsonl",
            Self::Csv => "csv",
        }
    }
}

/// Why records could not be encoded.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// The writer underneath failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A JSON value could not be written.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// A CSV record could not be written.
    #[error(transparent)]
    Csv(#[from] ::csv::Error),
    /// The column arrays do not fit their schema.
    #[error(transparent)]
    Arrow(#[from] arrow_schema::ArrowError),
    /// The Parquet writer failed.
    #[error(transparent)]
    Parquet(#[from] ::parquet::errors::ParquetError),
}

/// Writes `records` to `out` in `format`.
///
/// # Errors
/// [`EncodeError`] when the writer fails or a value does not fit the format.
pub fn write<R>(
    format: Format,
    columns: &[Column<R>],
    records: &[R],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    match format {
        Format::Parquet => parquet::write(columns, records, out),
        Format::Jsonl => jsonl::write(columns, records, out),
        Format::Csv => csv::write(columns, records, out),
    }
}

/// The bytes of `records` in `format`.
///
/// # Errors
/// [`EncodeError`] when a value does not fit the format.
pub fn to_bytes<R>(
    format: Format,
    columns: &[Column<R>],
    records: &[R],
) -> Result<Vec<u8>, EncodeError> {
    let mut bytes = Vec::new();
    write(format, columns, records, &mut bytes)?;
    Ok(bytes)
}

/// The value as plain text; `None` where it is missing. Floats are the shortest text that reads
/// back to the same bits, as in JSON Lines.
fn text_of(cell: Cell<'_>) -> Result<Option<Cow<'_, str>>, serde_json::Error> {
    Ok(match cell {
        Cell::Null => None,
        Cell::Text(text) => Some(Cow::Borrowed(text)),
        Cell::Unsigned(count) => Some(Cow::Owned(count.to_string())),
        Cell::Float(value) => Some(Cow::Owned(serde_json::to_string(&value)?)),
        Cell::Bool(value) => Some(Cow::Borrowed(if value { "true" } else { "false" })),
        Cell::Counts(counts) => Some(Cow::Owned(serde_json::to_string(counts)?)),
        Cell::Texts(texts) => Some(Cow::Owned(serde_json::to_string(texts)?)),
        Cell::Carried(Value::String(text)) => Some(Cow::Borrowed(text)),
        Cell::Carried(value) => Some(Cow::Owned(serde_json::to_string(value)?)),
    })
}
