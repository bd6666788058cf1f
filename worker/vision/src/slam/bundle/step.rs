//! One step: linearise, solve, substitute back, judge, take.

use nalgebra::Vector6;

use super::cost::candidate_cost;
use super::linearise::{EdgeCells, Relative, View, linearise};
use super::schur::inverse_diagonal;
use super::solve::solve_poses;
use super::workspace::{DOF, Workspace};
use super::{
    BundleError, BundleOptions, MAX_MAGNITUDE, OnNotPositiveDefinite, Problem, Scene, StepControl,
    UNIT_TOLERANCE,
};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes};

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
    for (source, _) in &workspace.sources {
        let frame = source * workspace.cells..(source + 1) * workspace.cells;
        for d in &mut scene.inverse_depths[frame] {
            *d = d.clamp(least, most);
        }
    }
    workspace.load_depths(scene);
}

/// dz = C⁻¹ (w − Eᵀ dx), the coupling computed again: cheaper than keeping it for all edges.
fn substitute_back(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) {
    workspace.depth_step.fill(0.0);
    if options.motion_only {
        return;
    }
    let tangent = |workspace: &Workspace, frame: usize| -> Vector6<f64> {
        let dropped = options.first_free_pose_quirk && frame == problem.free.start;
        if dropped || !problem.free.contains(&frame) {
            return Vector6::zeros();
        }
        let at = (frame - problem.free.start) * DOF;
        workspace.pose_step.fixed_rows::<DOF>(at).into_owned()
    };
    for index in 0..workspace.sources.len() {
        let (source, places) = workspace.sources[index].clone();
        let frame = source * workspace.padded..(source + 1) * workspace.padded;
        let by_source = tangent(workspace, source);
        workspace.depth_step[frame.clone()].copy_from_slice(&workspace.depth_rhs[frame.clone()]);
        for place in places {
            let edge = &problem.edges[workspace.order[place]];
            let relative = scene.poses[edge.target].relative_to(&scene.poses[source]);
            let moved = tangent(workspace, edge.target) - relative.adjoint() * by_source;
            dispatch(BackKernel {
                cells: EdgeCells {
                    edge,
                    relative: Relative::new(&relative),
                    camera: &scene.camera,
                    options,
                    cells: workspace.cells,
                },
                rays: [&workspace.rays[0], &workspace.rays[1]],
                depths: &workspace.depths[frame.clone()],
                moved: [0, 1, 2, 3, 4, 5].map(|k| moved[k]),
                step: &mut workspace.depth_step[frame.clone()],
            });
        }
        let diagonals = workspace.depth_diagonal[frame.clone()].chunks_exact(LANES);
        for (step, c) in workspace.depth_step[frame]
            .chunks_exact_mut(LANES)
            .zip(diagonals)
        {
            (Lanes::load(step, 0) * inverse_diagonal(Lanes::load(c, 0))).store(step, 0);
        }
    }
}

/// Subtracts Eᵀ v of one edge.
struct BackKernel<'a> {
    cells: EdgeCells<'a>,
    rays: [&'a [f64]; 2],
    depths: &'a [f64],
    moved: [f64; DOF],
    step: &'a mut [f64],
}

impl Kernel for BackKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [fx, fy] = [self.cells.camera.fx, self.cells.camera.fy].map(Lanes::splat);
        let v = self.moved.map(Lanes::splat);
        let one = Lanes::splat(1.0);
        let mut at = 0;
        while at < self.depths.len() {
            let [x, y] = self.rays.map(|axis| Lanes::load(axis, at));
            let View {
                a,
                b,
                h,
                weight: [wu, wv],
                by_depth: [zu, zv],
                ..
            } = self.cells.view(at, x, y, Lanes::load(self.depths, at));
            // Change of column and row that the poses' step makes.
            let du = h * (v[0] - a * v[2]) - a * b * v[3] + (one + a * a) * v[4] - b * v[5];
            let dv = h * (v[1] - b * v[2]) - (one + b * b) * v[3] + a * b * v[4] + a * v[5];
            let change = wu * fx * zu * du + wv * fy * zv * dv;
            (Lanes::load(self.step, at) - change).store(self.step, at);
            at += LANES;
        }
    }
}

/// The state after the step, in its bounds. Returns whether all numbers are in range.
fn make_candidate(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) -> bool {
    let mut in_range = true;
    workspace.candidate_poses.copy_from_slice(&scene.poses);
    for (place, frame) in problem.free.clone().enumerate() {
        let tangent = workspace
            .pose_step
            .fixed_rows::<DOF>(place * DOF)
            .into_owned();
        let mut pose = scene.poses[frame].retract(&tangent);
        if options.normalise_rotations {
            match pose.normalised() {
                Some(unit) => pose = unit,
                None => in_range = false,
            }
        }
        in_range &= pose.is_valid(UNIT_TOLERANCE)
            && pose.translation.iter().all(|t| t.abs() <= MAX_MAGNITUDE);
        workspace.candidate_poses[frame] = pose;
    }
    workspace
        .candidate_depths
        .copy_from_slice(&workspace.depths);
    if options.motion_only {
        return in_range;
    }
    for (source, _) in &workspace.sources {
        let frame = source * workspace.padded..source * workspace.padded + workspace.cells;
        let depths = &mut workspace.candidate_depths[frame.clone()];
        for (d, dz) in depths.iter_mut().zip(&workspace.depth_step[frame]) {
            *d += dz;
            if let Some((least, most)) = options.inverse_depth_bounds {
                // NaN stays NaN and is found below.
                *d = d.clamp(least, most);
            }
            in_range &= d.abs() <= MAX_MAGNITUDE;
        }
    }
    in_range
}

fn accept(scene: &mut Scene, workspace: &mut Workspace) {
    scene.poses.copy_from_slice(&workspace.candidate_poses);
    std::mem::swap(&mut workspace.depths, &mut workspace.candidate_depths);
    let rows = scene.inverse_depths.chunks_exact_mut(workspace.cells);
    for (to, from) in rows.zip(workspace.depths.chunks_exact(workspace.padded)) {
        to.copy_from_slice(&from[..workspace.cells]);
    }
}
