//! The pinhole camera on the grid, and how one cell reprojects into another frame.
//!
//! A cell (column u, row v) of the source with inverse depth d is the homogeneous point
//! X₀ = ((u − cx)/fx, (v − cy)/fy, 1, d). In the target, (x, y, z) = R (X₀, Y₀, 1) + d t, so that z is
//! the ratio of the two depths, not a length. With a = x/z, b = y/z, h = d/z the derivatives are
//!
//! - by the target's left tangent ξⱼ: fx (h, 0, −a h, −a b, 1 + a², −b), fy (0, h, −b h, −1 − b², a b, a);
//! - by the source's: −Adᵀ of `target_from_source` times that;
//! - by d: fx (t_x − a t_z)/z, fy (t_y − b t_z)/z.

use nalgebra::{Vector2, Vector3, Vector6};

use super::se3::Se3;

/// Size of a grid of cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Cells per row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
}

impl Grid {
    /// Number of cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.columns * self.rows
    }
}

/// A pinhole camera; all lengths in cells of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
}

impl Pinhole {
    /// The viewing ray of cell (u, v): (X₀, Y₀) at depth 1.
    #[must_use]
    pub fn ray(&self, u: f64, v: f64) -> [f64; 2] {
        [(u - self.cx) / self.fx, (v - self.cy) / self.fy]
    }

    /// Whether focal lengths are positive and all is finite.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let finite = [self.fx, self.fy, self.cx, self.cy]
            .iter()
            .all(|x| x.is_finite());
        finite && self.fx > 0.0 && self.fy > 0.0
    }
}

/// Which relative depths z can be projected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthRule {
    /// A cell is valid where z is greater than this.
    pub valid_above: f64,
    /// Where z is smaller than this, 1 stands in for it, so that coordinates stay finite.
    pub unit_below: f64,
}

impl DepthRule {
    /// WorldScore's `projective_transform`: MIN_DEPTH = 0.2, and 1 below half of it.
    pub const WORLDSCORE: Self = Self {
        valid_above: 0.2,
        unit_below: 0.1,
    };
}

/// Where a cell is in another frame, and how that depends on poses and depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reprojection {
    /// Column and row in the target, cells. Without meaning where not `valid`.
    pub at: Vector2<f64>,
    /// Depth in the target over depth in the source.
    pub z: f64,
    /// Whether the point lies far enough in front of the target camera.
    pub valid: bool,
    /// Derivatives of column and row by the source's tangent.
    pub by_source: [Vector6<f64>; 2],
    /// Derivatives of column and row by the target's tangent.
    pub by_target: [Vector6<f64>; 2],
    /// Derivatives of column and row by the inverse depth.
    pub by_inverse_depth: Vector2<f64>,
}

/// Reprojects cell (u, v) of inverse depth `d`. The plain form: the adjustment's loops are tested
/// against it.
#[must_use]
pub fn reproject(
    camera: &Pinhole,
    target_from_source: &Se3,
    [u, v]: [f64; 2],
    d: f64,
    rule: DepthRule,
) -> Reprojection {
    let (at, point) = project(camera, target_from_source, [u, v], d, rule);
    let t = target_from_source.translation;
    let depth = if point.z < rule.unit_below {
        1.0
    } else {
        point.z
    };
    let (a, b, h) = (point.x / depth, point.y / depth, d / depth);
    let Pinhole { fx, fy, .. } = *camera;
    // 1, but for points too near whose depth was replaced.
    let one = point.z / depth;
    let by_target = [
        fx * Vector6::new(h, 0.0, -a * h, -a * b, one + a * a, -b),
        fy * Vector6::new(0.0, h, -b * h, -one - b * b, a * b, a),
    ];
    let adjoint = target_from_source.adjoint().transpose();
    Reprojection {
        at,
        z: point.z,
        valid: point.z > rule.valid_above,
        by_source: by_target.map(|row| -(adjoint * row)),
        by_target,
        by_inverse_depth: Vector2::new(fx * (t.x - a * t.z) / depth, fy * (t.y - b * t.z) / depth),
    }
}

/// Where a cell is in the target, and its point there (scaled by the inverse depth).
#[must_use]
pub fn project(
    camera: &Pinhole,
    target_from_source: &Se3,
    [u, v]: [f64; 2],
    d: f64,
    rule: DepthRule,
) -> (Vector2<f64>, Vector3<f64>) {
    let [ray_x, ray_y] = camera.ray(u, v);
    let point = target_from_source.rotate(&Vector3::new(ray_x, ray_y, 1.0))
        + d * target_from_source.translation;
    let depth = if point.z < rule.unit_below {
        1.0
    } else {
        point.z
    };
    let at = Vector2::new(
        camera.fx * point.x / depth + camera.cx,
        camera.fy * point.y / depth + camera.cy,
    );
    (at, point)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CAMERA: Pinhole = Pinhole {
        fx: 14.0,
        fy: 13.5,
        cx: 7.4,
        cy: 6.3,
    };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        /// Central differences with step 1e-6: truncation and rounding are both near 1e-9 of values
        /// up to 10³ here.
        #[test]
        fn jacobians_match_central_differences(
            source in prop::array::uniform6(-0.3f64..0.3),
            target in prop::array::uniform6(-0.3f64..0.3),
            cell in prop::array::uniform2(0.0f64..16.0),
            d in 0.0f64..2.0,
        ) {
            const STEP: f64 = 1e-6;
            let pose = |xi: [f64; 6]| Se3::exp(&Vector6::from(xi));
            let (source, target) = (pose(source), pose(target));
            let at = |source: &Se3, target: &Se3, d: f64| {
                project(&CAMERA, &target.relative_to(source), cell, d, DepthRule::WORLDSCORE).0
            };
            let found = reproject(&CAMERA, &target.relative_to(&source), cell, d, DepthRule::WORLDSCORE);
            prop_assume!(found.z > 0.3);
            let close = |numeric: Vector2<f64>, u: f64, v: f64| {
                let scale = 1.0 + u.abs() + v.abs();
                (numeric.x - u).abs().max((numeric.y - v).abs()) < 1e-6 * scale
            };
            for axis in 0..6 {
                let step = Vector6::ith(axis, STEP);
                let by_source = (at(&source.retract(&step), &target, d)
                    - at(&source.retract(&-step), &target, d)) / (2.0 * STEP);
                prop_assert!(close(by_source, found.by_source[0][axis], found.by_source[1][axis]));
                let by_target = (at(&source, &target.retract(&step), d)
                    - at(&source, &target.retract(&-step), d)) / (2.0 * STEP);
                prop_assert!(close(by_target, found.by_target[0][axis], found.by_target[1][axis]));
            }
            let by_depth = (at(&source, &target, d + STEP) - at(&source, &target, d - STEP)) / (2.0 * STEP);
            prop_assert!(close(by_depth, found.by_inverse_depth.x, found.by_inverse_depth.y));
        }
    }

    #[test]
    fn a_point_behind_the_camera_is_invalid_and_finite() {
        let behind = Se3 {
            translation: Vector3::new(0.0, 0.0, -3.0),
            ..Se3::IDENTITY
        };
        for d in [1.0 / 3.0, 1.0, 1e6] {
            let found = reproject(&CAMERA, &behind, [3.0, 4.0], d, DepthRule::WORLDSCORE);
            assert!(!found.valid);
            assert!(found.at.iter().all(|x| x.is_finite()));
        }
    }
}
