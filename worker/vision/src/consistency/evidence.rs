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
mod tests {
    use super::*;

    fn flow(width: usize, height: usize, field: impl Fn(usize, usize) -> [f32; 2]) -> Flow {
        Flow {
            width,
            height,
            data: (0..width * height)
                .map(|i| field(i % width, i / width))
                .collect(),
        }
    }

    fn texture(width: usize, height: usize, shift: f64) -> Plane {
        // Wavelengths in units of the height, so that every working size shows the same picture.
        let unit = 256.0 / height as f64;
        Plane::from_fn(width, height, |x, y| {
            let (x, y) = ((x as f64 + 0.5) * unit - shift, (y as f64 + 0.5) * unit);
            (128.0 + 50.0 * libm::sin(0.11 * x + 0.05 * y) * libm::cos(0.09 * y - 0.04 * x)) as f32
        })
    }

    fn measure(forward: &Flow, backward: &Flow, first: &Plane, second: &Plane) -> Evidence {
        let params = ConsistencyParams::default();
        let grid = |flow| GridFlow::new(flow, &params).unwrap();
        let frame = |plane| NormalisedFrame::new(plane, &params).unwrap();
        Evidence::new(
            &grid(forward),
            &grid(backward),
            &frame(first),
            &frame(second),
            &params,
        )
        .unwrap()
    }

    #[test]
    fn true_motion_is_consistent_at_every_working_height() {
        for (width, height) in [
            (128, 128),
            (256, 256),
            (512, 512),
            (342, 256),
            (171, 128),
            (455, 341),
        ] {
            // 6 reference pixels to the right.
            let shift = 6.0 * height as f32 / 256.0;
            let forward = flow(width, height, |_, _| [shift, 0.0]);
            let backward = flow(width, height, |_, _| [-shift, 0.0]);
            let (first, second) = (texture(width, height, 0.0), texture(width, height, 6.0));
            let evidence = measure(&forward, &backward, &first, &second);
            assert_eq!(evidence.height, 128);
            let columns = (128.0 * width as f64 / height as f64).round_ties_even();
            assert_eq!(evidence.width, columns as usize);
            for index in (0..evidence.rho.len()).filter(|&i| evidence.counted[i]) {
                // f32 rounding of weights that sum to 1 on vectors of up to 12 px.
                assert!((evidence.speed_px[index] - 6.0).abs() < 1e-4);
                assert!(evidence.rho[index] < 1e-6 && evidence.consistent(index));
                // Local statistics reach 16 cells, and 3 cells of new picture enter at the left;
                // elsewhere bilinear look-up costs a few percent of a deviation, where a wrong
                // scale would cost tenths.
                let x = index % evidence.width;
                if (20..evidence.width - 20).contains(&x) {
                    assert!(evidence.appearance[index] < 0.1, "{width}x{height}");
                }
            }
        }
    }

    /// One cell from the definitions, in f64, with its own bilinear look-up.
    fn twin_cell(
        x: usize,
        y: usize,
        ahead: &GridFlow,
        back: &GridFlow,
        first: &Plane,
        second: &Plane,
    ) -> [f64; 3] {
        let (width, height) = (ahead.width, ahead.height);
        let lookup = |at: &dyn Fn(usize) -> f64, px: f64, py: f64| {
            let px = px.clamp(0.0, width as f64 - 1.0);
            let py = py.clamp(0.0, height as f64 - 1.0);
            let mut sum = 0.0;
            for row in 0..height {
                for column in 0..width {
                    let weight = (1.0 - (px - column as f64).abs()).max(0.0)
                        * (1.0 - (py - row as f64).abs()).max(0.0);
                    sum += weight * at(row * width + column);
                }
            }
            sum
        };
        let [u, v] = ahead.flow_px[y * width + x].map(f64::from);
        let px = x as f64 + u * f64::from(ahead.cells_per_px[0]);
        let py = y as f64 + v * f64::from(ahead.cells_per_px[1]);
        let bu = lookup(&|i| f64::from(back.flow_px[i][0]), px, py);
        let bv = lookup(&|i| f64::from(back.flow_px[i][1]), px, py);
        let e = (u + bu).hypot(v + bv);
        let rho = e * e / (0.5 + 0.01 * (u * u + v * v + bu * bu + bv * bv));
        let moved = lookup(&|i| f64::from(second.data[i]), px, py);
        let r = (f64::from(first.data[y * width + x]) - moved)
            .abs()
            .min(3.0);
        [e, rho, r]
    }

    #[test]
    fn cells_match_the_definitions() {
        let params = ConsistencyParams::default();
        let field = |sign: f32| {
            move |x: usize, y: usize| {
                [
                    sign * (2.0 + libm::sinf(x as f32 * 0.07)) * 4.0,
                    sign * libm::cosf(y as f32 * 0.05) * 3.0,
                ]
            }
        };
        let (ahead, back) = (flow(192, 144, field(1.0)), flow(192, 144, field(-1.0)));
        let (first, second) = (texture(192, 144, 0.0), texture(192, 144, 9.0));
        let evidence = measure(&ahead, &back, &first, &second);
        let grid = |flow| GridFlow::new(flow, &params).unwrap();
        let normal = |plane| NormalisedFrame::new(plane, &params).unwrap().normalised;
        let (ahead, back) = (grid(&ahead), grid(&back));
        let (first, second) = (normal(&first), normal(&second));
        for (x, y) in [(0, 0), (5, 90), (64, 64), (100, 3), (170, 127), (90, 31)] {
            let index = y * evidence.width + x;
            let [e, rho, r] = twin_cell(x, y, &ahead, &back, &first, &second);
            // f32 positions up to 171 cells: fractions good to 1e-5, times slopes of about 1.
            assert!((f64::from(evidence.error_px[index]) - e).abs() < 1e-3);
            assert!((f64::from(evidence.rho[index]) - rho).abs() < 1e-3 * (1.0 + rho));
            assert!((f64::from(evidence.appearance[index]) - r).abs() < 1e-3);
        }
    }

    #[test]
    fn normalised_frame_ignores_gain_and_offset_where_contrast_is_high() {
        let params = ConsistencyParams::default();
        let plain = texture(256, 256, 0.0);
        let brighter = Plane {
            data: plain.data.iter().map(|g| 1.2 * g + 20.0).collect(),
            ..plain
        };
        let a = NormalisedFrame::new(&plain, &params).unwrap().normalised;
        let b = NormalisedFrame::new(&brighter, &params).unwrap().normalised;
        let worst = a
            .data
            .iter()
            .zip(&b.data)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        // Only the variance floor of 25 tells them apart: 30% of 25 / variance at worst.
        assert!(worst < 0.25, "{worst}");
        let flat = NormalisedFrame::new(&Plane::from_fn(99, 77, |_, _| 255.0), &params).unwrap();
        assert!(flat.normalised.data.iter().all(|n| n.abs() < 1e-3));
    }

    #[test]
    fn change_maps_are_zero_for_true_motion_and_high_for_a_foreign_frame() {
        let still = flow(256, 256, |_, _| [0.0; 2]);
        let first = texture(256, 256, 0.0);
        let same = measure(&still, &still, &first, &first);
        assert!(same.change_map().data.iter().all(|q| *q == 0.0));
        let foreign = measure(&still, &still, &first, &texture(256, 256, 31.0));
        let mean = |plane: Plane| plane.data.iter().sum::<f32>() / plane.data.len() as f32;
        assert!(mean(foreign.appearance_change_map()) > 0.4);
        assert!(
            foreign
                .change_map()
                .data
                .iter()
                .all(|q| (0.0..=1.0 + 1e-6).contains(q))
        );
    }

    #[test]
    fn mismatched_and_broken_inputs_are_typed_errors() {
        let params = ConsistencyParams::default();
        let grid = |w, h| GridFlow::new(&flow(w, h, |_, _| [0.0; 2]), &params).unwrap();
        let frame = |w, h| NormalisedFrame::new(&texture(w, h, 0.0), &params).unwrap();
        let result = Evidence::new(
            &grid(64, 64),
            &grid(64, 64),
            &frame(64, 64),
            &frame(80, 64),
            &params,
        );
        assert!(matches!(result, Err(ConsistencyError::SizeMismatch { .. })));
        let mut broken = texture(16, 16, 0.0);
        broken.data[3] = f32::NAN;
        assert!(matches!(
            NormalisedFrame::new(&broken, &params),
            Err(ConsistencyError::PixelNotFinite { index: 3 })
        ));
        let nan = flow(16, 16, |_, _| [f32::NAN, 0.0]);
        assert!(matches!(
            GridFlow::new(&nan, &params),
            Err(ConsistencyError::FlowOutOfRange { .. })
        ));
        let zero = ConsistencyParams {
            grid_height: 0,
            ..params
        };
        assert!(matches!(
            GridFlow::new(&flow(16, 16, |_, _| [0.0; 2]), &zero),
            Err(ConsistencyError::InvalidParameter {
                name: "grid_height",
                ..
            })
        ));
    }
}
