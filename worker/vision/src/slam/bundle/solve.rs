//! The poses' system: damping, factorisation, solution.

use super::workspace::Workspace;
use super::{BundleOptions, Damping};

/// Solves for the pose step. Returns false where the damped system has no factor; the step is then 0.
pub(super) fn solve_poses(options: &BundleOptions, lm: f64, workspace: &mut Workspace) -> bool {
    let Workspace {
        matrix,
        factor,
        pose_diagonal,
        rhs,
        pose_step,
        ..
    } = workspace;
    factor.copy_from(matrix);
    for (k, before) in pose_diagonal.iter().enumerate() {
        let value = factor.diagonal_mut(k);
        let diagonal = match options.damping {
            Damping::AfterSchur => *value,
            Damping::BeforeSchur => *before,
        };
        *value += options.ep + lm * diagonal;
    }
    pose_step.copy_from_slice(rhs);
    let solved = factor.factor() && {
        factor.solve(pose_step);
        pose_step.iter().all(|x| x.is_finite())
    };
    if !solved {
        pose_step.fill(0.0);
    }
    solved
}
