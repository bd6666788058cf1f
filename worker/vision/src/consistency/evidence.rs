//! Per-direction evidence on a coarse grid: how far flow and counter-flow disagree, and how much the
//! moved appearance differs (`evidence.md`, section 2; yardstick `prototype/feat.py`, `dq`).
//!
//! The grid has `grid_height` rows (128) and square cells, whatever the working height. Flow is
//! area-filtered to the grid but stays in pixels of a picture `reference_height_px` (256) high. For
//! direction a → b at cell x: B' = B(x + F), e = |F + B'|, ρ = e² / (0.5 + 0.01 (|F|² + |B'|²)),
//! r = min(|Nₐ − N_b(x + F)|, 3), with N the locally normalised frame. Look-ups are bilinear with
//! clamped borders.

use std::ops::Range;

use super::look_up::{LookUpRow, mix};
use super::{ConsistencyError, ConsistencyParams, check_length, check_values, squared_norm};
use crate::exp::one_minus_exp_of_minus;
use crate::flow::Flow;
use crate::flow::simd::{Kernel, dispatch};
use crate::image::{ImageError, Plane, box_mean, gaussian_blur, resize_plane, resize_vectors};

/// A flow on the evidence grid.
#[derive(Debug, Clone, PartialEq)]
pub struct GridFlow {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Grid cells per reference pixel, x then y.
    pub cells_per_px: [f32; 2],
    /// `[H, W, 2]` vectors, x then y, reference pixels.
    pub flow_px: Vec<[f32; 2]>,
}

impl GridFlow {
    /// Brings a working-resolution flow (pixels of its own grid) to the evidence grid.
    ///
    /// # Errors
    /// [`ConsistencyError`] when the flow is empty, incomplete or holds absurd vectors.
    pub fn new(flow: &Flow, params: &ConsistencyParams) -> Result<Self, ConsistencyError> {
        params.validate()?;
        check_length(flow)?;
        check_values(flow)?;
        let (width, height) = grid_size(flow.width, flow.height, params);
        let scale = params.reference_height_px / flow.height as f64;
        Ok(Self {
            width,
            height,
            cells_per_px: [
                (width as f64 / (flow.width as f64 * scale)) as f32,
                (height as f64 / params.reference_height_px) as f32,
            ],
            flow_px: resize_vectors(&flow.data, flow.width, scale as f32, [width, height]),
        })
    }
}

/// A grey frame on the evidence grid and its locally normalised form; computed once per frame.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalisedFrame {
    /// Grey levels on the grid.
    pub grey: Plane,
    /// N = (G − μ) / √(max(variance, 0) + floor), with Gaussian local mean and variance.
    pub normalised: Plane,
}

impl NormalisedFrame {
    /// From a grey frame at working resolution, values 0..=255.
    ///
    /// # Errors
    /// [`ConsistencyError`] when the frame is no picture or holds a value that is not finite.
    pub fn new(grey: &Plane, params: &ConsistencyParams) -> Result<Self, ConsistencyError> {
        params.validate()?;
        grey.validate()?;
        if let Some(index) = grey.data.iter().position(|value| !value.is_finite()) {
            return Err(ConsistencyError::PixelNotFinite { index });
        }
        let (width, height) = grid_size(grey.width, grey.height, params);
        let grey = resize_plane(grey, width, height);
        let sigma = params.normalisation_sigma_cells;
        let mean = gaussian_blur(&grey, sigma);
        let squares = Plane {
            data: grey.data.iter().map(|g| g * g).collect(),
            ..grey
        };
        let mean_square = gaussian_blur(&squares, sigma);
        let data = grey
            .data
            .iter()
            .zip(&mean.data)
            .zip(&mean_square.data)
            .map(|((&g, &mean), &mean_square)| {
                let variance = (mean_square - mean * mean).max(0.0);
                (g - mean) / (variance + params.variance_floor).sqrt()
            })
            .collect();
        Ok(Self {
            normalised: Plane {
                width,
                height,
                data,
            },
            grey,
        })
    }
}

/// What one direction of a pair shows, per cell of the first frame's grid, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Grid cells per reference pixel, x then y.
    pub cells_per_px: [f32; 2],
    /// F, reference pixels.
    pub flow_px: Vec<[f32; 2]>,
    /// |F|, reference pixels.
    pub speed_px: Vec<f32>,
    /// e, reference pixels.
    pub error_px: Vec<f32>,
    /// ρ; the two flows agree below 1.
    pub rho: Vec<f32>,
    /// r, local standard deviations, at most `appearance_limit`.
    pub appearance: Vec<f32>,
    /// Whether the end point lies in the frame.
    pub in_frame: Vec<bool>,
    /// In frame, and the cell itself is at least `margin_cells` from the border: what statistics
    /// count.
    pub counted: Vec<bool>,
    appearance_scale: f32,
}

impl Evidence {
    /// The evidence of direction first → second; swap both pairs of arguments for the other one.
    ///
    /// # Errors
    /// [`ConsistencyError::SizeMismatch`] when the inputs are not on one grid.
    pub fn new(
        forward: &GridFlow,
        backward: &GridFlow,
        first: &NormalisedFrame,
        second: &NormalisedFrame,
        params: &ConsistencyParams,
    ) -> Result<Self, ConsistencyError> {
        params.validate()?;
        let (width, height) = (forward.width, forward.height);
        check_grids(forward, backward, first, second)?;
        Ok(dispatch(Comparison {
            forward,
            backward,
            first: &first.normalised.data,
            second: &second.normalised.data,
            size: (width, height),
            params,
        }))
    }

    /// Counted, and forward and backward flow agree.
    #[inline]
    #[must_use]
    pub fn consistent(&self, index: usize) -> bool {
        self.counted[index] && self.rho[index] < 1.0
    }

    /// q = box₃(1 − exp(−ρ − (r / scale)²)), 0 out of frame: change of motion or appearance, 0..=1.
    #[must_use]
    pub fn change_map(&self) -> Plane {
        self.map(true)
    }

    /// The same from appearance alone, q_r = box₃(1 − exp(−(r / scale)²)).
    #[must_use]
    pub fn appearance_change_map(&self) -> Plane {
        self.map(false)
    }

    fn map(&self, reads_flow: bool) -> Plane {
        let raw = Plane {
            width: self.width,
            height: self.height,
            data: dispatch(ChangeMap {
                evidence: self,
                reads_flow,
            }),
        };
        box_mean(&raw, 1)
    }
}

/// The evidence of one direction, row by row in whole vectors.
struct Comparison<'a> {
    forward: &'a GridFlow,
    backward: &'a GridFlow,
    first: &'a [f32],
    second: &'a [f32],
    size: (usize, usize),
    params: &'a ConsistencyParams,
}

impl Kernel for Comparison<'_> {
    type Output = Evidence;

    #[inline(always)]
    fn run(self) -> Evidence {
        let (width, height) = self.size;
        let cells = width * height;
        let mut evidence = Evidence {
            width,
            height,
            cells_per_px: self.forward.cells_per_px,
            flow_px: self.forward.flow_px.clone(),
            speed_px: vec![0.0; cells],
            error_px: vec![0.0; cells],
            rho: vec![0.0; cells],
            appearance: vec![0.0; cells],
            in_frame: vec![false; cells],
            counted: vec![false; cells],
            appearance_scale: self.params.appearance_scale,
        };
        let margin = self.params.margin_cells;
        let columns = margin.min(width)..width.saturating_sub(margin).max(margin.min(width));
        let rows = margin..height.saturating_sub(margin);
        let mut to = LookUpRow::new(width);
        let mut back = std::array::from_fn(|_| vec![[0.0; 2]; width]);
        let mut moved = std::array::from_fn(|_| vec![0.0; width]);
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            let ahead = &self.forward.flow_px[row.clone()];
            to.locate(ahead, self.forward.cells_per_px, y, height);
            to.gather(&self.backward.flow_px, &mut back);
            to.gather(self.second, &mut moved);
            self.compare(&to, ahead, &back, &moved, row.clone(), &mut evidence);
            let counted = &mut evidence.counted[row];
            if rows.contains(&y) {
                counted[columns.clone()].copy_from_slice(&to.inside[columns.clone()]);
            }
        }
        evidence
    }
}

impl Comparison<'_> {
    #[inline(always)]
    fn compare(
        &self,
        to: &LookUpRow,
        ahead: &[[f32; 2]],
        back: &[Vec<[f32; 2]>; 4],
        moved: &[Vec<f32>; 4],
        row: Range<usize>,
        evidence: &mut Evidence,
    ) {
        let width = ahead.len();
        let [a, b, c, d] = back;
        let (a, b, c, d) = (&a[..width], &b[..width], &c[..width], &d[..width]);
        let [p, q, r, s] = moved;
        let (p, q, r, s) = (&p[..width], &q[..width], &r[..width], &s[..width]);
        let fraction_x = &to.fraction_x[..width];
        let fraction_y = &to.fraction_y[..width];
        let here = &self.first[row.clone()][..width];
        let speed = &mut evidence.speed_px[row.clone()][..width];
        let error = &mut evidence.error_px[row.clone()][..width];
        let rho = &mut evidence.rho[row.clone()][..width];
        let appearance = &mut evidence.appearance[row.clone()][..width];
        for x in 0..width {
            let (fx, fy) = (fraction_x[x], fraction_y[x]);
            let back = [0, 1].map(|k| mix([a[x][k], b[x][k], c[x][k], d[x][k]], fx, fy));
            let [u, v] = ahead[x];
            let squared = squared_norm([u + back[0], v + back[1]]);
            speed[x] = squared_norm([u, v]).sqrt();
            error[x] = squared.sqrt();
            rho[x] = self.params.rho(squared, [u, v], back);
            let difference = (here[x] - mix([p[x], q[x], r[x], s[x]], fx, fy)).abs();
            appearance[x] = difference.min(self.params.appearance_limit);
        }
        evidence.in_frame[row].copy_from_slice(&to.inside);
    }
}

/// 1 − exp(−exponent) per cell, 0 out of frame; the exponent is (r / scale)², and ρ where flow is read.
struct ChangeMap<'a> {
    evidence: &'a Evidence,
    reads_flow: bool,
}

impl Kernel for ChangeMap<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run(self) -> Vec<f32> {
        let Evidence {
            rho,
            appearance,
            in_frame,
            appearance_scale,
            ..
        } = self.evidence;
        let cells = rho.len();
        let (rho, appearance, in_frame) = (&rho[..], &appearance[..cells], &in_frame[..cells]);
        let mut change = vec![0.0; cells];
        for cell in 0..cells {
            let ratio = appearance[cell] / appearance_scale;
            let flow = if self.reads_flow { rho[cell] } else { 0.0 };
            let share = one_minus_exp_of_minus(flow + ratio * ratio);
            change[cell] = if in_frame[cell] { share } else { 0.0 };
        }
        change
    }
}

/// Width and height of the evidence grid for a frame: fixed height, square cells.
fn grid_size(width: usize, height: usize, params: &ConsistencyParams) -> (usize, usize) {
    let columns = params.grid_height as f64 * width as f64 / height as f64;
    (
        columns.round_ties_even().max(1.0) as usize,
        params.grid_height,
    )
}

fn check_grids(
    forward: &GridFlow,
    backward: &GridFlow,
    first: &NormalisedFrame,
    second: &NormalisedFrame,
) -> Result<(), ConsistencyError> {
    let size = (forward.width, forward.height);
    let others = [
        (backward.width, backward.height),
        (first.normalised.width, first.normalised.height),
        (second.normalised.width, second.normalised.height),
    ];
    if let Some(&other) = others.iter().find(|&&other| other != size) {
        return Err(ConsistencyError::SizeMismatch {
            first: size,
            second: other,
        });
    }
    for flow in [forward, backward] {
        if flow.flow_px.len() != size.0 * size.1 {
            return Err(ImageError::LengthMismatch {
                width: size.0,
                height: size.1,
                expected: size.0 * size.1,
                actual: flow.flow_px.len(),
            }
            .into());
        }
    }
    first.normalised.validate()?;
    second.normalised.validate()?;
    Ok(())
}

#[cfg(test)]
mod tests;
