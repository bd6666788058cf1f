//! The solver against its slow twin: a dense system over poses and depths, built cell by cell from
//! `camera::reproject`.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

use super::super::*;
use super::cases::{Case, ordinary};
use crate::slam::camera::{DepthRule, reproject};

/// The whole system, undamped in the poses: matrix and right-hand side over free poses, then all depths.
fn dense_system(case: &Case, options: &BundleOptions) -> (DMatrix<f64>, DVector<f64>) {
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
            let depth = scene.inverse_depths[i * cells + cell];
            let found = reproject(&scene.camera, &relative, at, depth, rule);
            if !found.valid {
                continue;
            }
            for axis in 0..2 {
                let residual = f64::from(case.targets[e][axis * cells + cell]) - found.at[axis];
                let mut weight =
                    options.weight_scale * f64::from(case.weights[e][axis * cells + cell]);
                if let Some(threshold) = options.huber_cells.filter(|t| residual.abs() > *t) {
                    weight *= threshold / residual.abs();
                }
                let mut row = DVector::<f64>::zeros(size);
                for (frame, derivative) in
                    [(i, &found.by_source[axis]), (j, &found.by_target[axis])]
                {
                    if case.free.contains(&frame) {
                        let mut part = row.fixed_rows_mut::<6>(6 * (frame - case.free.start));
                        part += derivative;
                    }
                }
                if !options.motion_only {
                    row[poses + i * cells + cell] = found.by_inverse_depth[axis];
                }
                rhs.axpy(weight * residual, &row, 1.0);
                matrix.ger(weight, &row, &row, 1.0);
            }
        }
    }
    if !options.motion_only {
        finish_depths(case, options, &mut matrix, &mut rhs);
    }
    // What nothing is known of stays where it is.
    for k in poses..size {
        if matrix[(k, k)] == 0.0 {
            matrix[(k, k)] = 1.0;
        }
    }
    (matrix, rhs)
}

/// Damping of the depths, and what was measured.
fn finish_depths(
    case: &Case,
    options: &BundleOptions,
    matrix: &mut DMatrix<f64>,
    rhs: &mut DVector<f64>,
) {
    let cells = case.scene.grid.cells();
    let poses = 6 * case.free.len();
    for (k, depth) in case.scene.inverse_depths.iter().enumerate() {
        if !case.ends.iter().any(|&(i, _)| i == k / cells) {
            continue;
        }
        let at = poses + k;
        matrix[(at, at)] *= 1.0 + options.depth_lm_ratio * options.lm;
        let measured = case.measured.as_ref().map_or(0.0, |m| f64::from(m[k]));
        if measured > 0.0 {
            matrix[(at, at)] += options.depth_prior_weight;
            rhs[at] -= options.depth_prior_weight * (depth - measured);
        } else if let Some(damping) = &case.depth_damping {
            matrix[(at, at)] += f64::from(damping[k]);
        }
    }
}

/// One step. Returns that of the poses and of all depths.
fn dense_step(case: &Case, options: &BundleOptions) -> (DVector<f64>, DVector<f64>) {
    let (mut matrix, rhs) = dense_system(case, options);
    let poses = 6 * case.free.len();
    let depths = matrix.nrows() - poses;
    match options.damping {
        Damping::BeforeSchur => {
            for k in 0..poses {
                matrix[(k, k)] += options.ep + options.lm * matrix[(k, k)];
            }
            let step = matrix.full_piv_lu().solve(&rhs).unwrap();
            (
                step.rows(0, poses).into_owned(),
                step.rows(poses, depths).into_owned(),
            )
        }
        Damping::AfterSchur => {
            let coupling = matrix.view((0, poses), (poses, depths)).into_owned();
            let diagonal = matrix.view((poses, poses), (depths, depths)).into_owned();
            let inverse = diagonal.try_inverse().unwrap();
            let (b, w) = (rhs.rows(0, poses), rhs.rows(poses, depths));
            let mut schur =
                matrix.view((0, 0), (poses, poses)) - &coupling * &inverse * coupling.transpose();
            for k in 0..poses {
                schur[(k, k)] += options.ep + options.lm * schur[(k, k)];
            }
            let reduced = b - &coupling * &inverse * w;
            let dx = schur.full_piv_lu().solve(&reduced).unwrap();
            let dz = inverse * (w - coupling.transpose() * &dx);
            (dx, dz)
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// 1e-9 of the step: both solve systems of condition up to 1e6 in f64.
    #[test]
    fn elimination_equals_a_dense_solve(
        seed in any::<u64>(),
        frames in 2usize..5,
        columns in 1usize..6,
        rows in 1usize..5,
        damped in any::<bool>(),
        after in any::<bool>(),
        motion_only in prop::bool::weighted(0.2),
        measured in any::<bool>(),
        near in any::<bool>(),
        huber_cells in prop::option::of(0.05f64..2.0),
        repeated in any::<bool>(),
    ) {
        let mut case = ordinary(seed, frames, Grid { columns, rows }, 0.3);
        let count = case.scene.inverse_depths.len();
        if damped {
            case.depth_damping = Some(vec![0.02; count]);
        }
        if measured {
            case.measured = Some((0..count).map(|k| [0.0, 0.7][k % 2]).collect());
        }
        if repeated {
            // The same pair of frames twice, with other weights.
            case.ends.push(case.ends[0]);
            case.targets.push(case.targets[0].clone());
            case.weights.push(case.weights[1].clone());
        }
        if near {
            // Some cells lie nearer than the least depth that counts, some behind the camera.
            case.scene.poses[frames - 1].translation.z -= 0.9;
        }
        let options = BundleOptions {
            iterations: 1,
            lm: 1e-3,
            ep: 1e-2,
            damping: if after { Damping::AfterSchur } else { Damping::BeforeSchur },
            control: StepControl::Always,
            inverse_depth_bounds: None,
            huber_cells,
            motion_only,
            normalise_rotations: false,
            ..BundleOptions::default()
        };
        let (pose_step, depth_step) = dense_step(&case, &options);
        let mut scene = case.scene.clone();
        let mut workspace = Workspace::default();
        let result = case.with(|problem| adjust(&mut scene, problem, &options, &mut workspace));
        // A wild step of near cells may leave the range; it is still the step of the dense system.
        prop_assert!(near || result.is_ok(), "{result:?}");
        let scale = pose_step.amax().max(depth_step.amax());
        for (found, expected) in workspace.pose_step().iter().zip(pose_step.iter()) {
            prop_assert!((found - expected).abs() <= 1e-9 * scale, "{found} {expected}");
        }
        for (found, expected) in workspace.depth_step().iter().zip(depth_step.iter()) {
            prop_assert!((found - expected).abs() <= 1e-9 * scale, "{found} {expected}");
        }
    }
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
