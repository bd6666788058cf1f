//! Synthetic cameras and scenes for the tests: 384 × 256 px, focal length 256 px, a 48 × 32 grid.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::Rng;
use rand_pcg::Pcg32;

use super::correspondence::{Correspondence, CorrespondenceField};
use super::linear::{cross_matrix, unit};

const FOCAL_PX: f64 = 256.0;
pub(super) const COLUMNS: usize = 48;
pub(super) const ROWS: usize = 32;

/// The second camera relative to the first: `X₂ = R X₁ + t`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    /// Euler angles, rad.
    pub(super) turn: [f64; 3],
    /// In units of depth.
    pub(super) translation: [f64; 3],
}

/// Depth of a picture point.
#[derive(Debug, Clone, Copy)]
pub(super) enum Scene {
    /// A slanted plane.
    Plane,
    /// Depth 2 to 6, independent per point.
    Random,
    /// The plane, but with this fraction of points at random depths 2 to 6.
    PlaneAnd(f64),
}

impl Camera {
    pub(super) const STILL: Self = Self {
        turn: [0.0; 3],
        translation: [0.0; 3],
    };
    pub(super) const CENTRE: [f64; 2] = [192.0, 128.0];

    fn intrinsics() -> Matrix3<f64> {
        Matrix3::new(
            FOCAL_PX,
            0.0,
            Self::CENTRE[0],
            0.0,
            FOCAL_PX,
            Self::CENTRE[1],
            0.0,
            0.0,
            1.0,
        )
    }

    fn rotation(&self) -> Matrix3<f64> {
        Rotation3::from_euler_angles(self.turn[0], self.turn[1], self.turn[2]).into_inner()
    }

    /// Where a source point of a given inverse depth is in the target.
    pub(super) fn transfer(&self, from_px: [f64; 2], inverse_depth: f64) -> [f64; 2] {
        let ray = Vector3::new(
            (from_px[0] - Self::CENTRE[0]) / FOCAL_PX,
            (from_px[1] - Self::CENTRE[1]) / FOCAL_PX,
            1.0,
        );
        let p = Self::intrinsics()
            * (self.rotation() * ray + Vector3::from(self.translation) * inverse_depth);
        [p.x / p.z, p.y / p.z]
    }

    /// `K⁻ᵀ [t]× R K⁻¹`, unit norm.
    pub(super) fn fundamental(&self) -> [[f64; 3]; 3] {
        let k = Self::intrinsics().try_inverse().unwrap();
        let f = unit(
            k.transpose() * cross_matrix(&Vector3::from(self.translation)) * self.rotation() * k,
        )
        .unwrap();
        std::array::from_fn(|r| std::array::from_fn(|c| f[(r, c)]))
    }
}

pub(super) fn uniform(rng: &mut Pcg32) -> f64 {
    f64::from(rng.next_u32()) / 4_294_967_296.0
}

/// Nearly Gaussian, mean 0, standard deviation 1 (Irwin-Hall of 12).
pub(super) fn gauss(rng: &mut Pcg32) -> f64 {
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

/// The grid seen by two cameras, with Gaussian noise on the targets.
pub(super) fn clip_points(
    camera: &Camera,
    scene: Scene,
    noise_px: f64,
    seed: u64,
) -> CorrespondenceField {
    let mut rng = Pcg32::new(seed, 77);
    let correspondences: Vec<_> = (0..COLUMNS * ROWS)
        .map(|cell| {
            let from_px = [
                4.0 + 8.0 * (cell % COLUMNS) as f64,
                4.0 + 8.0 * (cell / COLUMNS) as f64,
            ];
            let plane = 0.3 + 0.0004 * from_px[0] + 0.0006 * from_px[1];
            let (choice, random) = (uniform(&mut rng), 1.0 / (2.0 + 4.0 * uniform(&mut rng)));
            let inverse_depth = match scene {
                Scene::Plane => plane,
                Scene::Random => random,
                Scene::PlaneAnd(fraction) => {
                    if choice < fraction {
                        random
                    } else {
                        plane
                    }
                }
            };
            let [x, y] = camera.transfer(from_px, inverse_depth);
            let to_px = [
                x + noise_px * gauss(&mut rng),
                y + noise_px * gauss(&mut rng),
            ];
            Correspondence {
                from_px,
                to_px,
                weight: 1.0,
            }
        })
        .collect();
    field(correspondences)
}

/// Any list as a one-row grid or, if it has its size, as the 48 × 32 grid.
pub(super) fn field(correspondences: Vec<Correspondence>) -> CorrespondenceField {
    let count = correspondences.len();
    let (columns, rows) = if count == COLUMNS * ROWS {
        (COLUMNS, ROWS)
    } else {
        (count, 1)
    };
    CorrespondenceField {
        columns,
        rows,
        cells: (0..count as u32).collect(),
        correspondences,
        invalid: 0,
        out_of_frame: 0,
    }
}

/// Moves a block of cells (a "moving arm") of the given fraction by one vector.
pub(super) fn move_arm(field: &mut CorrespondenceField, fraction: f64, by_px: [f64; 2]) {
    let columns = (fraction * COLUMNS as f64).round() as usize;
    for (c, &cell) in field.correspondences.iter_mut().zip(&field.cells) {
        let column = cell as usize % COLUMNS;
        if (20..20 + columns).contains(&column) {
            c.to_px = [c.to_px[0] + by_px[0], c.to_px[1] + by_px[1]];
        }
    }
}

/// Throws a fraction of the targets anywhere in the picture; returns which.
pub(super) fn throw_outliers(
    field: &mut CorrespondenceField,
    fraction: f64,
    seed: u64,
) -> Vec<bool> {
    let mut rng = Pcg32::new(seed, 78);
    field
        .correspondences
        .iter_mut()
        .map(|c| {
            let thrown = uniform(&mut rng) < fraction;
            if thrown {
                c.to_px = [384.0 * uniform(&mut rng), 256.0 * uniform(&mut rng)];
            }
            thrown
        })
        .collect()
}
