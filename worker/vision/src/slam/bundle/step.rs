//! One step: linearise, solve, substitute back, judge, take.

use nalgebra::Vector6;

use super::cost::candidate_cost;
use super::linearise::linearise;
use super::solve::solve_poses;
use super::substitute::substitute_back;
use super::workspace::{DOF, Workspace, of_sources};
use super::{
    BundleError, BundleOptions, MAX_MAGNITUDE, OnNotPositiveDefinite, Problem, Scene, StepControl,
    UNIT_TOLERANCE,
};

/// Factor of the damping after a step that failed, and its inverse after one that did not.
const DAMPING_FACTOR: f64 = 10.0;

/// The damping never falls below this: the scale of a scene is free, and only damping holds it.
const LEAST_LM: f64 = 1e-9;

pub(super) struct Taken {
    pub(super) cost_before: f64,
    pub(super) cost_after: f64,
    pub(super) pose_step_dropped: bool,
}

/// Takes one step; `None` where none lowers the cost.
pub(super) fn take(
    scene: &mut Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    lm: &mut f64,
    iteration: usize,
    workspace: &mut Workspace,
) -> Result<Option<Taken>, BundleError> {
    let (mut rises, mut failures) = (0, 0);
    loop {
        linearise(
            scene,
            problem,
            options,
            options.depth_lm_ratio * *lm,
            workspace,
        );
        let solved = solve_poses(options, *lm, workspace);
        if !solved
            && let OnNotPositiveDefinite::RaiseDamping { retries } =
                options.on_not_positive_definite
        {
            if failures == retries {
                return Err(BundleError::NotPositiveDefinite {
                    unknowns: workspace.rhs.len(),
                    damping: *lm,
                });
            }
            failures += 1;
            *lm = (*lm * DAMPING_FACTOR).max(LEAST_LM);
            continue;
        }
        substitute_back(scene, problem, options, workspace);
        let in_range = make_candidate(scene, problem, options, workspace);
        let cost_before = workspace.cost;
        let mut cost_after = cost_before;
        match options.control {
            StepControl::Always if !in_range => return Err(BundleError::Diverged { iteration }),
            StepControl::Always => {}
            StepControl::Decrease { retries } => {
                if in_range {
                    cost_after = candidate_cost(scene, problem, options, workspace);
                }
                let lowers = in_range && cost_after <= cost_before;
                if !lowers {
                    if rises == retries {
                        return Ok(None);
                    }
                    rises += 1;
                    *lm = (*lm * DAMPING_FACTOR).max(LEAST_LM);
                    continue;
                }
                *lm = (*lm / DAMPING_FACTOR).max(LEAST_LM);
            }
        }
        accept(scene, workspace);
        return Ok(Some(Taken {
            cost_before,
            cost_after,
            pose_step_dropped: !solved,
        }));
    }
}

/// Keeps the inverse depths of all sources in their bounds.
pub(super) fn project_to_bounds(
    scene: &mut Scene,
    workspace: &mut Workspace,
    options: &BundleOptions,
) {
    let Some((least, most)) = options.inverse_depth_bounds else {
        return;
    };
    if options.motion_only {
        return;
    }
    let frames = scene.inverse_depths.chunks_exact_mut(workspace.cells);
    for (_, depths) in of_sources(&workspace.sources, frames) {
        for d in depths {
            *d = d.clamp(least, most);
        }
    }
    workspace.load_depths(scene);
}

/// The state after the step, in its bounds. Returns whether all numbers are in range.
fn make_candidate(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) -> bool {
    let Workspace {
        cells,
        padded,
        sources,
        depths,
        depth_step,
        pose_step,
        candidate_poses,
        candidate_depths,
        ..
    } = workspace;
    let mut in_range = true;
    let tangents = pose_step.chunks_exact(DOF);
    for (frame, tangent) in problem.free.clone().zip(tangents) {
        let mut pose = scene.poses[frame].retract(&Vector6::from_column_slice(tangent));
        if options.normalise_rotations {
            match pose.normalised() {
                Some(unit) => pose = unit,
                None => in_range = false,
            }
        }
        in_range &= pose.is_valid(UNIT_TOLERANCE)
            && pose.translation.iter().all(|t| t.abs() <= MAX_MAGNITUDE);
        candidate_poses[frame] = pose;
    }
    if options.motion_only {
        return in_range;
    }
    let frames = candidate_depths
        .chunks_exact_mut(*padded)
        .zip(depths.chunks_exact(*padded))
        .zip(depth_step.chunks_exact(*padded));
    for (_, ((to, from), steps)) in of_sources(sources, frames) {
        for ((to, d), dz) in to.iter_mut().zip(from).zip(steps).take(*cells) {
            *to = d + dz;
            if let Some((least, most)) = options.inverse_depth_bounds {
                // NaN stays NaN and is found below.
                *to = to.clamp(least, most);
            }
            in_range &= to.abs() <= MAX_MAGNITUDE;
        }
    }
    in_range
}

fn accept(scene: &mut Scene, workspace: &mut Workspace) {
    let Workspace {
        cells,
        padded,
        sources,
        depths,
        candidate_poses,
        candidate_depths,
        ..
    } = workspace;
    scene.poses.copy_from_slice(candidate_poses);
    let frames = scene
        .inverse_depths
        .chunks_exact_mut(*cells)
        .zip(depths.chunks_exact_mut(*padded))
        .zip(candidate_depths.chunks_exact(*padded));
    for (_, ((scene, depths), candidate)) in of_sources(sources, frames) {
        scene.copy_from_slice(&candidate[..*cells]);
        depths.copy_from_slice(candidate);
    }
}
