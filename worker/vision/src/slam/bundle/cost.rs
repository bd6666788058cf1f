//! What a candidate state costs.
//!
//! Compared over the cells that are valid at the current state: a cell that the step moves behind the
//! camera keeps its old cost, so that nothing is gained by losing it.

use super::linearise::{EdgeCells, Relative};
use super::workspace::Workspace;
use super::{BundleOptions, Problem, Scene};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes};

/// Σ w ‖r‖² of the workspace's candidate, and the prior's cost.
pub(super) fn candidate_cost(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &Workspace,
) -> f64 {
    let mut cost = 0.0;
    for (source, places) in &workspace.sources {
        let frame = source * workspace.padded..(source + 1) * workspace.padded;
        for place in places.clone() {
            let edge = &problem.edges[workspace.order[place]];
            let side = |poses: &[crate::slam::se3::Se3]| EdgeCells {
                edge,
                relative: Relative::new(&poses[edge.target].relative_to(&poses[*source])),
                camera: &scene.camera,
                options,
                cells: workspace.cells,
            };
            cost += dispatch(CostKernel {
                before: side(&scene.poses),
                after: side(&workspace.candidate_poses),
                rays: [&workspace.rays[0], &workspace.rays[1]],
                depths_before: &workspace.depths[frame.clone()],
                depths_after: &workspace.candidate_depths[frame.clone()],
            });
        }
        if let Some(measured) = problem.measured.filter(|_| !options.motion_only) {
            let first = source * workspace.cells;
            for (m, d) in measured[first..first + workspace.cells]
                .iter()
                .zip(&workspace.candidate_depths[frame])
            {
                if *m > 0.0 {
                    let difference = d - f64::from(*m);
                    cost += options.depth_prior_weight * difference * difference;
                }
            }
        }
    }
    cost
}

struct CostKernel<'a> {
    before: EdgeCells<'a>,
    after: EdgeCells<'a>,
    rays: [&'a [f64]; 2],
    depths_before: &'a [f64],
    depths_after: &'a [f64],
}

impl Kernel for CostKernel<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let mut sum = Lanes::ZERO;
        let mut at = 0;
        while at < self.depths_before.len() {
            let [x, y] = self.rays.map(|axis| Lanes::load(axis, at));
            let before = self
                .before
                .view(at, x, y, Lanes::load(self.depths_before, at));
            let after = self
                .after
                .view(at, x, y, Lanes::load(self.depths_after, at));
            for axis in 0..2 {
                // Valid before and after: both weights are the same; valid before only: the second is 0.
                let old = before.weight[axis] * before.residual[axis] * before.residual[axis];
                let new = before.weight[axis] * after.residual[axis] * after.residual[axis];
                let lost = Lanes::ZERO - after.weight[axis];
                sum = sum + new.where_positive(after.weight[axis]) + old.where_at_least(lost, 0.0);
            }
            at += LANES;
        }
        sum.sum()
    }
}
