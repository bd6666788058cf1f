//! Which motion model a frame pair requires, and what the best rigid one leaves unexplained.
//!
//! From optical flow sampled on a grid ([`correspondence`]) three models are fitted, from cheap to
//! dear: a static camera, a homography ([`homography`]), a rigid scene with a free depth per point
//! ([`fundamental`]). GRIC ([`gric`], Torr 1998) picks the cheapest sufficient one per edge and
//! per clip; a model that provably cannot win is not fitted. [`solver`] is the seam, and
//! [`ClipGeometry::adjusted`] takes over what dense bundle adjustment leaves of a clip with parallax. What
//! the clip's two-view model leaves is split into rigid [`layers`].
//!
//! Units: all pixels are those of a 256-px-high picture, origin at its top-left corner. Residuals
//! are distances in the *target* picture. What may fail is [`SceneError`] (the input) and
//! [`FitError`] (one model on one edge).

mod affine;
pub mod clip;
pub mod correspondence;
pub mod evidence;
pub mod fundamental;
pub mod gric;
pub mod homography;
pub mod layers;
mod linear;
mod points;
pub mod ransac;
mod seven_point;
pub mod solver;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
mod two_view;

pub use clip::{AdjustedEdge, ClipGeometry, EdgeGeometry, FrameResidual, Work};
pub use correspondence::{Correspondence, CorrespondenceField, GridParams, sample_grid};
pub use evidence::{
    Method, ModelEvidence, ModelFit, MotionEstimate, MotionModel, PerModel, SceneKind,
};
pub use gric::GricParams;
pub use layers::{ClipLayers, LayerParams, clip_layers};
pub use ransac::RansacParams;
pub use solver::{EdgeInput, RigidSolver, TwoViewParams, TwoViewSolver};

/// Why an input cannot be judged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// The flow's vector count is not `width * height`, or it has no pixel.
    #[error("flow of {width} x {height} has {len} vectors")]
    FlowShape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Vectors found.
        len: usize,
    },
    /// The flow has a NaN or an infinity at a cell that the caller calls valid.
    #[error("flow is not finite at column {x}, row {y}")]
    NonFiniteFlow {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// A coordinate is NaN, infinite or beyond [`correspondence::MAX_COORDINATE_PX`].
    #[error("correspondence {index} has a coordinate that is not finite or out of range")]
    Coordinate {
        /// Position in the list.
        index: usize,
    },
    /// A weight is outside (0, 1].
    #[error("correspondence {index} has a weight outside (0, 1]")]
    Weight {
        /// Position in the list.
        index: usize,
    },
    /// The list of cells does not match the correspondences or the grid.
    #[error("cells do not match the correspondences or the grid")]
    Cells,
    /// Too few valid cells on this edge to choose between models: leave the edge out.
    #[error("{have} valid cells, {need} are needed")]
    TooFewCells {
        /// Valid cells of this edge.
        have: usize,
        /// Fewest that are judged.
        need: usize,
    },
    /// An edge must join two different frames.
    #[error("edge from frame {frame} to itself")]
    SelfEdge {
        /// The frame.
        frame: usize,
    },
    /// No edge could be judged: the clip has no geometric verdict.
    #[error("no edge to judge")]
    NoEdges,
    /// A parameter is outside its range.
    #[error("parameter {name} is out of range")]
    Parameter {
        /// The field's name.
        name: &'static str,
    },
}

/// Why one model could not be fitted to one edge. The model is then out of the choice.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, thiserror::Error, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum FitError {
    /// No sample and no simpler model gave an admissible estimate.
    #[error("no admissible estimate: the points are degenerate for this model")]
    Degenerate,
    /// The bounded eigenvalue iteration did not converge.
    #[error("eigenvalue iteration did not converge")]
    NoConvergence,
}
