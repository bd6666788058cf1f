//! What Huber's kernel does against outliers.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::*;
use super::cases::{Case, ordinary};
use crate::slam::camera::{DepthRule, project};

const GRID: Grid = Grid {
    columns: 16,
    rows: 12,
};

/// A scene with noise of up to `noise` cells, from disturbed poses and depths, and its true poses;
/// `share` of the cells of every edge are wrong by up to 8 cells.
fn with_outliers(seed: u64, noise: f64, share: f64) -> (Case, Vec<Se3>) {
    let mut case = ordinary(seed, 5, GRID, noise);
    let truth = adjusted(&ordinary(seed, 5, GRID, 0.0), None).0;
    let random = &mut Pcg64::seed_from_u64(seed);
    for targets in &mut case.targets {
        for cell in 0..GRID.cells() {
            if random.random_bool(share) {
                targets[cell] += random.random_range(-8.0f32..8.0);
                targets[GRID.cells() + cell] += random.random_range(-8.0f32..8.0);
            }
        }
    }
    (case, truth.poses)
}

fn adjusted(case: &Case, huber_cells: Option<f64>) -> (Scene, Report) {
    let options = BundleOptions {
        huber_cells,
        ..BundleOptions::default()
    };
    let mut scene = case.scene.clone();
    let mut workspace = Workspace::default();
    let report = case
        .with(|problem| adjust(&mut scene, problem, &options, &mut workspace))
        .unwrap();
    (scene, report)
}

/// Root mean square angle between relative rotations, rad: free of scale and frame.
fn rotation_error(found: &[Se3], truth: &[Se3]) -> f64 {
    let relative = |poses: &[Se3], k: usize| poses[k].relative_to(&poses[0]);
    let angle = |k: usize| {
        let difference = relative(found, k).relative_to(&relative(truth, k));
        difference.log().rows(3, 3).norm_squared()
    };
    let sum: f64 = (1..found.len()).map(angle).sum();
    libm::sqrt(sum / (found.len() - 1) as f64)
}

/// Median over twelve scenes.
fn median_error(noise: f64, share: f64, huber_cells: Option<f64>) -> f64 {
    let error = |seed| {
        let (case, truth) = with_outliers(seed, noise, share);
        let (scene, _) = adjusted(&case, huber_cells);
        rotation_error(&scene.poses, &truth)
    };
    let mut errors: Vec<f64> = (0..12).map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn the_default_gains_on_outliers_and_loses_nothing_without() {
    let default = BundleOptions::default().huber_cells;
    assert!(default.is_some() && BundleOptions::worldscore().huber_cells.is_none());
    for (noise, share, most) in [
        (0.1, 0.0, 1.01),
        (0.5, 0.0, 1.05),
        (0.1, 0.1, 0.3),
        (0.1, 0.3, 0.5),
        (0.5, 0.1, 0.5),
        (0.5, 0.3, 0.5),
    ] {
        let robust = median_error(noise, share, default);
        let squares = median_error(noise, share, None);
        println!("noise {noise}, {share} wrong: {robust:.2e} rad, squares {squares:.2e} rad");
        assert!(
            robust <= most * squares,
            "{noise} {share}: {robust} {squares}"
        );
    }
}

/// A wrong cell at the least depth moves the poses by a jump when it starts to count: 0.11 with squares,
/// 0.031 with the kernel. What is left comes from its derivatives, which are large where z is small.
#[test]
fn a_cell_at_the_least_depth_moves_the_poses_little() {
    let mut case = ordinary(21, 3, GRID, 0.1);
    let near = GRID.cells() / 2;
    // z = 1 + d t_z, nearly.
    case.scene.poses[1].translation.z = case.scene.poses[0].translation.z - 0.4;
    case.scene.inverse_depths[near] = 2.2;
    let z = {
        let relative = case.scene.poses[1].relative_to(&case.scene.poses[0]);
        let at = [(near % GRID.columns) as f64, (near / GRID.columns) as f64];
        project(
            &case.scene.camera,
            &relative,
            at,
            2.2,
            DepthRule::WORLDSCORE,
        )
        .1
        .z
    };
    assert!((0.05..0.3).contains(&z), "{z}");
    let edge = case.ends.iter().position(|ends| *ends == (0, 1)).unwrap();
    case.targets[edge][near] += 100.0;
    let step = |min_depth: f64, huber_cells: Option<f64>| {
        let options = BundleOptions {
            iterations: 1,
            control: StepControl::Always,
            min_depth,
            huber_cells,
            ..BundleOptions::default()
        };
        let mut workspace = Workspace::default();
        let mut scene = case.scene.clone();
        case.with(|problem| adjust(&mut scene, problem, &options, &mut workspace))
            .unwrap();
        nalgebra::DVector::from_column_slice(workspace.pose_step())
    };
    let jump = |huber: Option<f64>| (step(z - 1e-9, huber) - step(z + 1e-9, huber)).norm();
    let (robust, squares) = (jump(BundleOptions::default().huber_cells), jump(None));
    println!("jump of the step: {robust:.2e}, squares {squares:.2e}");
    assert!(robust < 0.5 * squares, "{robust} {squares}");
}
