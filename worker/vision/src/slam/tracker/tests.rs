//! The tracker on exact correspondences of a scene made up here, and at its extremes.

use nalgebra::{Vector3, Vector6};

use super::*;
use crate::slam::bundle::BundleError;
use crate::slam::camera::{Pinhole, project};
use crate::slam::se3::Se3;
use crate::slam::trajectory::{AbsoluteError, TimedPose, absolute_error};

const GRID: Grid = Grid {
    columns: 12,
    rows: 9,
};
const CAMERA: Pinhole = Pinhole {
    fx: 11.0,
    fy: 11.0,
    cx: 5.5,
    cy: 4.0,
};

/// Inverse depth of a cell of any frame: a relief that no homography flattens.
fn inverse_depth(cell: usize) -> f64 {
    let (u, v) = ((cell % GRID.columns) as f64, (cell / GRID.columns) as f64);
    0.6 + 0.3 * (0.9 * u).sin() * (0.7 * v).cos()
}

/// A camera that moves and turns; or only turns.
fn pose(k: usize, moves: f64) -> Se3 {
    let t = k as f64;
    let tau = moves * Vector3::new(0.06 * t, 0.03 * (0.8 * t).sin(), 0.02 * t);
    Se3::exp(&Vector6::new(
        tau.x,
        tau.y,
        tau.z,
        0.0,
        0.01 * t,
        0.02 * (0.5 * t).sin(),
    ))
}

/// Each frame's cells where they truly are in the others up to `span` away. Depths belong to the frame.
fn graph(frames: usize, span: usize, moves: f64) -> FlowGraph {
    let mut graph = FlowGraph::new(GRID);
    graph.frames = (0..frames).collect();
    for source in 0..frames {
        for target in (0..frames).filter(|t| *t != source && t.abs_diff(source) <= span) {
            graph.edges.push(FlowEdge {
                source,
                target,
                answer: answer(source, target, moves),
            });
        }
    }
    graph
}

fn answer(source: usize, target: usize, moves: f64) -> GridAnswer {
    seen_by(&CAMERA, source, target, moves)
}

fn seen_by(camera: &Pinhole, source: usize, target: usize, moves: f64) -> GridAnswer {
    let cells = GRID.cells();
    let relative = pose(target, moves).relative_to(&pose(source, moves));
    let mut answer = GridAnswer {
        at: vec![0.0; 2 * cells],
        weight: vec![1.0; 2 * cells],
    };
    for cell in 0..cells {
        let from = [(cell % GRID.columns) as f64, (cell / GRID.columns) as f64];
        let d = inverse_depth(cell);
        let (at, _) = project(camera, &relative, from, d, depth_rule());
        answer.at[cell] = at.x as f32;
        answer.at[cells + cell] = at.y as f32;
    }
    answer
}

fn exact() -> TrackParams {
    TrackParams {
        tolerance: 1e-9,
        rounds: 20,
        ..TrackParams::default()
    }
}

fn error(solution: &Solution, moves: f64) -> AbsoluteError {
    let timed = |(frame, pose): (usize, Se3)| TimedPose {
        time_s: frame as f64,
        world_from_camera: pose.inverse(),
    };
    let truth = solution
        .trajectory
        .iter()
        .map(|&(k, _)| (k, pose(k, moves)));
    let truth: Vec<TimedPose> = truth.map(timed).collect();
    let estimate: Vec<TimedPose> = solution.trajectory.iter().copied().map(timed).collect();
    absolute_error(&estimate, &truth).unwrap()
}

#[test]
fn exact_correspondences_give_poses_and_depths_back() {
    let graph = graph(12, 2, 1.0);
    let solution = solve(&graph, CAMERA, &exact()).unwrap();
    // Targets are f32 cells of about 10 (1e-6); a path of 0.7, seen by 108 cells.
    let ate = error(&solution, 1.0);
    assert!(ate.rmse < 1e-5 && ate.rotation_rmse_rad < 1e-5, "{ate:?}");
    let scale = ate.truth_from_estimate.scale;
    for (at, d) in solution.scene.inverse_depths.iter().enumerate() {
        let truth = inverse_depth(at % GRID.cells());
        assert!((d / scale - truth).abs() < 1e-3 * truth, "{d} {truth}");
    }
    assert!(solution.mean_residual_px().unwrap() < 1e-4);
    let known = solution.observability(&graph, &exact()).unwrap();
    assert!(known.fraction() > 0.9, "{}", known.fraction());
}

#[test]
fn the_relief_is_not_inverted_where_the_view_is_narrow() {
    // Views of 22 degrees: the inverted relief fits nearly as well.
    let narrow = Pinhole {
        fx: 30.0,
        fy: 30.0,
        ..CAMERA
    };
    let mut graph = graph(10, 3, 1.0);
    for edge in &mut graph.edges {
        edge.answer = seen_by(&narrow, edge.source, edge.target, 1.0);
    }
    let solution = solve(&graph, narrow, &exact()).unwrap();
    let ate = error(&solution, 1.0);
    assert!(ate.rmse < 1e-3 && ate.rotation_rmse_rad < 1e-3, "{ate:?}");
}

#[test]
fn windows_of_bounded_size_are_nearly_as_good() {
    let graph = graph(30, 2, 1.0);
    let windowed = TrackParams {
        most_adjusted: 10,
        ..exact()
    };
    let ate = error(&solve(&graph, CAMERA, &windowed).unwrap(), 1.0);
    // The same exact data, so that only convergence can differ.
    assert!(ate.rmse < 1e-4, "{ate:?}");
}

#[test]
fn outliers_do_not_move_the_camera() {
    let mut graph = graph(10, 2, 1.0);
    let cells = GRID.cells();
    // A tenth of the cells swing by themselves, each in its own way, by up to 8 px.
    let swing = |cell: usize, frame: usize| 0.5 * (1.7 * frame as f32 + cell as f32).sin();
    for edge in &mut graph.edges {
        for cell in (0..cells).filter(|cell| cell % 11 == 3) {
            let by = swing(cell, edge.target) - swing(cell, edge.source);
            edge.answer.at[cell] += by;
            edge.answer.at[cells + cell] -= by;
        }
    }
    let robust = error(&solve(&graph, CAMERA, &exact()).unwrap(), 1.0);
    let plain = TrackParams {
        huber_px: 1e6,
        ..exact()
    };
    let plain = error(&solve(&graph, CAMERA, &plain).unwrap(), 1.0);
    // Huber's loss bounds the pull of an outlier to that of a residual of 1 px.
    assert!(robust.rmse < 0.5 * plain.rmse, "{robust:?} {plain:?}");
}

#[test]
fn frames_between_keyframes_get_their_pose() {
    let mut graph = graph(12, 2, 1.0);
    // Every other frame becomes a follower of the one before.
    graph
        .edges
        .retain(|e| e.source % 2 == 0 && e.target % 2 == 0);
    for edge in &mut graph.edges {
        edge.source /= 2;
        edge.target /= 2;
    }
    graph.frames = (0..12).step_by(2).collect();
    for keyframe in 0..6 {
        graph.followers.push(Follower {
            frame: 2 * keyframe + 1,
            keyframe,
            answer: answer(2 * keyframe, 2 * keyframe + 1, 1.0),
        });
    }
    let solution = solve(&graph, CAMERA, &exact()).unwrap();
    let frames: Vec<usize> = solution.trajectory.iter().map(|&(f, _)| f).collect();
    assert_eq!(frames, (0..12).collect::<Vec<_>>());
    let ate = error(&solution, 1.0);
    assert!(ate.rmse < 1e-4, "{ate:?}");
}

#[test]
fn a_turning_camera_is_found_without_depth_and_its_depth_is_not_observable() {
    let graph = graph(10, 2, 0.0);
    let turned = rotate_only(&graph, CAMERA, &exact()).unwrap();
    assert_eq!(turned.effort.depth_cells, 0);
    for (k, found) in &turned.trajectory {
        let between = found.relative_to(&pose(*k, 0.0)).log();
        // Rounding of f32 targets.
        assert!(between.norm() < 1e-5, "{between}");
    }
    // Forced to look for depth, the gate finds that nothing of it is known.
    let forced = solve(&graph, CAMERA, &exact()).unwrap();
    let known = forced.observability(&graph, &exact()).unwrap();
    assert!(known.fraction() < 0.05, "{}", known.fraction());
}

#[test]
fn what_cannot_be_tracked_has_a_type() {
    let params = TrackParams::default();
    let none = FlowGraph::new(GRID);
    assert!(matches!(
        solve(&none, CAMERA, &params),
        Err(TrackError::NoEdges)
    ));
    let mut one = graph(1, 2, 1.0);
    one.followers.clear();
    assert!(matches!(
        solve(&one, CAMERA, &params),
        Err(TrackError::NoEdges)
    ));
    let bad = TrackParams {
        huber_px: 0.0,
        ..params
    };
    let two = graph(2, 2, 1.0);
    assert!(matches!(
        solve(&two, CAMERA, &bad),
        Err(TrackError::Parameter { name: "huber_px" })
    ));
    let mut absurd = graph(3, 2, 1.0);
    absurd.edges[0].answer.at[0] = f32::NAN;
    assert!(matches!(
        solve(&absurd, CAMERA, &params),
        Err(TrackError::Bundle(BundleError::OutOfRange { .. }))
    ));
}

#[test]
fn extremes_stay_finite() {
    let params = TrackParams::default();
    let finite = |solution: &Solution| {
        let poses = solution.trajectory.iter();
        poses
            .flat_map(|(_, pose)| pose.to_array())
            .all(f64::is_finite)
            && solution.scene.inverse_depths.iter().all(|d| d.is_finite())
    };
    // Nothing moves.
    let mut still = graph(6, 2, 0.0);
    for edge in &mut still.edges {
        edge.answer = answer(0, 0, 0.0);
    }
    let solution = solve(&still, CAMERA, &params).unwrap();
    assert!(finite(&solution));
    assert!(solution.mean_residual_px().unwrap() < 1e-3);
    // Nothing is seen: no cell has a residual.
    let mut blind = graph(6, 2, 1.0);
    for edge in &mut blind.edges {
        edge.answer.weight.fill(0.0);
    }
    let solution = solve(&blind, CAMERA, &params).unwrap();
    assert!(finite(&solution));
    assert_eq!(solution.mean_residual_px(), None);
    assert_eq!(
        solution.observability(&blind, &params).unwrap().fraction(),
        0.0
    );
    // Two halves that no edge joins.
    let mut torn = graph(8, 2, 1.0);
    torn.edges.retain(|e| (e.source < 4) == (e.target < 4));
    assert!(finite(&solve(&torn, CAMERA, &params).unwrap()));
}
