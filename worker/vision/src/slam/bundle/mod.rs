//! Dense bundle adjustment: camera poses and one inverse depth per cell, from dense targets.
//!
//! Minimises Σ w ρ(target − reprojection) over all edges and cells in front of the camera, plus
//! w_p (d − d_measured)² where a depth was measured; ρ is the square, or Huber's kernel. Gauss-Newton;
//! the depths' block of the normal equations is diagonal and is eliminated first (Schur complement), the
//! poses' system is solved by Cholesky inside its envelope. With C the depths' diagonal, E the coupling,
//! A the poses' block:
//!
//! S = A − E C⁻¹ Eᵀ,  S dx = b − E C⁻¹ w,  dz = C⁻¹ (w − Eᵀ dx).
//!
//! One solver with explicit options: [`BundleOptions::worldscore`] reproduces the reference (CUDA
//! kernels of DROID-SLAM commit 8016d2b) with its quirks; the default is a Levenberg-Marquardt
//! iteration that accepts no step that raises the cost. Targets and weights are f32, all sums f64, in
//! one fixed order, on any number of threads ([`Workspace::with_threads`]). Poses are
//! `camera_from_world`, lengths are grid cells. Fails with [`BundleError`]; no result is ever NaN.

mod assemble;
mod cost;
mod envelope;
mod linearise;
mod options;
mod parallel;
mod schur;
mod solve;
mod step;
mod substitute;
#[cfg(test)]
mod tests;
mod tile;
mod view;
mod workspace;

use std::ops::Range;

pub use options::{BundleOptions, Damping, OnNotPositiveDefinite, StepControl};
pub use workspace::Workspace;

use super::camera::{Grid, Pinhole};
use super::se3::Se3;

/// What is adjusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The camera of all frames, in cells.
    pub camera: Pinhole,
    /// Cells of one frame.
    pub grid: Grid,
    /// `camera_from_world` of each frame.
    pub poses: Vec<Se3>,
    /// `[frames, rows, columns]`, in inverse units of the poses' translation.
    pub inverse_depths: Vec<f64>,
}

/// Where the cells of `source` are in `target`.
#[derive(Debug, Clone, Copy)]
pub struct EdgeObservation<'a> {
    /// Frame whose cells and depths these are.
    pub source: usize,
    /// Frame they are found in.
    pub target: usize,
    /// `[2, rows, columns]`: column, then row, in cells of the target.
    pub at: &'a [f32],
    /// `[2, rows, columns]`: what each coordinate is worth, ≥ 0.
    pub weight: &'a [f32],
}

/// What the scene is adjusted to.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    /// The frame pairs.
    pub edges: &'a [EdgeObservation<'a>],
    /// Frames whose pose may change; depths of every source may.
    pub free: Range<usize>,
    /// Added to the depths' diagonal, `[frames, rows, columns]`, ≥ 0.
    pub depth_damping: Option<&'a [f32]>,
    /// Inverse depths measured by other means, `[frames, rows, columns]`; 0 where there is none.
    pub measured: Option<&'a [f32]>,
}

/// What an adjustment did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Steps taken.
    pub iterations: usize,
    /// Cost at the start, over the cells valid then.
    pub cost_before: f64,
    /// Cost at the last state where it was evaluated: after the last step if steps are controlled,
    /// before it otherwise. Each step is judged over the cells valid before it; a cell that comes in
    /// front of a camera counts from the next step on.
    pub cost_after: f64,
    /// Whether it ended because no step lowered the cost by more than the tolerance.
    pub converged: bool,
    /// Steps whose pose part was dropped ([`OnNotPositiveDefinite::ZeroPoseStep`]).
    pub pose_steps_dropped: usize,
}

/// Why a scene was not adjusted. The scene then is what the last good step left.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// An array has another length than frames and grid ask for.
    #[error("{what} holds {actual} values, {expected} are needed")]
    Shape {
        /// The array.
        what: &'static str,
        /// Values needed.
        expected: usize,
        /// Values found.
        actual: usize,
    },
    /// An edge names a frame that does not exist, or joins a frame to itself.
    #[error("edge {index} from frame {source_frame} to {target_frame} of {frames} frames")]
    Edge {
        /// Position of the edge.
        index: usize,
        /// Its source.
        source_frame: usize,
        /// Its target.
        target_frame: usize,
        /// Number of frames.
        frames: usize,
    },
    /// A number is NaN, infinite, or larger than any scene needs.
    #[error("{what} {index} is not finite or out of range")]
    OutOfRange {
        /// The array.
        what: &'static str,
        /// Position in it.
        index: usize,
    },
    /// A parameter is outside its range.
    #[error("parameter {name} is out of range")]
    Parameter {
        /// The field's name.
        name: &'static str,
    },
    /// The poses' system could not be factored, whatever the damping.
    #[error(
        "the system of {unknowns} pose unknowns is not positive definite at damping {damping:e}"
    )]
    NotPositiveDefinite {
        /// Its size.
        unknowns: usize,
        /// The last relative damping tried.
        damping: f64,
    },
    /// A step left the range of numbers that the solver accepts.
    #[error("step {iteration} diverged")]
    Diverged {
        /// The step, 0-based.
        iteration: usize,
    },
}

/// Adjusts `scene` in place. `workspace` can be reused: with one problem size and one thread nothing is
/// allocated after the first call.
///
/// # Errors
/// [`BundleError`]; malformed input leaves the scene as it was.
pub fn adjust(
    scene: &mut Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) -> Result<Report, BundleError> {
    options.validate()?;
    scene.validate()?;
    problem.validate(scene)?;
    workspace.plan(scene, problem);
    step::project_to_bounds(scene, workspace, options);
    let mut lm = options.lm;
    let mut report = Report {
        iterations: 0,
        cost_before: 0.0,
        cost_after: 0.0,
        converged: false,
        pose_steps_dropped: 0,
    };
    for iteration in 0..options.iterations {
        let Some(taken) = step::take(scene, problem, options, &mut lm, iteration, workspace)?
        else {
            if iteration == 0 {
                report.cost_before = workspace.cost;
                report.cost_after = workspace.cost;
            }
            report.converged = true;
            break;
        };
        if iteration == 0 {
            report.cost_before = taken.cost_before;
        }
        report.iterations += 1;
        report.cost_after = taken.cost_after;
        report.pose_steps_dropped += usize::from(taken.pose_step_dropped);
        let gain = taken.cost_before - taken.cost_after;
        if options.control.is_adaptive() && gain <= options.tolerance * taken.cost_before {
            report.converged = true;
            break;
        }
    }
    Ok(report)
}

/// The normal equations at the scene as it is, without damping of the poses; for inspection and tests.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalEquations {
    /// S, or A where only motion is adjusted: `[6 P, 6 P]` over the free poses.
    pub matrix: nalgebra::DMatrix<f64>,
    /// The right-hand side, `[6 P]`.
    pub rhs: nalgebra::DVector<f64>,
    /// Depth diagonal C with its damping, `[frames, rows, columns]`; 0 for frames that are no source.
    pub depth_diagonal: Vec<f64>,
    /// Depth right-hand side, likewise.
    pub depth_rhs: Vec<f64>,
    /// Σ w ρ(r) and the prior's cost.
    pub cost: f64,
}

/// Linearises without solving.
///
/// # Errors
/// [`BundleError`] on malformed input.
pub fn normal_equations(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
) -> Result<NormalEquations, BundleError> {
    options.validate()?;
    scene.validate()?;
    problem.validate(scene)?;
    let mut workspace = Workspace::default();
    workspace.plan(scene, problem);
    linearise::linearise(scene, problem, options, 0.0, &mut workspace);
    Ok(NormalEquations {
        matrix: workspace.matrix.to_dense(),
        rhs: nalgebra::DVector::from_column_slice(&workspace.rhs),
        depth_diagonal: workspace.unpadded(&workspace.depth_diagonal),
        depth_rhs: workspace.unpadded(&workspace.depth_rhs),
        cost: workspace.cost,
    })
}

/// Largest translation, inverse depth and viewing ray accepted: far beyond any scene, and their
/// fourth powers are far inside f64.
const MAX_MAGNITUDE: f64 = 1e6;

/// Quaternions rounded to f32 are unit to 1e-7; what is further off is no pose.
const UNIT_TOLERANCE: f64 = 1e-3;

impl Scene {
    /// Inverse depths of one frame.
    #[must_use]
    pub fn inverse_depths_of(&self, frame: usize) -> &[f64] {
        let cells = self.grid.cells();
        self.inverse_depths
            .get(frame * cells..(frame + 1) * cells)
            .unwrap_or(&[])
    }

    /// Checks shapes and ranges.
    ///
    /// # Errors
    /// [`BundleError::Shape`], [`BundleError::OutOfRange`], [`BundleError::Parameter`].
    pub fn validate(&self) -> Result<(), BundleError> {
        let (last_u, last_v) = (self.grid.columns as f64, self.grid.rows as f64);
        let corners = [self.camera.ray(0.0, 0.0), self.camera.ray(last_u, last_v)];
        let in_range = |x: &f64| x.abs() <= MAX_MAGNITUDE;
        if !self.camera.is_valid() || !corners.iter().flatten().all(in_range) {
            return Err(BundleError::Parameter { name: "camera" });
        }
        if self.grid.cells() == 0 {
            return Err(BundleError::Parameter { name: "grid" });
        }
        check_length(
            "inverse_depths",
            self.poses.len() * self.grid.cells(),
            self.inverse_depths.len(),
        )?;
        self.check_ranges()
    }

    fn check_ranges(&self) -> Result<(), BundleError> {
        let in_range = |x: &f64| x.abs() <= MAX_MAGNITUDE;
        let good =
            |pose: &Se3| pose.is_valid(UNIT_TOLERANCE) && pose.translation.iter().all(in_range);
        if let Some(index) = self.poses.iter().position(|pose| !good(pose)) {
            return Err(BundleError::OutOfRange {
                what: "pose",
                index,
            });
        }
        match self.inverse_depths.iter().position(|d| !in_range(d)) {
            Some(index) => Err(BundleError::OutOfRange {
                what: "inverse depth",
                index,
            }),
            None => Ok(()),
        }
    }
}

impl Problem<'_> {
    /// Position of a frame among the free ones.
    fn unknown(&self, frame: usize) -> Option<usize> {
        let is_free = self.free.contains(&frame);
        is_free.then(|| frame - self.free.start)
    }

    fn validate(&self, scene: &Scene) -> Result<(), BundleError> {
        let (frames, cells) = (scene.poses.len(), scene.grid.cells());
        if self.free.end > frames || self.free.start > self.free.end {
            return Err(BundleError::Parameter { name: "free" });
        }
        for (index, edge) in self.edges.iter().enumerate() {
            if edge.source >= frames || edge.target >= frames || edge.source == edge.target {
                return Err(BundleError::Edge {
                    index,
                    source_frame: edge.source,
                    target_frame: edge.target,
                    frames,
                });
            }
            check_length("targets of an edge", 2 * cells, edge.at.len())?;
            check_length("weights of an edge", 2 * cells, edge.weight.len())?;
            // Folds without branches, so that they are vectorised; NaN fails the comparison.
            let largest = |values: &[f32], limit: f32| {
                values
                    .iter()
                    .fold(true, |good, x| good & (x.abs() <= limit))
            };
            let is_negative = |values: &[f32]| values.iter().fold(false, |bad, x| bad | (*x < 0.0));
            if !largest(edge.at, 1e9) {
                return Err(BundleError::OutOfRange {
                    what: "targets of edge",
                    index,
                });
            }
            if !largest(edge.weight, 1e6) || is_negative(edge.weight) {
                return Err(BundleError::OutOfRange {
                    what: "weights of edge",
                    index,
                });
            }
        }
        for (what, values) in [
            ("depth damping", self.depth_damping),
            ("measured inverse depth", self.measured),
        ] {
            let Some(values) = values else { continue };
            check_length(what, frames * cells, values.len())?;
            if let Some(index) = values.iter().position(|x| !(0.0..=1e6).contains(x)) {
                return Err(BundleError::OutOfRange { what, index });
            }
        }
        Ok(())
    }
}

fn check_length(what: &'static str, expected: usize, actual: usize) -> Result<(), BundleError> {
    if expected == actual {
        return Ok(());
    }
    Err(BundleError::Shape {
        what,
        expected,
        actual,
    })
}
