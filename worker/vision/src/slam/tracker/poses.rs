//! Poses of all frames: those of the keyframes, and for each frame between the pose that its keyframe's
//! depths and the flow to it ask for (motion-only adjustment).

use super::residual::robust_weights;
use super::{FlowEdge, FlowGraph, TrackError, TrackParams};
use crate::slam::bundle::{BundleOptions, EdgeObservation, Problem, Scene, Workspace, adjust};
use crate::slam::se3::Se3;

/// Adjustments of one pose: plain, then robust.
const ROUNDS: usize = 2;

/// `camera_from_world` of every frame of the graph, in order.
pub(super) fn trajectory(
    graph: &FlowGraph,
    scene: &Scene,
    params: &TrackParams,
) -> Result<Vec<(usize, Se3)>, TrackError> {
    let keyframes = graph.frames.iter().zip(&scene.poses);
    let mut trajectory: Vec<(usize, Se3)> = keyframes.map(|(&f, &pose)| (f, pose)).collect();
    let mut workspace = Workspace::default();
    let cells = scene.grid.cells();
    // Followers come in order: each starts from the pose before it, if that hangs on the same keyframe.
    let mut before: Option<(usize, Se3)> = None;
    for follower in &graph.followers {
        let slot = follower.keyframe;
        let start = match before {
            Some((keyframe, pose)) if keyframe == slot => pose,
            _ => scene.poses[slot],
        };
        let mut pair = Scene {
            camera: scene.camera,
            grid: scene.grid,
            poses: vec![scene.poses[slot], start],
            inverse_depths: [scene.inverse_depths_of(slot), &vec![0.0; cells]].concat(),
        };
        let edge = FlowEdge {
            source: 0,
            target: 1,
            answer: follower.answer.clone(),
        };
        for round in 0..ROUNDS {
            let weight = match round {
                0 => edge.answer.weight.clone(),
                _ => robust_weights(&pair, &edge, params.huber_px),
            };
            let observations = [EdgeObservation {
                weight: &weight,
                ..edge.observation()
            }];
            let problem = Problem {
                edges: &observations,
                free: 1..2,
                depth_damping: None,
                measured: None,
            };
            let options = BundleOptions {
                motion_only: true,
                ..params.options(params.iterations)
            };
            adjust(&mut pair, &problem, &options, &mut workspace)?;
        }
        before = Some((slot, pair.poses[1]));
        trajectory.push((follower.frame, pair.poses[1]));
    }
    trajectory.sort_by_key(|&(frame, _)| frame);
    Ok(trajectory)
}
