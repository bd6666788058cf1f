//! Rigid motions. The conventions of this module are those of all of `slam`.
//!
//! - A pose is `camera_from_world`: X_camera = R X_world + t.
//! - Quaternions are stored x, y, z, w; unit up to rounding. A vector is rotated by
//!   X + 2 w (q × X) + 2 q × (q × X), the inverse is the conjugate: exact for unit quaternions, and
//!   what the reference kernels compute on quaternions rounded to f32.
//! - Tangent vectors are (τ, φ): translation, then rotation. A pose is changed from the left,
//!   T ← Exp(ξ) T, so that the adjoint is Ad = \[\[R, \[t\]× R\], \[0, R\]\].
//!
//! `exp` and `log` are accurate to rounding from angle 0 to π (series where the closed form
//! cancels). Trigonometry comes from `libm`: the same bits everywhere.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Below this squared angle the series are exact to rounding: their first omitted term is θ⁴ of
/// what is kept, relative.
const SMALL_ANGLE_SQUARED: f64 = 1e-8;

/// A rigid motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Se3 {
    /// t.
    pub translation: Vector3<f64>,
    /// Unit quaternion, x, y, z, w.
    pub rotation: [f64; 4],
}

impl Default for Se3 {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Se3 {
    /// No motion.
    pub const IDENTITY: Self = Self {
        translation: Vector3::new(0.0, 0.0, 0.0),
        rotation: [0.0, 0.0, 0.0, 1.0],
    };

    /// From tx, ty, tz, qx, qy, qz, qw as they are: the quaternion is not normalised.
    #[must_use]
    pub fn from_array([tx, ty, tz, qx, qy, qz, qw]: [f64; 7]) -> Self {
        Self {
            translation: Vector3::new(tx, ty, tz),
            rotation: [qx, qy, qz, qw],
        }
    }

    /// tx, ty, tz, qx, qy, qz, qw.
    #[must_use]
    pub fn to_array(self) -> [f64; 7] {
        let [qx, qy, qz, qw] = self.rotation;
        let t = self.translation;
        [t.x, t.y, t.z, qx, qy, qz, qw]
    }

    /// Exp(ξ), ξ = (τ, φ).
    #[must_use]
    pub fn exp(tangent: &Vector6<f64>) -> Self {
        let tau = Vector3::new(tangent[0], tangent[1], tangent[2]);
        let phi = Vector3::new(tangent[3], tangent[4], tangent[5]);
        let squared = phi.norm_squared();
        let angle = libm::sqrt(squared);
        let (half_sine_ratio, w, first, second) = if squared < SMALL_ANGLE_SQUARED {
            (
                0.5 - squared / 48.0,
                1.0 - squared / 8.0,
                0.5 - squared / 24.0,
                1.0 / 6.0 - squared / 120.0,
            )
        } else {
            let half_sine = libm::sin(0.5 * angle);
            (
                half_sine / angle,
                libm::cos(0.5 * angle),
                // 1 − cos θ as 2 sin²(θ/2), which does not cancel.
                2.0 * half_sine * half_sine / squared,
                sine_deficit(angle) / squared,
            )
        };
        let turn = phi.cross(&tau);
        Self {
            translation: tau + first * turn + second * phi.cross(&turn),
            rotation: [
                half_sine_ratio * phi.x,
                half_sine_ratio * phi.y,
                half_sine_ratio * phi.z,
                w,
            ],
        }
    }

    /// ξ with Exp(ξ) = self and |φ| ≤ π.
    #[must_use]
    pub fn log(&self) -> Vector6<f64> {
        let [x, y, z, w] = self.rotation;
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        let (vector, w) = (sign * Vector3::new(x, y, z), sign * w);
        let sine = vector.norm();
        let angle = 2.0 * libm::atan2(sine, w);
        let squared = angle * angle;
        let (ratio, curvature) = if squared < SMALL_ANGLE_SQUARED {
            (2.0 + squared / 12.0, 1.0 / 12.0 + squared / 720.0)
        } else {
            let half = 0.5 * angle;
            // (1 − (θ/2) cot(θ/2)) / θ², through sin x − x cos x, which is small together with x³.
            let deficit = half_cotangent_deficit(half);
            (angle / sine, deficit / squared)
        };
        let phi = ratio * vector;
        let turn = phi.cross(&self.translation);
        let tau = self.translation - 0.5 * turn + curvature * phi.cross(&turn);
        Vector6::new(tau.x, tau.y, tau.z, phi.x, phi.y, phi.z)
    }

    /// Exp(ξ) self, with the quaternion as the product gives it.
    #[must_use]
    pub fn retract(&self, tangent: &Vector6<f64>) -> Self {
        Self::exp(tangent).compose(self)
    }

    /// self ∘ other: first `other`, then `self`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            translation: self.rotate(&other.translation) + self.translation,
            rotation: multiply(self.rotation, other.rotation),
        }
    }

    /// The motion back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        let back = Self {
            translation: Vector3::zeros(),
            rotation: [-x, -y, -z, w],
        };
        Self {
            translation: -back.rotate(&self.translation),
            ..back
        }
    }

    /// `target_from_source` of two poses `source_from_world` and `self = target_from_world`.
    #[must_use]
    pub fn relative_to(&self, source_from_world: &Self) -> Self {
        let [x, y, z, w] = source_from_world.rotation;
        let mut relative = Self {
            translation: Vector3::zeros(),
            rotation: multiply(self.rotation, [-x, -y, -z, w]),
        };
        relative.translation = self.translation - relative.rotate(&source_from_world.translation);
        relative
    }

    /// R X.
    #[must_use]
    pub fn rotate(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let [x, y, z, w] = self.rotation;
        let q = Vector3::new(x, y, z);
        let turn = 2.0 * q.cross(point);
        point + w * turn + q.cross(&turn)
    }

    /// R.
    #[must_use]
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&[
            self.rotate(&Vector3::x()),
            self.rotate(&Vector3::y()),
            self.rotate(&Vector3::z()),
        ])
    }

    /// Ad: Exp(Ad ξ) self = self Exp(ξ).
    #[must_use]
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation_matrix();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(self.translation.cross_matrix() * rotation));
        adjoint
    }

    /// The same motion with the quaternion's norm set to 1 and w ≥ 0; `None` if the quaternion is
    /// zero or a number is not finite.
    #[must_use]
    pub fn normalised(&self) -> Option<Self> {
        let squared: f64 = self.rotation.iter().map(|q| q * q).sum();
        if !(squared > 0.0 && squared.is_finite() && self.translation.iter().all(|t| t.is_finite()))
        {
            return None;
        }
        let scale = if self.rotation[3] < 0.0 { -1.0 } else { 1.0 } / libm::sqrt(squared);
        Some(Self {
            rotation: self.rotation.map(|q| q * scale),
            ..*self
        })
    }

    /// Whether all numbers are finite and the quaternion's squared norm is 1 to within `tolerance`.
    #[must_use]
    pub fn is_valid(&self, tolerance: f64) -> bool {
        let squared: f64 = self.rotation.iter().map(|q| q * q).sum();
        (squared - 1.0).abs() <= tolerance && self.translation.iter().all(|t| t.is_finite())
    }
}

/// a b.
fn multiply([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// 1 − sin θ / θ, without the cancellation at small θ.
fn sine_deficit(angle: f64) -> f64 {
    const SERIES_BELOW: f64 = 0.5;
    if angle < SERIES_BELOW {
        // θ²/3! − θ⁴/5! + …: below 0.5 the ninth term is under 1e-18 of the first.
        alternating(angle * angle, |n| ((2 * n + 2) * (2 * n + 3)) as f64)
    } else {
        1.0 - libm::sin(angle) / angle
    }
}

/// 1 − x cot x for x in [0, π/2].
fn half_cotangent_deficit(x: f64) -> f64 {
    // cot x = cos x / sin x; x cos x = sin x − (sin x − x cos x), and the last has its own series.
    let squared = x * x;
    let sine = libm::sin(x);
    const SERIES_BELOW: f64 = 0.5;
    let difference = if x < SERIES_BELOW {
        // sin x − x cos x = x³ Σ (−1)ⁿ (2n+2) x²ⁿ / (2n+3)!
        let (mut sum, mut term) = (0.0, 1.0 / 6.0);
        for n in 0..10 {
            let n = n as f64;
            sum += (2.0 * n + 2.0) * term;
            term *= -squared / ((2.0 * n + 4.0) * (2.0 * n + 5.0));
        }
        x * squared * sum
    } else {
        sine - x * libm::cos(x)
    };
    difference / sine
}

/// Σₙ (−1)ⁿ xⁿ⁺¹ / (d(0) … d(n)), ten terms.
fn alternating(x: f64, divisor: impl Fn(usize) -> f64) -> f64 {
    let (mut sum, mut term) = (0.0, 1.0);
    for n in 0..10 {
        term *= x / divisor(n);
        sum += if n % 2 == 0 { term } else { -term };
    }
    sum
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Exp by its power series on 4 × 4 matrices, scaled and squared: slow and obvious.
    fn exp_twin(tangent: &Vector6<f64>) -> nalgebra::Matrix4<f64> {
        let mut generator = nalgebra::Matrix4::zeros();
        let phi = Vector3::new(tangent[3], tangent[4], tangent[5]);
        generator
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&phi.cross_matrix());
        for row in 0..3 {
            generator[(row, 3)] = tangent[row];
        }
        const SQUARINGS: u32 = 6;
        generator /= f64::from(2u32.pow(SQUARINGS));
        let mut power = nalgebra::Matrix4::identity();
        let mut sum = nalgebra::Matrix4::identity();
        for n in 1..20 {
            power = power * generator / f64::from(n);
            sum += power;
        }
        for _ in 0..SQUARINGS {
            sum *= sum;
        }
        sum
    }

    fn matrix(pose: &Se3) -> nalgebra::Matrix4<f64> {
        let mut matrix = nalgebra::Matrix4::identity();
        matrix
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&pose.rotation_matrix());
        matrix
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&pose.translation);
        matrix
    }

    /// Tangents whose angles crowd around 0 and π.
    fn tangent() -> impl Strategy<Value = Vector6<f64>> {
        let pi = std::f64::consts::PI;
        let angle = prop_oneof![
            Just(0.0),
            (-160i32..-2).prop_map(|e| libm::exp10(f64::from(e) / 10.0)),
            0.0..pi,
            (-120i32..-4).prop_map(move |e| pi - libm::exp10(f64::from(e) / 10.0)),
        ];
        let direction = prop::array::uniform3(-1.0f64..1.0).prop_filter("a direction", |d| {
            d.iter().map(|x| x * x).sum::<f64>() > 1e-4
        });
        (prop::array::uniform3(-3.0f64..3.0), direction, angle).prop_map(|(tau, axis, angle)| {
            let phi = Vector3::from(axis).normalize() * angle;
            Vector6::new(tau[0], tau[1], tau[2], phi.x, phi.y, phi.z)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn exp_is_the_matrix_exponential(xi in tangent()) {
            // Six squarings lose up to 2⁶ roundings of entries up to 10.
            let difference = (matrix(&Se3::exp(&xi)) - exp_twin(&xi)).abs().max();
            prop_assert!(difference < 1e-12, "{difference:e}");
        }

        #[test]
        fn log_undoes_exp(xi in tangent()) {
            let back = Se3::exp(&Se3::exp(&xi).log());
            let difference = (matrix(&back) - matrix(&Se3::exp(&xi))).abs().max();
            prop_assert!(difference < 1e-13, "{difference:e}");
            let rotation = Vector3::new(xi[3], xi[4], xi[5]);
            if rotation.norm() < std::f64::consts::PI - 1e-3 {
                // Away from π the logarithm is unique.
                prop_assert!((Se3::exp(&xi).log() - xi).abs().max() < 1e-12);
            }
        }

        #[test]
        fn group_laws(a in tangent(), b in tangent(), c in tangent()) {
            let (a, b, c) = (Se3::exp(&a), Se3::exp(&b), Se3::exp(&c));
            let close = |x: &Se3, y: &Se3| (matrix(x) - matrix(y)).abs().max() < 1e-13;
            prop_assert!(close(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))));
            prop_assert!(close(&a.compose(&a.inverse()), &Se3::IDENTITY));
            prop_assert!(close(&a.relative_to(&b), &a.compose(&b.inverse())));
        }

        #[test]
        fn adjoint_carries_a_tangent_through(pose in tangent(), xi in tangent()) {
            let pose = Se3::exp(&pose);
            let left = Se3::exp(&(pose.adjoint() * xi)).compose(&pose);
            let right = pose.compose(&Se3::exp(&xi));
            prop_assert!((matrix(&left) - matrix(&right)).abs().max() < 1e-12);
        }
    }

    #[test]
    fn what_is_no_rotation_is_not_normalised() {
        assert!(Se3::from_array([0.0; 7]).normalised().is_none());
        assert!(Se3::from_array([f64::NAN; 7]).normalised().is_none());
        assert!(!Se3::from_array([f64::NAN; 7]).is_valid(1.0));
        let twice = Se3::from_array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, -2.0]);
        assert_eq!(
            twice.normalised(),
            Some(Se3 {
                translation: Vector3::new(1.0, 2.0, 3.0),
                ..Se3::IDENTITY
            })
        );
    }
}
