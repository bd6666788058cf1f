//! The extremes of geometry, one test each, with what is expected of them:
//!
//! - zero motion: nothing moves, the cost stays 0;
//! - pure rotation: found, without a translation, although no depth is observable;
//! - zero parallax (targets at infinity): poses turn, inverse depths go to their least bound;
//! - points at and behind the camera: do not count; a graph of only such points changes nothing;
//! - inverse depth → 0 and → ∞: stays in its bounds, and out of range is a typed error;
//! - rotation near 0 and π: the step is exact for the first, the relative pose of the second is recovered;
//! - rank-deficient graphs: `NotPositiveDefinite` without damping, a step with it;
//! - disconnected graphs: each part is solved as if it were alone;
//! - one cell: solved with damping, `NotPositiveDefinite` without;
//! - all weights zero: nothing moves; without damping `NotPositiveDefinite`;
//! - no edges, no free pose, one frame: nothing to do, and no error.
//!
//! Random graphs with all of these at once are in `hostile`; exp and log near 0 and π in `se3`.

use nalgebra::Vector6;

use super::super::*;
use super::cases::{Case, ordinary};
use crate::slam::camera::{DepthRule, project};

const GRID: Grid = Grid {
    columns: 8,
    rows: 6,
};

/// No damping by `ep`, no tries with more: only the system itself.
fn undamped() -> BundleOptions {
    BundleOptions {
        iterations: 1,
        lm: 0.0,
        ep: 0.0,
        on_not_positive_definite: OnNotPositiveDefinite::RaiseDamping { retries: 0 },
        ..BundleOptions::default()
    }
}

fn to_convergence() -> BundleOptions {
    BundleOptions {
        iterations: 50,
        tolerance: 0.0,
        ..BundleOptions::default()
    }
}

/// A case whose targets are exactly what `truth` and `depths` say, all weights 1.
fn exact(truth: &[Se3], depths: impl Fn(usize) -> f64) -> Case {
    let mut case = ordinary(5, truth.len(), GRID, 0.0);
    case.scene.poses = truth.to_vec();
    case.scene.inverse_depths = (0..truth.len() * GRID.cells()).map(depths).collect();
    for (&(i, j), targets) in case.ends.iter().zip(&mut case.targets) {
        let relative = truth[j].relative_to(&truth[i]);
        for cell in 0..GRID.cells() {
            let at = [(cell % GRID.columns) as f64, (cell / GRID.columns) as f64];
            let d = case.scene.inverse_depths_of(i)[cell];
            let (to, _) = project(&case.scene.camera, &relative, at, d, DepthRule::WORLDSCORE);
            targets[cell] = to.x as f32;
            targets[GRID.cells() + cell] = to.y as f32;
        }
    }
    case.weights
        .iter_mut()
        .for_each(|weights| weights.fill(1.0));
    case
}

fn run(case: &Case, options: &BundleOptions) -> (Scene, Result<Report, BundleError>) {
    let mut scene = case.scene.clone();
    let mut workspace = Workspace::default();
    let result = case.with(|problem| adjust(&mut scene, problem, options, &mut workspace));
    (scene, result)
}

fn turn(angle: f64) -> Se3 {
    Se3::exp(&Vector6::new(
        0.0,
        0.0,
        0.0,
        0.2 * angle,
        angle,
        0.1 * angle,
    ))
}

fn distance(a: &Se3, b: &Se3) -> f64 {
    a.relative_to(b).log().amax()
}

#[test]
fn zero_motion_stays() {
    let case = exact(&[Se3::IDENTITY; 3], |k| 0.5 + 0.01 * (k % 48) as f64);
    let (scene, result) = run(&case, &to_convergence());
    let report = result.unwrap();
    // Targets are integers; the way to the ray and back rounds.
    assert!(report.cost_before < 1e-24 && report.cost_after <= report.cost_before);
    assert!(
        scene
            .poses
            .iter()
            .all(|p| distance(p, &Se3::IDENTITY) < 1e-12)
    );
    for (d, before) in scene.inverse_depths.iter().zip(&case.scene.inverse_depths) {
        assert!((d - before).abs() < 1e-9);
    }
}

#[test]
fn a_pure_rotation_is_found() {
    let truth = [Se3::IDENTITY, turn(0.05), turn(-0.04)];
    let mut case = exact(&truth, |_| 0.8);
    case.scene.poses.fill(Se3::IDENTITY);
    let (scene, result) = run(&case, &to_convergence());
    assert!(result.unwrap().cost_after < 1e-8);
    for (found, true_pose) in scene.poses.iter().zip(&truth) {
        assert!(distance(found, true_pose) < 1e-4, "{found:?}");
    }
    let (least, most) = BundleOptions::default().inverse_depth_bounds.unwrap();
    assert!(
        scene
            .inverse_depths
            .iter()
            .all(|d| (least..=most).contains(d))
    );
}

#[test]
fn without_parallax_depths_fall_to_their_bound() {
    // The truth is infinitely far away; the cameras are apart.
    let apart = |x: f64| Se3 {
        translation: [x, 0.0, 0.0].into(),
        ..Se3::IDENTITY
    };
    let truth = [apart(0.0), apart(0.2), apart(0.4)];
    let mut case = exact(&truth, |_| 0.0);
    case.scene.inverse_depths.fill(1.0);
    case.free = 3..3;
    let (scene, result) = run(&case, &to_convergence());
    result.unwrap();
    let (least, _) = BundleOptions::default().inverse_depth_bounds.unwrap();
    assert!(
        scene
            .inverse_depths
            .iter()
            .all(|d| (d - least).abs() < 1e-9)
    );
}

#[test]
fn points_at_and_behind_the_camera_do_not_count() {
    let mut case = ordinary(6, 2, GRID, 0.1);
    // z = 1 + d t_z: at the camera and behind it.
    for depth in [1.0, 3.0, 1e3] {
        case.scene.poses = vec![Se3::IDENTITY; 2];
        case.scene.poses[1].translation.z = -1.0;
        case.scene.inverse_depths.fill(depth);
        case.ends = vec![(0, 1)];
        case.targets.truncate(1);
        case.weights.truncate(1);
        let (scene, result) = run(&case, &BundleOptions::default());
        let report = result.unwrap();
        assert_eq!((report.cost_before, report.cost_after), (0.0, 0.0));
        assert_eq!(scene, case.scene);
        let (_, result) = run(&case, &undamped());
        assert!(matches!(
            result,
            Err(BundleError::NotPositiveDefinite { .. })
        ));
    }
}

#[test]
fn inverse_depths_at_the_ends_of_their_range() {
    let (least, most) = BundleOptions::default().inverse_depth_bounds.unwrap();
    for start in [0.0, 1e-300, -5.0, 1e6] {
        let mut case = ordinary(7, 3, GRID, 0.1);
        case.scene.inverse_depths.fill(start);
        let (scene, result) = run(&case, &to_convergence());
        assert!(result.unwrap().cost_after.is_finite());
        assert!(
            scene
                .inverse_depths
                .iter()
                .all(|d| (least..=most).contains(d))
        );
    }
    for bad in [1.1e6, f64::INFINITY, f64::NAN] {
        let mut case = ordinary(7, 3, GRID, 0.1);
        case.scene.inverse_depths[3] = bad;
        let (_, result) = run(&case, &BundleOptions::default());
        assert!(matches!(
            result,
            Err(BundleError::OutOfRange { index: 3, .. })
        ));
    }
}

#[test]
fn rotations_near_zero_and_half_a_turn() {
    let pi = std::f64::consts::PI;
    // Both cameras look the same way; the world's axes are half a turn off, or nearly.
    for angle in [0.0, 1e-12, 1e-5, pi - 1e-5, pi - 1e-12, pi] {
        let world = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, angle, 0.0));
        let offset = Se3::exp(&Vector6::new(0.1, 0.05, 0.0, 0.0, 0.02, 0.01));
        let truth = [world, offset.compose(&world)];
        let mut case = exact(&truth, |k| 0.5 + 0.02 * (k % 48) as f64);
        case.scene.poses[1] = world;
        let (scene, result) = run(&case, &to_convergence());
        let report = result.unwrap();
        assert!(
            report.cost_after < 1e-7 && report.cost_before > 0.1,
            "{angle}: {report:?}"
        );
        let relative = scene.poses[1].relative_to(&scene.poses[0]).log();
        // The rotation is observable, the translation up to scale.
        for (found, expected) in relative.iter().zip(offset.log().iter()).skip(3) {
            assert!((found - expected).abs() < 1e-3, "{angle}: {relative}");
        }
    }
    // And half a turn between the cameras: all points lie behind, nothing counts.
    let back = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, pi, 0.0));
    let mut case = exact(&[Se3::IDENTITY; 2], |_| 0.1);
    case.scene.poses[1] = back;
    let (scene, result) = run(&case, &BundleOptions::default());
    assert_eq!(result.unwrap().cost_after, 0.0);
    assert!(distance(&scene.poses[1], &back) < 1e-12);
}

#[test]
fn rank_deficient_graphs_are_typed_or_damped() {
    // Frame 2 is joined to nothing; and with all poses free, the world may move as a whole.
    let mut loose = ordinary(8, 3, GRID, 0.1);
    let kept: Vec<usize> = (0..loose.ends.len())
        .filter(|&e| loose.ends[e].0 != 2 && loose.ends[e].1 != 2)
        .collect();
    loose.ends = kept.iter().map(|&e| loose.ends[e]).collect();
    loose.targets = kept.iter().map(|&e| loose.targets[e].clone()).collect();
    loose.weights = kept.iter().map(|&e| loose.weights[e].clone()).collect();
    let (scene, result) = run(&loose, &undamped());
    assert_eq!(
        result,
        Err(BundleError::NotPositiveDefinite {
            unknowns: 12,
            damping: 0.0
        })
    );
    assert_eq!(scene, loose.scene, "a failed adjustment changes nothing");
    let (scene, result) = run(&loose, &BundleOptions::default());
    let report = result.unwrap();
    assert!(report.cost_after < report.cost_before);
    assert!(distance(&scene.poses[2], &loose.scene.poses[2]) < 1e-12);

    let mut floating = ordinary(9, 3, GRID, 0.1);
    floating.free = 0..3;
    let report = run(&floating, &BundleOptions::default()).1.unwrap();
    assert!(report.cost_after < report.cost_before);
}

#[test]
fn the_parts_of_a_disconnected_graph_do_not_see_each_other() {
    let (first, second) = (ordinary(10, 2, GRID, 0.1), ordinary(11, 2, GRID, 0.1));
    let mut both = first.clone();
    both.scene.poses.extend(&second.scene.poses);
    both.scene
        .inverse_depths
        .extend(&second.scene.inverse_depths);
    both.ends
        .extend(second.ends.iter().map(|&(i, j)| (i + 2, j + 2)));
    both.targets.extend(second.targets.clone());
    both.weights.extend(second.weights.clone());
    both.free = 0..4;
    let options = BundleOptions {
        iterations: 3,
        control: StepControl::Always,
        tolerance: 0.0,
        ..BundleOptions::default()
    };
    let alone = [first, second].map(|mut case| {
        case.free = 0..2;
        run(&case, &options).0
    });
    let (together, result) = run(&both, &options);
    result.unwrap();
    let poses = alone.iter().flat_map(|scene| &scene.poses);
    // The blocks between the parts are exactly 0, so that not even the rounding differs.
    assert!(together.poses.iter().eq(poses));
    let depths = alone.iter().flat_map(|scene| &scene.inverse_depths);
    assert!(together.inverse_depths.iter().eq(depths));
}

#[test]
fn one_cell() {
    let grid = Grid {
        columns: 1,
        rows: 1,
    };
    let mut case = ordinary(12, 2, grid, 0.0);
    for targets in &mut case.targets {
        targets.iter_mut().for_each(|at| *at += 0.3);
    }
    // Two equations for seven unknowns.
    let (_, result) = run(&case, &undamped());
    assert!(matches!(
        result,
        Err(BundleError::NotPositiveDefinite { .. })
    ));
    let report = run(&case, &to_convergence()).1.unwrap();
    assert!(report.cost_after < 1e-3 * report.cost_before, "{report:?}");
}

#[test]
fn all_weights_zero() {
    let mut case = ordinary(13, 3, GRID, 0.1);
    case.weights
        .iter_mut()
        .for_each(|weights| weights.fill(0.0));
    let (scene, result) = run(&case, &to_convergence());
    let report = result.unwrap();
    assert_eq!((report.cost_before, report.cost_after), (0.0, 0.0));
    for (pose, before) in scene.poses.iter().zip(&case.scene.poses) {
        assert!(distance(pose, before) < 1e-12);
    }
    assert_eq!(scene.inverse_depths, case.scene.inverse_depths);
    let (_, result) = run(&case, &undamped());
    assert!(matches!(
        result,
        Err(BundleError::NotPositiveDefinite { .. })
    ));
    // The reference counts a dropped step instead.
    let reference = BundleOptions {
        lm: 0.0,
        ep: 0.0,
        ..BundleOptions::worldscore()
    };
    assert_eq!(run(&case, &reference).1.unwrap().pose_steps_dropped, 2);
}

#[test]
fn nothing_to_do() {
    let mut case = ordinary(14, 1, GRID, 0.0);
    case.free = 0..1;
    assert!(case.ends.is_empty());
    let (scene, result) = run(&case, &BundleOptions::default());
    assert_eq!(result.unwrap().cost_after, 0.0);
    assert!(distance(&scene.poses[0], &case.scene.poses[0]) < 1e-12);
    let mut fixed = ordinary(15, 3, GRID, 0.1);
    fixed.free = 3..3;
    let (scene, result) = run(&fixed, &BundleOptions::default());
    let report = result.unwrap();
    assert!(report.cost_after < report.cost_before);
    assert_eq!(scene.poses, fixed.scene.poses);
}
