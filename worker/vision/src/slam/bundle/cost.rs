//! What a candidate state costs.
//!
//! Compared over the cells that are valid at the current state: a cell that the step moves behind the
//! camera keeps its old cost, so that nothing is gained by losing it.

use super::parallel::for_each;
use super::view::EdgeCells;
use super::workspace::{Source, Workspace, of_sources};
use super::{BundleOptions, Problem, Scene};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes};
use crate::slam::se3::Se3;

/// Σ w ρ(r) of the workspace's candidate, and the prior's cost.
pub(super) fn candidate_cost(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) -> f64 {
    let Workspace {
        cells,
        padded,
        rays,
        order,
        sources,
        parts,
        scratch,
        depths,
        candidate_depths,
        candidate_poses,
        ..
    } = workspace;
    let frames = depths
        .chunks_exact(*padded)
        .zip(candidate_depths.chunks_exact(*padded));
    let jobs = of_sources(sources, frames).zip(parts.iter_mut());
    for_each(scratch, jobs, |_, ((source, (before, after)), part)| {
        part.cost = prior_cost(problem, options, source, &after[..*cells]);
        for &edge in &order[source.edges.clone()] {
            let edge = &problem.edges[edge];
            let side = |poses: &[Se3]| {
                let relative = poses[edge.target].relative_to(&poses[source.frame]);
                EdgeCells::new(scene, edge, &relative, options)
            };
            part.cost += dispatch(CostKernel {
                before: side(&scene.poses),
                after: side(candidate_poses),
                rays: [&rays[0], &rays[1]],
                depths_before: before,
                depths_after: after,
            });
        }
    });
    let parts = parts.iter().zip(&*sources);
    parts.map(|(part, _)| part.cost).sum()
}

fn prior_cost(
    problem: &Problem<'_>,
    options: &BundleOptions,
    source: &Source,
    depths: &[f64],
) -> f64 {
    let Some(measured) = problem.measured.filter(|_| !options.motion_only) else {
        return 0.0;
    };
    let measured = &measured[source.frame * depths.len()..];
    let known = measured.iter().zip(depths).filter(|(m, _)| **m > 0.0);
    let square = |(m, d): (&f32, &f64)| (d - f64::from(*m)) * (d - f64::from(*m));
    options.depth_prior_weight * known.map(square).sum::<f64>()
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
            let (x, y) = (Lanes::load(self.rays[0], at), Lanes::load(self.rays[1], at));
            let before = Lanes::load(self.depths_before, at);
            let after = Lanes::load(self.depths_after, at);
            let before = self.before.view(at, x, y, before);
            let after = self.after.view(at, x, y, after);
            let lost = before.loss - before.loss.where_at_least(after.clearance, 0.0);
            let kept = after.loss.where_at_least(before.clearance, 0.0);
            sum = sum + (kept + lost);
            at += LANES;
        }
        sum.sum()
    }
}
