//! Pictures in memory: 8-bit RGB frames and single-channel float planes, row-major, top-left origin,
//! pixel centres at integer coordinates.
//!
//! Grey values are BT.601 luma in 0..=255. Every function here is total: a picture without pixels,
//! or one whose buffer does not match its size, gives an empty picture (0 × 0), never a panic; the
//! constructors report such pictures as [`ImageError`].

pub mod filter;
pub mod resize;

pub use filter::{box_mean, gaussian_blur};
pub(crate) use resize::resize_vectors;
pub use resize::{resize_plane, resize_rgb};

/// Why pixels do not make a picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// Width or height is zero.
    #[error("picture of {width}x{height} has no pixels")]
    Empty {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The buffer does not hold `width * height` pixels.
    #[error("{width}x{height} picture needs {expected} values, the buffer holds {actual}")]
    LengthMismatch {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Values that the size asks for; the largest `usize` where that overflows.
        expected: usize,
        /// Values in the buffer.
        actual: usize,
    },
}

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

// BT.601 luma weights times 2^15, as OpenCV's 8-bit cvtColor rounds them (they sum to 2^15).
const LUMA_SHIFT: u32 = 15;
const LUMA_RED: u32 = 9798;
const LUMA_GREEN: u32 = 19235;
const LUMA_BLUE: u32 = 3735;

impl Rgb8 {
    /// A picture from its bytes, `[H, W, 3]`.
    ///
    /// # Errors
    /// [`ImageError`] when the picture is empty or the buffer has another length.
    pub fn new(width: usize, height: usize, data: Vec<u8>) -> Result<Self, ImageError> {
        check_shape(width, height, 3, data.len())?;
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// Whether size and buffer agree and there is at least one pixel.
    ///
    /// # Errors
    /// [`ImageError`] when they do not.
    pub fn validate(&self) -> Result<(), ImageError> {
        check_shape(self.width, self.height, 3, self.data.len())
    }

    /// BT.601 luma, 0..=255, rounded to the nearest integer (half up) in 15-bit fixed point: the
    /// same values as OpenCV's `cvtColor` on 8-bit pictures, so that thresholds in grey levels
    /// carry over. An invalid picture gives an empty plane.
    #[must_use]
    pub fn grey(&self) -> Plane {
        if self.validate().is_err() {
            return Plane::empty();
        }
        let luma = |p: &[u8]| {
            let sum = LUMA_RED * u32::from(p[0])
                + LUMA_GREEN * u32::from(p[1])
                + LUMA_BLUE * u32::from(p[2]);
            ((sum + (1 << (LUMA_SHIFT - 1))) >> LUMA_SHIFT) as f32
        };
        Plane {
            width: self.width,
            height: self.height,
            data: self.data.chunks_exact(3).map(luma).collect(),
        }
    }
}

impl Plane {
    /// A plane from its values, `[H, W]`.
    ///
    /// # Errors
    /// [`ImageError`] when the plane is empty or the buffer has another length.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Result<Self, ImageError> {
        check_shape(width, height, 1, data.len())?;
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// A plane whose value at column `x`, row `y` is `value(x, y)`.
    #[must_use]
    pub fn from_fn(
        width: usize,
        height: usize,
        mut value: impl FnMut(usize, usize) -> f32,
    ) -> Self {
        let mut data = Vec::with_capacity(width.saturating_mul(height));
        for y in 0..height {
            data.extend((0..width).map(|x| value(x, y)));
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// Whether size and buffer agree and there is at least one pixel.
    ///
    /// # Errors
    /// [`ImageError`] when they do not.
    pub fn validate(&self) -> Result<(), ImageError> {
        check_shape(self.width, self.height, 1, self.data.len())
    }

    /// Bilinear value at column `x`, row `y` (pixels, centres at integers); points outside take the
    /// nearest border value. `None` where the plane has no pixels.
    #[must_use]
    pub fn sample(&self, x: f32, y: f32) -> Option<f32> {
        self.validate().ok()?;
        Some(self.bilinear(Bilinear::at(x, y, self.width, self.height)))
    }

    /// The value at a precomputed look-up of a plane of this size.
    #[inline]
    pub(crate) fn bilinear(&self, at: Bilinear) -> f32 {
        at.mix(
            self.data[at.indices[0]],
            self.data[at.indices[1]],
            self.data[at.indices[2]],
            self.data[at.indices[3]],
        )
    }

    pub(crate) fn empty() -> Self {
        Self {
            width: 0,
            height: 0,
            data: Vec::new(),
        }
    }
}

/// Where a sub-pixel point lies among its four neighbours; shared by all planes of one size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bilinear {
    /// Flat indices: top left, top right, bottom left, bottom right.
    pub(crate) indices: [usize; 4],
    fraction_x: f32,
    fraction_y: f32,
}

impl Bilinear {
    /// The look-up at `(x, y)`, clamped to the picture; NaN is taken as 0.
    #[inline]
    pub(crate) fn at(x: f32, y: f32, width: usize, height: usize) -> Self {
        let x = x.max(0.0).min((width - 1) as f32);
        let y = y.max(0.0).min((height - 1) as f32);
        // Not negative, so truncation is the floor; through i32, which converts in one instruction.
        let (left, top) = (x as i32 as usize, y as i32 as usize);
        let right = (left + 1).min(width - 1);
        let bottom = (top + 1).min(height - 1);
        Self {
            indices: [
                top * width + left,
                top * width + right,
                bottom * width + left,
                bottom * width + right,
            ],
            fraction_x: x - left as f32,
            fraction_y: y - top as f32,
        }
    }

    #[inline]
    pub(crate) fn mix(
        &self,
        top_left: f32,
        top_right: f32,
        bottom_left: f32,
        bottom_right: f32,
    ) -> f32 {
        let top = top_left + self.fraction_x * (top_right - top_left);
        let bottom = bottom_left + self.fraction_x * (bottom_right - bottom_left);
        top + self.fraction_y * (bottom - top)
    }
}

fn check_shape(
    width: usize,
    height: usize,
    channels: usize,
    actual: usize,
) -> Result<(), ImageError> {
    if width == 0 || height == 0 {
        return Err(ImageError::Empty { width, height });
    }
    let expected = width
        .checked_mul(height)
        .and_then(|pixels| pixels.checked_mul(channels));
    if expected == Some(actual) {
        return Ok(());
    }
    Err(ImageError::LengthMismatch {
        width,
        height,
        expected: expected.unwrap_or(usize::MAX),
        actual,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_is_rounded_bt601_luma() {
        for pixel in [
            [0, 0, 0],
            [255, 255, 255],
            [255, 0, 0],
            [0, 255, 0],
            [0, 0, 255],
            [17, 93, 201],
        ] {
            let grey = Rgb8::new(1, 1, pixel.to_vec()).unwrap().grey();
            let [r, g, b] = pixel.map(f64::from);
            let exact = 0.299 * r + 0.587 * g + 0.114 * b;
            // Half a level of rounding, and 255 · 2^-16 from the 15-bit weights.
            assert!(
                (f64::from(grey.data[0]) - exact).abs() <= 0.5 + 0.004,
                "{pixel:?}"
            );
            assert_eq!(grey.data[0].fract(), 0.0);
        }
    }

    #[test]
    fn sample_interpolates_inside_and_clamps_outside() {
        let plane = Plane::new(2, 2, vec![0.0, 1.0, 2.0, 3.0]).unwrap();
        assert_eq!(plane.sample(0.5, 0.5), Some(1.5));
        assert_eq!(plane.sample(-7.0, 9.0), Some(2.0));
        assert_eq!(plane.sample(f32::INFINITY, f32::NEG_INFINITY), Some(1.0));
        assert!(plane.sample(f32::NAN, 0.0).is_some_and(f32::is_finite));
        assert_eq!(Plane::empty().sample(0.0, 0.0), None);
    }

    #[test]
    fn malformed_pictures_are_errors_or_empty_never_panics() {
        assert!(matches!(
            Plane::new(0, 3, vec![]),
            Err(ImageError::Empty { .. })
        ));
        assert!(matches!(
            Rgb8::new(usize::MAX, 2, vec![0; 3]),
            Err(ImageError::LengthMismatch { .. })
        ));
        let short = Rgb8 {
            width: 4,
            height: 4,
            data: vec![0; 5],
        };
        assert_eq!(short.grey(), Plane::empty());
    }
}
