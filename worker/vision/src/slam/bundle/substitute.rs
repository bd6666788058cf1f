//! The depths' step from the poses'.

use nalgebra::Vector6;

use super::parallel::for_each;
use super::schur::inverse_diagonal;
use super::view::{EdgeCells, View};
use super::workspace::{DOF, Workspace, of_sources};
use super::{BundleOptions, Problem, Scene};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes};

/// dz = C⁻¹ (w − Eᵀ dx), the coupling computed again: cheaper than keeping it for all edges.
pub(super) fn substitute_back(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    workspace: &mut Workspace,
) {
    if options.motion_only {
        return;
    }
    let Workspace {
        padded,
        rays,
        order,
        sources,
        scratch,
        depths,
        depth_diagonal,
        depth_rhs,
        depth_step,
        pose_step,
        ..
    } = workspace;
    let tangent = |frame: usize| -> Vector6<f64> {
        let dropped = options.first_free_pose_quirk && frame == problem.free.start;
        match problem.unknown(frame) {
            Some(pose) if !dropped => Vector6::from_column_slice(&pose_step[pose * DOF..][..DOF]),
            _ => Vector6::zeros(),
        }
    };
    let frames = depths
        .chunks_exact(*padded)
        .zip(depth_diagonal.chunks_exact(*padded))
        .zip(depth_rhs.chunks_exact(*padded))
        .zip(depth_step.chunks_exact_mut(*padded));
    let jobs = of_sources(sources, frames);
    for_each(scratch, jobs, |_, (source, planes)| {
        let (((depths, diagonal), rhs), step) = planes;
        step.copy_from_slice(rhs);
        let by_source = tangent(source.frame);
        for &edge in &order[source.edges.clone()] {
            let edge = &problem.edges[edge];
            let relative = scene.poses[edge.target].relative_to(&scene.poses[source.frame]);
            let moved = tangent(edge.target) - relative.adjoint() * by_source;
            dispatch(BackKernel {
                cells: EdgeCells::new(scene, edge, &relative, options),
                rays: [&rays[0], &rays[1]],
                depths,
                moved: moved.into(),
                step,
            });
        }
        let lanes = step.chunks_exact_mut(LANES);
        for (step, c) in lanes.zip(diagonal.chunks_exact(LANES)) {
            (Lanes::load(step, 0) * inverse_diagonal(Lanes::load(c, 0))).store(step, 0);
        }
    });
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
        let (fx, fy) = (
            Lanes::splat(self.cells.camera.fx),
            Lanes::splat(self.cells.camera.fy),
        );
        let v = self.moved.map(Lanes::splat);
        let one = Lanes::splat(1.0);
        let mut at = 0;
        while at < self.depths.len() {
            let (x, y) = (Lanes::load(self.rays[0], at), Lanes::load(self.rays[1], at));
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
