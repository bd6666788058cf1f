//! The embedded default tracker: camera poses, and inverse depths where they can be known, of a clip.
//!
//! - [`FrontEnd`] takes frames as they come, keeps those as keyframes that the picture has moved enough
//!   for, and joins each to the keyframes before it: a [`FlowGraph`]. A stored graph does as well.
//! - [`solve()`] grows a map keyframe by keyframe (local adjustment of the last few), then refines it as a
//!   whole, robustly; a round that lowers the cost by less than the tolerance is the last.
//! - [`Solution::observability`] is the parallax gate: how much of the depth the flows determine.
//!
//! Bounds: at most [`TrackParams::most_adjusted`] poses are free at once. Longer clips are refined in
//! windows that overlap by half, the poses before each held fixed, so that time is linear in the frames
//! and the poses' system is bounded; memory is 16 bytes for each edge and cell. Units: grid cells;
//! parameters named `_px` are pixels of a 256-px-high picture, eight to a cell.

mod front_end;
mod gate;
mod poses;
mod residual;
mod solve;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use front_end::FrontEnd;
pub use gate::Observability;
pub use residual::{EdgeResidual, series};
pub use solve::{Effort, Solution, rotate_only, solve};
pub(super) use solve::{first_edges, resolve};

use super::bundle::{BundleError, BundleOptions, EdgeObservation};
use super::camera::{DepthRule, Grid};
use super::flow_operator::{FlowOperatorError, GridAnswer};

/// Side of a cell, px of a 256-px-high picture: the 1/8 grid.
pub const CELL_PX: f64 = 8.0;

/// Most depths of a map: 574 keyframes of 16:9, 1024 square ones.
pub const MOST_CELLS: usize = 1 << 20;

/// How a clip is tracked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackParams {
    /// A frame becomes a keyframe when its cells have moved this far in the mean since the last one, px.
    pub keyframe_motion_px: f64,
    /// Keyframes before it that each keyframe is joined to, both ways.
    pub span: usize,
    /// Keyframes adjusted together at the start.
    pub warmup: usize,
    /// Keyframes whose poses a new one may still move.
    pub window: usize,
    /// Steps for each new keyframe.
    pub local_iterations: usize,
    /// Most poses refined together.
    pub most_adjusted: usize,
    /// Most rounds of the refinement; each weighs the residuals anew.
    pub rounds: usize,
    /// Most steps of a round.
    pub iterations: usize,
    /// A round, or a step, that lowers the cost by less than this share is the last.
    pub tolerance: f64,
    /// Residuals beyond this count linearly (Huber), px.
    pub huber_px: f64,
    /// Standard deviation of a flow coordinate, px: GRIC's.
    pub sigma_px: f64,
    /// The depth of a clip is observable when it is for this share of its cells.
    pub least_observable: f64,
}

impl Default for TrackParams {
    fn default() -> Self {
        Self {
            keyframe_motion_px: 6.0,
            span: 3,
            warmup: 8,
            window: 8,
            local_iterations: 4,
            most_adjusted: 128,
            rounds: 6,
            iterations: 10,
            tolerance: 1e-3,
            huber_px: 1.0,
            sigma_px: 0.5,
            least_observable: 0.25,
        }
    }
}

impl TrackParams {
    fn options(&self, iterations: usize) -> BundleOptions {
        BundleOptions {
            iterations,
            tolerance: self.tolerance,
            ..BundleOptions::default()
        }
    }

    /// # Errors
    /// [`TrackError::Parameter`].
    fn validate(&self) -> Result<(), TrackError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        for (name, good) in [
            ("keyframe_motion_px", self.keyframe_motion_px >= 0.0),
            ("span", self.span > 0),
            ("warmup", self.warmup > 1),
            ("window", self.window > 0),
            ("most_adjusted", self.most_adjusted > 2 * self.span),
            ("huber_px", positive(self.huber_px)),
            ("sigma_px", positive(self.sigma_px)),
        ] {
            if !good {
                return Err(TrackError::Parameter { name });
            }
        }
        Ok(())
    }
}

/// A directed pair of keyframes.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowEdge {
    /// Keyframe whose cells these are.
    pub source: usize,
    /// Keyframe they are found in.
    pub target: usize,
    /// Where they are, and what that is worth.
    pub answer: GridAnswer,
}

impl FlowEdge {
    fn observation(&self) -> EdgeObservation<'_> {
        EdgeObservation {
            source: self.source,
            target: self.target,
            at: &self.answer.at,
            weight: &self.answer.weight,
        }
    }
}

/// A frame that is no keyframe, seen from the keyframe before it.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    /// Input frame.
    pub frame: usize,
    /// Its keyframe.
    pub keyframe: usize,
    /// Where the keyframe's cells are in it.
    pub answer: GridAnswer,
}

/// A clip's correspondences on the grid.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowGraph {
    /// The grid of all frames.
    pub grid: Grid,
    /// Input frame of each keyframe, increasing.
    pub frames: Vec<usize>,
    /// Pairs of keyframes, in any order.
    pub edges: Vec<FlowEdge>,
    /// The frames between.
    pub followers: Vec<Follower>,
}

impl FlowGraph {
    /// No frames.
    #[must_use]
    pub fn new(grid: Grid) -> Self {
        Self {
            grid,
            frames: Vec::new(),
            edges: Vec::new(),
            followers: Vec::new(),
        }
    }

    /// Bytes that the correspondences take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let answers = self.edges.len() + self.followers.len();
        answers * self.grid.cells() * 4 * size_of::<f32>()
    }
}

/// Why a clip has no trajectory.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// An adjustment failed: no factor at any damping, or malformed input.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The flows are missing or malformed.
    #[error(transparent)]
    Flow(#[from] FlowOperatorError),
    /// More depths than a map may have.
    #[error(
        "the camera moves too far for one map: more than {keyframes} keyframes; cut the clip into parts"
    )]
    TooLong {
        /// The most.
        keyframes: usize,
    },
    /// Fewer than two keyframes, or none joined to another.
    #[error("no two frames are joined")]
    NoEdges,
    /// A parameter is outside its range.
    #[error("parameter {name} is out of range")]
    Parameter {
        /// The field's name.
        name: &'static str,
    },
}

/// Which relative depths count, everywhere in the tracker: the adjustment's.
fn depth_rule() -> DepthRule {
    let least = BundleOptions::default().min_depth;
    DepthRule {
        valid_above: least,
        unit_below: least,
    }
}
