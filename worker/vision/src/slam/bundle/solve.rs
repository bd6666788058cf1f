//! The poses' system: damping and Cholesky (nalgebra's, which is plain scalar Rust with one order of
//! operations whatever the machine).

use nalgebra::Cholesky;

use super::workspace::Workspace;
use super::{BundleOptions, Damping};

/// Solves for the pose step. Returns false where the damped system has no factor; the step is then 0.
pub(super) fn solve_poses(options: &BundleOptions, lm: f64, workspace: &mut Workspace) -> bool {
    let unknowns = workspace.rhs.len();
    workspace.pose_step.fill(0.0);
    if unknowns == 0 {
        return true;
    }
    let mut damped = match workspace.factor.take() {
        Some(mut buffer) => {
            buffer.copy_from(&workspace.matrix);
            buffer
        }
        None => workspace.matrix.clone(),
    };
    for k in 0..unknowns {
        let diagonal = match options.damping {
            Damping::AfterSchur => workspace.matrix[(k, k)],
            Damping::BeforeSchur => workspace.pose_diagonal[k],
        };
        damped[(k, k)] += options.ep + lm * diagonal;
    }
    let Some(factor) = Cholesky::new(damped) else {
        return false;
    };
    workspace.pose_step.copy_from(&workspace.rhs);
    factor.solve_mut(&mut workspace.pose_step);
    workspace.factor = Some(factor.unpack_dirty());
    let finite = workspace.pose_step.iter().all(|x| x.is_finite());
    if !finite {
        workspace.pose_step.fill(0.0);
    }
    finite
}
