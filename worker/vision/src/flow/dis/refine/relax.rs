//! Red-black successive over-relaxation of the increment (D. M. Young; the form of OpenCV's solver).
//!
//! All sweeps run in one pass over the rows: sweep t follows sweep t − 1 two rows behind, and black
//! one row behind red, so that every update sees exactly the values that separate sweeps would show
//! it while only some ten rows need to be in the cache.

use super::grid::{Around, Colour, Field, Grid};
use super::system::{Equations, System};
use crate::flow::simd::{LANES, Lanes};

/// `sweeps` sweeps; `keep` is 1 − ω.
#[inline(always)]
pub(super) fn relax(grid: &Grid, system: &System, increment: &mut Field, keep: f32, sweeps: usize) {
    for step in 0..grid.height + 2 * sweeps {
        for sweep in 0..sweeps {
            for (colour, lag) in [(Colour::Red, 2 * sweep), (Colour::Black, 2 * sweep + 1)] {
                if let Some(y) = step.checked_sub(lag).filter(|&y| y < grid.height) {
                    let equations = system.row(grid, colour, y);
                    let (du, around_u) = increment.u.row_mut_and_around(grid, colour, y);
                    let (dv, around_v) = increment.v.row_mut_and_around(grid, colour, y);
                    relax_row(&equations, (du, around_u), (dv, around_v), keep);
                }
            }
        }
    }
}

/// One row of one colour: u first, then v with the new u.
#[inline(always)]
fn relax_row(
    equations: &Equations<'_>,
    (du, around_u): (&mut [f32], Around<'_>),
    (dv, around_v): (&mut [f32], Around<'_>),
    keep: f32,
) {
    let keep = Lanes::splat(keep);
    for k in (0..du.len()).step_by(LANES) {
        let couplings = [
            equations.coupling_left,
            equations.coupling_above,
            equations.coupling,
        ]
        .map(|row| Lanes::load(row, k));
        let cross = Lanes::load(equations.cross, k);
        let (u, v) = (Lanes::load(du, k), Lanes::load(dv, k));
        let target_u =
            pull(&around_u, k, couplings) + Lanes::load(equations.right_u, k) - cross * v;
        let u = keep * u + target_u * Lanes::load(equations.scale_u, k);
        let target_v =
            pull(&around_v, k, couplings) + Lanes::load(equations.right_v, k) - cross * u;
        let v = keep * v + target_v * Lanes::load(equations.scale_v, k);
        u.store(du, k);
        v.store(dv, k);
    }
}

/// The coupled neighbours of eight pixels; `ahead` couples both the right and the lower one.
#[inline(always)]
fn pull(around: &Around<'_>, at: usize, [left, above, ahead]: [Lanes; 3]) -> Lanes {
    left * Lanes::load(around.left, at)
        + above * Lanes::load(around.above, at)
        + ahead * (Lanes::load(around.right, at) + Lanes::load(around.below, at))
}
