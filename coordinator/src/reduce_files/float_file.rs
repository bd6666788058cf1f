//! One float per row in a scratch file: 8 bytes a row on disk instead of in memory. NaN is a row
//! without a value.
//!
//! Statistics go through such a file several times; what fits the page cache is read at the speed of
//! memory, and nothing of it counts against the process.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

use crate::reduce::values::Values;

/// Values per read: 256 KiB.
const PIECE: usize = 1 << 15;

/// A column of floats by row index.
#[derive(Debug, Clone)]
pub(super) struct FloatFile {
    file: Arc<File>,
    /// Where row 0 lies in the file, in rows.
    start: u64,
    rows: u64,
    threads: usize,
}

impl FloatFile {
    /// A file without a name in `directory`: it is gone with the process, however that ends.
    pub(super) fn create(directory: &Path, rows: u64, threads: usize) -> io::Result<Self> {
        let file = tempfile::tempfile_in(directory)?;
        Ok(Self {
            file: Arc::new(file),
            start: 0,
            rows,
            threads,
        })
    }

    pub(super) fn rows(&self) -> u64 {
        self.rows
    }

    /// Some rows of it, as a file of their own.
    pub(super) fn section(&self, rows: std::ops::Range<u64>) -> Self {
        Self {
            file: Arc::clone(&self.file),
            start: self.start + rows.start,
            rows: rows.end - rows.start,
            threads: self.threads,
        }
    }

    /// Writes values from a row on.
    pub(super) fn write(&self, row: u64, values: &[f64]) -> io::Result<()> {
        let mut bytes = vec![0; values.len() * 8];
        for (bytes, value) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(values) {
            *bytes = value.to_le_bytes();
        }
        self.file.write_all_at(&bytes, (self.start + row) * 8)
    }

    /// Reads as many values as `values` holds, from a row on.
    pub(super) fn read(&self, row: u64, values: &mut [f64], bytes: &mut Vec<u8>) -> io::Result<()> {
        bytes.resize(values.len() * 8, 0);
        self.file.read_exact_at(bytes, (self.start + row) * 8)?;
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *value = f64::from_le_bytes(*bytes);
        }
        Ok(())
    }

    /// Hands the values of some rows on in pieces, NaN included.
    pub(super) fn pieces(
        &self,
        rows: std::ops::Range<u64>,
        mut each: impl FnMut(u64, &mut [f64]) -> io::Result<()>,
    ) -> io::Result<()> {
        let mut values = vec![0.0; PIECE];
        let mut bytes = Vec::new();
        let mut row = rows.start;
        while row < rows.end {
            let n = (rows.end - row).min(PIECE as u64) as usize;
            self.read(row, &mut values[..n], &mut bytes)?;
            each(row, &mut values[..n])?;
            row += n as u64;
        }
        Ok(())
    }
}

/// `rows` in as many ranges of like size as there are threads.
pub(super) fn shares(rows: u64, threads: usize) -> Vec<std::ops::Range<u64>> {
    let threads = threads.max(1) as u64;
    (0..threads)
        .map(|k| rows * k / threads..rows * (k + 1) / threads)
        .collect()
}

/// Brings the values to the front and says how many there are.
fn compact(values: &mut [f64]) -> usize {
    let mut kept = 0;
    for i in 0..values.len() {
        let value = values[i];
        values[kept] = value;
        kept += usize::from(!value.is_nan());
    }
    kept
}

impl Values for FloatFile {
    type Error = io::Error;

    fn fold<S: Send>(
        &self,
        start: &(dyn Fn() -> S + Sync),
        step: &(dyn Fn(&mut S, &[f64]) + Sync),
        merge: &dyn Fn(&mut S, S),
    ) -> Result<S, io::Error> {
        let share = |rows: std::ops::Range<u64>| -> io::Result<S> {
            let mut state = start();
            self.pieces(rows, |_, values| {
                let kept = compact(values);
                step(&mut state, &values[..kept]);
                Ok(())
            })?;
            Ok(state)
        };
        let mut shares = shares(self.rows, self.threads).into_iter();
        let Some(own) = shares.next() else {
            return Ok(start());
        };
        std::thread::scope(|scope| {
            let share = &share;
            let others: Vec<_> = shares
                .map(|rows| scope.spawn(move || share(rows)))
                .collect();
            let mut state = share(own)?;
            for other in others {
                let broken = |_| io::Error::other("a thread of the reduce broke down");
                merge(&mut state, other.join().map_err(broken)??);
            }
            Ok(state)
        })
    }
}
