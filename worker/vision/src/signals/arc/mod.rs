//! Signals on frames of constant visual motion (ARC): the same motion per step whatever the frame
//! rate and the speed of the scene (`evidence.md`, section 2b; yardstick `prototype/arc.py`,
//! `lean.py`).
//!
//! [`ArcSelector`] says which frames to keep; [`ArcSignals`] takes the kept frames with the evidence
//! of kept → next kept, and gives, per step and for the clip:
//! - layer acceleration (accs): layers keep their motion pattern from step to step;
//! - interior shear (Sd): rigid interiors do not shear;
//! - detail change (sh): moving surfaces keep their detail over four steps.
//!
//! accs and sh come as the mean over a step's cells (the definition of `evidence.md`) and as the
//! lower quartile, which flow that fails at a layer's edge does not reach: it is high only where even
//! the part that is followed best does not keep its motion or its detail.
//!
//! Evidence grid, flow in pixels of a picture 256 px high. A step with too little to go by is `None`.
//! Fails with [`ArcError`] on inputs of changing size.

mod acceleration;
mod detail;
mod selector;
mod shear;
mod stream;

pub use acceleration::layer_acceleration;
pub use detail::{DetailFrame, detail_change};
pub use selector::{ArcSelector, ArcSelectorParams};
pub use shear::interior_shear;
pub use stream::{ArcClip, ArcSignals, ArcStep};

use serde::{Deserialize, Serialize};

use crate::consistency::Evidence;

/// Constants of the three signals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArcParams {
    /// A cell moves when its flow is longer than this, reference pixels.
    pub moving_px: f32,
    /// A step's value needs more cells than this.
    pub min_cells: usize,
    /// A clip's value needs this many steps that have one.
    pub min_steps: usize,
    /// Layer acceleration.
    pub acceleration: AccelerationParams,
    /// Interior shear.
    pub shear: ShearParams,
    /// Detail change.
    pub detail: DetailParams,
}

/// Constants of the layer acceleration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AccelerationParams {
    /// Added to the mean speed in the denominator d, reference pixels.
    pub speed_offset_px: f32,
    /// Only cells with d above this count, reference pixels.
    pub min_denominator_px: f32,
    /// Radius of the box over which a layer's motion is taken as common, cells.
    pub layer_radius_cells: usize,
    /// Added to the box mean of |F|², px².
    pub energy_offset_px2: f32,
    /// Least ratio of a layer's speeds.
    pub min_ratio: f32,
    /// Largest ratio of a layer's speeds.
    pub max_ratio: f32,
    /// Added to the box mean of the counted share.
    pub share_offset: f32,
    /// Largest relative residual of a cell.
    pub residual_limit: f32,
}

/// Constants of the interior shear.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShearParams {
    /// Reach of the one-sided differences, cells.
    pub reach_cells: usize,
    /// Interiors are this far from cells that do not move, cells.
    pub erosion_radius_cells: usize,
}

/// Constants of the detail change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetailParams {
    /// Steps over which points are followed.
    pub steps: usize,
    /// Points start at every so manieth kept frame.
    pub stride: usize,
    /// Standard deviation of the Gaussian that separates detail, cells.
    pub detail_sigma_cells: f64,
    /// Radius of the box mean of |detail|, cells.
    pub detail_radius_cells: usize,
    /// Added to the mean |detail| before its logarithm, grey levels.
    pub detail_offset: f32,
    /// Only points displaced farther than this count, reference pixels.
    pub min_displacement_px: f32,
    /// Points closer to the border than this are lost, cells.
    pub margin_cells: usize,
}

impl Default for ArcParams {
    fn default() -> Self {
        Self {
            moving_px: 1.0,
            min_cells: 40,
            min_steps: 3,
            acceleration: AccelerationParams::default(),
            shear: ShearParams::default(),
            detail: DetailParams::default(),
        }
    }
}

impl Default for AccelerationParams {
    fn default() -> Self {
        Self {
            speed_offset_px: 1.0,
            min_denominator_px: 2.0,
            layer_radius_cells: 7,
            energy_offset_px2: 0.2,
            min_ratio: -2.0,
            max_ratio: 3.0,
            share_offset: 0.001,
            residual_limit: 4.0,
        }
    }
}

impl Default for ShearParams {
    fn default() -> Self {
        Self {
            reach_cells: 3,
            erosion_radius_cells: 2,
        }
    }
}

impl Default for DetailParams {
    fn default() -> Self {
        Self {
            steps: 4,
            stride: 2,
            detail_sigma_cells: 2.0,
            detail_radius_cells: 3,
            detail_offset: 1.0,
            min_displacement_px: 3.0,
            margin_cells: 4,
        }
    }
}

/// Why a kept frame was not taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ArcError {
    /// Every kept frame but the first needs the evidence from the one before.
    #[error("kept frame {frame} came without the evidence from the one before")]
    MissingEvidence {
        /// The caller's number of the frame.
        frame: usize,
    },
    /// The input is on another grid than the first frame, or incomplete.
    #[error("kept frame {frame} is on a grid of {actual:?}, not {expected:?} (width, height)")]
    SizeMismatch {
        /// The caller's number of the frame.
        frame: usize,
        /// The grid of the first frame.
        expected: (usize, usize),
        /// The grid of the input.
        actual: (usize, usize),
    },
    /// A parameter has no meaning.
    #[error("{name} = {value} has no meaning")]
    InvalidParameter {
        /// The field's name.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Where a cell's flow ends, in cells.
fn end_point(evidence: &Evidence, cell: usize) -> [f32; 2] {
    let [u, v] = evidence.flow_px[cell];
    let x = (cell % evidence.width) as f32;
    let y = (cell / evidence.width) as f32;
    [
        x + u * evidence.cells_per_px[0],
        y + v * evidence.cells_per_px[1],
    ]
}

/// A mean over more than `min_cells` cells, else `None`.
#[derive(Debug, Clone, Copy, Default)]
struct CellMean {
    sum: f64,
    cells: usize,
}

impl CellMean {
    fn add(&mut self, value: f32) {
        self.sum += f64::from(value);
        self.cells += 1;
    }

    fn over(self, min_cells: usize) -> Option<f64> {
        (self.cells > min_cells).then(|| self.sum / self.cells as f64)
    }
}

/// What a step's cells have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellSummary {
    /// The mean over the cells, in order.
    pub mean: f64,
    /// The value that a quarter of the cells stay below, linear between cells.
    pub lower_quartile: f64,
}

/// The values of a step's cells.
#[derive(Debug, Clone, Default)]
struct CellSample {
    mean: CellMean,
    values: Vec<f32>,
}

impl CellSample {
    fn add(&mut self, value: f32) {
        self.mean.add(value);
        self.values.push(value);
    }

    /// Of more than `min_cells` cells, else `None`.
    fn over(mut self, min_cells: usize) -> Option<CellSummary> {
        let mean = self.mean.over(min_cells)?;
        let place = (self.values.len().checked_sub(1)?) as f64 / 4.0;
        let (_, &mut below, above) = self
            .values
            .select_nth_unstable_by(place as usize, f32::total_cmp);
        let above = above.iter().copied().min_by(f32::total_cmp);
        let step = above.map_or(0.0, |above| f64::from(above) - f64::from(below));
        Some(CellSummary {
            mean,
            lower_quartile: f64::from(below) + place.fract() * step,
        })
    }
}

#[cfg(test)]
mod tests;
