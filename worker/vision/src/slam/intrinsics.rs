//! The camera's intrinsics: given, or a field-of-view prior, or refined.
//!
//! In pixels of the video as decoded, pixel centres at whole numbers. Without calibration the prior is a
//! horizontal (longer side's) view of [`PRIOR_VIEW_DEG`] degrees, square pixels and the principal point
//! in the middle. WorldScore's fixed 500/500/256/256 belongs to the reference's option set alone.
//!
//! The focal length is refined only where the adjustment determines it. The cost, minimised over all
//! poses and depths, is a function of ln f alone; its second derivative is the Schur complement of the
//! Hessian in ln f. From it follows the standard deviation of ln f; above [`MOST_DEVIATION`] (five per
//! cent) the prior stays.

use serde::{Deserialize, Serialize};

use super::bundle::Scene;
use super::camera::Pinhole;
use super::tracker::{FlowGraph, Solution, TrackError, TrackParams, first_edges, resolve};

/// View over the longer side of the picture, degrees: between webcams (55 to 65) and phones' video (60
/// to 70).
pub const PRIOR_VIEW_DEG: f64 = 60.0;

/// Largest standard deviation of ln f at which the refined value is used.
pub const MOST_DEVIATION: f64 = 0.05;

/// Flow errors of neighbouring cells, and of the edges of one frame, are not independent: this many
/// observations count as one.
const DEPENDENT_OBSERVATIONS: f64 = 16.0;

/// The refined focal length stays within this factor of the prior: views of 32 to 98 degrees.
const MOST_FACTOR: f64 = 2.0;

/// Distance of the points through which a parabola is laid, in ln f.
const STEP: f64 = 0.1;

/// Most parabolas.
const ROUNDS: usize = 4;

/// Intrinsics, px of the video as decoded.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
}

/// Where intrinsics come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IntrinsicsOrigin {
    /// By the user.
    Given,
    /// The field-of-view prior.
    Prior,
    /// The prior, its focal length refined.
    Refined,
}

impl IntrinsicsOrigin {
    /// The name used in every output.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Prior => "prior",
            Self::Refined => "refined",
        }
    }
}

impl Intrinsics {
    /// The prior for a picture size.
    #[must_use]
    pub fn prior(width: usize, height: usize) -> Self {
        let half_view = 0.5 * PRIOR_VIEW_DEG.to_radians();
        let focal = 0.5 * width.max(height) as f64 / libm::tan(half_view);
        Self {
            fx: focal,
            fy: focal,
            cx: 0.5 * (width as f64 - 1.0),
            cy: 0.5 * (height as f64 - 1.0),
        }
    }

    /// Whether focal lengths are positive and all is finite.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let Self { fx, fy, cx, cy } = *self;
        Pinhole { fx, fy, cx, cy }.is_valid()
    }

    /// The camera in cells of the grid that `step` lays on the picture resized to `working` (columns,
    /// rows) from `video`.
    #[must_use]
    pub fn on_grid(&self, video: (usize, usize), working: (usize, usize), step: usize) -> Pinhole {
        let scale_x = working.0 as f64 / video.0 as f64;
        let scale_y = working.1 as f64 / video.1 as f64;
        let (step_px, first) = (step as f64, (step / 2) as f64);
        // Both pictures cover the same view, so that their corners, not their centres, coincide.
        let cell = |centre: f64, scale: f64| ((centre + 0.5) * scale - 0.5 - first) / step_px;
        Pinhole {
            fx: self.fx * scale_x / step_px,
            fy: self.fy * scale_y / step_px,
            cx: cell(self.cx, scale_x),
            cy: cell(self.cy, scale_y),
        }
    }

    /// With both focal lengths times `factor`.
    #[must_use]
    pub fn with_focal_factor(self, factor: f64) -> Self {
        Self {
            fx: self.fx * factor,
            fy: self.fy * factor,
            ..self
        }
    }
}

/// What is known of the focal length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocalEvidence {
    /// The best focal length over the one started from.
    pub factor: f64,
    /// Standard deviation of ln f; `None` where the cost has no minimum there.
    pub deviation: Option<f64>,
}

impl FocalEvidence {
    /// Whether it is known well enough to be used.
    #[must_use]
    pub fn is_determined(&self) -> bool {
        self.deviation.is_some_and(|d| d <= MOST_DEVIATION)
    }
}

/// Looks for the focal length, from a solved map on.
///
/// # Errors
/// [`TrackError`].
pub fn focal_evidence(
    graph: &FlowGraph,
    solution: &Solution,
    params: &TrackParams,
) -> Result<FocalEvidence, TrackError> {
    let start = solution.scene.camera;
    let most = libm::log(MOST_FACTOR);
    let mut scene = solution.scene.clone();
    let mut centre = 0.0;
    let mut deviation = None;
    for _ in 0..ROUNDS {
        let cost_at = |log_factor: f64| -> Result<(f64, Scene), TrackError> {
            let factor = libm::exp(log_factor);
            let mut moved = scene.clone();
            moved.camera = Pinhole {
                fx: start.fx * factor,
                fy: start.fy * factor,
                ..start
            };
            let cost = resolve(graph, &mut moved, solution, params)?;
            Ok((cost, moved))
        };
        let (below, _) = cost_at(centre - STEP)?;
        let (middle, settled) = cost_at(centre)?;
        let (above, _) = cost_at(centre + STEP)?;
        scene = settled;
        let slope = (above - below) / (2.0 * STEP);
        let curvature = (above - 2.0 * middle + below) / (STEP * STEP);
        if curvature.is_nan() || curvature <= 0.0 {
            deviation = None;
            // Downhill by one step: the minimum may lie there.
            centre = (centre - STEP * slope.signum()).clamp(-most, most);
            continue;
        }
        let observations: f64 = first_edges(graph, params)
            .flat_map(|edge| &edge.answer.weight)
            .map(|&weight| f64::from(weight))
            .sum();
        // Cost is a sum of squares: its Hessian is 2/σ² times the information.
        let variance = middle / observations.max(1.0);
        deviation = Some(libm::sqrt(
            2.0 * variance * DEPENDENT_OBSERVATIONS / curvature,
        ));
        let step = (-slope / curvature).clamp(-2.0 * STEP, 2.0 * STEP);
        let next = (centre + step).clamp(-most, most);
        let moved = (next - centre).abs();
        centre = next;
        if moved < 0.1 * STEP {
            break;
        }
    }
    Ok(FocalEvidence {
        factor: libm::exp(centre),
        // At the end of the range there is no minimum.
        deviation: deviation.filter(|_| centre.abs() < most),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_seen_at_the_same_place_on_the_grid_and_in_the_video() {
        let (video, working, step) = ((640, 480), (341, 256), 8);
        let intrinsics = Intrinsics {
            fx: 585.0,
            fy: 583.0,
            cx: 320.0,
            cy: 240.0,
        };
        let grid = intrinsics.on_grid(video, working, step);
        // A direction; where the video sees it, in shares of the picture; where the grid does.
        let (x, y) = (0.21, -0.13);
        let video_px = [
            intrinsics.fx * x + intrinsics.cx,
            intrinsics.fy * y + intrinsics.cy,
        ];
        let share = [(video_px[0] + 0.5) / 640.0, (video_px[1] + 0.5) / 480.0];
        let cell = [grid.fx * x + grid.cx, grid.fy * y + grid.cy];
        // Cell k is at working pixel 4 + 8 k.
        let working_px = cell.map(|cell| 4.0 + 8.0 * cell);
        assert!((working_px[0] + 0.5 - share[0] * 341.0).abs() < 1e-9);
        assert!((working_px[1] + 0.5 - share[1] * 256.0).abs() < 1e-9);
    }

    #[test]
    fn the_prior_sees_sixty_degrees_along_the_longer_side() {
        for (width, height) in [(640, 480), (480, 640)] {
            let prior = Intrinsics::prior(width, height);
            let view = 2.0 * libm::atan(320.0 / prior.fx);
            assert!((view.to_degrees() - 60.0).abs() < 1e-9);
            assert!(prior.is_valid());
        }
    }
}
