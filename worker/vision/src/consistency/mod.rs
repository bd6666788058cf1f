//! Forward/backward consistency of a pair of flows: WorldScore's end-point error to the bit, its
//! corrected form, and the per-direction evidence that the signals and fault maps read.
//!
//! `forward` maps frame a to frame b on a's grid, `backward` b to a on b's. Errors are in pixels of a
//! 256-px-high picture (`reference_height_px`) except where a name or comment says otherwise.
//! Fails with [`ConsistencyError`] on flows that do not belong together or are not finite.

mod end_point;
mod evidence;
mod look_up;
mod structure;
mod worldscore;

pub use end_point::{EndPointError, EndPoints};
pub use evidence::{Evidence, GridFlow, NormalisedFrame};
pub use structure::{FrameStructure, Structure};
pub use worldscore::{WorldscoreEpe, worldscore_epe};

use serde::{Deserialize, Serialize};

use crate::flow::Flow;
use crate::image::ImageError;

// No frame is this wide; larger vectors are garbage, and their squares would leave f32.
const MAX_FLOW_PX: f32 = 1e6;

/// Constants of the consistency measures. Pixels are those of a picture `reference_height_px` high.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ConsistencyParams {
    /// Height of the picture whose pixels are the unit of every error.
    pub reference_height_px: f64,
    /// Share of |F|² + |B'|² by which forward and backward flow may disagree (Sundaram et al. 2010).
    pub tolerance_relative: f32,
    /// Disagreement always allowed, squared pixels (Sundaram et al. 2010).
    pub tolerance_px2: f32,
    /// Rows of the evidence grid; its columns follow the frame's shape.
    pub grid_height: usize,
    /// Cells at the grid's border whose evidence is not counted.
    pub margin_cells: usize,
    /// Standard deviation of the local normalisation, cells.
    pub normalisation_sigma_cells: f64,
    /// Variance added before dividing by the local deviation, squared grey levels: keeps sensor and
    /// coding noise in flat regions small.
    pub variance_floor: f32,
    /// Largest appearance residual, local standard deviations.
    pub appearance_limit: f32,
    /// Appearance residual at which the change map reaches 1 − 1/e.
    pub appearance_scale: f32,
}

impl Default for ConsistencyParams {
    fn default() -> Self {
        Self {
            reference_height_px: 256.0,
            tolerance_relative: 0.01,
            tolerance_px2: 0.5,
            grid_height: 128,
            margin_cells: 4,
            normalisation_sigma_cells: 4.0,
            variance_floor: 25.0,
            appearance_limit: 3.0,
            appearance_scale: 0.7,
        }
    }
}

impl ConsistencyParams {
    /// Whether every field has a meaning.
    ///
    /// # Errors
    /// [`ConsistencyError::InvalidParameter`] naming the first field that has none.
    pub fn validate(&self) -> Result<(), ConsistencyError> {
        let positive = [
            ("reference_height_px", self.reference_height_px),
            ("tolerance_px2", f64::from(self.tolerance_px2)),
            ("grid_height", self.grid_height as f64),
            ("normalisation_sigma_cells", self.normalisation_sigma_cells),
            ("variance_floor", f64::from(self.variance_floor)),
            ("appearance_limit", f64::from(self.appearance_limit)),
            ("appearance_scale", f64::from(self.appearance_scale)),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(ConsistencyError::InvalidParameter { name, value });
            }
        }
        if !(self.tolerance_relative.is_finite() && self.tolerance_relative >= 0.0) {
            return Err(ConsistencyError::InvalidParameter {
                name: "tolerance_relative",
                value: f64::from(self.tolerance_relative),
            });
        }
        Ok(())
    }

    /// ρ = |F + B'|² / (absolute + relative (|F|² + |B'|²)); the two flows agree where ρ < 1.
    #[inline]
    fn rho(&self, squared_error: f32, forward: [f32; 2], backward: [f32; 2]) -> f32 {
        squared_error / self.tolerance(forward, backward)
    }

    /// The largest |F + B'|² at which the two flows agree, squared pixels.
    #[inline]
    fn tolerance(&self, forward: [f32; 2], backward: [f32; 2]) -> f32 {
        let energy = squared_norm(forward) + squared_norm(backward);
        self.tolerance_px2 + self.tolerance_relative * energy
    }
}

/// Why consistency was not measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConsistencyError {
    /// The inputs are not on one grid.
    #[error("inputs differ in size: {first:?} and {second:?} (width, height)")]
    SizeMismatch {
        /// Width and height of the first input.
        first: (usize, usize),
        /// Width and height of the other.
        second: (usize, usize),
    },
    /// A flow's buffer does not match its size, or a frame is not a picture.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A vector is NaN, infinite or absurdly long.
    #[error("flow vector {index} is {vector:?}, outside ±{limit_px} px")]
    FlowOutOfRange {
        /// Flat index of the vector.
        index: usize,
        /// The vector, x then y.
        vector: [f32; 2],
        /// Largest magnitude accepted.
        limit_px: f32,
    },
    /// A grey frame holds a value that is not finite.
    #[error("pixel {index} of a frame is not finite")]
    PixelNotFinite {
        /// Flat index of the pixel.
        index: usize,
    },
    /// A parameter has no meaning.
    #[error("{name} = {value} is not allowed")]
    InvalidParameter {
        /// The field's name.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

fn squared_norm([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
}

/// Both fields are whole and of one size.
fn check_pair(forward: &Flow, backward: &Flow) -> Result<(), ConsistencyError> {
    for flow in [forward, backward] {
        check_length(flow)?;
    }
    let (first, second) = (
        (forward.width, forward.height),
        (backward.width, backward.height),
    );
    if first == second {
        Ok(())
    } else {
        Err(ConsistencyError::SizeMismatch { first, second })
    }
}

fn check_length(flow: &Flow) -> Result<(), ConsistencyError> {
    let expected = flow.width.checked_mul(flow.height);
    if expected == Some(flow.data.len()) {
        return Ok(());
    }
    Err(ImageError::LengthMismatch {
        width: flow.width,
        height: flow.height,
        expected: expected.unwrap_or(usize::MAX),
        actual: flow.data.len(),
    }
    .into())
}

/// At least one vector, and all of them finite.
fn check_values(flow: &Flow) -> Result<(), ConsistencyError> {
    if flow.data.is_empty() {
        return Err(ImageError::Empty {
            width: flow.width,
            height: flow.height,
        }
        .into());
    }
    // NaN fails the comparison too.
    let absurd = |v: &[f32; 2]| !(v[0].abs() <= MAX_FLOW_PX && v[1].abs() <= MAX_FLOW_PX);
    match flow.data.iter().position(absurd) {
        None => Ok(()),
        Some(index) => Err(ConsistencyError::FlowOutOfRange {
            index,
            vector: flow.data[index],
            limit_px: MAX_FLOW_PX,
        }),
    }
}
