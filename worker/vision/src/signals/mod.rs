//! Motion-balanced signals of one frame pair, from its per-direction evidence (`evidence.md`,
//! section 2; yardstick `prototype/lean2.py`).
//!
//! P rises with motion and T falls with it, so that together they see faults rather than motion. All
//! pixels are those of a picture 256 px high. A signal with too little to go by is `None`, never 0.
//! Nothing here fails: the evidence was checked when it was made.

pub mod arc;
pub mod contact;
mod erode;
mod median;
mod piecewise;

pub use piecewise::{PiecewiseParams, piecewise_residual};

pub use median::median;
pub(crate) use median::median_f32;

use serde::{Deserialize, Serialize};

use crate::consistency::{ConsistencyParams, EndPointError, Evidence, WorldscoreEpe};

/// Constants of the per-pair signals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SignalParams {
    /// A cell moves when its flow is longer than this, reference pixels.
    pub moving_px: f32,
    /// T needs more moving cells than this.
    pub appearance_min_cells: usize,
    /// The piecewise-affine residual P.
    pub piecewise: PiecewiseParams,
}

impl Default for SignalParams {
    fn default() -> Self {
        Self {
            moving_px: 1.0,
            appearance_min_cells: 20,
            piecewise: PiecewiseParams::default(),
        }
    }
}

/// Everything measured on one pair of frames; `None` where undefined.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairSignals {
    /// Mean |flow| over counted cells, reference pixels.
    pub motion_px: Option<f64>,
    /// Share of counted cells that move.
    pub moving_fraction: Option<f64>,
    /// P: relative residual of the moving cells under up to four affine motions.
    pub piecewise_residual: Option<f64>,
    /// T: appearance residual of moving over that of all consistent cells.
    pub appearance_ratio: Option<f64>,
    /// Corrected forward/backward end-point error, reference pixels.
    pub aepe_px: Option<f64>,
    /// WorldScore's form of it, reference pixels.
    pub aepe_worldscore_px: Option<f64>,
    /// Share of in-frame pixels where forward and backward flow disagree.
    pub occluded_fraction: Option<f64>,
    /// Share of pixels whose end point lies in the frame.
    pub in_frame_fraction: f64,
}

impl PairSignals {
    /// Collects the pair's signals; all three inputs are of the forward direction.
    #[must_use]
    pub fn new(
        evidence: &Evidence,
        end_point: &EndPointError,
        worldscore: &WorldscoreEpe,
        consistency: &ConsistencyParams,
        params: &SignalParams,
    ) -> Self {
        Self {
            motion_px: motion_px(evidence),
            moving_fraction: moving_fraction(evidence, params),
            piecewise_residual: piecewise_residual(evidence, params.moving_px, &params.piecewise),
            appearance_ratio: appearance_ratio(evidence, params),
            aepe_px: end_point.mean_px,
            aepe_worldscore_px: worldscore.average_reference_px(consistency),
            occluded_fraction: end_point.occluded_fraction,
            in_frame_fraction: end_point.in_frame_fraction,
        }
    }
}

/// Mean |flow| over counted cells, reference pixels; `None` when no cell counts.
#[must_use]
pub fn motion_px(evidence: &Evidence) -> Option<f64> {
    mean(counted(evidence, &evidence.speed_px))
}

/// Share of counted cells that move; `None` when no cell counts.
#[must_use]
pub fn moving_fraction(evidence: &Evidence, params: &SignalParams) -> Option<f64> {
    let moves = |speed: f32| f32::from(u8::from(speed > params.moving_px));
    mean(counted(evidence, &evidence.speed_px).map(moves))
}

/// T: mean appearance residual r of moving cells over that of all consistent cells. `None` with too
/// few moving cells, or when nothing differs at all.
#[must_use]
pub fn appearance_ratio(evidence: &Evidence, params: &SignalParams) -> Option<f64> {
    let moving: Vec<usize> = moving_cells(evidence, params.moving_px);
    if moving.len() <= params.appearance_min_cells {
        return None;
    }
    let of_moving = mean(moving.iter().map(|&index| evidence.appearance[index]))?;
    let judged = evidence.rho.iter().zip(&evidence.appearance);
    let consistent = judged
        .zip(&evidence.counted)
        .filter(|&((&rho, _), &counted)| counted && rho < 1.0);
    let of_all = mean(consistent.map(|((_, &appearance), _)| appearance))?;
    (of_all > 0.0).then(|| of_moving / of_all)
}

/// Indices of consistent cells whose flow is longer than `moving_px`.
fn moving_cells(evidence: &Evidence, moving_px: f32) -> Vec<usize> {
    let cells = evidence.speed_px.iter().zip(&evidence.rho);
    cells
        .zip(&evidence.counted)
        .enumerate()
        .filter(|&(_, ((&speed, &rho), &counted))| counted && rho < 1.0 && speed > moving_px)
        .map(|(cell, _)| cell)
        .collect()
}

/// Of the values of the cells, those of counted ones.
fn counted<'a>(evidence: &'a Evidence, values: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    let cells = values.iter().zip(&evidence.counted);
    cells.filter_map(|(&value, &counted)| counted.then_some(value))
}

/// Mean in f64, in order; `None` of nothing.
fn mean(values: impl Iterator<Item = f32>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| {
        (sum + f64::from(value), count + 1)
    });
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests;
