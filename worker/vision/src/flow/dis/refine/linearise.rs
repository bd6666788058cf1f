//! The data term, linearised around the field to refine: the second frame is warped by the field,
//! and brightness and both gradient components are differentiated at the mean of the first frame and
//! the warped second one.
//!
//! Differences are between a pixel's two neighbours, borders repeated, as OpenCV's 1 × 3 Sobel, times
//! `difference_scale`. Each residual
//! z + x du + y dv is divided by √(x² + y² + ζ²) here, once, so that the iterations need not.

use super::super::densify::DenseField;
use super::super::frame::Level;
use super::super::params::RefinementParams;
use super::grid::{Board, Colour, Grid};

/// Planes of the picture, rows with one border cell at each end.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    mean: Bordered,
    /// Warped second frame minus first.
    temporal: Bordered,
    x: Bordered,
    y: Bordered,
    corners: Corners,
    terms: [Vec<f32>; 9],
}

/// A plane whose rows repeat their first and last values once.
#[derive(Debug, Clone, Default)]
struct Bordered {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl Bordered {
    fn reshape(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.data.resize((width + 2) * height, 0.0);
    }

    #[inline(always)]
    fn row(&self, y: usize) -> &[f32] {
        &self.data[y * (self.width + 2)..][..self.width + 2]
    }

    /// The rows above and below, the frame's own at its edges.
    #[inline(always)]
    fn neighbours(&self, y: usize) -> [&[f32]; 2] {
        [
            self.row(y.saturating_sub(1)),
            self.row((y + 1).min(self.height - 1)),
        ]
    }

    #[inline(always)]
    fn inner_mut(&mut self, y: usize) -> &mut [f32] {
        &mut self.data[y * (self.width + 2) + 1..][..self.width]
    }

    #[inline(always)]
    fn repeat_ends(&mut self, y: usize) {
        let row = &mut self.data[y * (self.width + 2)..][..self.width + 2];
        row[0] = row[1];
        row[self.width + 1] = row[self.width];
    }
}

/// The four pixels around every end point of one row, and the point's place among them.
#[derive(Debug, Clone, Default)]
struct Corners {
    /// Whole numbers, left as floats here because Rust's saturating casts do not become vectors.
    left: Vec<f32>,
    top: Vec<f32>,
    fraction_x: Vec<f32>,
    fraction_y: Vec<f32>,
    pixels: [Vec<f32>; 4],
}

impl Corners {
    fn reshape(&mut self, width: usize) {
        let places = [
            &mut self.left,
            &mut self.top,
            &mut self.fraction_x,
            &mut self.fraction_y,
        ];
        for plane in places.into_iter().chain(&mut self.pixels) {
            plane.resize(width, 0.0);
        }
    }

    /// Reads the corners of row `y`; end points outside take the nearest border pixel.
    #[inline(always)]
    fn gather(&mut self, second: &Level, y: usize, u: &[f32], v: &[f32]) {
        let width = second.width;
        let (last_x, last_y) = ((width - 1) as f32, (second.height - 1) as f32);
        let origin = second.border * second.stride + second.border;
        let left = &mut self.left[..width];
        let top = &mut self.top[..width];
        let fraction_x = &mut self.fraction_x[..width];
        let fraction_y = &mut self.fraction_y[..width];
        let (u, v) = (&u[..width], &v[..width]);
        let y = y as f32;
        for k in 0..width {
            let x = (k as i32 as f32 + u[k]).max(0.0).min(last_x);
            let y = (y + v[k]).max(0.0).min(last_y);
            left[k] = x.floor();
            top[k] = y.floor();
            fraction_x[k] = x - left[k];
            fraction_y[k] = y - top[k];
        }
        let [a, b, c, d] = &mut self.pixels;
        let corners = a.iter_mut().zip(b).zip(c).zip(d);
        let places = left.iter().zip(top.iter());
        for ((((a, b), c), d), (&left, &top)) in corners.zip(places) {
            // In range; through i32, which converts in one instruction.
            let (left, top) = (left as i32 as usize, top as i32 as usize);
            let window = &second.padded[origin + top * second.stride + left..][..second.stride + 2];
            *a = window[0];
            *b = window[1];
            *c = window[second.stride];
            *d = window[second.stride + 1];
        }
    }
}

impl Scratch {
    /// Warps the second frame by `field` and takes first differences.
    #[inline(always)]
    pub(super) fn differentiate(
        &mut self,
        field: &DenseField,
        first: &Level,
        second: &Level,
        scale: f32,
    ) {
        let (width, height) = (field.width, field.height);
        for plane in [&mut self.mean, &mut self.temporal, &mut self.x, &mut self.y] {
            plane.reshape(width, height);
        }
        self.corners.reshape(width);
        for y in 0..height {
            let at = y * width;
            self.corners
                .gather(second, y, &field.u[at..][..width], &field.v[at..][..width]);
            let reference = &first.pixels_at(0, y)[..width];
            self.blend(y, reference);
        }
        for y in 0..height {
            let here = self.mean.row(y);
            let [above, below] = self.mean.neighbours(y);
            difference_x(here, scale, self.x.inner_mut(y));
            difference_y(above, below, scale, self.y.inner_mut(y));
            self.x.repeat_ends(y);
        }
    }

    /// Interpolates the warped row; its mean with, and its difference from, the first frame's.
    #[inline(always)]
    fn blend(&mut self, y: usize, reference: &[f32]) {
        let width = reference.len();
        let [a, b, c, d] = &self.corners.pixels;
        let (a, b, c, d) = (&a[..width], &b[..width], &c[..width], &d[..width]);
        let fraction_x = &self.corners.fraction_x[..width];
        let fraction_y = &self.corners.fraction_y[..width];
        let mean = self.mean.inner_mut(y);
        let temporal = self.temporal.inner_mut(y);
        for k in 0..width {
            let upper = a[k] + fraction_x[k] * (b[k] - a[k]);
            let lower = c[k] + fraction_x[k] * (d[k] - c[k]);
            let warped = upper + fraction_y[k] * (lower - upper);
            mean[k] = 0.5 * (reference[k] + warped);
            temporal[k] = warped - reference[k];
        }
        self.mean.repeat_ends(y);
        self.temporal.repeat_ends(y);
    }
}

#[inline(always)]
fn difference_x(bordered: &[f32], scale: f32, out: &mut [f32]) {
    let width = out.len();
    let (left, right) = (&bordered[..width], &bordered[2..][..width]);
    for k in 0..width {
        out[k] = scale * (right[k] - left[k]);
    }
}

#[inline(always)]
fn difference_y(above: &[f32], below: &[f32], scale: f32, out: &mut [f32]) {
    let width = out.len();
    let (above, below) = (&above[1..][..width], &below[1..][..width]);
    for k in 0..width {
        out[k] = scale * (below[k] - above[k]);
    }
}

/// Residuals z + x du + y dv of every pixel: brightness, then both gradient components, normalised.
#[derive(Debug, Clone, Default)]
pub(super) struct Linearisation {
    terms: [Board; 9],
}

/// z + x du + y dv, cell by cell, for a row of one colour.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual<'a> {
    pub(super) x: &'a [f32],
    pub(super) y: &'a [f32],
    pub(super) z: &'a [f32],
}

impl Linearisation {
    /// Second differences, normalisation by ζ, and the deal to the checkerboard.
    #[inline(always)]
    pub(super) fn fill(&mut self, grid: &Grid, scratch: &mut Scratch, params: &RefinementParams) {
        for board in &mut self.terms {
            board.reset(grid);
        }
        let Scratch {
            temporal,
            x,
            y: plane_y,
            terms,
            ..
        } = scratch;
        for line in terms.iter_mut() {
            line.resize(grid.width, 0.0);
        }
        let (width, scale) = (grid.width, params.difference_scale);
        for row in 0..grid.height {
            let [bx, by, bz, xx, xy, xz, yx, yy, yz] = terms.each_mut().map(|t| &mut t[..width]);
            let [x_above, x_below] = x.neighbours(row);
            let [y_above, y_below] = plane_y.neighbours(row);
            let [z_above, z_below] = temporal.neighbours(row);
            bx.copy_from_slice(&x.row(row)[1..][..width]);
            by.copy_from_slice(&plane_y.row(row)[1..][..width]);
            bz.copy_from_slice(&temporal.row(row)[1..][..width]);
            difference_x(x.row(row), scale, xx);
            difference_y(x_above, x_below, scale, xy);
            difference_x(temporal.row(row), scale, xz);
            yx.copy_from_slice(xy);
            difference_y(y_above, y_below, scale, yy);
            difference_y(z_above, z_below, scale, yz);
            for [x, y, z] in [[bx, by, bz], [xx, xy, xz], [yx, yy, yz]] {
                normalise(x, y, z, params.normalisation * params.normalisation);
            }
            for (board, line) in self.terms.iter_mut().zip(terms.iter()) {
                board.split_row(grid, row, &line[..width]);
            }
        }
    }

    /// The residuals of a row of one colour: brightness, x gradient, y gradient.
    #[inline(always)]
    pub(super) fn row(&self, grid: &Grid, colour: Colour, y: usize) -> [Residual<'_>; 3] {
        [0, 3, 6].map(|first| Residual {
            x: self.terms[first].row(grid, colour, y),
            y: self.terms[first + 1].row(grid, colour, y),
            z: self.terms[first + 2].row(grid, colour, y),
        })
    }
}

#[inline(always)]
fn normalise(x: &mut [f32], y: &mut [f32], z: &mut [f32], zeta_squared: f32) {
    let width = x.len();
    let (y, z) = (&mut y[..width], &mut z[..width]);
    for k in 0..width {
        let scale = 1.0 / (x[k] * x[k] + y[k] * y[k] + zeta_squared).sqrt();
        x[k] *= scale;
        y[k] *= scale;
        z[k] *= scale;
    }
}
