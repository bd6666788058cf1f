//! Pictures in memory: 8-bit RGB frames and single-channel float planes, row-major, top-left origin.

/// An 8-bit RGB picture, `[H, W, 3]` row-major, sRGB as decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rgb8 {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height * width * 3` bytes.
    pub data: Vec<u8>,
}

/// A single-channel float plane, `[H, W]` row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height * width` values.
    pub data: Vec<f32>,
}
