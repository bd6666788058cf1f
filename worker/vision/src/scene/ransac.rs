//! Robust estimation: seeded LO-RANSAC on the truncated quadratic that GRIC sums.
//!
//! Chum, Matas and Kittler, "Locally optimized RANSAC", DAGM 2003, with the MSAC score of Torr
//! and Zisserman, "MLESAC", CVIU 2000. The score *is* GRIC's data term (nats), so the estimate
//! minimises the criterion it is judged by. Refinement is Levenberg-Marquardt on the points below
//! the cap, re-chosen at every step. Every loop is bounded. Works in normalised coordinates.

use nalgebra::Matrix3;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::SceneError;
use super::points::{BLOCK, PointSet};

/// Effort of the robust estimation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RansacParams {
    /// Most minimal samples drawn. 300 draws find an all-inlier seven with 99% up to 45% outliers.
    pub max_samples: usize,
    /// Stop when an all-inlier sample has been drawn with this probability.
    pub confidence: f64,
    /// Most refinement steps on each new best model.
    pub local_steps: usize,
    /// Points used by those (a fixed random subset), for speed.
    pub local_points: usize,
    /// Most refinement steps on the final model, on all points.
    pub final_steps: usize,
}

impl Default for RansacParams {
    fn default() -> Self {
        Self {
            max_samples: 300,
            confidence: 0.999,
            local_steps: 4,
            local_points: 300,
            final_steps: 12,
        }
    }
}

impl RansacParams {
    /// # Errors
    /// [`SceneError::Parameter`] where `confidence` is outside (0, 1) or `local_points` below 8.
    pub fn validate(&self) -> Result<(), SceneError> {
        if !(self.confidence > 0.0 && self.confidence < 1.0) {
            return Err(SceneError::Parameter { name: "confidence" });
        }
        if self.local_points < 8 {
            return Err(SceneError::Parameter {
                name: "local_points",
            });
        }
        Ok(())
    }
}

/// First Levenberg-Marquardt damping, relative to the mean diagonal, and its change per step.
const FIRST_DAMPING: f64 = 1e-4;
const DAMPING_DOWN: f64 = 0.1;
const DAMPING_UP: f64 = 10.0;

/// A step that gains less than this fraction of the score (or this many nats) is the last.
const RELATIVE_GAIN: f64 = 1e-4;
const ABSOLUTE_GAIN: f64 = 1e-9;

/// A model class over one point set.
pub(super) trait Problem {
    /// Points in a minimal sample.
    const SAMPLE: i32;

    /// The points it is fitted to.
    fn points(&self) -> &PointSet;

    /// Draws once and appends the models found.
    fn sample(&self, rng: &mut Pcg32, models: &mut Vec<Matrix3<f64>>);

    /// Whether the model is physically possible, as far as can be told without the points.
    fn admissible(&self, model: &Matrix3<f64>) -> bool;

    /// The weighted truncated costs of points `start..end` summed, and how many points (by
    /// weight) stay below the cap; `None` where the model is impossible at one of them.
    fn block(&self, model: &Matrix3<f64>, start: usize, end: usize) -> Option<(f64, f64)>;

    /// One damped Gauss-Newton step on the points of the first `count` that are below the cap.
    fn step(&self, model: &Matrix3<f64>, damping: f64, count: usize) -> Option<Matrix3<f64>>;
}

/// A model and its score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scored {
    pub(super) model: Matrix3<f64>,
    /// GRIC's data term, nats.
    pub(super) cost: f64,
    /// Fraction (by weight) of points below the cap.
    pub(super) inlier_fraction: f64,
}

/// Scores a model; `None` if it is inadmissible or not below `limit`.
pub(super) fn score_below<P: Problem>(
    problem: &P,
    model: &Matrix3<f64>,
    limit: f64,
) -> Option<Scored> {
    if !problem.admissible(model) {
        return None;
    }
    let points = problem.points();
    let (mut cost, mut inliers, mut start) = (0.0, 0.0, 0);
    while start < points.len() {
        let end = (start + BLOCK).min(points.len());
        let (block_cost, block_inliers) = problem.block(model, start, end)?;
        cost += block_cost;
        inliers += block_inliers;
        if cost >= limit {
            return None;
        }
        start = end;
    }
    cost.is_finite().then(|| Scored {
        model: *model,
        cost,
        inlier_fraction: inliers / points.total_weight,
    })
}

/// The best model found, starting from `initial` (the simpler class's solution), and whether it
/// still is that one. `None` where `initial` and all samples are inadmissible.
pub(super) fn estimate<P: Problem>(
    problem: &P,
    initial: &Matrix3<f64>,
    params: &RansacParams,
    rng: &mut Pcg32,
) -> Option<(Scored, bool)> {
    let local = |scored| refine(problem, scored, params.local_steps, params.local_points);
    let start = score_below(problem, initial, f64::INFINITY);
    let start_cost = start.map_or(f64::INFINITY, |s| s.cost);
    let mut best = start.map(local);
    let mut models = Vec::with_capacity(4);
    let mut drawn = 0;
    while drawn < params.max_samples {
        drawn += 1;
        models.clear();
        problem.sample(rng, &mut models);
        for model in &models {
            let limit = best.map_or(f64::INFINITY, |b| b.cost);
            if let Some(scored) = score_below(problem, model, limit) {
                best = Some(local(scored));
            }
        }
        if best.is_some_and(|b| enough(drawn, b.inlier_fraction, P::SAMPLE, params.confidence)) {
            break;
        }
    }
    let best = refine(problem, best?, params.final_steps, usize::MAX);
    Some((best, best.cost + ABSOLUTE_GAIN >= start_cost))
}

/// Whether `drawn` samples contained an all-inlier one with the asked probability.
fn enough(drawn: usize, inlier_fraction: f64, sample: i32, confidence: f64) -> bool {
    let mut all_inliers = 1.0;
    for _ in 0..sample {
        all_inliers *= inlier_fraction;
    }
    // The smallest argument only keeps ln(0) away when every point is an inlier.
    drawn as f64 * libm::log((1.0 - all_inliers).max(f64::MIN_POSITIVE))
        <= libm::log(1.0 - confidence)
}

fn refine<P: Problem>(problem: &P, mut best: Scored, steps: usize, count: usize) -> Scored {
    let mut damping = FIRST_DAMPING;
    for _ in 0..steps {
        let Some(next) = problem.step(&best.model, damping, count.min(problem.points().len()))
        else {
            break;
        };
        if let Some(scored) = score_below(problem, &next, best.cost) {
            let gain = best.cost - scored.cost;
            best = scored;
            damping *= DAMPING_DOWN;
            if gain <= RELATIVE_GAIN * best.cost + ABSOLUTE_GAIN {
                break;
            }
        } else {
            damping *= DAMPING_UP;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_when_the_confidence_is_reached() {
        // 0.7^7 = 0.0824: ln 0.001 / ln(1 - 0.0824) = 80.4 draws.
        assert!(!enough(80, 0.7, 7, 0.999));
        assert!(enough(81, 0.7, 7, 0.999));
        assert!(enough(1, 1.0, 7, 0.999));
        assert!(!enough(1_000_000, 0.0, 7, 0.999));
    }
}
