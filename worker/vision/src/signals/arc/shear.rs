//! Sd, the interior shear: how much the flow of moving interiors deforms, relative to its length.
//!
//! One-sided differences of F at ±3 cells (0 where they leave the grid); of each pair the smaller if
//! both have one sign, else 0 (minmod: a layer boundary on one side does not count); per reference
//! pixel. dev = √((u_x − v_y)² + (u_y + v_x)²), free of divergence and rotation. Sd = mean dev / mean
//! |F| over moving, consistent cells eroded by a 5 × 5 box. Unit: 1/px.

use super::{ArcParams, CellMean};
use crate::consistency::Evidence;
use crate::signals::erode::erode;

/// Sd of a step; `None` with too few interior cells.
#[must_use]
pub fn interior_shear(step: &Evidence, params: &ArcParams) -> Option<f64> {
    let interior = interior(step, params);
    let reach = params.shear.reach_cells;
    // Each difference spans `reach` cells, which are this many reference pixels.
    let span_px = step.cells_per_px.map(|cells| reach as f32 / cells);
    let mut deviation = CellMean::default();
    let mut speed = CellMean::default();
    for (cell, _) in interior.iter().enumerate().filter(|&(_, &inside)| inside) {
        let [ux, vx] = slope(step, cell, reach, 1, step.width, cell % step.width);
        let rows = (step.height, cell / step.width);
        let [uy, vy] = slope(step, cell, reach, step.width, rows.0, rows.1);
        let stretch = ux / span_px[0] - vy / span_px[1];
        let skew = uy / span_px[1] + vx / span_px[0];
        deviation.add((stretch * stretch + skew * skew).sqrt());
        speed.add(step.speed_px[cell]);
    }
    // Interior cells move, so that their mean speed is above zero.
    Some(deviation.over(params.min_cells)? / speed.over(params.min_cells)?)
}

/// minmod of the differences ahead and behind along an axis, whose neighbours are `stride` apart and on
/// which the cell is at `position` of `length`.
fn slope(
    step: &Evidence,
    cell: usize,
    reach: usize,
    stride: usize,
    length: usize,
    position: usize,
) -> [f32; 2] {
    if position < reach || position + reach >= length {
        return [0.0; 2];
    }
    let behind = step.flow_px[cell - reach * stride];
    let here = step.flow_px[cell];
    let ahead = step.flow_px[cell + reach * stride];
    [0, 1].map(|axis| minmod(ahead[axis] - here[axis], here[axis] - behind[axis]))
}

fn minmod(a: f32, b: f32) -> f32 {
    if a * b <= 0.0 {
        0.0
    } else if a.abs() < b.abs() {
        a
    } else {
        b
    }
}

/// Cells whose whole neighbourhood moves consistently; what lies outside the grid does not matter.
fn interior(step: &Evidence, params: &ArcParams) -> Vec<bool> {
    let moving: Vec<bool> = (0..step.width * step.height)
        .map(|cell| step.consistent(cell) && step.speed_px[cell] > params.moving_px)
        .collect();
    erode(&moving, step.width, params.shear.erosion_radius_cells)
}
