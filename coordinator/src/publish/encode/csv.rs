//! CSV by RFC 4180: a header, CRLF line ends, quotes where needed. Null is the empty field, and so
//! is an empty text: CSV cannot tell them apart.

use std::io::Write;

use crate::publish::encode::{EncodeError, text_of};
use crate::publish::table::Column;

pub(super) fn write<R>(
    columns: &[Column<R>],
    records: &[R],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let mut writer = ::csv::WriterBuilder::new()
        .terminator(::csv::Terminator::CRLF)
        .from_writer(out);
    writer.write_record(columns.iter().map(|column| column.name.as_str()))?;
    for record in records {
        for column in columns {
            let text = text_of(column.cell(record))?;
            writer.write_field(text.as_deref().unwrap_or_default())?;
        }
        writer.write_record(None::<&[u8]>)?;
    }
    Ok(writer.flush()?)
}
