//! Why a learned measure gave nothing.

use super::network::NetworkError;
use crate::image::ImageError;

/// Why a learned measure gave nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LearnedError {
    /// A frame is not a picture.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A network failed.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The picture is smaller than the correlation pyramid allows.
    #[error(
        "a {width}x{height} picture is too small for the learned networks: {least} px are needed on each side"
    )]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Least side, pixels.
        least: usize,
    },
    /// A picture's sides are not multiples of a cell's.
    #[error("a {width}x{height} picture is not made of whole cells of {cell} px", cell = super::CELL_PX)]
    NotWholeCells {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Two frames differ in size.
    #[error("frames differ in size: {first:?} and {second:?} (width, height)")]
    SizeMismatch {
        /// Width and height of the first frame.
        first: (usize, usize),
        /// Width and height of the second frame.
        second: (usize, usize),
    },
    /// A frame is asked for that was never shown, or is no keyframe.
    #[error("frame {frame} is not a keyframe")]
    UnknownFrame {
        /// The frame's index.
        frame: usize,
    },
    /// An array does not have the values its use asks for.
    #[error("{name} has {actual} values, {expected} are needed")]
    LengthMismatch {
        /// The array.
        name: &'static str,
        /// Values needed.
        expected: usize,
        /// Values there.
        actual: usize,
    },
    /// A network gave NaN or an infinity.
    #[error("{name} is not finite: the model's weights or the picture are damaged")]
    NotFinite {
        /// The array.
        name: &'static str,
    },
}

/// [`LearnedError::LengthMismatch`] unless `actual` is `expected`.
pub(super) fn check_length(
    name: &'static str,
    actual: usize,
    expected: usize,
) -> Result<(), LearnedError> {
    if actual == expected {
        Ok(())
    } else {
        Err(LearnedError::LengthMismatch {
            name,
            expected,
            actual,
        })
    }
}

/// [`LearnedError::NotFinite`] unless every value is finite.
pub(super) fn check_finite(name: &'static str, values: &[f32]) -> Result<(), LearnedError> {
    if values.iter().all(|v| v.is_finite()) {
        Ok(())
    } else {
        Err(LearnedError::NotFinite { name })
    }
}
