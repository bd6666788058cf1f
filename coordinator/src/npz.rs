//! Archives of NumPy arrays.

use std::io::{self, Seek, Write};

use npyz::npz::NpzWriter;
use npyz::{AutoSerialize, WriterBuilder};
use zip::write::FileOptions;
use zip::{CompressionMethod, DateTime};

/// An archive of NumPy arrays, deflated.
pub(crate) struct Npz<W: Write + Seek> {
    zip: NpzWriter<W>,
}

impl<W: Write + Seek> Npz<W> {
    /// An empty archive.
    pub(crate) fn new(to: W) -> Self {
        Self {
            zip: NpzWriter::new(to),
        }
    }

    /// Adds an array; `values` are as many as `shape` asks for.
    pub(crate) fn array<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        // Fastest level: the arrays are hundreds of megabytes raw, and mostly zeros.
        // No time: equal arrays give equal files.
        let options = FileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1))
            .last_modified_time(DateTime::default());
        let mut writer = self
            .zip
            .array(name, options)?
            .default_dtype()
            .shape(shape)
            .begin_nd()?;
        writer.extend(values)?;
        writer.finish()
    }

    /// Writes the directory; gives back what was written to, not yet flushed.
    pub(crate) fn finish(mut self) -> io::Result<W> {
        Ok(self.zip.zip_writer().finish()?)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn an_archive_does_not_tell_when_it_was_written() {
        let mut archive = Npz::new(Cursor::new(Vec::new()));
        archive.array("a", &[2], [1.0_f32, 2.0]).unwrap();
        let bytes = archive.finish().unwrap().into_inner();
        // Time and date in the first local header (PKWARE APPNOTE 4.3.7): midnight, 1 January 1980.
        assert_eq!(bytes[10..14], [0, 0, 0x21, 0]);
    }
}
