//! Archives of NumPy arrays.

use std::io::{self, Seek, Write};

use npyz::npz::NpzWriter;
use npyz::{AutoSerialize, WriterBuilder};
use zip::CompressionMethod;
use zip::write::FileOptions;

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
        let options = FileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1));
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
