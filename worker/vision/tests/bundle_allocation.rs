//! The adjustment allocates nothing once its workspace has its size: counted at the allocator.

mod allocations;

use plumbline_vision::slam::bundle::{
    BundleOptions, EdgeObservation, Problem, Scene, Workspace, adjust,
};
use plumbline_vision::slam::camera::{Grid, Pinhole};
use plumbline_vision::slam::se3::Se3;

#[test]
fn adjustments_after_the_first_allocate_nothing() {
    const FRAMES: usize = 9;
    let grid = Grid {
        columns: 11,
        rows: 7,
    };
    let cells = grid.cells();
    let at: Vec<f32> = (0..2 * cells).map(|k| (k * 7 % 11) as f32).collect();
    let weight = vec![0.5; 2 * cells];
    let mut edges = Vec::new();
    for source in 0..FRAMES {
        for target in 0..FRAMES {
            if source != target {
                edges.push(EdgeObservation {
                    source,
                    target,
                    at: &at,
                    weight: &weight,
                });
            }
        }
    }
    let problem = Problem {
        edges: &edges,
        free: 1..FRAMES,
        depth_damping: None,
        measured: None,
    };
    let mut scene = Scene {
        camera: Pinhole {
            fx: 9.0,
            fy: 9.0,
            cx: 5.0,
            cy: 3.0,
        },
        grid,
        poses: vec![Se3::IDENTITY; FRAMES],
        inverse_depths: vec![1.0; FRAMES * cells],
    };
    let options = BundleOptions::default();
    let mut workspace = Workspace::default();
    adjust(&mut scene, &problem, &options, &mut workspace).unwrap();
    let before = allocations::count();
    assert!(before > 0);
    for _ in 0..2 {
        let report = adjust(&mut scene, &problem, &options, &mut workspace).unwrap();
        assert!(report.cost_after <= report.cost_before || report.iterations > 1);
    }
    assert_eq!(allocations::count(), before);
}
