//! The same bits whatever ran before in the workspace and however many threads run.

use std::num::NonZeroUsize;

use super::super::*;
use super::cases::{Case, ordinary};

/// Poses, depths and costs after a run of the clean solver and one of the reference's.
fn results(case: &Case, workspace: &mut Workspace) -> Vec<(Scene, Report)> {
    let clean = BundleOptions {
        huber_cells: Some(0.5),
        ..BundleOptions::default()
    };
    let run = |options: BundleOptions| {
        let mut scene = case.scene.clone();
        let report = case
            .with(|problem| adjust(&mut scene, problem, &options, workspace))
            .unwrap();
        (scene, report)
    };
    [clean, BundleOptions::worldscore()].map(run).into()
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    // Large enough for three threads to start: see `CELLS_PER_THREAD`.
    let grid = Grid {
        columns: 59,
        rows: 43,
    };
    let case = ordinary(11, 12, grid, 0.4);
    assert!(case.ends.len() * grid.cells() > 3 * super::super::workspace::CELLS_PER_THREAD);
    let one = results(&case, &mut Workspace::default());
    for threads in [2, 3, 7] {
        let mut workspace = Workspace::with_threads(NonZeroUsize::new(threads).unwrap());
        for _ in 0..3 {
            assert_eq!(results(&case, &mut workspace), one, "{threads} threads");
        }
        assert_eq!(workspace.scratch.len(), threads.min(4));
    }
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
