//! Whatever the input: a typed error or a scene of finite numbers.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::*;
use super::cases::{Case, ordinary, wild};

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
