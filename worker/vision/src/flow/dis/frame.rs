//! What Dense Inverse Search needs of one frame, computed once and shared by all its pairs: the
//! pyramid, its gradients (grey levels per pixel) and, per patch, the inverse structure tensor.
//!
//! Levels run from the coarsest to the finest. Fails with [`FlowError`] on frames that are no
//! pictures, too small for a patch, or hold values that are no grey levels.

use super::params::DisParams;
use crate::flow::FlowError;
use crate::flow::simd::{Kernel, dispatch};
use crate::image::{Plane, resize_plane};

// Grey values lie in 0..=255; bicubic enlargement may overshoot a little. Beyond this bound squared
// differences of a patch would leave the range where f32 sums are meaningful.
const MAX_PIXEL: f32 = 1024.0;

// Below this determinant (grey⁴/px⁴) a patch is taken as textureless. OpenCV's 0.001 for gradients
// eight times as large (8⁴ = 4096).
const MIN_DETERMINANT: f64 = 0.001 / 4096.0;

// Pixels checked before looking whether one failed: a few cache lines.
const CHECK_CHUNK: usize = 256;

// The coarsest level is about this many patches wide: motions up to a quarter of the width are in
// reach (Kroeger et al., section 2.4, as OpenCV reads it).
const COARSEST_WIDTH_PATCHES: f64 = 4.0;

/// One frame, prepared for any number of pairs.
#[derive(Debug, Clone)]
pub struct DisFrame {
    width: usize,
    height: usize,
    params: DisParams,
    levels: Vec<Level>,
}

/// One scale of the pyramid.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    /// The picture with `border` repeated edge pixels on every side.
    pub(super) padded: Vec<f32>,
    /// Row length of `padded`.
    pub(super) stride: usize,
    pub(super) border: usize,
    /// `[H, W]` derivatives, grey levels per pixel.
    pub(super) gradient_x: Vec<f32>,
    pub(super) gradient_y: Vec<f32>,
    /// Left columns and top rows of the patches.
    pub(super) patch_columns: Vec<usize>,
    pub(super) patch_rows: Vec<usize>,
    /// One per patch, row-major.
    pub(super) tensors: Vec<PatchTensor>,
}

/// The inverse of a patch's structure tensor and its mean gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PatchTensor {
    pub(super) inverse_xx: f32,
    pub(super) inverse_xy: f32,
    pub(super) inverse_yy: f32,
    pub(super) mean_x: f32,
    pub(super) mean_y: f32,
}

impl DisFrame {
    /// Prepares a grey frame, values 0..=255.
    ///
    /// # Errors
    /// [`FlowError`] when the parameters have no meaning, the frame is no picture or smaller than a
    /// patch, or a pixel is not finite or far outside 0..=255.
    // A stage of its own in a profile.
    #[inline(never)]
    pub fn new(grey: &Plane, params: &DisParams) -> Result<Self, FlowError> {
        params.validate()?;
        grey.validate()?;
        if let Some(index) = first_out_of_range(&grey.data) {
            return Err(FlowError::PixelOutOfRange {
                index,
                value: grey.data[index],
                limit: MAX_PIXEL,
            });
        }
        let (width, height) = (grey.width, grey.height);
        let coarsest =
            coarsest_scale(width, height, params.patch_size).ok_or(FlowError::TooSmall {
                width,
                height,
                patch_size: params.patch_size,
            })?;
        let finest = params.finest_scale.min(coarsest);
        let mut picture = resize_plane(grey, width >> finest, height >> finest);
        let mut levels = Vec::new();
        for scale in finest..=coarsest {
            if scale > finest {
                picture = resize_plane(&picture, picture.width / 2, picture.height / 2);
            }
            levels.push(dispatch(NewLevel {
                picture: &picture,
                params,
            }));
        }
        levels.reverse();
        Ok(Self {
            width,
            height,
            params: params.clone(),
            levels,
        })
    }

    /// Width and height of the full frame, pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The parameters it was prepared with.
    #[must_use]
    pub fn params(&self) -> &DisParams {
        &self.params
    }

    /// Coarsest first.
    pub(super) fn levels(&self) -> &[Level] {
        &self.levels
    }
}

/// The first pixel that is NaN or beyond the limit. Chunks are judged whole, which becomes vectors.
fn first_out_of_range(pixels: &[f32]) -> Option<usize> {
    // NaN compares false.
    let fits = |value: &f32| value.abs() <= MAX_PIXEL;
    let chunk_fits = |chunk: &[f32]| chunk.iter().fold(true, |all, value| all & fits(value));
    let bad = pixels
        .chunks(CHECK_CHUNK)
        .position(|chunk| !chunk_fits(chunk))?;
    let start = bad * CHECK_CHUNK;
    let inside = pixels[start..].iter().position(|value| !fits(value))?;
    Some(start + inside)
}

/// The coarsest scale whose longer side still holds about four patches and whose shorter side holds
/// one; `None` when the frame itself does not hold one.
pub(super) fn coarsest_scale(width: usize, height: usize, patch_size: usize) -> Option<u32> {
    let (longer, shorter) = (width.max(height), width.min(height));
    if shorter < patch_size {
        return None;
    }
    let patches = longer as f64 / (COARSEST_WIDTH_PATCHES * patch_size as f64);
    let by_motion = (libm::log2(patches) + 0.5).max(0.0) as u32;
    let by_size = (shorter / patch_size).ilog2();
    Some(by_motion.min(by_size))
}

/// Starts of patches along an axis: every `stride` pixels, and one that touches the far border.
fn patch_starts(length: usize, size: usize, stride: usize) -> Vec<usize> {
    let last = length - size;
    (0..last).step_by(stride).chain([last]).collect()
}

struct NewLevel<'a> {
    picture: &'a Plane,
    params: &'a DisParams,
}

impl Kernel for NewLevel<'_> {
    type Output = Level;

    #[inline(always)]
    fn run(self) -> Level {
        Level::new(self.picture, self.params)
    }
}

impl Level {
    #[inline(always)]
    fn new(picture: &Plane, params: &DisParams) -> Self {
        let (width, height) = (picture.width, picture.height);
        // A displaced patch may leave the frame but for one pixel, and interpolation reads one more.
        let border = params.patch_size;
        let (padded, stride) = pad(picture, border);
        let (gradient_x, gradient_y) = sobel(&padded, stride, border, width, height);
        let mut level = Self {
            width,
            height,
            padded,
            stride,
            border,
            gradient_x,
            gradient_y,
            patch_columns: patch_starts(width, params.patch_size, params.patch_stride),
            patch_rows: patch_starts(height, params.patch_size, params.patch_stride),
            tensors: Vec::new(),
        };
        level.tensors = level.structure_tensors(params.patch_size);
        level
    }

    /// The picture's pixels from column `x`, row `y` on.
    #[inline(always)]
    pub(super) fn pixels_at(&self, x: usize, y: usize) -> &[f32] {
        &self.padded[(y + self.border) * self.stride + x + self.border..]
    }

    /// Sums of gradient products over every patch: along rows first, at the patch columns only, then
    /// down the columns. Patches hold at most 256 terms, so plain f32 sums suffice; the determinant,
    /// a difference of near-equal products, is taken in f64.
    #[inline(always)]
    fn structure_tensors(&self, size: usize) -> Vec<PatchTensor> {
        let columns = self.patch_columns.len();
        let mut row_sums = vec![[0.0f32; 5]; self.height * columns];
        let rows = self
            .gradient_x
            .chunks_exact(self.width)
            .zip(self.gradient_y.chunks_exact(self.width));
        for ((gx, gy), sums) in rows.zip(row_sums.chunks_exact_mut(columns)) {
            for (sum, &x) in sums.iter_mut().zip(&self.patch_columns) {
                let mut total = [0.0; 5];
                for (&gx, &gy) in gx[x..x + size].iter().zip(&gy[x..x + size]) {
                    total[0] += gx * gx;
                    total[1] += gx * gy;
                    total[2] += gy * gy;
                    total[3] += gx;
                    total[4] += gy;
                }
                *sum = total;
            }
        }
        let pixels = (size * size) as f32;
        let mut tensors = Vec::with_capacity(columns * self.patch_rows.len());
        for &y in &self.patch_rows {
            for column in 0..columns {
                let mut total = [0.0f32; 5];
                for row in y..y + size {
                    for (sum, value) in total.iter_mut().zip(row_sums[row * columns + column]) {
                        *sum += value;
                    }
                }
                tensors.push(PatchTensor::new(total, pixels));
            }
        }
        tensors
    }
}

impl PatchTensor {
    /// From the patch's sums of gx², gx·gy, gy², gx and gy.
    #[inline(always)]
    pub(super) fn new([xx, xy, yy, x, y]: [f32; 5], pixels: f32) -> Self {
        let [xx, xy, yy] = [xx, xy, yy].map(f64::from);
        let determinant = (xx * yy - xy * xy).max(MIN_DETERMINANT);
        Self {
            inverse_xx: (yy / determinant) as f32,
            inverse_xy: (-xy / determinant) as f32,
            inverse_yy: (xx / determinant) as f32,
            mean_x: x / pixels,
            mean_y: y / pixels,
        }
    }
}

/// Repeats the edge pixels `border` times on every side; returns the buffer and its row length.
fn pad(picture: &Plane, border: usize) -> (Vec<f32>, usize) {
    let stride = picture.width + 2 * border;
    let mut padded = Vec::with_capacity(stride * (picture.height + 2 * border));
    for y in 0..picture.height + 2 * border {
        let row = y.saturating_sub(border).min(picture.height - 1);
        let line = &picture.data[row * picture.width..][..picture.width];
        padded.extend(std::iter::repeat_n(line[0], border));
        padded.extend_from_slice(line);
        padded.extend(std::iter::repeat_n(line[picture.width - 1], border));
    }
    (padded, stride)
}

/// Sobel derivatives divided by eight, so that a ramp of slope 1 gives 1; edge pixels repeat.
#[inline(always)]
fn sobel(
    padded: &[f32],
    stride: usize,
    border: usize,
    width: usize,
    height: usize,
) -> (Vec<f32>, Vec<f32>) {
    let mut gradient_x = vec![0.0; width * height];
    let mut gradient_y = vec![0.0; width * height];
    let rows = gradient_x
        .chunks_exact_mut(width)
        .zip(gradient_y.chunks_exact_mut(width));
    for (y, (gx, gy)) in rows.enumerate() {
        let line = |row: usize| &padded[(row + border) * stride + border - 1..][..width + 2];
        let start = (y + border - 1) * stride + border - 1;
        let above = &padded[start..][..width + 2];
        let here = line(y);
        let below = line(y + 1);
        for x in 0..width {
            gx[x] = ((above[x + 2] - above[x])
                + 2.0 * (here[x + 2] - here[x])
                + (below[x + 2] - below[x]))
                * 0.125;
            gy[x] = ((below[x] - above[x])
                + 2.0 * (below[x + 1] - above[x + 1])
                + (below[x + 2] - above[x + 2]))
                * 0.125;
        }
    }
    (gradient_x, gradient_y)
}
