//! The linear system of one fixed-point iteration: robust weights frozen at the current field, then
//! per pixel the 2 × 2 data block, the smoothness couplings and the right-hand side.
//!
//! Smoothness couples a pixel to its right and lower neighbours with one weight, α / 2 over the
//! robust norm of the forward differences (half, because the equations are half the derivative).

use super::super::params::RefinementParams;
use super::grid::{Around, Board, Colour, Field, Grid};
use super::linearise::{Linearisation, Residual};
use crate::flow::simd::{LANES, Lanes};

/// A x = b with the diagonal inverted.
#[derive(Debug, Clone, Default)]
pub(super) struct System {
    /// Coupling of a pixel to its right and lower neighbours.
    coupling: Board,
    /// ω / A₁₁ and ω / A₂₂; zero beyond the frame, which pins those cells at zero.
    scale_u: Board,
    scale_v: Board,
    /// A₁₂.
    cross: Board,
    right_u: Board,
    right_v: Board,
    /// By parity of a row's first column: forward neighbours of each cell, but for the last row.
    forward: [Vec<f32>; 2],
    /// Likewise: ω inside the frame, 0 beyond.
    relaxation: [Vec<f32>; 2],
}

/// What a sweep reads of one row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Equations<'a> {
    pub(super) coupling: &'a [f32],
    pub(super) coupling_left: &'a [f32],
    pub(super) coupling_above: &'a [f32],
    pub(super) scale_u: &'a [f32],
    pub(super) scale_v: &'a [f32],
    pub(super) cross: &'a [f32],
    pub(super) right_u: &'a [f32],
    pub(super) right_v: &'a [f32],
}

impl System {
    pub(super) fn reset(&mut self, grid: &Grid, relaxation: f32) {
        for board in [
            &mut self.coupling,
            &mut self.scale_u,
            &mut self.scale_v,
            &mut self.cross,
            &mut self.right_u,
            &mut self.right_v,
        ] {
            board.reset(grid);
        }
        for (parity, (forward, inside)) in self
            .forward
            .iter_mut()
            .zip(&mut self.relaxation)
            .enumerate()
        {
            let column = |k: usize| 2 * k + parity;
            forward.clear();
            forward.extend((0..grid.half).map(|k| {
                if column(k) + 1 == grid.width {
                    1.0
                } else {
                    2.0
                }
            }));
            inside.clear();
            inside.extend((0..grid.half).map(|k| {
                if column(k) < grid.width {
                    relaxation
                } else {
                    0.0
                }
            }));
        }
    }

    /// Freezes the weights at `current` = `base` + `increment` and builds all rows.
    #[inline(always)]
    pub(super) fn assemble(
        &mut self,
        grid: &Grid,
        linearisation: &Linearisation,
        base: &Field,
        increment: &Field,
        current: &Field,
        params: &RefinementParams,
    ) {
        let constants = Constants::new(params);
        for y in 0..grid.height {
            for colour in Colour::BOTH {
                let coupling = self.coupling.row_mut(grid, colour, y);
                couple(coupling, grid, (colour, y), current, &constants);
            }
            for colour in Colour::BOTH {
                self.assemble_row(
                    grid,
                    (colour, y),
                    linearisation,
                    base,
                    increment,
                    &constants,
                );
            }
        }
    }

    #[inline(always)]
    fn assemble_row(
        &mut self,
        grid: &Grid,
        (colour, y): (Colour, usize),
        linearisation: &Linearisation,
        base: &Field,
        increment: &Field,
        constants: &Constants,
    ) {
        let residuals = linearisation.row(grid, colour, y);
        let du = increment.u.row(grid, colour, y);
        let dv = increment.v.row(grid, colour, y);
        let base_u = base.u.row(grid, colour, y);
        let base_v = base.v.row(grid, colour, y);
        let around_u = base.u.around(grid, colour, y);
        let around_v = base.v.around(grid, colour, y);
        let coupling = self.coupling.row(grid, colour, y);
        let coupled = self.coupling.around(grid, colour, y);
        let parity = colour.parity(y);
        let (forward, relaxation) = (&self.forward[parity], &self.relaxation[parity]);
        // The last row has no lower neighbour.
        let missing = Lanes::splat(if y + 1 == grid.height { 1.0 } else { 0.0 });
        let scale_u = self.scale_u.row_mut(grid, colour, y);
        let scale_v = self.scale_v.row_mut(grid, colour, y);
        let cross = self.cross.row_mut(grid, colour, y);
        let right_u = self.right_u.row_mut(grid, colour, y);
        let right_v = self.right_v.row_mut(grid, colour, y);
        for k in (0..grid.half).step_by(LANES) {
            let increment = [Lanes::load(du, k), Lanes::load(dv, k)];
            let data = DataTerm::new(&residuals, k, increment, constants);
            let ahead = Lanes::load(coupling, k);
            let left = Lanes::load(coupled.left, k);
            let above = Lanes::load(coupled.above, k);
            let couplings = [left, above, ahead];
            let degree = Lanes::load(forward, k) - missing;
            let smooth = constants.ridge + (left + above + ahead * degree);
            let relaxation = Lanes::load(relaxation, k);
            (relaxation / (data.xx + smooth)).store(scale_u, k);
            (relaxation / (data.yy + smooth)).store(scale_v, k);
            data.xy.store(cross, k);
            (laplacian(base_u, &around_u, k, couplings) - data.xz).store(right_u, k);
            (laplacian(base_v, &around_v, k, couplings) - data.yz).store(right_v, k);
        }
    }

    #[inline(always)]
    pub(super) fn row(&self, grid: &Grid, colour: Colour, y: usize) -> Equations<'_> {
        let around = self.coupling.around(grid, colour, y);
        Equations {
            coupling: self.coupling.row(grid, colour, y),
            coupling_left: around.left,
            coupling_above: around.above,
            scale_u: self.scale_u.row(grid, colour, y),
            scale_v: self.scale_v.row(grid, colour, y),
            cross: self.cross.row(grid, colour, y),
            right_u: self.right_u.row(grid, colour, y),
            right_v: self.right_v.row(grid, colour, y),
        }
    }
}

/// The parameters as the equations use them.
#[derive(Debug, Clone, Copy)]
struct Constants {
    half_alpha: Lanes,
    half_delta: Lanes,
    half_gamma: Lanes,
    epsilon_squared: Lanes,
    /// ζ², which keeps flat ground solvable.
    ridge: Lanes,
}

impl Constants {
    #[inline(always)]
    fn new(params: &RefinementParams) -> Self {
        Self {
            half_alpha: Lanes::splat(0.5 * params.smoothness),
            half_delta: Lanes::splat(0.5 * params.brightness),
            half_gamma: Lanes::splat(0.5 * params.gradient),
            epsilon_squared: Lanes::splat(params.epsilon * params.epsilon),
            ridge: Lanes::splat(params.normalisation * params.normalisation),
        }
    }
}

/// Σ weight (x, y) (x, y, z)ᵀ over the three residuals of eight pixels.
struct DataTerm {
    xx: Lanes,
    xy: Lanes,
    yy: Lanes,
    xz: Lanes,
    yz: Lanes,
}

impl DataTerm {
    #[inline(always)]
    fn new(
        residuals: &[Residual<'_>; 3],
        at: usize,
        [du, dv]: [Lanes; 2],
        constants: &Constants,
    ) -> Self {
        let [[bx, by, bz], [xx, xy, xz], [yx, yy, yz]] =
            residuals.map(|r| [r.x, r.y, r.z].map(|plane| Lanes::load(plane, at)));
        let by_brightness = squared([bx, by, bz], [du, dv]);
        let by_gradient = squared([xx, xy, xz], [du, dv]) + squared([yx, yy, yz], [du, dv]);
        let brightness = constants.half_delta / (by_brightness + constants.epsilon_squared).sqrt();
        let gradient = constants.half_gamma / (by_gradient + constants.epsilon_squared).sqrt();
        Self {
            xx: brightness * (bx * bx) + gradient * (xx * xx + yx * yx),
            xy: brightness * (bx * by) + gradient * (xx * xy + yx * yy),
            yy: brightness * (by * by) + gradient * (xy * xy + yy * yy),
            xz: brightness * (bx * bz) + gradient * (xx * xz + yx * yz),
            yz: brightness * (by * bz) + gradient * (xy * xz + yy * yz),
        }
    }
}

/// The smoothness weights of a row, from the forward differences of the current field.
#[inline(always)]
fn couple(
    coupling: &mut [f32],
    grid: &Grid,
    (colour, y): (Colour, usize),
    current: &Field,
    constants: &Constants,
) {
    let u = current.u.row(grid, colour, y);
    let v = current.v.row(grid, colour, y);
    let around_u = current.u.around(grid, colour, y);
    let around_v = current.v.around(grid, colour, y);
    for k in (0..grid.half).step_by(LANES) {
        let norm =
            roughness(u, &around_u, k) + roughness(v, &around_v, k) + constants.epsilon_squared;
        (constants.half_alpha / norm.sqrt()).store(coupling, k);
    }
}

/// Squared forward differences of eight pixels.
#[inline(always)]
fn roughness(row: &[f32], around: &Around<'_>, at: usize) -> Lanes {
    let here = Lanes::load(row, at);
    let right = Lanes::load(around.right, at) - here;
    let below = Lanes::load(around.below, at) - here;
    right * right + below * below
}

/// (z + x du + y dv)².
#[inline(always)]
fn squared([x, y, z]: [Lanes; 3], [du, dv]: [Lanes; 2]) -> Lanes {
    let r = z + x * du + y * dv;
    r * r
}

/// Weighted differences of eight pixels to their neighbours: the pull of the field as it was.
#[inline(always)]
fn laplacian(
    row: &[f32],
    around: &Around<'_>,
    at: usize,
    [left, above, ahead]: [Lanes; 3],
) -> Lanes {
    let here = Lanes::load(row, at);
    let forward = (Lanes::load(around.right, at) - here) + (Lanes::load(around.below, at) - here);
    ahead * forward
        + (left * (Lanes::load(around.left, at) - here)
            + above * (Lanes::load(around.above, at) - here))
}
