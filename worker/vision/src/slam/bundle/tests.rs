//! The solver against its slow twin (a dense system over poses and depths, built cell by cell from
//! `camera::reproject`), and under everything that a graph can be.

use nalgebra::{DMatrix, DVector, Vector6};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::slam::camera::{DepthRule, reproject};

/// A problem that owns its arrays.
#[derive(Debug, Clone)]
struct Case {
    scene: Scene,
    ends: Vec<(usize, usize)>,
    targets: Vec<Vec<f32>>,
    weights: Vec<Vec<f32>>,
    free: Range<usize>,
    depth_damping: Option<Vec<f32>>,
    measured: Option<Vec<f32>>,
}

impl Case {
    fn edges(&self) -> Vec<EdgeObservation<'_>> {
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

    fn with<R>(&self, use_problem: impl FnOnce(&Problem<'_>) -> R) -> R {
        let edges = self.edges();
        use_problem(&Problem {
            edges: &edges,
            free: self.free.clone(),
            depth_damping: self.depth_damping.as_deref(),
            measured: self.measured.as_deref(),
        })
    }
}

fn random_pose(random: &mut Pcg64, translation: f64, angle: f64) -> Se3 {
    let mut draw = |scale: f64| scale * random.random_range(-1.0..1.0);
    let tau = [0; 3].map(|_| draw(translation));
    let phi = [0; 3].map(|_| draw(angle));
    Se3::exp(&Vector6::new(
        tau[0], tau[1], tau[2], phi[0], phi[1], phi[2],
    ))
}

/// A scene whose targets are its own reprojections plus noise of `noise` cells; poses and depths are
/// then disturbed.
fn ordinary(seed: u64, frames: usize, grid: Grid, noise: f64) -> Case {
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

/// One undamped-by-elimination step of the whole system at once: dense, obvious, slow. Returns the
/// pose step, and the depth step of every source.
fn dense_step(case: &Case, options: &BundleOptions) -> (DVector<f64>, Vec<f64>) {
    let (scene, cells) = (&case.scene, case.scene.grid.cells());
    let poses = 6 * case.free.len();
    let size = poses + scene.inverse_depths.len();
    let mut matrix = DMatrix::<f64>::zeros(size, size);
    let mut rhs = DVector::<f64>::zeros(size);
    let rule = DepthRule {
        valid_above: options.min_depth,
        unit_below: options.min_depth,
    };
    for (e, &(i, j)) in case.ends.iter().enumerate() {
        let relative = scene.poses[j].relative_to(&scene.poses[i]);
        for cell in 0..cells {
            let at = [
                (cell % scene.grid.columns) as f64,
                (cell / scene.grid.columns) as f64,
            ];
            let found = reproject(
                &scene.camera,
                &relative,
                at,
                scene.inverse_depths[i * cells + cell],
                rule,
            );
            if !found.valid {
                continue;
            }
            for axis in 0..2 {
                let weight = options.weight_scale * f64::from(case.weights[e][axis * cells + cell]);
                let residual = f64::from(case.targets[e][axis * cells + cell]) - found.at[axis];
                let mut row = DVector::<f64>::zeros(size);
                for (frame, derivative) in
                    [(i, &found.by_source[axis]), (j, &found.by_target[axis])]
                {
                    if case.free.contains(&frame) {
                        let mut part = row.fixed_rows_mut::<6>(6 * (frame - case.free.start));
                        part += derivative;
                    }
                }
                row[poses + i * cells + cell] = found.by_inverse_depth[axis];
                rhs.axpy(weight * residual, &row, 1.0);
                matrix.ger(weight, &row, &row, 1.0);
            }
        }
    }
    for k in 0..poses {
        matrix[(k, k)] += options.ep + options.lm * matrix[(k, k)];
    }
    for k in poses..size {
        let observed = matrix[(k, k)] > 0.0;
        matrix[(k, k)] *= 1.0 + options.depth_lm_ratio * options.lm;
        if let Some(damping) = &case.depth_damping {
            matrix[(k, k)] += f64::from(damping[k - poses]);
        }
        if !observed && matrix[(k, k)] == 0.0 {
            matrix[(k, k)] = 1.0;
        }
    }
    let step = matrix.full_piv_lu().solve(&rhs).unwrap();
    (
        step.rows(0, poses).into_owned(),
        step.rows(poses, size - poses).iter().copied().collect(),
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// 1e-9 of the step: both solve systems of condition up to 1e6 in f64.
    #[test]
    fn elimination_equals_a_dense_solve(
        seed in any::<u64>(),
        frames in 2usize..5,
        columns in 1usize..6,
        rows in 1usize..5,
        damped in any::<bool>(),
    ) {
        let mut case = ordinary(seed, frames, Grid { columns, rows }, 0.3);
        if damped {
            case.depth_damping = Some(vec![0.02; case.scene.inverse_depths.len()]);
        }
        let options = BundleOptions {
            iterations: 1,
            lm: 1e-3,
            ep: 1e-2,
            control: StepControl::Always,
            inverse_depth_bounds: None,
            ..BundleOptions::default()
        };
        let (pose_step, depth_step) = dense_step(&case, &options);
        let mut scene = case.scene.clone();
        let mut workspace = Workspace::default();
        case.with(|problem| adjust(&mut scene, problem, &options, &mut workspace)).unwrap();
        let scale = pose_step.amax().max(depth_step.iter().fold(0.0, |m, d| m.max(d.abs())));
        for (found, expected) in workspace.pose_step().iter().zip(pose_step.iter()) {
            prop_assert!((found - expected).abs() <= 1e-9 * scale, "{found} {expected}");
        }
        for (found, expected) in workspace.depth_step().iter().zip(&depth_step) {
            prop_assert!((found - expected).abs() <= 1e-9 * scale, "{found} {expected}");
        }
    }
}

/// A graph of small size in which anything may be wrong.
fn wild(seed: u64) -> Case {
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

#[test]
fn no_graph_makes_a_number_that_is_not_finite() {
    const GRAPHS: u64 = 12_000;
    let (mut adjusted, mut failed, mut dropped) = (0, 0, 0);
    let mut workspace = Workspace::default();
    for seed in 0..GRAPHS {
        let case = wild(seed);
        let random = &mut Pcg64::seed_from_u64(seed ^ 0x5eed);
        let iterations = 1 + (seed / 3 % 3) as usize;
        let mut options = match seed % 3 {
            0 => BundleOptions {
                iterations,
                ..BundleOptions::default()
            },
            1 => BundleOptions {
                iterations,
                ..BundleOptions::worldscore()
            },
            // No damping at all: only the failure of the factorisation stands between the solver and
            // a singular system.
            _ => BundleOptions {
                iterations,
                lm: 0.0,
                ep: 0.0,
                ..BundleOptions::default()
            },
        };
        options.motion_only = random.random_bool(0.1);
        let mut scene = case.scene.clone();
        match case.with(|problem| adjust(&mut scene, problem, &options, &mut workspace)) {
            Ok(report) => {
                adjusted += 1;
                dropped += report.pose_steps_dropped;
                assert!(
                    report.cost_before.is_finite() && report.cost_after.is_finite(),
                    "{seed}"
                );
                // Over several steps the set of cells in front of the camera may grow.
                if options.control.is_adaptive() && iterations == 1 {
                    assert!(
                        report.cost_after <= report.cost_before,
                        "{seed}: {report:?}"
                    );
                }
            }
            Err(BundleError::NotPositiveDefinite { .. } | BundleError::Diverged { .. }) => {
                failed += 1;
            }
            Err(other) => panic!("{seed}: {other}"),
        }
        // Whatever happened, the scene is one that the solver would accept again.
        assert!(
            scene.poses.iter().all(|p| p.is_valid(1e-2)),
            "{seed}: {:?}",
            scene.poses
        );
        assert!(scene.inverse_depths.iter().all(|d| d.is_finite()), "{seed}");
        assert!(
            workspace.pose_step().iter().all(|x| x.is_finite()),
            "{seed}"
        );
    }
    assert!(
        adjusted > GRAPHS / 2 && failed > 0,
        "{adjusted} {failed} {dropped}"
    );
}

#[test]
fn results_do_not_depend_on_the_workspace() {
    let case = ordinary(
        1,
        4,
        Grid {
            columns: 7,
            rows: 5,
        },
        0.2,
    );
    let run = |workspace: &mut Workspace| {
        let mut scene = case.scene.clone();
        case.with(|problem| adjust(&mut scene, problem, &BundleOptions::default(), workspace))
            .unwrap();
        scene
    };
    let fresh = run(&mut Workspace::default());
    let mut used = Workspace::default();
    let other = ordinary(
        2,
        6,
        Grid {
            columns: 9,
            rows: 20,
        },
        0.2,
    );
    let mut scene = other.scene.clone();
    other
        .with(|problem| adjust(&mut scene, problem, &BundleOptions::default(), &mut used))
        .unwrap();
    assert_eq!(run(&mut used), fresh);
    assert_eq!(run(&mut used), fresh);
}

#[test]
fn exact_targets_are_reached() {
    // Scale and the first pose's frame are free; the cost is not.
    let case = ordinary(
        3,
        5,
        Grid {
            columns: 16,
            rows: 12,
        },
        0.0,
    );
    let mut scene = case.scene.clone();
    let options = BundleOptions {
        iterations: 30,
        tolerance: 0.0,
        ..BundleOptions::default()
    };
    let report = case
        .with(|problem| adjust(&mut scene, problem, &options, &mut Workspace::default()))
        .unwrap();
    // Targets are f32: rounding of 1e-6 cells, squared, over some thousand observations.
    assert!(report.cost_after < 1e-8, "{report:?}");
    assert!(report.cost_before > 1.0);
}

#[test]
fn malformed_input_is_a_typed_error_and_changes_nothing() {
    let good = ordinary(
        4,
        3,
        Grid {
            columns: 3,
            rows: 2,
        },
        0.1,
    );
    let fails = |change: &dyn Fn(&mut Case)| {
        let mut case = good.clone();
        change(&mut case);
        let mut scene = case.scene.clone();
        let error = case
            .with(|problem| {
                adjust(
                    &mut scene,
                    problem,
                    &BundleOptions::default(),
                    &mut Workspace::default(),
                )
            })
            .unwrap_err();
        assert_eq!(format!("{scene:?}"), format!("{:?}", case.scene));
        error
    };
    assert!(matches!(
        fails(&|c| c.weights[1][2] = f32::NAN),
        BundleError::OutOfRange { index: 1, .. }
    ));
    assert!(matches!(
        fails(&|c| c.weights[1][2] = -1.0),
        BundleError::OutOfRange { index: 1, .. }
    ));
    assert!(matches!(
        fails(&|c| c.targets[0][2] = f32::INFINITY),
        BundleError::OutOfRange { index: 0, .. }
    ));
    assert!(matches!(
        fails(&|c| c.targets[0].push(0.0)),
        BundleError::Shape {
            expected: 12,
            actual: 13,
            ..
        }
    ));
    assert!(matches!(
        fails(&|c| c.ends[0] = (0, 9)),
        BundleError::Edge {
            target_frame: 9,
            ..
        }
    ));
    assert!(matches!(
        fails(&|c| c.ends[0] = (1, 1)),
        BundleError::Edge { .. }
    ));
    assert!(matches!(
        fails(&|c| c.scene.inverse_depths[5] = f64::NAN),
        BundleError::OutOfRange { index: 5, .. }
    ));
    assert!(matches!(
        fails(&|c| c.scene.poses[2].rotation = [0.0; 4]),
        BundleError::OutOfRange { index: 2, .. }
    ));
    assert!(matches!(
        fails(&|c| c.scene.camera.fx = 0.0),
        BundleError::Parameter { name: "camera" }
    ));
    assert!(matches!(
        fails(&|c| c.free = 1..4),
        BundleError::Parameter { name: "free" }
    ));
    assert!(matches!(
        fails(&|c| {
            c.scene.inverse_depths.pop();
        }),
        BundleError::Shape { .. }
    ));
    assert!(matches!(
        fails(&|c| c.depth_damping = Some(vec![-1.0; 18])),
        BundleError::OutOfRange { index: 0, .. }
    ));
}
