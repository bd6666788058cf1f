//! Flow fields as files, bytes in and bytes out: [`middlebury`] (`.flo`, 32-bit floats) and [`kitti`]
//! (16-bit png, 1/64 px). Both can say of single pixels that their flow is unknown.
//!
//! Vectors are pixels of the field's own grid, `[H, W, 2]`, x then y. Nothing is allocated on a
//! header's word: the size is held against the bytes that are there first. Fails with
//! [`FlowFileError`], whose text says what to do; the caller knows and names the file.

pub mod kitti;
pub mod middlebury;

use super::Flow;

/// Largest field that is read or written, pixels: 8192 × 8192.
pub const MAX_PIXELS: u64 = 1 << 26;

/// A flow that may be unknown in places, as ground truth is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KnownFlow {
    /// The vectors; zero where unknown.
    pub flow: Flow,
    /// `height * width`, row-major: whether the vector is known.
    pub known: Vec<bool>,
}

impl KnownFlow {
    /// A flow that is known everywhere.
    #[must_use]
    pub fn dense(flow: Flow) -> Self {
        let known = vec![true; flow.data.len()];
        Self { flow, known }
    }

    /// Checks that buffers and size agree and that there is something to write.
    fn validate(&self) -> Result<(), FlowFileError> {
        let Flow {
            width,
            height,
            ref data,
        } = self.flow;
        check_size(width as u64, height as u64)?;
        let pixels = width * height;
        if (data.len(), self.known.len()) == (pixels, pixels) {
            return Ok(());
        }
        Err(FlowFileError::Incomplete {
            width,
            height,
            vectors: data.len().min(self.known.len()),
        })
    }
}

/// Why bytes are no flow, or a flow does not fit a format.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlowFileError {
    /// The bytes do not begin as this format does.
    #[error("is no {format} file: {reason}; give a Middlebury .flo or a KITTI 16-bit png")]
    WrongFormat {
        /// Name of the format.
        format: &'static str,
        /// What is there instead.
        reason: String,
    },
    /// The header names a size that no flow has.
    #[error(
        "holds a flow of {width}x{height}; sizes must be 1x1 to {MAX_PIXELS} pixels, so the file is damaged or no flow"
    )]
    Size {
        /// Columns, as the header has them.
        width: i64,
        /// Rows, as the header has them.
        height: i64,
    },
    /// The bytes end early, or go on after the last vector.
    #[error("has {found} bytes where a {width}x{height} flow has {expected}; copy it again")]
    Length {
        /// Columns, as the header has them.
        width: u64,
        /// Rows, as the header has them.
        height: u64,
        /// Bytes that this size asks for.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// The png does not decode.
    #[error("does not decode as png ({reason}); copy it again")]
    Damaged {
        /// As the decoder said.
        reason: String,
    },
    /// A known vector cannot be written in this format.
    #[error(
        "vector {index} is ({}, {}) px, which the format cannot hold ({range}); write another format", vector[0], vector[1]
    )]
    OutOfRange {
        /// Flat index of the vector.
        index: usize,
        /// The vector, x then y.
        vector: [f32; 2],
        /// What can be held.
        range: &'static str,
    },
    /// The field to write does not have as many vectors as its size says.
    #[error("a {width}x{height} flow with {vectors} vectors cannot be written")]
    Incomplete {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Vectors there are.
        vectors: usize,
    },
}

fn check_size(width: u64, height: u64) -> Result<(), FlowFileError> {
    match width.checked_mul(height) {
        Some(1..=MAX_PIXELS) => Ok(()),
        _ => Err(FlowFileError::Size {
            width: i64::try_from(width).unwrap_or(i64::MAX),
            height: i64::try_from(height).unwrap_or(i64::MAX),
        }),
    }
}
