//! Affine motion between two pictures: a small or distant rigid surface that moves by little.
//!
//! Over a region that is small against its distance a rigid motion moves the picture affinely up to
//! second-order terms (Koenderink and van Doorn, "Affine structure from motion", JOSA A 8, 1991).
//! Minimal three-point solution inside LO-RANSAC, weighted least squares as the refinement, in
//! normalised coordinates. As a 3 × 3 matrix with last row `[0, 0, 1]` it is a homography, and is
//! scored and admitted as one. Residual: distance from the moved source point to the target, px.

use nalgebra::{Matrix3, Vector3};
use rand_pcg::Pcg32;

use super::FitError;
use super::gric::Loss;
use super::homography::HomographyProblem;
use super::points::PointSet;
use super::ransac::{Problem, RansacParams, Scored, estimate};

/// Twice the least area of a sample's triangle, in squared normalised units (the points are about √2
/// from their centre): below it three points are a line.
const MIN_TRIANGLE: f64 = 1e-3;

/// The affine motion that most of the points share, in normalised coordinates.
///
/// # Errors
/// [`FitError::Degenerate`] where all samples are lines.
pub(super) fn fit(
    points: &PointSet,
    loss: Loss,
    params: &RansacParams,
    rng: &mut Pcg32,
) -> Result<Scored, FitError> {
    let problem = AffineProblem(HomographyProblem {
        points,
        loss: loss.in_units_of(points.scale),
    });
    estimate(&problem, &Matrix3::identity(), params, rng)
        .map(|(scored, _)| scored)
        .ok_or(FitError::Degenerate)
}

struct AffineProblem<'a>(HomographyProblem<'a>);

impl Problem for AffineProblem<'_> {
    const SAMPLE: i32 = 3;

    fn points(&self) -> &PointSet {
        self.0.points
    }

    fn sample(&self, rng: &mut Pcg32, models: &mut Vec<Matrix3<f64>>) {
        let p = self.0.points;
        let Some([a, b, c]) = p.draw::<3>(rng) else {
            return;
        };
        let (x1, y1) = (p.x[b] - p.x[a], p.y[b] - p.y[a]);
        let (x2, y2) = (p.x[c] - p.x[a], p.y[c] - p.y[a]);
        let area = x1 * y2 - x2 * y1;
        if area.abs() < MIN_TRIANGLE {
            return;
        }
        let row = |to: &[f64]| {
            let (d1, d2) = (to[b] - to[a], to[c] - to[a]);
            let (across, down) = ((d1 * y2 - d2 * y1) / area, (d2 * x1 - d1 * x2) / area);
            [across, down, to[a] - across * p.x[a] - down * p.y[a]]
        };
        models.push(matrix(row(&p.u), row(&p.v)));
    }

    fn admissible(&self, model: &Matrix3<f64>) -> bool {
        self.0.admissible(model)
    }

    fn block(&self, model: &Matrix3<f64>, start: usize, end: usize) -> Option<(f64, f64)> {
        self.0.block(model, start, end)
    }

    /// Weighted least squares on the points below the cap; linear, so that the damping only keeps a
    /// line of points solvable.
    fn step(&self, model: &Matrix3<f64>, damping: f64, count: usize) -> Option<Matrix3<f64>> {
        let p = self.0.points;
        let mut normal = Matrix3::zeros();
        let mut gradient = [Vector3::zeros(); 2];
        for i in 0..count {
            let at = Vector3::new(p.x[i], p.y[i], 1.0);
            let moved = model * at;
            let (du, dv) = (moved.x - p.u[i], moved.y - p.v[i]);
            if self.0.loss.of(du * du + dv * dv) >= self.0.loss.cap {
                continue;
            }
            let weighted = at * p.weight[i];
            normal += weighted * at.transpose();
            gradient[0] += weighted * du;
            gradient[1] += weighted * dv;
        }
        let lift = damping * normal.trace() / 3.0;
        for k in 0..3 {
            normal[(k, k)] += lift;
        }
        let cholesky = normal.cholesky()?;
        let [across, down] = gradient.map(|g| cholesky.solve(&g));
        let row = |r: usize, delta: Vector3<f64>| std::array::from_fn(|c| model[(r, c)] - delta[c]);
        let next = matrix(row(0, across), row(1, down));
        next.iter().all(|v| v.is_finite()).then_some(next)
    }
}

fn matrix([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> Matrix3<f64> {
    Matrix3::new(a, b, c, d, e, f, 0.0, 0.0, 1.0)
}
