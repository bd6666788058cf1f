//! Arrow batches into the same bytes as records: for tables that do not fit into memory.
//!
//! JSON Lines and CSV equal those of the record writers byte for byte. Parquet holds the same values
//! in the same types; columns whose values hardly repeat (floats, ranks, names) are stored plainly,
//! since a dictionary of distinct values only costs time and space.

use std::io::Write;

use arrow_array::cast::AsArray;
use arrow_array::{
    Array, BooleanArray, Float64Array, Int64Array, ListArray, RecordBatch, StringArray,
    UInt32Array, UInt64Array,
};
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
        let path = ColumnPath::from(name.as_str());
        let distinct = match field.data_type() {
            DataType::Float64 => {
                // The digits of a measure are noise: zstd saves 5% of them, at as much time as all
                // else takes. Snappy passes over noise, and still folds what repeats.
                properties = properties.set_column_compression(path.clone(), Compression::SNAPPY);
                true
            }
            DataType::UInt64 | DataType::Int64 => true,
            _ => DISTINCT_TEXTS.contains(&name.as_str()),
        };
        if distinct {
            properties = properties.set_column_dictionary_enabled(path, false);
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
    // What stands before each column that has values: its key, and whole columns of nulls before it.
    let mut columns = Vec::with_capacity(batch.num_columns());
    let mut before = vec![b'{'];
    for (index, (field, array)) in schema.fields().iter().zip(batch.columns()).enumerate() {
        if index > 0 {
            before.push(b',');
        }
        serde_json::to_writer(&mut before, field.name())?;
        before.push(b':');
        if array.null_count() == array.len() {
            before.extend_from_slice(b"null");
        } else {
            columns.push((std::mem::take(&mut before), Json::of(array)));
        }
    }
    before.extend_from_slice(b"}\n");
    for row in 0..batch.num_rows() {
        for (before, column) in &columns {
            text.extend_from_slice(before);
            column.write(row, text)?;
        }
        text.extend_from_slice(&before);
        if text.len() >= TEXT_BUFFER_BYTES {
            out.write_all(text)?;
            text.clear();
        }
    }
    Ok(())
}

/// A column as JSON, its type looked up once.
struct Json<'a> {
    array: &'a dyn Array,
    nulls: bool,
    values: JsonValues<'a>,
}

enum JsonValues<'a> {
    Text(&'a StringArray),
    Float64(&'a Float64Array),
    UInt64(&'a UInt64Array),
    UInt32(&'a UInt32Array),
    Int64(&'a Int64Array),
    Bool(&'a BooleanArray),
    List(&'a ListArray),
    /// Of no type that a column of ours has.
    Other,
}

impl<'a> Json<'a> {
    fn of(array: &'a dyn Array) -> Self {
        let values = match array.data_type() {
            DataType::Utf8 => JsonValues::Text(array.as_string()),
            DataType::Float64 => JsonValues::Float64(array.as_primitive()),
            DataType::UInt64 => JsonValues::UInt64(array.as_primitive()),
            DataType::UInt32 => JsonValues::UInt32(array.as_primitive()),
            DataType::Int64 => JsonValues::Int64(array.as_primitive()),
            DataType::Boolean => JsonValues::Bool(array.as_boolean()),
            _ => array
                .as_list_opt()
                .map_or(JsonValues::Other, JsonValues::List),
        };
        Self {
            array,
            nulls: array.null_count() > 0,
            values,
        }
    }

    fn write(&self, row: usize, text: &mut Vec<u8>) -> Result<(), EncodeError> {
        if self.nulls && self.array.is_null(row) {
            text.extend_from_slice(b"null");
            return Ok(());
        }
        match self.values {
            JsonValues::Text(values) => write_text(values.value(row), text)?,
            JsonValues::Float64(values) => {
                let value = values.value(row);
                // No output says NaN: it is null, as in the record writers.
                serde_json::to_writer(text, &value.is_finite().then_some(value))?;
            }
            JsonValues::UInt64(values) => serde_json::to_writer(text, &values.value(row))?,
            JsonValues::UInt32(values) => serde_json::to_writer(text, &values.value(row))?,
            JsonValues::Int64(values) => serde_json::to_writer(text, &values.value(row))?,
            JsonValues::Bool(values) => serde_json::to_writer(text, &values.value(row))?,
            JsonValues::List(values) => {
                let items = values.value(row);
                let column = Json::of(&items);
                text.push(b'[');
                for item in 0..items.len() {
                    if item > 0 {
                        text.push(b',');
                    }
                    column.write(item, text)?;
                }
                text.push(b']');
            }
            JsonValues::Other => text.extend_from_slice(b"null"),
        }
        Ok(())
    }
}

fn write_text(value: &str, text: &mut Vec<u8>) -> Result<(), EncodeError> {
    // Names hold nothing to escape, nearly always; looked at as a whole, which takes several bytes at
    // a time.
    let escaped = |byte: u8| (byte < 0x20) | (byte == b'"') | (byte == b'\\');
    if value.bytes().fold(false, |any, byte| any | escaped(byte)) {
        serde_json::to_writer(text, value)?;
    } else {
        text.push(b'"');
        text.extend_from_slice(value.as_bytes());
        text.push(b'"');
    }
    Ok(())
}

fn write_csv(
    batch: &RecordBatch,
    out: &mut csv::Writer<&mut (dyn Write + Send)>,
) -> Result<(), EncodeError> {
    let mut text = Vec::new();
    let columns: Vec<Json<'_>> = batch
        .columns()
        .iter()
        .map(|array| Json::of(array))
        .collect();
    for row in 0..batch.num_rows() {
        for column in &columns {
            if let JsonValues::Text(texts) = column.values {
                // Null is the empty field.
                let valid = texts.is_valid(row);
                out.write_field(if valid { texts.value(row) } else { "" })?;
                continue;
            }
            text.clear();
            column.write(row, &mut text)?;
            out.write_field(if text == b"null" {
                b""
            } else {
                text.as_slice()
            })?;
        }
        out.write_record(None::<&[u8]>)?;
    }
    Ok(())
}
