//! The inner loop: a `P` × `P` patch of the first frame against a bilinearly interpolated patch of
//! the second. Grey levels in, sums out. All lanes are independent until the end, and the final
//! reduction has a fixed order, so that the result does not depend on the vector width.

use super::frame::{Level, PatchTensor};

/// Where a displaced patch lies in the padded second frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    offset: usize,
    fraction_x: f32,
    fraction_y: f32,
}

impl Placement {
    /// The patch at `(x, y)` moved by `vector`, kept where at least one of its pixels touches the
    /// frame; beyond that the repeated border would look the same everywhere.
    #[inline]
    pub(super) fn new(level: &Level, x: usize, y: usize, vector: [f32; 2], size: usize) -> Self {
        let border = level.border as f32;
        let low = border - size as f32 + 1.0;
        // NaN compares false and lands on `low`.
        let place = |start: usize, shift: f32, length: usize| {
            (start as f32 + shift + border)
                .max(low)
                .min(border + length as f32 - 1.0)
        };
        let column = place(x, vector[0], level.width);
        let row = place(y, vector[1], level.height);
        // Positive, so truncation is the floor.
        let (left, top) = (column as usize, row as usize);
        Self {
            offset: top * level.stride + left,
            fraction_x: column - left as f32,
            fraction_y: row - top as f32,
        }
    }
}

/// Squared distance of two patches, and the right-hand side of the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Comparison {
    pub(super) distance: f32,
    pub(super) descent: [f32; 2],
}

/// The interpolated difference second − first, row by row, handed to `row(index, differences)`.
#[inline(always)]
fn differences<const P: usize>(
    first: &[f32],
    second: &Level,
    at: Placement,
    mut row: impl FnMut(usize, [f32; P]),
) {
    let stride = second.stride;
    let pixels = &second.padded[at.offset..];
    let mut upper = interpolate_row::<P>(pixels, at.fraction_x);
    for y in 0..P {
        let lower = interpolate_row::<P>(&pixels[(y + 1) * stride..], at.fraction_x);
        let reference = &first[y * stride..][..P];
        let mut difference = [0.0; P];
        for k in 0..P {
            difference[k] = upper[k] + at.fraction_y * (lower[k] - upper[k]) - reference[k];
        }
        row(y, difference);
        upper = lower;
    }
}

#[inline(always)]
fn interpolate_row<const P: usize>(pixels: &[f32], fraction: f32) -> [f32; P] {
    let pixels = &pixels[..P + 1];
    let mut row = [0.0; P];
    for k in 0..P {
        row[k] = pixels[k] + fraction * (pixels[k + 1] - pixels[k]);
    }
    row
}

/// Sums the lanes pairwise, halving each time; an odd middle lane is carried.
#[inline(always)]
fn reduce<const P: usize>(mut lanes: [f32; P]) -> f32 {
    let mut count = P;
    while count > 1 {
        let half = count.div_ceil(2);
        for k in 0..count - half {
            lanes[k] += lanes[k + half];
        }
        count = half;
    }
    lanes[0]
}

/// Squared distance alone, for choosing among starting points.
#[inline]
pub(super) fn distance<const P: usize>(
    first: &[f32],
    second: &Level,
    at: Placement,
    mean_normalisation: bool,
) -> f32 {
    let mut sum = [0.0; P];
    let mut square = [0.0; P];
    differences::<P>(first, second, at, |_, difference| {
        for k in 0..P {
            sum[k] += difference[k];
            square[k] += difference[k] * difference[k];
        }
    });
    let (sum, square) = (reduce(sum), reduce(square));
    if mean_normalisation {
        square - sum * sum / (P * P) as f32
    } else {
        square
    }
}

/// Squared distance and gradient-weighted difference, for one search step.
#[inline]
pub(super) fn compare<const P: usize>(
    first: &[f32],
    second: &Level,
    at: Placement,
    [gradient_x, gradient_y]: [&[f32]; 2],
    tensor: &PatchTensor,
    mean_normalisation: bool,
) -> Comparison {
    let width = second.width;
    let mut sum = [0.0; P];
    let mut square = [0.0; P];
    let mut along_x = [0.0; P];
    let mut along_y = [0.0; P];
    differences::<P>(first, second, at, |y, difference| {
        let gx = &gradient_x[y * width..][..P];
        let gy = &gradient_y[y * width..][..P];
        for k in 0..P {
            sum[k] += difference[k];
            square[k] += difference[k] * difference[k];
            along_x[k] += difference[k] * gx[k];
            along_y[k] += difference[k] * gy[k];
        }
    });
    let (sum, square) = (reduce(sum), reduce(square));
    let (along_x, along_y) = (reduce(along_x), reduce(along_y));
    if mean_normalisation {
        Comparison {
            distance: square - sum * sum / (P * P) as f32,
            descent: [along_x - sum * tensor.mean_x, along_y - sum * tensor.mean_y],
        }
    } else {
        Comparison {
            distance: square,
            descent: [along_x, along_y],
        }
    }
}

/// Weight of every patch pixel in the dense field, 1 / max(1, |difference|), row by row.
#[inline(always)]
pub(super) fn weights<const P: usize>(
    first: &[f32],
    second: &Level,
    at: Placement,
    mut row: impl FnMut(usize, [f32; P]),
) {
    differences::<P>(first, second, at, |y, difference| {
        row(y, difference.map(|d| 1.0 / d.abs().max(1.0)));
    });
}
