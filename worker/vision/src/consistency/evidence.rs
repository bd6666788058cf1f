//! Per-direction evidence on a coarse grid: how far flow and counter-flow disagree, and how much the
//! moved appearance differs (`evidence.md`, section 2; yardstick `prototype/feat.py`, `dq`).
//!
//! The grid has `grid_height` rows (128) and square cells, whatever the working height. Flow is
//! area-filtered to the grid but stays in pixels of a picture `reference_height_px` (256) high. For
//! direction a → b at cell x: B' = B(x + F), e = |F + B'|, ρ = e² / (0.5 + 0.01 (|F|² + |B'|²)),
//! r = min(|Nₐ − N_b(x + F)|, 3), with N the locally normalised frame. Look-ups are bilinear with
//! clamped borders.

use super::end_point::inside;
use super::{ConsistencyError, ConsistencyParams, check_length, check_values, squared_norm};
use crate::flow::Flow;
use crate::image::{Bilinear, ImageError, Plane, box_mean, gaussian_blur, resize_plane};

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
        let component = |axis: usize| {
            let plane = Plane {
                width: flow.width,
                height: flow.height,
                data: flow.data.iter().map(|v| v[axis] * scale as f32).collect(),
            };
            resize_plane(&plane, width, height).data
        };
        Ok(Self {
            width,
            height,
            cells_per_px: [
                (width as f64 / (flow.width as f64 * scale)) as f32,
                (height as f64 / params.reference_height_px) as f32,
            ],
            flow_px: component(0)
                .into_iter()
                .zip(component(1))
                .map(|(u, v)| [u, v])
                .collect(),
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
        let cells = width * height;
        let mut evidence = Self {
            width,
            height,
            cells_per_px: forward.cells_per_px,
            flow_px: forward.flow_px.clone(),
            speed_px: Vec::with_capacity(cells),
            error_px: Vec::with_capacity(cells),
            rho: Vec::with_capacity(cells),
            appearance: Vec::with_capacity(cells),
            in_frame: Vec::with_capacity(cells),
            counted: Vec::with_capacity(cells),
            appearance_scale: params.appearance_scale,
        };
        for y in 0..height {
            for x in 0..width {
                evidence.push_cell(x, y, backward, first, second, params);
            }
        }
        Ok(evidence)
    }

    fn push_cell(
        &mut self,
        x: usize,
        y: usize,
        backward: &GridFlow,
        first: &NormalisedFrame,
        second: &NormalisedFrame,
        params: &ConsistencyParams,
    ) {
        let (width, height) = (self.width, self.height);
        let index = y * width + x;
        let [u, v] = self.flow_px[index];
        let to_x = x as f32 + u * self.cells_per_px[0];
        let to_y = y as f32 + v * self.cells_per_px[1];
        let at = Bilinear::at(to_x, to_y, width, height);
        let [a, b, c, d] = at.indices.map(|index| backward.flow_px[index]);
        let back = [
            at.mix(a[0], b[0], c[0], d[0]),
            at.mix(a[1], b[1], c[1], d[1]),
        ];
        let squared = squared_norm([u + back[0], v + back[1]]);
        let moved = second.normalised.bilinear(at);
        let difference = (first.normalised.data[index] - moved).abs();
        let in_frame = inside(to_x, to_y, width, height);
        let margin = params.margin_cells;
        let central = (margin..width.saturating_sub(margin)).contains(&x)
            && (margin..height.saturating_sub(margin)).contains(&y);
        self.speed_px.push(squared_norm([u, v]).sqrt());
        self.error_px.push(squared.sqrt());
        self.rho.push(params.rho(squared, [u, v], back));
        self.appearance
            .push(difference.min(params.appearance_limit));
        self.in_frame.push(in_frame);
        self.counted.push(in_frame && central);
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
        self.map(|index| self.rho[index] + self.appearance_exponent(index))
    }

    /// The same from appearance alone, q_r = box₃(1 − exp(−(r / scale)²)).
    #[must_use]
    pub fn appearance_change_map(&self) -> Plane {
        self.map(|index| self.appearance_exponent(index))
    }

    fn appearance_exponent(&self, index: usize) -> f32 {
        let ratio = self.appearance[index] / self.appearance_scale;
        ratio * ratio
    }

    fn map(&self, exponent: impl Fn(usize) -> f32) -> Plane {
        let change = |index: usize| {
            if self.in_frame[index] {
                -libm::expm1f(-exponent(index))
            } else {
                0.0
            }
        };
        let raw = Plane {
            width: self.width,
            height: self.height,
            data: (0..self.rho.len()).map(change).collect(),
        };
        box_mean(&raw, 1)
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
