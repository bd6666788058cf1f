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
    #[inline(always)]
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
    /// Squared distance before the means are removed.
    pub(super) square: f32,
    pub(super) descent: [f32; 2],
}

/// A patch of the first frame with its derivatives, copied out once for all its comparisons: fixed arrays
/// need no bounds checks, which would be a third of a comparison's instructions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Template<const P: usize> {
    pixels: [[f32; P]; P],
    gradient_x: [[f32; P]; P],
    gradient_y: [[f32; P]; P],
}

impl<const P: usize> Template<P> {
    #[inline(always)]
    pub(super) fn new(first: &Level, x: usize, y: usize) -> Self {
        let start = y * first.width + x;
        Self {
            pixels: copy_rows(first.pixels_at(x, y), first.stride),
            gradient_x: copy_rows(&first.gradient_x[start..], first.width),
            gradient_y: copy_rows(&first.gradient_y[start..], first.width),
        }
    }
}

#[inline(always)]
fn copy_rows<const P: usize>(source: &[f32], stride: usize) -> [[f32; P]; P] {
    let mut rows = [[0.0; P]; P];
    for (y, row) in rows.iter_mut().enumerate() {
        row.copy_from_slice(&source[y * stride..][..P]);
    }
    rows
}

/// The interpolated difference second − first, row by row from the top.
///
/// No closures here: one that the compiler does not inline keeps the baseline's instructions.
pub(super) struct Differences<'a, const P: usize> {
    pixels: &'a [f32],
    stride: usize,
    fraction_x: f32,
    fraction_y: f32,
    upper: [f32; P],
}

impl<'a, const P: usize> Differences<'a, P> {
    #[inline(always)]
    pub(super) fn new(second: &'a Level, at: Placement) -> Self {
        let pixels = &second.padded[at.offset..];
        Self {
            pixels,
            stride: second.stride,
            fraction_x: at.fraction_x,
            fraction_y: at.fraction_y,
            upper: interpolate_row::<P>(pixels, at.fraction_x),
        }
    }

    /// Row `y` against the first frame's; rows are asked for in order.
    #[inline(always)]
    pub(super) fn row(&mut self, y: usize, reference: &[f32]) -> [f32; P] {
        let lower = interpolate_row::<P>(&self.pixels[(y + 1) * self.stride..], self.fraction_x);
        let reference = &reference[..P];
        let mut difference = [0.0; P];
        for k in 0..P {
            difference[k] = self.upper[k] + self.fraction_y * (lower[k] - self.upper[k]);
            difference[k] -= reference[k];
        }
        self.upper = lower;
        difference
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

/// Sums the lanes of each row pairwise, halving each time; an odd middle lane is carried. All rows at once,
/// lane by lane.
///
/// The rows pass through memory: that keeps them whole vectors, where otherwise the compiler takes the halving
/// as a reason to compute everything before it in pairs.
#[inline(always)]
fn reduce<const P: usize, const N: usize>(rows: [[f32; P]; N]) -> [f32; N] {
    let rows = std::hint::black_box(rows);
    let mut lanes = [[0.0; N]; P];
    for (k, lane) in lanes.iter_mut().enumerate() {
        for (value, row) in lane.iter_mut().zip(&rows) {
            *value = row[k];
        }
    }
    let mut count = P;
    while count > 1 {
        let half = count.div_ceil(2);
        let (sums, others) = lanes.split_at_mut(half);
        for (sums, others) in sums.iter_mut().zip(&others[..count - half]) {
            for (sum, other) in sums.iter_mut().zip(others) {
                *sum += other;
            }
        }
        count = half;
    }
    lanes[0]
}

/// Squared distance alone, for choosing among starting points.
#[inline(always)]
pub(super) fn distance<const P: usize>(
    template: &Template<P>,
    second: &Level,
    at: Placement,
    mean_normalisation: bool,
) -> f32 {
    let mut sum = [0.0; P];
    let mut square = [0.0; P];
    let mut differences = Differences::<P>::new(second, at);
    for y in 0..P {
        let difference = differences.row(y, &template.pixels[y]);
        for k in 0..P {
            sum[k] += difference[k];
            square[k] += difference[k] * difference[k];
        }
    }
    let [sum, square] = reduce([sum, square]);
    if mean_normalisation {
        square - sum * sum / (P * P) as f32
    } else {
        square
    }
}

/// Squared distance and gradient-weighted difference, for one search step.
#[inline(always)]
pub(super) fn compare<const P: usize>(
    template: &Template<P>,
    second: &Level,
    at: Placement,
    tensor: &PatchTensor,
    mean_normalisation: bool,
) -> Comparison {
    let mut sum = [0.0; P];
    let mut square = [0.0; P];
    let mut along_x = [0.0; P];
    let mut along_y = [0.0; P];
    let mut differences = Differences::<P>::new(second, at);
    for y in 0..P {
        let difference = differences.row(y, &template.pixels[y]);
        let (gx, gy) = (&template.gradient_x[y], &template.gradient_y[y]);
        for k in 0..P {
            sum[k] += difference[k];
            square[k] += difference[k] * difference[k];
            along_x[k] += difference[k] * gx[k];
            along_y[k] += difference[k] * gy[k];
        }
    }
    let [sum, square, along_x, along_y] = reduce([sum, square, along_x, along_y]);
    if mean_normalisation {
        Comparison {
            distance: square - sum * sum / (P * P) as f32,
            square,
            descent: [along_x - sum * tensor.mean_x, along_y - sum * tensor.mean_y],
        }
    } else {
        Comparison {
            distance: square,
            square,
            descent: [along_x, along_y],
        }
    }
}
