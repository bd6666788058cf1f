//! Small fixed-size linear algebra: vectors, 3×3 matrices, affine maps and rigid poses, in f64.
//!
//! Frames: a map named `a_from_b` takes coordinates of b to coordinates of a. The world has z up (x right, y away
//! from the default camera); the camera has x right, y down, z forward. Lengths are metres, angles radians.
//! Nothing fails; the inverse of a singular map is `None`. Trigonometry is `libm`'s, so that results do not depend on
//! the machine.

use std::ops::{Add, Mul, Neg, Sub};

use serde::{Deserialize, Serialize};

/// A point or direction in three dimensions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vec3 {
    /// First coordinate.
    pub x: f64,
    /// Second coordinate.
    pub y: f64,
    /// Third coordinate.
    pub z: f64,
}

/// Short form of [`Vec3`]'s constructor.
#[must_use]
pub const fn vec3(x: f64, y: f64, z: f64) -> Vec3 {
    Vec3 { x, y, z }
}

impl Vec3 {
    /// Scalar product.
    #[must_use]
    pub fn dot(self, other: Self) -> f64 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    #[must_use]
    pub fn cross(self, other: Self) -> Self {
        vec3(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Euclidean length.
    #[must_use]
    pub fn length(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// The vector scaled to length 1; the zero vector stays zero.
    #[must_use]
    pub fn normalised(self) -> Self {
        let length = self.length();
        if length > 0.0 {
            self * (1.0 / length)
        } else {
            self
        }
    }

    /// Component-wise product.
    #[must_use]
    pub fn scaled(self, by: Self) -> Self {
        vec3(self.x * by.x, self.y * by.y, self.z * by.z)
    }
}

impl Add for Vec3 {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        vec3(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for Vec3 {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        vec3(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Neg for Vec3 {
    type Output = Self;
    fn neg(self) -> Self {
        vec3(-self.x, -self.y, -self.z)
    }
}

impl Mul<f64> for Vec3 {
    type Output = Self;
    fn mul(self, by: f64) -> Self {
        vec3(self.x * by, self.y * by, self.z * by)
    }
}

/// A 3×3 matrix held by its columns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mat3 {
    /// The three columns.
    pub columns: [Vec3; 3],
}

impl Mat3 {
    /// The identity.
    pub const IDENTITY: Self = Self::diagonal(vec3(1.0, 1.0, 1.0));

    /// A matrix from its columns.
    #[must_use]
    pub const fn from_columns(a: Vec3, b: Vec3, c: Vec3) -> Self {
        Self { columns: [a, b, c] }
    }

    /// A diagonal matrix.
    #[must_use]
    pub const fn diagonal(d: Vec3) -> Self {
        Self::from_columns(
            vec3(d.x, 0.0, 0.0),
            vec3(0.0, d.y, 0.0),
            vec3(0.0, 0.0, d.z),
        )
    }

    /// Rotation about z by `angle_rad`, x towards y.
    #[must_use]
    pub fn rotation_z(angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(angle_rad);
        Self::from_columns(
            vec3(cos, sin, 0.0),
            vec3(-sin, cos, 0.0),
            vec3(0.0, 0.0, 1.0),
        )
    }

    /// Rotation about y by `angle_rad`, z towards x.
    #[must_use]
    pub fn rotation_y(angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(angle_rad);
        Self::from_columns(
            vec3(cos, 0.0, -sin),
            vec3(0.0, 1.0, 0.0),
            vec3(sin, 0.0, cos),
        )
    }

    /// The transposed matrix.
    #[must_use]
    pub fn transposed(&self) -> Self {
        let [a, b, c] = self.columns;
        Self::from_columns(
            vec3(a.x, b.x, c.x),
            vec3(a.y, b.y, c.y),
            vec3(a.z, b.z, c.z),
        )
    }

    /// The determinant.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let [a, b, c] = self.columns;
        a.dot(b.cross(c))
    }

    /// The inverse by cofactors, or `None` where the determinant is zero or not finite.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let [a, b, c] = self.columns;
        let scale = 1.0 / self.determinant();
        scale.is_finite().then(|| {
            Self::from_columns(b.cross(c) * scale, c.cross(a) * scale, a.cross(b) * scale)
                .transposed()
        })
    }
}

impl Mul<Vec3> for Mat3 {
    type Output = Vec3;
    fn mul(self, v: Vec3) -> Vec3 {
        let [a, b, c] = self.columns;
        a * v.x + b * v.y + c * v.z
    }
}

impl Mul for Mat3 {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        let [a, b, c] = o.columns;
        Self::from_columns(self * a, self * b, self * c)
    }
}

/// An affine map `x ↦ linear · x + offset`; rigid where `linear` is a rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Affine {
    /// The linear part.
    pub linear: Mat3,
    /// The translation.
    pub offset: Vec3,
}

impl Affine {
    /// A map from its two parts.
    #[must_use]
    pub const fn new(linear: Mat3, offset: Vec3) -> Self {
        Self { linear, offset }
    }

    /// A pure translation.
    #[must_use]
    pub const fn translation(offset: Vec3) -> Self {
        Self::new(Mat3::IDENTITY, offset)
    }

    /// The image of a point.
    #[must_use]
    pub fn apply(&self, point: Vec3) -> Vec3 {
        self.linear * point + self.offset
    }

    /// The inverse map, or `None` where `linear` is singular.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        self.linear
            .inverse()
            .map(|linear| Self::new(linear, -(linear * self.offset)))
    }
}

impl Mul for Affine {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self::new(self.linear * o.linear, self.apply(o.offset))
    }
}

/// A rigid pose `camera_from_world`: rotation (row-major) and translation in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation matrix, row-major.
    pub rotation: [[f64; 3]; 3],
    /// Translation in metres.
    pub translation_m: [f64; 3],
}

impl Pose {
    /// The pose of a rigid affine map; the caller vouches that `linear` is a rotation.
    #[must_use]
    pub fn from_rigid(map: &Affine) -> Self {
        let rows = map.linear.transposed().columns;
        Self {
            rotation: rows.map(|r| [r.x, r.y, r.z]),
            translation_m: [map.offset.x, map.offset.y, map.offset.z],
        }
    }

    /// The rotation as a unit quaternion (x, y, z, w) with w ≥ 0 (Shepperd's method: the largest component first, so
    /// that nothing small is divided by).
    #[must_use]
    pub fn quaternion_xyzw(&self) -> [f64; 4] {
        let r = &self.rotation;
        let trace = r[0][0] + r[1][1] + r[2][2];
        let four_squares = [
            1.0 + 2.0 * r[0][0] - trace,
            1.0 + 2.0 * r[1][1] - trace,
            1.0 + 2.0 * r[2][2] - trace,
            1.0 + trace,
        ];
        let mut largest = 3;
        for (i, &s) in four_squares.iter().enumerate() {
            if s > four_squares[largest] {
                largest = i;
            }
        }
        let twice = four_squares[largest].max(0.0).sqrt();
        let over = 0.5 / twice;
        let q = match largest {
            0 => [
                twice * 0.5,
                (r[0][1] + r[1][0]) * over,
                (r[0][2] + r[2][0]) * over,
                (r[2][1] - r[1][2]) * over,
            ],
            1 => [
                (r[0][1] + r[1][0]) * over,
                twice * 0.5,
                (r[1][2] + r[2][1]) * over,
                (r[0][2] - r[2][0]) * over,
            ],
            2 => [
                (r[0][2] + r[2][0]) * over,
                (r[1][2] + r[2][1]) * over,
                twice * 0.5,
                (r[1][0] - r[0][1]) * over,
            ],
            _ => [
                (r[2][1] - r[1][2]) * over,
                (r[0][2] - r[2][0]) * over,
                (r[1][0] - r[0][1]) * over,
                twice * 0.5,
            ],
        };
        if q[3] < 0.0 { q.map(|v| -v) } else { q }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_the_map() {
        let map = Affine::new(
            Mat3::rotation_z(0.7) * Mat3::rotation_y(-0.4) * Mat3::diagonal(vec3(0.5, 2.0, 3.0)),
            vec3(1.0, -2.0, 0.3),
        );
        let p = vec3(0.2, -0.9, 1.7);
        let back = map.inverse().unwrap().apply(map.apply(p));
        // A handful of f64 roundings of numbers near 1.
        assert!((back - p).length() < 1e-14);
        assert!(Mat3::diagonal(vec3(1.0, 0.0, 1.0)).inverse().is_none());
    }

    /// Twin: the rotation matrix rebuilt from the quaternion by the textbook formula.
    #[test]
    fn quaternion_gives_the_rotation_back() {
        for k in 0..40 {
            let a = f64::from(k) * 0.37;
            let rotation =
                Mat3::rotation_z(a) * Mat3::rotation_y(1.3 * a) * Mat3::rotation_z(-0.6 * a);
            let pose = Pose::from_rigid(&Affine::new(rotation, Vec3::default()));
            let [x, y, z, w] = pose.quaternion_xyzw();
            let rebuilt = [
                [
                    1.0 - 2.0 * (y * y + z * z),
                    2.0 * (x * y - z * w),
                    2.0 * (x * z + y * w),
                ],
                [
                    2.0 * (x * y + z * w),
                    1.0 - 2.0 * (x * x + z * z),
                    2.0 * (y * z - x * w),
                ],
                [
                    2.0 * (x * z - y * w),
                    2.0 * (y * z + x * w),
                    1.0 - 2.0 * (x * x + y * y),
                ],
            ];
            for (row, twin) in pose.rotation.iter().flatten().zip(rebuilt.iter().flatten()) {
                assert!((row - twin).abs() < 1e-14, "{row} {twin}");
            }
        }
    }
}
