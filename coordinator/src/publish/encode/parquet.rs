//! Parquet with zstd, in bounded row groups; the file says who wrote it (name and version) but not
//! when, so that equal records give equal bytes.

use std::io::Write;
use std::sync::Arc;

use arrow_array::builder::{ListBuilder, StringBuilder, UInt32Builder};
use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, RecordBatchOptions, UInt32Array,
    UInt64Array,
};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;
use serde_json::Value;

use crate::publish::encode::{EncodeError, text_of};
use crate::publish::table::{Cell, Column, Kind};

/// Rows per batch handed to the writer: bounds the arrays held beside the records.
const BATCH_ROWS: usize = 8_192;
/// Rows per row group: readers skip and parallelise by it; about 20 MB of our columns unpacked.
pub(super) const ROW_GROUP_ROWS: usize = 65_536;

/// Records to columns of Arrow.
///
/// # Errors
/// [`EncodeError`] when a value does not fit its column.
pub fn to_batch<R>(columns: &[Column<R>], records: &[R]) -> Result<RecordBatch, EncodeError> {
    let fields: Vec<Field> = columns
        .iter()
        .map(|column| Field::new(&column.name, data_type(column.kind), true))
        .collect();
    let arrays = columns
        .iter()
        .map(|column| array(column, records))
        .collect::<Result<Vec<_>, _>>()?;
    let options = RecordBatchOptions::new().with_row_count(Some(records.len()));
    Ok(RecordBatch::try_new_with_options(
        Arc::new(Schema::new(fields)),
        arrays,
        &options,
    )?)
}

pub(super) fn write<R>(
    columns: &[Column<R>],
    records: &[R],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let fields: Vec<Field> = columns
        .iter()
        .map(|column| Field::new(&column.name, data_type(column.kind), true))
        .collect();
    let schema = Arc::new(Schema::new(fields));
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
        .set_created_by(format!("plumbline {}", env!("CARGO_PKG_VERSION")))
        .build();
    let mut writer = ArrowWriter::try_new(out, Arc::clone(&schema), Some(properties))?;
    for records in records.chunks(BATCH_ROWS) {
        let arrays = columns
            .iter()
            .map(|column| array(column, records))
            .collect::<Result<Vec<_>, _>>()?;
        let options = RecordBatchOptions::new().with_row_count(Some(records.len()));
        let batch = RecordBatch::try_new_with_options(Arc::clone(&schema), arrays, &options)?;
        writer.write(&batch)?;
    }
    writer.close()?;
    Ok(())
}

/// The Arrow type of a column.
#[must_use]
pub fn data_type(kind: Kind) -> DataType {
    match kind {
        Kind::Text => DataType::Utf8,
        Kind::UInt32 => DataType::UInt32,
        Kind::UInt64 => DataType::UInt64,
        Kind::Int64 => DataType::Int64,
        Kind::Float64 => DataType::Float64,
        Kind::Bool => DataType::Boolean,
        Kind::ListUInt32 => DataType::new_list(DataType::UInt32, true),
        Kind::ListText => DataType::new_list(DataType::Utf8, true),
    }
}

fn array<R>(column: &Column<R>, records: &[R]) -> Result<ArrayRef, EncodeError> {
    let cells = records.iter().map(|record| column.cell(record));
    Ok(match column.kind {
        Kind::Text => {
            let mut builder = StringBuilder::new();
            for cell in cells {
                builder.append_option(text_of(cell)?);
            }
            Arc::new(builder.finish())
        }
        Kind::UInt32 => Arc::new(
            cells
                .map(|cell| unsigned(cell).and_then(|n| u32::try_from(n).ok()))
                .collect::<UInt32Array>(),
        ),
        Kind::UInt64 => Arc::new(cells.map(unsigned).collect::<UInt64Array>()),
        Kind::Int64 => Arc::new(cells.map(signed).collect::<Int64Array>()),
        Kind::Float64 => Arc::new(cells.map(float).collect::<Float64Array>()),
        Kind::Bool => Arc::new(cells.map(boolean).collect::<BooleanArray>()),
        Kind::ListUInt32 => {
            let mut builder = ListBuilder::new(UInt32Builder::new());
            for cell in cells {
                builder.append_option(match cell {
                    Cell::Counts(counts) => Some(counts.iter().copied().map(Some).collect()),
                    Cell::Carried(Value::Array(values)) => Some(
                        values
                            .iter()
                            .map(|v| v.as_u64().and_then(|n| u32::try_from(n).ok()))
                            .collect::<Vec<_>>(),
                    ),
                    _ => None,
                });
            }
            Arc::new(builder.finish())
        }
        Kind::ListText => {
            let mut builder = ListBuilder::new(StringBuilder::new());
            for cell in cells {
                builder.append_option(match cell {
                    Cell::Texts(texts) => {
                        Some(texts.iter().map(|text| Some(text.as_str())).collect())
                    }
                    Cell::Carried(Value::Array(values)) => {
                        Some(values.iter().map(Value::as_str).collect::<Vec<_>>())
                    }
                    _ => None,
                });
            }
            Arc::new(builder.finish())
        }
    })
}

fn unsigned(cell: Cell<'_>) -> Option<u64> {
    match cell {
        Cell::Unsigned(count) => Some(count),
        Cell::Carried(value) => value.as_u64(),
        _ => None,
    }
}

fn signed(cell: Cell<'_>) -> Option<i64> {
    match cell {
        Cell::Unsigned(count) => i64::try_from(count).ok(),
        Cell::Carried(value) => value.as_i64(),
        _ => None,
    }
}

fn float(cell: Cell<'_>) -> Option<f64> {
    match cell {
        Cell::Float(value) => Some(value),
        Cell::Carried(value) => value.as_f64(),
        _ => None,
    }
}

fn boolean(cell: Cell<'_>) -> Option<bool> {
    match cell {
        Cell::Bool(value) => Some(value),
        Cell::Carried(Value::Bool(value)) => Some(*value),
        _ => None,
    }
}
