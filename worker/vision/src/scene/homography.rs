//! Homography between two pictures: a rotating or zooming camera, or any camera before a plane.
//!
//! Minimal four-point DLT in normalised coordinates (Hartley, "In defense of the eight-point
//! algorithm", PAMI 1997; Hartley and Zisserman, *Multiple View Geometry*, 2nd ed., §4.1) inside
//! LO-RANSAC; Levenberg-Marquardt on the one-sided transfer error. The search starts from the
//! identity, itself a homography, so that the result is never worse than a static camera.
//!
//! Residual: distance from the transferred source point to the target point, target px. A
//! homography that mirrors, collapses, or brings the horizon near the picture is not admitted:
//! both ends of a correspondence were seen, so neither is behind the camera.

use nalgebra::{Matrix3, SMatrix, SVector};
use rand_pcg::Pcg32;

use super::FitError;
use super::correspondence::Correspondence;
use super::gric::Loss;
use super::linear::{null_space, unit};
use super::points::{BLOCK, PointSet, distance, lane_sum};
use super::ransac::{Problem, RansacParams, Scored, estimate};

/// Least ratio of the third homogeneous coordinate over the picture. It is the ratio of a plane's
/// depths before and after (or that of a 58° turn with a 53° lens): pairs beyond share no picture.
const MIN_DEPTH_RATIO: f64 = 0.1;

/// Least determinant with `h33 = 1`: the change of area at the centre. A tenfold zoom has 0.01; a
/// mirror image is negative.
const MIN_DETERMINANT: f64 = 1e-3;

/// `h33` below this fraction of the norm means a horizon through the centre.
const MIN_CENTRE_DEPTH: f64 = 1e-6;

/// Distance from `homography · source` to the target, px; `None` where the source point maps to
/// infinity or behind the camera. `homography` is in pixel coordinates with a positive third
/// coordinate over the picture, as in [`super::MotionEstimate::Homography`].
#[must_use]
pub fn transfer_residual_px(homography: &[[f64; 3]; 3], c: &Correspondence) -> Option<f64> {
    let [x, y] = c.from_px;
    let [a, b, w] = homography.map(|row| row[0] * x + row[1] * y + row[2]);
    let residual = distance([a / w, b / w], c.to_px);
    (w > 0.0 && residual.is_finite()).then_some(residual)
}

/// A fitted homography in normalised coordinates, and whether the identity was not improved on.
pub(super) fn fit(
    points: &PointSet,
    loss: Loss,
    params: &RansacParams,
    rng: &mut Pcg32,
) -> Result<(Scored, bool), FitError> {
    let problem = HomographyProblem {
        points,
        loss: loss.in_units_of(points.scale),
    };
    estimate(&problem, &Matrix3::identity(), params, rng).ok_or(FitError::Degenerate)
}

/// A normalised homography in pixel coordinates, Frobenius norm 1.
pub(super) fn to_px(points: &PointSet, model: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    unit(points.px_from_normalised() * model * points.normalised_from_px())
}

/// Indices of the points that `model` (normalised) does not explain.
pub(super) fn outliers(points: &PointSet, model: &Matrix3<f64>, loss: Loss) -> Vec<usize> {
    let loss = loss.in_units_of(points.scale);
    (0..points.len())
        .filter(|&i| loss.of(squared_transfer_error(points, &rows(model), i)) >= loss.cap)
        .collect()
}

pub(super) struct HomographyProblem<'a> {
    pub(super) points: &'a PointSet,
    pub(super) loss: Loss,
}

fn rows(m: &Matrix3<f64>) -> [f64; 9] {
    [
        m[(0, 0)],
        m[(0, 1)],
        m[(0, 2)],
        m[(1, 0)],
        m[(1, 1)],
        m[(1, 2)],
        m[(2, 0)],
        m[(2, 1)],
        m[(2, 2)],
    ]
}

fn squared_transfer_error(points: &PointSet, h: &[f64; 9], i: usize) -> f64 {
    let (x, y) = (points.x[i], points.y[i]);
    let inverse_depth = 1.0 / (h[6] * x + h[7] * y + h[8]);
    let du = (h[0] * x + h[1] * y + h[2]) * inverse_depth - points.u[i];
    let dv = (h[3] * x + h[4] * y + h[5]) * inverse_depth - points.v[i];
    du * du + dv * dv
}

impl Problem for HomographyProblem<'_> {
    const SAMPLE: i32 = 4;

    fn points(&self) -> &PointSet {
        self.points
    }

    fn sample(&self, rng: &mut Pcg32, models: &mut Vec<Matrix3<f64>>) {
        let Some(picked) = self.points.draw::<4>(rng) else {
            return;
        };
        let mut equations = [[0.0; 9]; 8];
        for (k, &i) in picked.iter().enumerate() {
            let (x, y, u, v) = (
                self.points.x[i],
                self.points.y[i],
                self.points.u[i],
                self.points.v[i],
            );
            equations[2 * k] = [x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u];
            equations[2 * k + 1] = [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v];
        }
        let Some([h]) = null_space::<8, 1>(equations) else {
            return;
        };
        let model = Matrix3::from_row_slice(&h);
        let centre_depth = model[(2, 2)];
        if centre_depth.abs() > MIN_CENTRE_DEPTH * model.norm() {
            models.push(model / centre_depth);
        }
    }

    fn admissible(&self, model: &Matrix3<f64>) -> bool {
        let depths = self
            .points
            .corners
            .map(|[x, y]| model[(2, 0)] * x + model[(2, 1)] * y + model[(2, 2)]);
        let least = depths.iter().copied().fold(f64::INFINITY, f64::min);
        let most = depths.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let determinant = model.determinant();
        least > 0.0
            && least >= MIN_DEPTH_RATIO * most
            && determinant >= MIN_DETERMINANT
            && determinant.is_finite()
    }

    fn block(&self, model: &Matrix3<f64>, start: usize, end: usize) -> Option<(f64, f64)> {
        let h = rows(model);
        let p = self.points;
        let n = end - start;
        let (x, y, u, v, w) = (
            &p.x[start..end],
            &p.y[start..end],
            &p.u[start..end],
            &p.v[start..end],
            &p.weight[start..end],
        );
        let (mut costs, mut inliers) = ([0.0; BLOCK], [0.0; BLOCK]);
        for i in 0..n.min(BLOCK) {
            let inverse_depth = 1.0 / (h[6] * x[i] + h[7] * y[i] + h[8]);
            let du = (h[0] * x[i] + h[1] * y[i] + h[2]) * inverse_depth - u[i];
            let dv = (h[3] * x[i] + h[4] * y[i] + h[5]) * inverse_depth - v[i];
            let cost = (du * du + dv * dv) * self.loss.per_square;
            let below = cost < self.loss.cap;
            costs[i] = w[i] * if below { cost } else { self.loss.cap };
            inliers[i] = if below { w[i] } else { 0.0 };
        }
        Some((lane_sum(&costs[..n]), lane_sum(&inliers[..n])))
    }

    /// On the eight parameters with `h33 = 1`.
    fn step(&self, model: &Matrix3<f64>, damping: f64, count: usize) -> Option<Matrix3<f64>> {
        let h = rows(model);
        let p = self.points;
        let (mut normal, mut gradient) = ([[0.0; 8]; 8], [0.0; 8]);
        for i in 0..count {
            let (x, y) = (p.x[i], p.y[i]);
            let inverse_depth = 1.0 / (h[6] * x + h[7] * y + h[8]);
            let a = (h[0] * x + h[1] * y + h[2]) * inverse_depth;
            let b = (h[3] * x + h[4] * y + h[5]) * inverse_depth;
            let (du, dv) = (a - p.u[i], b - p.v[i]);
            if (du * du + dv * dv) * self.loss.per_square >= self.loss.cap {
                continue;
            }
            let (sx, sy) = (x * inverse_depth, y * inverse_depth);
            let row_u = [sx, sy, inverse_depth, 0.0, 0.0, 0.0, -a * sx, -a * sy];
            let row_v = [0.0, 0.0, 0.0, sx, sy, inverse_depth, -b * sx, -b * sy];
            let weight = p.weight[i];
            for r in 0..8 {
                let (wu, wv) = (weight * row_u[r], weight * row_v[r]);
                gradient[r] += wu * du + wv * dv;
                for c in 0..8 {
                    normal[r][c] += wu * row_u[c] + wv * row_v[c];
                }
            }
        }
        let mut normal = SMatrix::<f64, 8, 8>::from_fn(|r, c| normal[r][c]);
        let lift = damping * normal.trace() / 8.0;
        for k in 0..8 {
            normal[(k, k)] += lift;
        }
        let delta = normal
            .cholesky()?
            .solve(&SVector::<f64, 8>::from_column_slice(&gradient));
        let next: [f64; 9] = std::array::from_fn(|k| if k < 8 { h[k] - delta[k] } else { 1.0 });
        next.iter()
            .all(|v| v.is_finite())
            .then(|| Matrix3::from_row_slice(&next))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::evidence::MotionModel;
    use crate::scene::gric::GricParams;

    fn problem_points() -> PointSet {
        let points: Vec<_> = (0..40)
            .map(|i| {
                let (x, y) = (f64::from(i % 8) * 30.0, f64::from(i / 8) * 40.0);
                Correspondence {
                    from_px: [x, y],
                    to_px: [x * 1.02 + 1.0, y * 0.99 - 2.0 + 0.01 * x],
                    weight: 1.0,
                }
            })
            .collect();
        PointSet::new(&points, &mut Pcg32::new(5, 5))
    }

    #[test]
    fn gauss_newton_gradient_matches_finite_differences() {
        let points = problem_points();
        let loss = GricParams {
            sigma_px: 100.0,
            ..GricParams::default()
        }
        .loss(MotionModel::Homography);
        let problem = HomographyProblem {
            points: &points,
            loss: loss.in_units_of(points.scale),
        };
        let at = Matrix3::new(1.01, 0.02, 0.03, -0.01, 0.98, 0.05, 0.004, -0.003, 1.0);
        let cost = |m: &Matrix3<f64>| problem.block(m, 0, points.len()).unwrap().0;
        // With overwhelming damping the step is along the negative gradient.
        let step = problem.step(&at, 1e9, points.len()).unwrap() - at;
        let h = 1e-6;
        let numeric: Vec<f64> = (0..8)
            .map(|k| {
                let mut bump = Matrix3::zeros();
                bump[(k / 3, k % 3)] = h;
                (cost(&(at + bump)) - cost(&(at - bump))) / (2.0 * h)
            })
            .collect();
        let ratio = -step[(0, 2)] / numeric[2];
        for (k, g) in numeric.iter().enumerate() {
            let expected = -g * ratio;
            // Central differences of a smooth sum: relative error near 1e-8.
            assert!(
                (step[(k / 3, k % 3)] - expected).abs() <= 1e-5 * step.norm(),
                "parameter {k}"
            );
        }
        assert!(ratio > 0.0);
    }

    #[test]
    fn impossible_homographies_are_not_admitted() {
        let points = problem_points();
        let problem = HomographyProblem {
            points: &points,
            loss: GricParams::default().loss(MotionModel::Homography),
        };
        assert!(problem.admissible(&Matrix3::identity()));
        let horizon = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.9, 0.0, 1.0);
        let mirror = Matrix3::new(-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let collapse = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        for (name, model) in [
            ("horizon", horizon),
            ("mirror", mirror),
            ("collapse", collapse),
            ("nan", Matrix3::repeat(f64::NAN)),
        ] {
            assert!(!problem.admissible(&model), "{name}");
        }
    }

    #[test]
    fn points_at_and_behind_infinity_have_no_residual() {
        let h = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]];
        let at = |x: f64| {
            transfer_residual_px(
                &h,
                &Correspondence {
                    from_px: [x, 0.0],
                    to_px: [0.0, 0.0],
                    weight: 1.0,
                },
            )
        };
        assert_eq!(at(50.0), Some(100.0));
        assert_eq!(at(100.0), None, "at infinity");
        assert_eq!(at(150.0), None, "behind the camera");
    }
}
