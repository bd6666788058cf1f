//! How far apart two frames look: the mean optical flow that pose and depth induce.
//!
//! For each cell of the source, e₁ is the flow of the whole motion and e₂ that of the translation
//! alone; β of e₁ and 1 − β of e₂ are averaged over the samples in front of the camera. A distance
//! that too few samples support is `None` (the reference kernel, DROID-SLAM commit 8016d2b, returns
//! 1000). In cells of the grid; not symmetric.

use super::camera::{DepthRule, Grid, Pinhole, project};
use super::se3::Se3;

/// Relative depth beyond which a sample counts; the reference kernel's.
pub const MIN_DEPTH: f64 = 0.25;

/// Share of the samples that must count.
pub const VALID_FRACTION: f64 = 0.75;

/// Mean induced flow from the frame whose `inverse_depths` are given, `[rows, columns]`, to another.
/// `None` where less than [`VALID_FRACTION`] of the samples lie in front of the camera.
#[must_use]
pub fn frame_distance(
    camera: &Pinhole,
    grid: Grid,
    inverse_depths: &[f64],
    target_from_source: &Se3,
    beta: f64,
) -> Option<f64> {
    let translation = Se3 {
        translation: target_from_source.translation,
        ..Se3::IDENTITY
    };
    let samples = [(*target_from_source, beta), (translation, 1.0 - beta)];
    let rule = DepthRule {
        valid_above: MIN_DEPTH,
        unit_below: MIN_DEPTH,
    };
    let (mut sum, mut valid, mut total) = (0.0, 0.0, 0.0);
    for (cell, &d) in inverse_depths.iter().enumerate().take(grid.cells()) {
        let from = [(cell % grid.columns) as f64, (cell / grid.columns) as f64];
        for (motion, share) in &samples {
            total += share;
            let (at, point) = project(camera, motion, from, d, rule);
            if point.z > rule.valid_above {
                let (du, dv) = (at.x - from[0], at.y - from[1]);
                sum += share * libm::sqrt(du * du + dv * dv);
                valid += share;
            }
        }
    }
    let distance = sum / valid;
    // The small constant is the reference's; it decides nothing but an empty grid.
    (valid / (total + 1e-8) >= VALID_FRACTION && distance.is_finite()).then_some(distance)
}

/// Mean of the distances there and back; `None` where one of them is missing.
#[must_use]
pub fn symmetric_distance(
    camera: &Pinhole,
    grid: Grid,
    [first, second]: [(&Se3, &[f64]); 2],
    beta: f64,
) -> Option<f64> {
    let there = second.0.relative_to(first.0);
    let back = first.0.relative_to(second.0);
    let there = frame_distance(camera, grid, first.1, &there, beta)?;
    Some(0.5 * (there + frame_distance(camera, grid, second.1, &back, beta)?))
}
