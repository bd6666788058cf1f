//! Rigid scene with a free depth per point: the fundamental matrix.
//!
//! Estimation in normalised coordinates by LO-RANSAC: seven-point samples, and plane-and-parallax
//! samples (the homography and two points off it; Chum, Werner and Matas, "Two-view geometry
//! estimation unaffected by a dominant plane", CVPR 2005), since a dominant table top leaves most
//! seven-point samples degenerate. Refinement: Levenberg-Marquardt on the Sampson error along the
//! tangent of the matrices of rank 2.
//!
//! Residual: distance from the target point to the source's epipolar line in the target picture,
//! px. For *one* edge that is exactly the reprojection error left when each point's inverse depth
//! is chosen freely (any real number, so also behind a camera). It is therefore a lower bound of
//! what bundle adjustment leaves, where one depth per point is shared by several edges.
//!
//! With a static camera the matrix is degenerate: any epipole fits. Only GRIC may prefer it.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use rand_pcg::Pcg32;

use super::FitError;
use super::correspondence::Correspondence;
use super::gric::Loss;
use super::linear::{cofactors, cross_matrix, rank_two, unit};
use super::points::{BLOCK, PointSet, draw_below, lane_sum};
use super::ransac::{Problem, RansacParams, Scored, estimate, score_below};
use super::seven_point::seven_point;

/// Farthest epipolar line from the picture's centre, normalised (about ten picture widths). The
/// target was seen on that line, so a matrix that puts it farther is not the scene's.
const MAX_LINE_DISTANCE: f64 = 20.0;

/// Squared line normals below this are rounding: the source is at the epipole.
const MIN_SQUARED_NORMAL: f64 = 1e-24;

/// Distance from the target to the epipolar line `F · source`, px. A source at the epipole has no
/// line: its neighbours' lines pass through every point, so it constrains nothing and has 0.
/// `None` where the line is at infinity. `fundamental` is in pixel coordinates.
#[must_use]
pub fn epipolar_residual_px(fundamental: &[[f64; 3]; 3], c: &Correspondence) -> Option<f64> {
    let [x, y] = c.from_px;
    let [a, b, d] = fundamental.map(|row| row[0] * x + row[1] * y + row[2]);
    let error = a * c.to_px[0] + b * c.to_px[1] + d;
    if error == 0.0 {
        return Some(0.0);
    }
    let residual = error.abs() / (a * a + b * b).sqrt();
    residual.is_finite().then_some(residual)
}

/// A fundamental matrix in normalised coordinates, rank 2, and whether plane-and-parallax with
/// `homography` (normalised) and an arbitrary epipole was not improved on.
pub(super) fn fit(
    points: &PointSet,
    homography: &Matrix3<f64>,
    homography_outliers: &[usize],
    loss: Loss,
    params: &RansacParams,
    rng: &mut Pcg32,
) -> Result<(Scored, bool), FitError> {
    let problem = FundamentalProblem {
        points,
        loss: loss.in_units_of(points.scale),
        homography,
        off_plane: homography_outliers,
    };
    let initial = unit(cross_matrix(&Vector3::x()) * homography).ok_or(FitError::Degenerate)?;
    let (best, inherited) =
        estimate(&problem, &initial, params, rng).ok_or(FitError::Degenerate)?;
    let singular = unit(rank_two(&best.model)?).ok_or(FitError::Degenerate)?;
    let scored = score_below(&problem, &singular, f64::INFINITY).ok_or(FitError::Degenerate)?;
    Ok((scored, inherited))
}

/// A normalised fundamental matrix in pixel coordinates, Frobenius norm 1.
pub(super) fn to_px(points: &PointSet, model: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let t = points.normalised_from_px();
    unit(t.transpose() * model * t)
}

struct FundamentalProblem<'a> {
    points: &'a PointSet,
    loss: Loss,
    homography: &'a Matrix3<f64>,
    off_plane: &'a [usize],
}

impl FundamentalProblem<'_> {
    /// `[e']× H` with the epipole where two off-plane points' parallax vectors meet.
    fn plane_and_parallax(&self, rng: &mut Pcg32) -> Option<Matrix3<f64>> {
        let picked: [usize; 2] = draw_below(self.off_plane.len(), rng)?;
        let lines = picked.map(|k| {
            let i = self.off_plane[k];
            let source = Vector3::new(self.points.x[i], self.points.y[i], 1.0);
            Vector3::new(self.points.u[i], self.points.v[i], 1.0).cross(&(self.homography * source))
        });
        unit(cross_matrix(&lines[0].cross(&lines[1])) * self.homography)
    }
}

impl Problem for FundamentalProblem<'_> {
    const SAMPLE: i32 = 7;

    fn points(&self) -> &PointSet {
        self.points
    }

    fn sample(&self, rng: &mut Pcg32, models: &mut Vec<Matrix3<f64>>) {
        let p = self.points;
        if let Some(picked) = p.draw::<7>(rng) {
            seven_point(&picked.map(|i| [p.x[i], p.y[i], p.u[i], p.v[i]]), models);
        }
        models.extend(self.plane_and_parallax(rng));
    }

    fn admissible(&self, model: &Matrix3<f64>) -> bool {
        model.iter().all(|v| v.is_finite())
    }

    fn block(&self, model: &Matrix3<f64>, start: usize, end: usize) -> Option<(f64, f64)> {
        let f = Rows::new(model);
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
        let mut far = false;
        for i in 0..n.min(BLOCK) {
            let (line, back) = f.lines(x[i], y[i], u[i], v[i]);
            let error = line[0] * u[i] + line[1] * v[i] + line[2];
            let squared_normal = line[0] * line[0] + line[1] * line[1];
            far |= line[2] * line[2]
                > MAX_LINE_DISTANCE * MAX_LINE_DISTANCE * squared_normal + MIN_SQUARED_NORMAL;
            let norm = squared_normal + back[0] * back[0] + back[1] * back[1];
            let cost = error * error / norm.max(MIN_SQUARED_NORMAL) * self.loss.per_square;
            let below = cost < self.loss.cap;
            costs[i] = w[i] * if below { cost } else { self.loss.cap };
            inliers[i] = if below { w[i] } else { 0.0 };
        }
        (!far).then(|| (lane_sum(&costs[..n]), lane_sum(&inliers[..n])))
    }

    /// On the nine entries, with the scale and the gradient of the determinant held fixed.
    fn step(&self, model: &Matrix3<f64>, damping: f64, count: usize) -> Option<Matrix3<f64>> {
        let f = Rows::new(model);
        let p = self.points;
        let (mut normal, mut gradient) = ([[0.0; 9]; 9], [0.0; 9]);
        for i in 0..count {
            let (x, y, u, v) = (p.x[i], p.y[i], p.u[i], p.v[i]);
            let (line, back) = f.lines(x, y, u, v);
            let norm =
                line[0] * line[0] + line[1] * line[1] + back[0] * back[0] + back[1] * back[1];
            if norm < MIN_SQUARED_NORMAL {
                continue;
            }
            let scale = 1.0 / norm.sqrt();
            let r = (line[0] * u + line[1] * v + line[2]) * scale;
            if r * r * self.loss.per_square >= self.loss.cap {
                continue;
            }
            // d(N/√D) = dN/√D - r/D · dD/2, with N = x'ᵀFx and D the squared line normals.
            let k = r * scale;
            let [tu, tv] = [u - k * line[0], v - k * line[1]];
            let [bx, by] = [k * back[0], k * back[1]];
            let row = [
                tu * x - u * bx,
                tu * y - u * by,
                tu,
                tv * x - v * bx,
                tv * y - v * by,
                tv,
                x - bx,
                y - by,
                1.0,
            ]
            .map(|g| g * scale);
            let weight = p.weight[i];
            for a in 0..9 {
                let weighted = weight * row[a];
                gradient[a] += weighted * r;
                for b in 0..9 {
                    normal[a][b] += weighted * row[b];
                }
            }
        }
        let normal = SMatrix::<f64, 9, 9>::from_fn(|a, b| normal[a][b]);
        let gradient = SVector::<f64, 9>::from_column_slice(&gradient);
        let scale_direction = row_major(model);
        let rank_direction = row_major(&unit(cofactors(model))?);
        let tangent =
            SMatrix::<f64, 9, 9>::identity() - rank_direction * rank_direction.transpose();
        let size = normal.trace();
        let mut constrained = tangent * normal * tangent
            + (rank_direction * rank_direction.transpose()
                + scale_direction * scale_direction.transpose())
                * size;
        for k in 0..9 {
            constrained[(k, k)] += damping * size / 9.0;
        }
        let delta = constrained.cholesky()?.solve(&(tangent * gradient));
        let moved = model - Matrix3::from_row_slice(delta.as_slice());
        unit(rank_two(&moved).ok()?)
    }
}

fn row_major(m: &Matrix3<f64>) -> SVector<f64, 9> {
    SVector::<f64, 9>::from_column_slice(m.transpose().as_slice())
}

/// A matrix as nine scalars, which stay in registers in the scoring loop.
struct Rows([f64; 9]);

impl Rows {
    fn new(m: &Matrix3<f64>) -> Self {
        let v = row_major(m);
        Self(std::array::from_fn(|k| v[k]))
    }

    /// The epipolar line of the source in the target picture, and the normal of the target's in
    /// the source picture.
    #[inline(always)]
    fn lines(&self, x: f64, y: f64, u: f64, v: f64) -> ([f64; 3], [f64; 2]) {
        let f = &self.0;
        let line = [
            f[0] * x + f[1] * y + f[2],
            f[3] * x + f[4] * y + f[5],
            f[6] * x + f[7] * y + f[8],
        ];
        (
            line,
            [f[0] * u + f[3] * v + f[6], f[1] * u + f[4] * v + f[7]],
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene::evidence::MotionModel;
    use crate::scene::gric::GricParams;
    use crate::scene::synthetic::{Camera, Scene, clip_points};

    /// The least reprojection error over inverse depth, by brute force: a scan of the whole
    /// projective line of inverse depths, then golden sections around the best.
    fn least_reprojection_px(camera: &Camera, c: &Correspondence) -> f64 {
        // Inverse depth tan(angle): covers every real number, and infinity at the ends.
        let at = |angle: f64| {
            let projected = camera.transfer(c.from_px, angle.tan());
            (projected[0] - c.to_px[0]).hypot(projected[1] - c.to_px[1])
        };
        let half_turn = std::f64::consts::FRAC_PI_2;
        let count = 20_000;
        let step = 2.0 * half_turn / f64::from(count);
        let best = (1..count)
            .map(|k| -half_turn + f64::from(k) * step)
            .min_by(|a, b| at(*a).total_cmp(&at(*b)))
            .unwrap();
        let (mut low, mut high) = (best - step, best + step);
        for _ in 0..200 {
            let (a, b) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
            if at(a) < at(b) { high = b } else { low = a }
        }
        at(0.5 * (low + high))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn residual_is_the_least_reprojection_error_over_depth(
            turn in proptest::array::uniform3(-0.2..0.2f64), t in proptest::array::uniform3(-0.5..0.5f64),
            from in proptest::array::uniform2(10.0..240.0f64), to in proptest::array::uniform2(10.0..240.0f64),
        ) {
            prop_assume!(t.iter().map(|v| v * v).sum::<f64>() > 0.01);
            let camera = Camera { turn, translation: t };
            let c = Correspondence { from_px: from, to_px: to, weight: 1.0 };
            let slow = least_reprojection_px(&camera, &c);
            let fast = epipolar_residual_px(&camera.fundamental(), &c).unwrap();
            // The scan's grid cannot miss the valley by more; golden section ends near 1e-8
            // relative, as a quadratic minimum allows.
            prop_assert!((slow - fast).abs() < 1e-4 * (1.0 + fast), "{} {}", slow, fast);
        }
    }

    #[test]
    fn at_the_epipole_nothing_is_constrained() {
        let forward = Camera {
            turn: [0.0; 3],
            translation: [0.0, 0.0, -0.5],
        }
        .fundamental();
        let c = |from_px, to_px| Correspondence {
            from_px,
            to_px,
            weight: 1.0,
        };
        let centre = Camera::CENTRE;
        assert_eq!(
            epipolar_residual_px(&forward, &c(centre, centre)),
            Some(0.0)
        );
        assert_eq!(
            epipolar_residual_px(&[[0.0; 3]; 3], &c([1.0, 2.0], [3.0, 4.0])),
            Some(0.0)
        );
        let at_infinity = [[0.0; 3], [0.0; 3], [0.0, 0.0, 1.0]];
        assert_eq!(
            epipolar_residual_px(&at_infinity, &c([1.0, 2.0], [3.0, 4.0])),
            None
        );
    }

    #[test]
    fn gauss_newton_gradient_matches_finite_differences() {
        let camera = Camera {
            turn: [0.02, -0.01, 0.03],
            translation: [0.2, 0.05, 0.1],
        };
        let field = clip_points(&camera, Scene::Random, 0.5, 3);
        let points = PointSet::new(&field.correspondences, &mut Pcg32::new(9, 9));
        let loss = GricParams {
            sigma_px: 100.0,
            ..GricParams::default()
        }
        .loss(MotionModel::Rigid);
        let loss = loss.in_units_of(points.scale);
        let plane = Matrix3::identity();
        let problem = FundamentalProblem {
            points: &points,
            loss,
            homography: &plane,
            off_plane: &[],
        };
        let t = points.px_from_normalised();
        let px = Matrix3::from_fn(|r, c| camera.fundamental()[r][c]);
        let bumped = t.transpose() * px * t
            + Matrix3::new(0.1, 0.2, 0.0, -0.1, 0.0, 0.3, 0.0, 0.1, 0.0) * 1e-3;
        let at = unit(rank_two(&unit(bumped).unwrap()).unwrap()).unwrap();
        let cost = |m: &Matrix3<f64>| {
            (0..points.len())
                .step_by(BLOCK)
                .map(|s| {
                    problem
                        .block(m, s, (s + BLOCK).min(points.len()))
                        .unwrap()
                        .0
                })
                .sum::<f64>()
        };
        // With overwhelming damping the step is along the negative gradient within the tangent of
        // rank 2; the damping leaves the constrained directions unmoved.
        let step = row_major(&(problem.step(&at, 1e7, points.len()).unwrap() - at));
        let h = 1e-6;
        let numeric = SVector::<f64, 9>::from_fn(|k, _| {
            let mut bump = Matrix3::zeros();
            bump[(k / 3, k % 3)] = h;
            (cost(&(at + bump)) - cost(&(at - bump))) / (2.0 * h)
        });
        let normal = row_major(&unit(cofactors(&at)).unwrap());
        let along = numeric - normal * normal.dot(&numeric);
        let cosine = -along.dot(&step) / (along.norm() * step.norm());
        // Rounding of `at + step` with steps near 1e-7 leaves about nine digits.
        assert!(cosine > 1.0 - 1e-6, "{cosine}");
    }
}
