//! Dense optical flow fields and the methods that find them.

/// A dense flow field, `[H, W, 2]` row-major, x then y, in pixels of its own grid: the point at
/// column `x`, row `y` of the first frame is at `(x + u, y + v)` in the second.
#[derive(Debug, Clone, PartialEq)]
pub struct Flow {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height * width` vectors.
    pub data: Vec<[f32; 2]>,
}
