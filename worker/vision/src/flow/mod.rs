//! Dense optical flow fields and the methods that find them.
//!
//! Flows are in pixels of their own grid, `[H, W, 2]`, x (right) then y (down). [`mod@file`] reads and writes
//! them, [`accuracy`] holds them against ground truth.

pub mod accuracy;
pub mod dis;
pub mod file;
pub(crate) mod simd;

use crate::image::ImageError;

/// A dense flow field, `[H, W, 2]` row-major, x then y, in pixels of its own grid: the point at
/// column `x`, row `y` of the first frame is at `(x + u, y + v)` in the second.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Flow {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height * width` vectors.
    pub data: Vec<[f32; 2]>,
}

impl Flow {
    /// Nothing moves.
    #[must_use]
    pub fn still(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            data: vec![[0.0; 2]; width * height],
        }
    }
}

/// Why no flow was computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlowError {
    /// A frame is not a picture.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A frame is smaller than one patch.
    #[error("{width}x{height} frame is smaller than one {patch_size}-px patch")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Side of a patch, pixels.
        patch_size: usize,
    },
    /// The two frames differ in size.
    #[error("frames differ in size: {first:?} and {second:?} (width, height)")]
    SizeMismatch {
        /// Width and height of the first frame.
        first: (usize, usize),
        /// Width and height of the second frame.
        second: (usize, usize),
    },
    /// A frame was prepared with other parameters than the flow is asked with.
    #[error("frame was prepared with other parameters than those of this flow")]
    ParamsMismatch,
    /// A pixel is NaN, infinite or far outside 0..=255.
    #[error("pixel {index} is {value}, outside ±{limit}")]
    PixelOutOfRange {
        /// Flat index of the pixel.
        index: usize,
        /// Its value.
        value: f32,
        /// Largest magnitude accepted.
        limit: f32,
    },
    /// A parameter has no meaning.
    #[error("{name} = {value} is not allowed: {reason}")]
    InvalidParameter {
        /// The field's name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        reason: &'static str,
    },
}
