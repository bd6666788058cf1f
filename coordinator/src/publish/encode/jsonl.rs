//! JSON Lines: one object per record and line, keys in column order, nulls written, floats as the
//! shortest text that reads back to the same bits.

use std::io::Write;

use crate::publish::encode::EncodeError;
use crate::publish::table::{Cell, Column};

pub(super) fn write<R>(
    columns: &[Column<R>],
    records: &[R],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let mut line = Vec::new();
    for record in records {
        line.clear();
        line.push(b'{');
        for (index, column) in columns.iter().enumerate() {
            if index > 0 {
                line.push(b',');
            }
            serde_json::to_writer(&mut line, &column.name)?;
            line.push(b':');
            match column.cell(record) {
                Cell::Null => line.extend_from_slice(b"null"),
                Cell::Text(text) => serde_json::to_writer(&mut line, text)?,
                Cell::Unsigned(count) => serde_json::to_writer(&mut line, &count)?,
                Cell::Float(value) => serde_json::to_writer(&mut line, &value)?,
                Cell::Bool(value) => serde_json::to_writer(&mut line, &value)?,
                Cell::Counts(counts) => serde_json::to_writer(&mut line, counts)?,
                Cell::Texts(texts) => serde_json::to_writer(&mut line, texts)?,
                Cell::Carried(value) => serde_json::to_writer(&mut line, value)?,
            }
        }
        line.extend_from_slice(b"}\n");
        out.write_all(&line)?;
    }
    Ok(())
}
