//! The poses' system from what the sources add, in the order of their frames.

use super::schur::pair;
use super::workspace::{DOF, Workspace};
use super::{BundleOptions, Problem};

/// Sums all parts into the workspace's system: with x_t of the targets and x_s of the source,
/// Σ (x_a − Ad_a x_s)ᵀ M_ab (x_b − Ad_b x_s) over all pairs of a source's edges.
pub(super) fn assemble(problem: &Problem<'_>, options: &BundleOptions, workspace: &mut Workspace) {
    let Workspace {
        order,
        sources,
        parts,
        matrix,
        pose_diagonal,
        rhs,
        cost,
        ..
    } = workspace;
    matrix.clear();
    rhs.fill(0.0);
    pose_diagonal.fill(0.0);
    *cost = 0.0;
    let add = |to: &mut [f64], pose: usize, values: &nalgebra::Vector6<f64>| {
        for (to, value) in to[pose * DOF..(pose + 1) * DOF].iter_mut().zip(values) {
            *to += value;
        }
    };
    for (source, part) in sources.iter().zip(parts) {
        let edges = &order[source.edges.clone()];
        let target = |slot: usize| problem.unknown(problem.edges[edges[slot]].target);
        *cost += part.cost;
        let at_source = problem.unknown(source.frame);
        if let Some(s) = at_source {
            matrix.add(s, s, &part.source);
            add(rhs, s, &part.source_gradient);
            add(pose_diagonal, s, &part.source_diagonal);
        }
        for (a, edge) in part.edges.iter().enumerate() {
            let Some(t) = target(a) else { continue };
            add(rhs, t, &edge.gradient);
            add(pose_diagonal, t, &edge.diagonal);
            if let Some(s) = at_source {
                matrix.add(t, s, &edge.by_source);
            }
            matrix.add(t, t, &part.pairs[pair(edges.len(), a, a)]);
            if options.motion_only {
                continue;
            }
            for b in a + 1..edges.len() {
                let Some(u) = target(b) else { continue };
                let block = &part.pairs[pair(edges.len(), a, b)];
                matrix.add(t, u, block);
                if t == u {
                    // The same pair of frames twice: the transposed block lies here too.
                    matrix.add(t, t, &block.transpose());
                }
            }
        }
    }
}
