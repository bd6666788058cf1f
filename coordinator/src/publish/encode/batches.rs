//! Arrow batches into the same bytes as records: for tables that do not fit into memory.
//!
//! JSON Lines and CSV equal those of the record writers byte for byte. Parquet holds the same values
//! in the same types; columns whose values hardly repeat (floats, ranks, names) are stored plainly,
//! since a dictionary of distinct values only costs time and space.

use std::io::Write;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type, UInt32Type, UInt64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::{DataType, Schema, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;

use super::{EncodeError, Format};

/// Text columns of ours whose values differ from row to row.
const DISTINCT_TEXTS: [&str; 3] = ["video", "path", "digest"];

/// Bytes of text gathered before they are written.
const TEXT_BUFFER_BYTES: usize = 1 << 20;

/// Writes batches of one schema in one format.
pub struct BatchWriter<'w>(Kinds<'w>);

enum Kinds<'w> {
    Parquet(Box<ArrowWriter<&'w mut (dyn Write + Send)>>),
    Jsonl {
        out: &'w mut (dyn Write + Send),
        text: Vec<u8>,
    },
    Csv {
        out: Box<csv::Writer<&'w mut (dyn Write + Send)>>,
        started: bool,
        names: Vec<String>,
    },
}

impl<'w> BatchWriter<'w> {
    /// Starts a table.
    ///
    /// # Errors
    /// [`EncodeError`].
    pub fn new(
        format: Format,
        schema: &SchemaRef,
        out: &'w mut (dyn Write + Send),
    ) -> Result<Self, EncodeError> {
        Ok(Self(match format {
            Format::Parquet => Kinds::Parquet(Box::new(ArrowWriter::try_new(
                out,
                SchemaRef::clone(schema),
                Some(properties(schema)),
            )?)),
            Format::Jsonl => Kinds::Jsonl {
                out,
                text: Vec::with_capacity(TEXT_BUFFER_BYTES + TEXT_BUFFER_BYTES / 8),
            },
            Format::Csv => Kinds::Csv {
                out: Box::new(
                    csv::WriterBuilder::new()
                        .terminator(csv::Terminator::CRLF)
                        .from_writer(out),
                ),
                started: false,
                names: schema
                    .fields()
                    .iter()
                    .map(|field| field.name().clone())
                    .collect(),
            },
        }))
    }

    /// Writes one batch.
    ///
    /// # Errors
    /// [`EncodeError`].
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), EncodeError> {
        match &mut self.0 {
            Kinds::Parquet(writer) => Ok(writer.write(batch)?),
            Kinds::Jsonl { out, text } => write_jsonl(batch, text, out),
            Kinds::Csv {
                out,
                started,
                names,
            } => {
                if !std::mem::replace(started, true) {
                    out.write_record(names.iter())?;
                }
                write_csv(batch, out)
            }
        }
    }

    /// Ends the table.
    ///
    /// # Errors
    /// [`EncodeError`].
    pub fn finish(self) -> Result<(), EncodeError> {
        match self.0 {
            Kinds::Parquet(writer) => {
                writer.close()?;
            }
            Kinds::Jsonl { out, text } => out.write_all(&text)?,
            Kinds::Csv {
                mut out,
                started,
                names,
            } => {
                if !started {
                    out.write_record(names.iter())?;
                }
                out.flush()?;
            }
        }
        Ok(())
    }
}

fn properties(schema: &Schema) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_max_row_group_row_count(Some(super::parquet::ROW_GROUP_ROWS))
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_created_by(format!("plumbline {}", env!("CARGO_PKG_VERSION")));
    for field in schema.fields() {
        let name = field.name();
        let distinct = match field.data_type() {
            DataType::Float64 | DataType::UInt64 | DataType::Int64 => true,
            _ => DISTINCT_TEXTS.contains(&name.as_str()),
        };
        if distinct {
            properties =
                properties.set_column_dictionary_enabled(ColumnPath::from(name.as_str()), false);
        }
    }
    properties.build()
}

fn write_jsonl(
    batch: &RecordBatch,
    text: &mut Vec<u8>,
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let schema = batch.schema();
    let mut columns = Vec::with_capacity(batch.num_columns());
    for (index, (field, array)) in schema.fields().iter().zip(batch.columns()).enumerate() {
        let mut key = vec![if index == 0 { b'{' } else { b',' }];
        serde_json::to_writer(&mut key, field.name())?;
        key.push(b':');
        columns.push((key, array));
    }
    for row in 0..batch.num_rows() {
        for (key, array) in &columns {
            text.extend_from_slice(key);
            if array.is_null(row) {
                text.extend_from_slice(b"null");
            } else {
                write_json(array, row, text)?;
            }
        }
        text.extend_from_slice(if columns.is_empty() { b"{}\n" } else { b"}\n" });
        if text.len() >= TEXT_BUFFER_BYTES {
            out.write_all(text)?;
            text.clear();
        }
    }
    Ok(())
}

/// One value that is not null.
fn write_json(array: &ArrayRef, row: usize, text: &mut Vec<u8>) -> Result<(), EncodeError> {
    match array.data_type() {
        DataType::Utf8 => {
            write_text(array.as_string::<i32>().value(row), text)?;
        }
        DataType::Float64 => {
            let value = array.as_primitive::<Float64Type>().value(row);
            // No output says NaN: it is null, as in the record writers.
            serde_json::to_writer(text, &value.is_finite().then_some(value))?;
        }
        DataType::UInt64 => {
            serde_json::to_writer(text, &array.as_primitive::<UInt64Type>().value(row))?;
        }
        DataType::UInt32 => {
            serde_json::to_writer(text, &array.as_primitive::<UInt32Type>().value(row))?;
        }
        DataType::Int64 => {
            serde_json::to_writer(text, &array.as_primitive::<Int64Type>().value(row))?;
        }
        DataType::Boolean => {
            serde_json::to_writer(text, &array.as_boolean().value(row))?;
        }
        _ => {
            let Some(list) = array.as_list_opt::<i32>() else {
                text.extend_from_slice(b"null");
                return Ok(());
            };
            let items = list.value(row);
            for item in 0..items.len() {
                text.push(if item == 0 { b'[' } else { b',' });
                if items.is_null(item) {
                    text.extend_from_slice(b"null");
                } else {
                    write_json(&items, item, text)?;
                }
            }
            text.extend_from_slice(if items.is_empty() { b"[]" } else { b"]" });
        }
    }
    Ok(())
}

fn write_text(value: &str, text: &mut Vec<u8>) -> Result<(), EncodeError> {
    // Names hold nothing to escape, nearly always.
    if value.bytes().all(|b| b >= 0x20 && b != b'"' && b != b'\\') {
        text.push(b'"');
        text.extend_from_slice(value.as_bytes());
        text.push(b'"');
    } else {
        serde_json::to_writer(text, value)?;
    }
    Ok(())
}

fn write_csv(
    batch: &RecordBatch,
    out: &mut csv::Writer<&mut (dyn Write + Send)>,
) -> Result<(), EncodeError> {
    let mut text = Vec::new();
    for row in 0..batch.num_rows() {
        for array in batch.columns() {
            text.clear();
            if array.is_null(row) {
                out.write_field(b"")?;
            } else if let Some(texts) = array.as_string_opt::<i32>() {
                out.write_field(texts.value(row))?;
            } else {
                write_json(array, row, &mut text)?;
                out.write_field(if text == b"null" {
                    b""
                } else {
                    text.as_slice()
                })?;
            }
        }
        out.write_record(None::<&[u8]>)?;
    }
    Ok(())
}
