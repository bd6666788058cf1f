//! The normal equations of one state, source frame by source frame.
//!
//! An edge's derivatives by its source's pose are −Ad of those by its target's, so that an edge sees
//! only v = dx_target − Ad dx_source. Everything is summed in v, one 6 × 6 block an edge pair, and
//! carried to the poses afterwards. A source's depths couple only its own edges: its cells are taken in
//! blocks that fit the cache, linearised, eliminated and forgotten. Sources share nothing, so that
//! each is one job of [`for_each`].

use nalgebra::{Matrix6, Vector6};

use super::assemble::assemble;
use super::parallel::for_each;
use super::schur::{eliminate_block, matrix, pair};
use super::tile::Tiled;
use super::view::{EdgeCells, View};
use super::workspace::{BLOCK, DOF, Scratch, Source, Workspace, of_sources};
use super::{BundleOptions, Problem, Scene};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes, add_sums};
use crate::slam::se3::Se3;

/// Sums over one edge's cells: upper triangle of the target's Hessian (21), its gradient (6), cost.
const SUMS: usize = 28;

/// What one source adds to the poses' system, with M = H − E C⁻¹ Eᵀ over its edges.
#[derive(Debug, Clone, Default)]
pub(super) struct SourcePart {
    /// Of each edge.
    pub(super) edges: Vec<EdgePart>,
    /// E C⁻¹ Eᵀ of all pairs, see [`pair`].
    products: Vec<Tiled>,
    /// E C⁻¹ w of each edge.
    reduced: Vec<[f64; DOF]>,
    /// M of all pairs.
    pub(super) pairs: Vec<Matrix6<f64>>,
    /// Σ Adᵀ M Ad over all pairs: the source's own block.
    pub(super) source: Matrix6<f64>,
    /// −Σ Adᵀ g: its right-hand side.
    pub(super) source_gradient: Vector6<f64>,
    /// Σ diag(Adᵀ H Ad).
    pub(super) source_diagonal: Vector6<f64>,
    pub(super) cost: f64,
}

/// One edge's share.
#[derive(Debug, Clone, Default)]
pub(super) struct EdgePart {
    relative: Se3,
    adjoint: Matrix6<f64>,
    sums: [f64; SUMS],
    /// −Σ M Ad over the pairs of this edge: the block of target and source.
    pub(super) by_source: Matrix6<f64>,
    pub(super) gradient: Vector6<f64>,
    /// diag(H).
    pub(super) diagonal: Vector6<f64>,
}

impl SourcePart {
    pub(super) fn resize(&mut self, edges: usize) {
        self.edges.resize(edges, EdgePart::default());
        self.reduced.resize(edges, [0.0; DOF]);
        let pairs = edges * (edges + 1) / 2;
        self.products.resize(pairs, Tiled::default());
        self.pairs.resize(pairs, Matrix6::zeros());
    }
}

/// Fills the workspace's system from `scene` (whose depths it has loaded). `depth_lm` is the relative
/// damping of the depths.
pub(super) fn linearise(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    depth_lm: f64,
    workspace: &mut Workspace,
) {
    let Workspace {
        cells,
        padded,
        rays,
        order,
        sources,
        parts,
        scratch,
        depths,
        depth_diagonal,
        depth_rhs,
        ..
    } = workspace;
    let context = Context {
        scene,
        problem,
        options,
        depth_lm,
        cells: *cells,
        rays: [&rays[0], &rays[1]],
        order,
    };
    let frames = depths
        .chunks_exact(*padded)
        .zip(depth_diagonal.chunks_exact_mut(*padded))
        .zip(depth_rhs.chunks_exact_mut(*padded));
    let jobs = of_sources(sources, frames).zip(parts);
    for_each(scratch, jobs, |scratch, ((source, planes), part)| {
        let ((depths, diagonal), rhs) = planes;
        part.place(&context, source);
        dispatch(SourceKernel {
            context: &context,
            source,
            depths,
            diagonal,
            rhs,
            part,
            scratch,
        });
        part.carry(options.motion_only);
    });
    assemble(problem, options, workspace);
}

/// What all sources see.
struct Context<'a> {
    scene: &'a Scene,
    problem: &'a Problem<'a>,
    options: &'a BundleOptions,
    depth_lm: f64,
    cells: usize,
    rays: [&'a [f64]; 2],
    order: &'a [usize],
}

/// One source's edges, summed over its cells.
struct SourceKernel<'a> {
    context: &'a Context<'a>,
    source: &'a Source,
    /// Inverse depths, C and w of the source.
    depths: &'a [f64],
    diagonal: &'a mut [f64],
    rhs: &'a mut [f64],
    part: &'a mut SourcePart,
    scratch: &'a mut Scratch,
}

impl Kernel for SourceKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let Context {
            scene,
            problem,
            options,
            order,
            ..
        } = *self.context;
        self.diagonal.fill(0.0);
        self.rhs.fill(0.0);
        let padded = self.depths.len();
        let mut start = 0;
        while start < padded {
            let block = start..(start + BLOCK).min(padded);
            for slot in 0..self.source.edges.len() {
                let edge = &problem.edges[order[self.source.edges.start + slot]];
                let relative = &self.part.edges[slot].relative;
                let cells = EdgeCells::new(scene, edge, relative, options);
                self.accumulate(&cells, block.clone(), slot);
            }
            if !options.motion_only {
                self.finish_depths(block.clone());
                eliminate_block(
                    self.scratch,
                    &self.diagonal[block.clone()],
                    &self.rhs[block.clone()],
                    &mut self.part.products,
                    &mut self.part.reduced,
                );
            }
            start = block.end;
        }
    }
}

impl SourceKernel<'_> {
    /// Damping and measurements of a block's depths.
    #[inline(always)]
    fn finish_depths(&mut self, block: std::ops::Range<usize>) {
        let Context {
            problem,
            options,
            depth_lm,
            cells,
            ..
        } = *self.context;
        let first = self.source.frame * cells;
        for cell in block.start..block.end.min(cells) {
            let at = first + cell;
            let damping = problem.depth_damping.map_or(0.0, |d| f64::from(d[at]));
            let measured = problem.measured.map_or(0.0, |m| f64::from(m[at]));
            let c = &mut self.diagonal[cell];
            *c *= 1.0 + depth_lm;
            if measured > 0.0 {
                let weight = options.depth_prior_weight;
                let difference = self.depths[cell] - measured;
                *c += weight;
                self.rhs[cell] -= weight * difference;
                self.part.cost += weight * difference * difference;
            } else {
                *c += damping;
            }
        }
    }

    /// Adds a block's cells of one edge: to the edge's sums, to the depths' diagonal and right-hand
    /// side; writes the coupling.
    #[inline(always)]
    fn accumulate(&mut self, cells: &EdgeCells<'_>, block: std::ops::Range<usize>, slot: usize) {
        let length = block.len();
        let rays_x = &self.context.rays[0][block.clone()];
        let rays_y = &self.context.rays[1][block.clone()];
        let depths = &self.depths[block.clone()];
        let diagonal = &mut self.diagonal[block.clone()];
        let rhs = &mut self.rhs[block.clone()];
        let planes = &mut self.scratch.coupling[slot * DOF * BLOCK..(slot + 1) * DOF * BLOCK];
        let (e0, rest) = planes.split_at_mut(BLOCK);
        let (e1, rest) = rest.split_at_mut(BLOCK);
        let (e2, rest) = rest.split_at_mut(BLOCK);
        let (e3, rest) = rest.split_at_mut(BLOCK);
        let (e4, e5) = rest.split_at_mut(BLOCK);
        let (fx, fy) = (Lanes::splat(cells.camera.fx), Lanes::splat(cells.camera.fy));
        let one = Lanes::splat(1.0);
        let mut total = [Lanes::ZERO; SUMS];
        let mut at = 0;
        while at < length {
            let View {
                a,
                b,
                h,
                weight: [wu, wv],
                residual: [ru, rv],
                by_depth: [zu, zv],
                loss,
                ..
            } = cells.view(
                block.start + at,
                Lanes::load(rays_x, at),
                Lanes::load(rays_y, at),
                Lanes::load(depths, at),
            );
            // Derivatives without the focal length: (h, 0, p, q, s, n) and (0, h, g, m, −q, a).
            let zero = Lanes::ZERO;
            let (p, q, s, n) = (zero - a * h, zero - a * b, one + a * a, zero - b);
            let (g, m, q2) = (zero - b * h, zero - (one + b * b), a * b);
            let (fu, fv) = (wu * fx, wv * fy);

            let (cu, cv) = (fu * zu, fv * zv);
            (cu * h).store(e0, at);
            (cv * h).store(e1, at);
            (cu * p + cv * g).store(e2, at);
            (cu * q + cv * m).store(e3, at);
            (cu * s + cv * q2).store(e4, at);
            (cu * n + cv * a).store(e5, at);
            (Lanes::load(diagonal, at) + (wu * zu * zu + wv * zv * zv)).store(diagonal, at);
            (Lanes::load(rhs, at) + (wu * ru * zu + wv * rv * zv)).store(rhs, at);

            let (gu, gv) = (fu * ru, fv * rv);
            let (ku, kv) = (fu * fx, fv * fy);
            let (kh, kp, kq, ks, kn) = (ku * h, ku * p, ku * q, ku * s, ku * n);
            let (lh, lg, lm, lq, la) = (kv * h, kv * g, kv * m, kv * q2, kv * a);
            let terms = [
                kh * h,
                zero,
                kh * p,
                kh * q,
                kh * s,
                kh * n,
                lh * h,
                lh * g,
                lh * m,
                lh * q2,
                lh * a,
                kp * p + lg * g,
                kp * q + lg * m,
                kp * s + lg * q2,
                kp * n + lg * a,
                kq * q + lm * m,
                kq * s + lm * q2,
                kq * n + lm * a,
                ks * s + lq * q2,
                ks * n + lq * a,
                kn * n + la * a,
                gu * h,
                gv * h,
                gu * p + gv * g,
                gu * q + gv * m,
                gu * s + gv * q2,
                gu * n + gv * a,
                loss,
            ];
            for (sum, term) in total.iter_mut().zip(terms) {
                *sum = *sum + term;
            }
            at += LANES;
        }
        add_sums(&total, &mut self.part.edges[slot].sums);
    }
}

impl SourcePart {
    /// Sets all sums to zero and the edges' relative poses.
    fn place(&mut self, context: &Context<'_>, source: &Source) {
        let poses = &context.scene.poses;
        let edges = &context.order[source.edges.clone()];
        for (part, &edge) in self.edges.iter_mut().zip(edges) {
            let target = context.problem.edges[edge].target;
            part.relative = poses[target].relative_to(&poses[source.frame]);
            part.adjoint = part.relative.adjoint();
            part.sums.fill(0.0);
        }
        self.products.fill(Tiled::default());
        self.reduced.fill([0.0; DOF]);
        self.cost = 0.0;
    }

    /// Carries what is summed in v to the poses.
    fn carry(&mut self, motion_only: bool) {
        let count = self.edges.len();
        self.source = Matrix6::zeros();
        self.source_gradient = Vector6::zeros();
        self.source_diagonal = Vector6::zeros();
        for (slot, edge) in self.edges.iter_mut().enumerate() {
            let (hessian, gradient) = unpack(&edge.sums);
            let reduced = Vector6::from(self.reduced[slot]);
            edge.gradient = gradient - reduced;
            edge.diagonal = hessian.diagonal();
            self.source_gradient -= edge.adjoint.tr_mul(&edge.gradient);
            self.source_diagonal += edge.adjoint.tr_mul(&(hessian * edge.adjoint)).diagonal();
            self.cost += edge.sums[SUMS - 1];
            let place = pair(count, slot, slot);
            self.pairs[place] = hessian - matrix(&self.products[place], true);
            edge.by_source = -(self.pairs[place] * edge.adjoint);
        }
        if !motion_only {
            for a in 0..count {
                for b in a + 1..count {
                    let place = pair(count, a, b);
                    let block = -matrix(&self.products[place], false);
                    self.pairs[place] = block;
                    let (adjoint_a, adjoint_b) = (self.edges[a].adjoint, self.edges[b].adjoint);
                    self.edges[a].by_source -= block * adjoint_b;
                    self.edges[b].by_source -= block.tr_mul(&adjoint_a);
                }
            }
        }
        for edge in &self.edges {
            self.source -= edge.adjoint.tr_mul(&edge.by_source);
        }
    }
}

/// Hessian and gradient by v.
fn unpack(sums: &[f64; SUMS]) -> (Matrix6<f64>, Vector6<f64>) {
    let mut hessian = Matrix6::zeros();
    let mut next = sums.iter();
    for row in 0..DOF {
        for column in row..DOF {
            let value = next.next().copied().unwrap_or(0.0);
            hessian[(row, column)] = value;
            hessian[(column, row)] = value;
        }
    }
    (hessian, Vector6::from_iterator(next.take(DOF).copied()))
}
