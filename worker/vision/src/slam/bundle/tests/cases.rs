//! Problems for the solver: ordinary ones, and graphs in which anything may be wrong.

use std::ops::Range;

use nalgebra::Vector6;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::*;
use crate::slam::camera::{DepthRule, reproject};

/// A problem that owns its arrays.
#[derive(Debug, Clone)]
pub(super) struct Case {
    pub(super) scene: Scene,
    pub(super) ends: Vec<(usize, usize)>,
    pub(super) targets: Vec<Vec<f32>>,
    pub(super) weights: Vec<Vec<f32>>,
    pub(super) free: Range<usize>,
    pub(super) depth_damping: Option<Vec<f32>>,
    pub(super) measured: Option<Vec<f32>>,
}

impl Case {
    pub(super) fn edges(&self) -> Vec<EdgeObservation<'_>> {
        let fields = self.targets.iter().zip(&self.weights);
        let edges = self.ends.iter().zip(fields);
        edges
            .map(|(&(source, target), (at, weight))| EdgeObservation {
                source,
                target,
                at,
                weight,
            })
            .collect()
    }

    pub(super) fn with<R>(&self, use_problem: impl FnOnce(&Problem<'_>) -> R) -> R {
        let edges = self.edges();
        use_problem(&Problem {
            edges: &edges,
            free: self.free.clone(),
            depth_damping: self.depth_damping.as_deref(),
            measured: self.measured.as_deref(),
        })
    }
}

pub(super) fn random_pose(random: &mut Pcg64, translation: f64, angle: f64) -> Se3 {
    let mut draw = |scale: f64| scale * random.random_range(-1.0..1.0);
    let tau = [0; 3].map(|_| draw(translation));
    let phi = [0; 3].map(|_| draw(angle));
    Se3::exp(&Vector6::new(
        tau[0], tau[1], tau[2], phi[0], phi[1], phi[2],
    ))
}

/// A scene whose targets are its own reprojections plus noise of `noise` cells; poses and depths are
/// then disturbed.
pub(super) fn ordinary(seed: u64, frames: usize, grid: Grid, noise: f64) -> Case {
    let random = &mut Pcg64::seed_from_u64(seed);
    let camera = Pinhole {
        fx: 0.9 * grid.columns as f64,
        fy: 0.95 * grid.columns as f64,
        cx: 0.48 * grid.columns as f64,
        cy: 0.51 * grid.rows as f64,
    };
    let cells = grid.cells();
    let poses: Vec<Se3> = (0..frames)
        .map(|_| random_pose(random, 0.2, 0.05))
        .collect();
    let inverse_depths: Vec<f64> = (0..frames * cells)
        .map(|_| random.random_range(0.3..1.5))
        .collect();
    let mut ends = Vec::new();
    for i in 0..frames {
        for j in 0..frames {
            if i != j && i.abs_diff(j) <= 2 {
                ends.push((i, j));
            }
        }
    }
    let mut targets = Vec::new();
    let mut weights = Vec::new();
    for &(i, j) in &ends {
        let relative = poses[j].relative_to(&poses[i]);
        let mut planes = [Vec::new(), Vec::new()];
        for cell in 0..cells {
            let at = [(cell % grid.columns) as f64, (cell / grid.columns) as f64];
            let found = reproject(
                &camera,
                &relative,
                at,
                inverse_depths[i * cells + cell],
                DepthRule::WORLDSCORE,
            )
            .at;
            for axis in 0..2 {
                planes[axis].push((found[axis] + noise * random.random_range(-1.0..1.0)) as f32);
            }
        }
        targets.push(planes.concat());
        weights.push(
            (0..2 * cells)
                .map(|_| random.random_range(0.05..1.0))
                .collect(),
        );
    }
    let mut scene = Scene {
        camera,
        grid,
        poses,
        inverse_depths,
    };
    for pose in &mut scene.poses[1..] {
        *pose = random_pose(random, 0.03, 0.01).compose(pose);
    }
    for d in &mut scene.inverse_depths {
        *d *= 1.0 + 0.1 * random.random_range(-1.0..1.0);
    }
    Case {
        scene,
        ends,
        targets,
        weights,
        free: 1..frames,
        depth_damping: None,
        measured: None,
    }
}

/// A graph of small size in which anything may be wrong.
pub(super) fn wild(seed: u64) -> Case {
    let random = &mut Pcg64::seed_from_u64(seed);
    let grid = Grid {
        columns: random.random_range(1..5),
        rows: random.random_range(1..4),
    };
    let frames = random.random_range(1..6usize);
    let cells = grid.cells();
    let pi = std::f64::consts::PI;
    let poses = (0..frames)
        .map(|_| match random.random_range(0..7) {
            0 => Se3::IDENTITY,
            1 => random_pose(random, 1e-9, 1e-9),
            2 => random_pose(random, 1.0, 0.1),
            // Points at and behind the camera.
            3 => Se3 {
                translation: [0.0, 0.0, random.random_range(-3.0..1.0)].into(),
                ..Se3::IDENTITY
            },
            // Half a turn, or nearly.
            4 => Se3::exp(&Vector6::new(
                0.0,
                0.0,
                1.0,
                0.0,
                pi - random.random_range(0.0..1e-6),
                0.0,
            )),
            5 => random_pose(random, 5e5, 3.0),
            _ => random_pose(random, 0.1, 0.01),
        })
        .collect();
    let depth_kind = random.random_range(0..5);
    let inverse_depths = (0..frames * cells)
        .map(|_| match depth_kind {
            0 => random.random_range(0.1..2.0),
            1 => 0.0,
            2 => libm::exp10(random.random_range(-12.0..5.9)),
            3 => -random.random_range(0.0..3.0),
            _ => [0.0, 1.0, 1e-300, 1e6, -1e6][random.random_range(0..5)],
        })
        .collect();
    let edge_count = random.random_range(0..9);
    let mut ends = Vec::new();
    for _ in 0..edge_count {
        let (i, j) = (
            random.random_range(0..frames),
            random.random_range(0..frames),
        );
        if i != j {
            // Disconnected and repeated edges as they come.
            ends.push((i, j));
        }
    }
    let weight_kind = random.random_range(0..4);
    let weight = |random: &mut Pcg64| match weight_kind {
        0 => 0.0,
        1 => random.random_range(0.0..1.0),
        2 => [0.0, 1e6, 1e-30][random.random_range(0..3)],
        _ => 1.0,
    };
    let target_scale = [0.0, 1.0, 10.0, 1e8][random.random_range(0..4)];
    let targets = ends
        .iter()
        .map(|_| {
            (0..2 * cells)
                .map(|_| target_scale * random.random_range(-1.0f32..1.0))
                .collect()
        })
        .collect();
    let weights = ends
        .iter()
        .map(|_| (0..2 * cells).map(|_| weight(random)).collect())
        .collect();
    let start = random.random_range(0..=frames);
    let values = |random: &mut Pcg64| {
        let values = (0..frames * cells).map(|_| [0.0, 1e-7, 0.5, 1e6][random.random_range(0..4)]);
        values.collect::<Vec<f32>>()
    };
    let depth_damping = random.random_bool(0.5).then(|| values(random));
    let measured = random.random_bool(0.3).then(|| values(random));
    Case {
        scene: Scene {
            camera: Pinhole {
                fx: [1.0, 5.0, 1e-3, 1e5][random.random_range(0..4)],
                fy: 4.0,
                cx: 1.5,
                cy: [1.0, -30.0][random.random_range(0..2)],
            },
            grid,
            poses,
            inverse_depths,
        },
        ends,
        targets,
        weights,
        free: start..random.random_range(start..=frames),
        depth_damping,
        measured,
    }
}
