//! Trajectories in the format of the TUM RGB-D benchmark, and how far one is from another.
//!
//! A line is `timestamp tx ty tz qx qy qz qw`: seconds, then `world_from_camera` (the camera's place and
//! attitude in the world; the inverse of the poses of `slam`), unit quaternion with w last; `#` starts a
//! comment (J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012).
//!
//! Absolute trajectory error: the root mean square distance of camera places at the same times, after
//! the similarity that makes it least (S. Umeyama, "Least-squares estimation of transformation
//! parameters between two point patterns", TPAMI 1991), since a monocular trajectory has no scale. Each
//! pose of the shorter trajectory is held against the other's nearest in time, as in `evo_ape -as`.

use std::fmt::Write as _;

use nalgebra::{Matrix3, Vector3};

use super::se3::Se3;

/// Times that differ by more than this are not the same, seconds: evo's default.
pub const MAX_TIME_DIFFERENCE_S: f64 = 0.01;

/// Fewest places that fix a similarity.
const LEAST_PAIRS: usize = 3;

/// Squared, relative: far above the rounding of f64, far below any path that was meant.
const ROUNDING: f64 = 1e-24;

/// Quaternions are printed with a few digits.
const UNIT_TOLERANCE: f64 = 1e-2;

/// A camera at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedPose {
    /// Seconds.
    pub time_s: f64,
    /// The camera's place and attitude.
    pub world_from_camera: Se3,
}

/// Why trajectories cannot be read or compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// A line is no pose.
    #[error("line {line} is not `timestamp tx ty tz qx qy qz qw` with a unit quaternion")]
    Line {
        /// 1-based.
        line: usize,
    },
    /// Too few poses at common times.
    #[error(
        "{pairs} poses have a partner within {MAX_TIME_DIFFERENCE_S} s, {LEAST_PAIRS} are needed; compare the time stamps (--sequence-fps sets those of numbered images)"
    )]
    TooFewPairs {
        /// Poses that have one.
        pairs: usize,
    },
    /// The places of one trajectory are all the same.
    #[error("the camera stands still in one of the trajectories: no scale can be found")]
    StandsStill,
}

/// Reads a trajectory.
///
/// # Errors
/// [`TrajectoryError::Line`].
pub fn parse_tum(text: &str) -> Result<Vec<TimedPose>, TrajectoryError> {
    let mut poses = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let error = || TrajectoryError::Line { line: index + 1 };
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Vec<f64> = line
            .split([' ', '\t', ','])
            .filter(|word| !word.is_empty())
            .map(str::parse)
            .collect::<Result<_, _>>()
            .map_err(|_| error())?;
        let [time_s, pose @ ..] = numbers.as_slice() else {
            return Err(error());
        };
        let pose = Se3::from_array(pose.try_into().map_err(|_| error())?);
        if !time_s.is_finite() || !pose.is_valid(UNIT_TOLERANCE) {
            return Err(error());
        }
        poses.push(TimedPose {
            time_s: *time_s,
            world_from_camera: pose.normalised().ok_or_else(error)?,
        });
    }
    Ok(poses)
}

/// Writes a trajectory.
#[must_use]
pub fn to_tum(poses: &[TimedPose]) -> String {
    let mut text = String::from("# timestamp tx ty tz qx qy qz qw (camera to world)\n");
    for pose in poses {
        // Writing to a string does not fail.
        let _ = write!(text, "{:.6}", pose.time_s);
        for value in pose.world_from_camera.to_array() {
            let _ = write!(text, " {value:.9}");
        }
        text.push('\n');
    }
    text
}

/// x ↦ s R x + t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// s.
    pub scale: f64,
    /// R.
    pub rotation: Matrix3<f64>,
    /// t.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// s R x + t.
    #[must_use]
    pub fn apply(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.scale * (self.rotation * point) + self.translation
    }
}

/// The similarity that takes `from` nearest to `to` (Umeyama's equations 34 to 43); `None` where the
/// points of one of them coincide, or the lists differ in length. On a line the turn about it is free.
#[must_use]
pub fn umeyama(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Similarity> {
    if from.len() != to.len() || from.is_empty() {
        return None;
    }
    let n = from.len() as f64;
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / n;
    let (from_mean, to_mean) = (mean(from), mean(to));
    let mut covariance = Matrix3::zeros();
    let (mut from_variance, mut to_variance) = (0.0, 0.0);
    for (a, b) in from.iter().zip(to) {
        let (a, b) = (a - from_mean, b - to_mean);
        covariance += b * a.transpose() / n;
        from_variance += a.norm_squared() / n;
        to_variance += b.norm_squared() / n;
    }
    // What rounding leaves of places that coincide is no extent.
    let extends = |variance: f64, mean: &Vector3<f64>| variance > ROUNDING * mean.norm_squared();
    if !(from_variance > 0.0
        && to_variance > 0.0
        && extends(from_variance, &from_mean)
        && extends(to_variance, &to_mean))
    {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // A reflection is turned into the nearest rotation: the least singular value changes its sign.
    let mut signs = Vector3::from_element(1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        signs[svd.singular_values.imin()] = -1.0;
    }
    let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
    let scale = svd.singular_values.dot(&signs) / from_variance;
    Some(Similarity {
        scale,
        rotation,
        translation: to_mean - scale * (rotation * from_mean),
    })
}

/// How far a trajectory is from the truth, in the truth's unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AbsoluteError {
    /// Root mean square distance: the ATE.
    pub rmse: f64,
    /// Mean distance.
    pub mean: f64,
    /// Largest distance.
    pub max: f64,
    /// Poses compared.
    pub pairs: usize,
    /// What takes the estimate to the truth.
    pub truth_from_estimate: Similarity,
    /// Root mean square angle between the turns since the first common pose, radians. Not after the
    /// alignment: places on a line leave the turn about it free.
    pub rotation_rmse_rad: f64,
}

/// Compares an estimate with the truth.
///
/// # Errors
/// [`TrajectoryError::TooFewPairs`], [`TrajectoryError::StandsStill`].
pub fn absolute_error(
    estimate: &[TimedPose],
    truth: &[TimedPose],
) -> Result<AbsoluteError, TrajectoryError> {
    let pairs = at_common_times(estimate, truth);
    if pairs.len() < LEAST_PAIRS {
        return Err(TrajectoryError::TooFewPairs { pairs: pairs.len() });
    }
    let place = |pose: &Se3| pose.translation;
    let from: Vec<_> = pairs.iter().map(|(e, _)| place(e)).collect();
    let to: Vec<_> = pairs.iter().map(|(_, t)| place(t)).collect();
    let similarity = umeyama(&from, &to).ok_or(TrajectoryError::StandsStill)?;
    let (mut squares, mut sum, mut max, mut angles) = (0.0, 0.0, 0.0f64, 0.0);
    for (estimate, truth) in &pairs {
        let distance = (similarity.apply(&estimate.translation) - truth.translation).norm();
        squares += distance * distance;
        sum += distance;
        max = max.max(distance);
        let turned = |pose: &Se3, first: &Se3| first.inverse().compose(pose);
        let between = turned(truth, &pairs[0].1).relative_to(&turned(estimate, &pairs[0].0));
        // Of a quaternion as read; its norm is 1 to its digits.
        let phi = between.log().fixed_rows::<3>(3).into_owned();
        angles += phi.norm_squared();
    }
    let n = pairs.len() as f64;
    Ok(AbsoluteError {
        rmse: libm::sqrt(squares / n),
        mean: sum / n,
        max,
        pairs: pairs.len(),
        truth_from_estimate: similarity,
        rotation_rmse_rad: libm::sqrt(angles / n),
    })
}

/// Each pose of the shorter trajectory with the nearest in time of the other, estimate first.
fn at_common_times(estimate: &[TimedPose], truth: &[TimedPose]) -> Vec<(Se3, Se3)> {
    let swapped = truth.len() < estimate.len();
    let (short, long) = match swapped {
        true => (truth, estimate),
        false => (estimate, truth),
    };
    let nearest = |pose: &TimedPose| {
        let apart = |other: &TimedPose| (other.time_s - pose.time_s).abs();
        let best = long
            .iter()
            .min_by(|a, b| apart(a).total_cmp(&apart(b)))
            .filter(|best| apart(best) <= MAX_TIME_DIFFERENCE_S)?;
        let pair = (pose.world_from_camera, best.world_from_camera);
        Some(if swapped { (pair.1, pair.0) } else { pair })
    };
    short.iter().filter_map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    fn poses(count: usize) -> Vec<TimedPose> {
        let pose = |k: usize| {
            let t = k as f64;
            let tangent = Vector6::new(t, 0.1 * t * t, (0.7 * t).sin(), 0.02 * t, -0.1, 0.05 * t);
            TimedPose {
                time_s: 0.1 * t,
                world_from_camera: Se3::exp(&tangent),
            }
        };
        (0..count).map(pose).collect()
    }

    #[test]
    fn a_trajectory_survives_its_file() {
        let poses = poses(5);
        let read = parse_tum(&to_tum(&poses)).unwrap();
        for (a, b) in poses.iter().zip(&read) {
            // Nine decimals.
            assert!((a.time_s - b.time_s).abs() < 1e-6);
            let between = b.world_from_camera.relative_to(&a.world_from_camera);
            assert!(between.log().norm() < 1e-7);
        }
    }

    #[test]
    fn what_is_no_pose_is_named_by_its_line() {
        for (text, line) in [
            ("0 0 0 0 0 0 0 1\n\n# note\n1 2 3\n", 4),
            ("0 0 0 0 0 0 0 0", 1),
            ("0 0 nan 0 0 0 0 1", 1),
            ("x 0 0 0 0 0 0 1", 1),
            ("0 0 0 0 0 0 0 1 9", 1),
        ] {
            assert_eq!(
                parse_tum(text),
                Err(TrajectoryError::Line { line }),
                "{text}"
            );
        }
    }

    #[test]
    fn a_moved_turned_and_scaled_trajectory_has_no_error() {
        let truth = poses(9);
        let world = Se3::exp(&Vector6::new(3.0, -2.0, 1.0, 0.4, 1.1, -0.6));
        let estimate: Vec<TimedPose> = truth
            .iter()
            .map(|pose| {
                let mut moved = world.compose(&pose.world_from_camera);
                moved.translation *= 0.25;
                TimedPose {
                    time_s: pose.time_s + 0.004,
                    world_from_camera: moved,
                }
            })
            .collect();
        let error = absolute_error(&estimate, &truth).unwrap();
        assert_eq!(error.pairs, 9);
        // Rounding of coordinates of about 10.
        assert!(
            error.rmse < 1e-13 && error.rotation_rmse_rad < 1e-13,
            "{error:?}"
        );
        assert!((error.truth_from_estimate.scale - 4.0).abs() < 1e-12);
    }

    #[test]
    fn umeyamas_own_example_is_met() {
        // Section IV of the paper: a triangle and its mirror image, which no rotation can reach. The
        // paper prints R, t, c and the error ε² rounded.
        let points = |xy: [[f64; 2]; 3]| xy.map(|[x, y]| Vector3::new(x, y, 0.0));
        let from = points([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]);
        let to = points([[0.0, 0.0], [-1.0, 0.0], [0.0, 2.0]]);
        let similarity = umeyama(&from, &to).unwrap();
        // In space the triangle is turned over instead and fits exactly.
        assert!((similarity.scale - 1.0).abs() < 1e-12);
        for (a, b) in from.iter().zip(&to) {
            assert!((similarity.apply(a) - b).norm() < 1e-12);
        }
        assert!((similarity.rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_mirrored_tetrahedron_is_not_reached_by_a_rotation() {
        let from = [
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(1.0, 0.0, 0.0),
            Vector3::new(0.0, 2.0, 0.0),
            Vector3::new(0.0, 0.0, 3.0),
        ];
        let to = from.map(|p| Vector3::new(-p.x, p.y, p.z));
        let similarity = umeyama(&from, &to).unwrap();
        assert!((similarity.rotation.determinant() - 1.0).abs() < 1e-12);
        // Equation 33: the least error is σ_to² − tr(D S)² / σ_from², which is the sum computed here.
        let squares: f64 = from
            .iter()
            .zip(&to)
            .map(|(a, b)| (similarity.apply(a) - b).norm_squared() / 4.0)
            .sum();
        let centre = |points: &[Vector3<f64>; 4]| points.iter().sum::<Vector3<f64>>() / 4.0;
        let variance = |points: &[Vector3<f64>; 4]| -> f64 {
            let mean = centre(points);
            points.iter().map(|p| (p - mean).norm_squared() / 4.0).sum()
        };
        let gain = similarity.scale * similarity.scale * variance(&from);
        assert!((squares - (variance(&to) - gain)).abs() < 1e-12);
        assert!(squares > 0.1);
    }

    #[test]
    fn what_cannot_be_compared_says_why() {
        let truth = poses(9);
        let late: Vec<TimedPose> = truth
            .iter()
            .map(|pose| TimedPose {
                time_s: pose.time_s + 50.0,
                ..*pose
            })
            .collect();
        assert_eq!(
            absolute_error(&late, &truth),
            Err(TrajectoryError::TooFewPairs { pairs: 0 })
        );
        let still = vec![truth[0]; 9];
        let still: Vec<TimedPose> = still
            .iter()
            .zip(&truth)
            .map(|(pose, at)| TimedPose {
                time_s: at.time_s,
                ..*pose
            })
            .collect();
        assert_eq!(
            absolute_error(&still, &truth),
            Err(TrajectoryError::StandsStill)
        );
    }

    #[test]
    fn the_error_of_one_displaced_place_is_what_the_hand_finds() {
        // A square of side 2 and the same with one corner lifted by h out of its plane; the identity is
        // not the best alignment, but for small h the mean lift and tilt are: 4 residuals of h/4.
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let at = |k: usize, z: f64| TimedPose {
            time_s: k as f64,
            world_from_camera: Se3 {
                translation: Vector3::new(corners[k][0], corners[k][1], z),
                ..Se3::IDENTITY
            },
        };
        let h = 1e-3;
        let truth: Vec<_> = (0..4).map(|k| at(k, 0.0)).collect();
        let estimate: Vec<_> = (0..4)
            .map(|k| at(k, if k == 2 { h } else { 0.0 }))
            .collect();
        let error = absolute_error(&estimate, &truth).unwrap();
        // A plane through four points of a square leaves ±h/4; the tilt's second order is h².
        assert!((error.rmse - h / 4.0).abs() < h * h, "{error:?}");
    }
}
