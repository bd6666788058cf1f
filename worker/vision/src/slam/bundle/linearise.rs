//! The normal equations of one state, source frame by source frame.
//!
//! An edge's derivatives by its source's pose are −Ad of those by its target's, so that an edge sees
//! only v = dx_target − Ad dx_source. Everything is summed in v, one 6 × 6 block an edge, and carried
//! to the poses once per edge pair. A source's depths couple only its own edges: its cells are taken
//! in blocks that fit the cache, linearised, eliminated and forgotten.

use nalgebra::{Matrix6, Vector6};

use super::schur::eliminate_block;
use super::workspace::{BLOCK, DOF, SUMS, Workspace};
use super::{BundleOptions, EdgeObservation, Problem, Scene};
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::camera::Pinhole;
use crate::slam::lanes::{LANES, Lanes};
use crate::slam::se3::Se3;

/// Fills the workspace's system from `scene` (whose depths it has loaded). `depth_lm` is the relative
/// damping of the depths.
pub(super) fn linearise(
    scene: &Scene,
    problem: &Problem<'_>,
    options: &BundleOptions,
    depth_lm: f64,
    workspace: &mut Workspace,
) {
    workspace.matrix.fill(0.0);
    workspace.rhs.fill(0.0);
    workspace.pose_diagonal.fill(0.0);
    workspace.cost = 0.0;
    for index in 0..workspace.sources.len() {
        let (source, places) = workspace.sources[index].clone();
        let degree = places.len();
        for (slot, place) in places.clone().enumerate() {
            let edge = &problem.edges[workspace.order[place]];
            let relative = scene.poses[edge.target].relative_to(&scene.poses[source]);
            workspace.relatives[slot] = relative;
            workspace.adjoints[slot] = relative.adjoint();
        }
        workspace.sums[..degree].fill([0.0; SUMS]);
        workspace.products[..degree * degree * DOF * DOF].fill(0.0);
        workspace.reduced[..degree * DOF].fill(0.0);
        dispatch(SourceKernel {
            camera: &scene.camera,
            problem,
            options,
            depth_lm,
            source,
            places,
            workspace,
        });
        scatter(problem, options, index, workspace);
    }
}

/// One source's edges, summed over its cells.
struct SourceKernel<'a> {
    camera: &'a Pinhole,
    problem: &'a Problem<'a>,
    options: &'a BundleOptions,
    depth_lm: f64,
    source: usize,
    places: std::ops::Range<usize>,
    workspace: &'a mut Workspace,
}

impl Kernel for SourceKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Workspace {
            cells,
            padded,
            rays,
            order,
            depths,
            coupling,
            scaled,
            products,
            reduced,
            sums,
            relatives,
            depth_diagonal,
            depth_rhs,
            cost,
            ..
        } = self.workspace;
        let frame = self.source * *padded..(self.source + 1) * *padded;
        let depths = &depths[frame.clone()];
        let diagonal = &mut depth_diagonal[frame.clone()];
        let rhs = &mut depth_rhs[frame];
        let edges = &order[self.places];
        diagonal.fill(0.0);
        rhs.fill(0.0);
        let mut start = 0;
        while start < *padded {
            let block = start..(start + BLOCK).min(*padded);
            for (slot, &edge) in edges.iter().enumerate() {
                let cells = EdgeCells {
                    edge: &self.problem.edges[edge],
                    relative: Relative::new(&relatives[slot]),
                    camera: self.camera,
                    options: self.options,
                    cells: *cells,
                };
                cells.accumulate(
                    block.clone(),
                    [&rays[0], &rays[1]],
                    depths,
                    &mut coupling[slot * DOF * BLOCK..(slot + 1) * DOF * BLOCK],
                    (&mut *diagonal, &mut *rhs),
                    &mut sums[slot],
                );
            }
            if !self.options.motion_only {
                let first = self.source * *cells;
                for cell in block.start..block.end.min(*cells) {
                    let at = first + cell;
                    let damping = self.problem.depth_damping.map_or(0.0, |d| f64::from(d[at]));
                    let measured = self.problem.measured.map_or(0.0, |m| f64::from(m[at]));
                    let c = &mut diagonal[cell];
                    *c *= 1.0 + self.depth_lm;
                    if measured > 0.0 {
                        let weight = self.options.depth_prior_weight;
                        let difference = depths[cell] - measured;
                        *c += weight;
                        rhs[cell] -= weight * difference;
                        *cost += weight * difference * difference;
                    } else {
                        *c += damping;
                    }
                }
                eliminate_block(
                    edges.len(),
                    block.end - block.start,
                    coupling,
                    scaled,
                    &diagonal[block.clone()],
                    &rhs[block.clone()],
                    products,
                    reduced,
                );
            }
            start = block.end;
        }
    }
}

/// `target_from_source` as plain numbers.
#[derive(Clone, Copy)]
pub(super) struct Relative {
    rotation: [[f64; 3]; 3],
    pub(super) translation: [f64; 3],
}

impl Relative {
    pub(super) fn new(pose: &Se3) -> Self {
        let r = pose.rotation_matrix();
        Self {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)])),
            translation: [0, 1, 2].map(|i| pose.translation[i]),
        }
    }

    /// R (X₀, Y₀, 1) + d t.
    #[inline(always)]
    pub(super) fn point(&self, x: Lanes, y: Lanes, d: Lanes) -> [Lanes; 3] {
        [0, 1, 2].map(|i| {
            let [rx, ry, rz] = self.rotation[i].map(Lanes::splat);
            (rx * x + ry * y) + (rz + Lanes::splat(self.translation[i]) * d)
        })
    }
}

/// The reprojection of four cells of one edge: what residuals and derivatives are made of. All zero
/// where the cell does not count.
pub(super) struct View {
    /// x/z, y/z, d/z.
    pub(super) a: Lanes,
    pub(super) b: Lanes,
    pub(super) h: Lanes,
    /// Weights of column and row, scaled.
    pub(super) weight: [Lanes; 2],
    /// Target − reprojection.
    pub(super) residual: [Lanes; 2],
    /// Derivatives by the inverse depth.
    pub(super) by_depth: [Lanes; 2],
}

/// One edge.
pub(super) struct EdgeCells<'a> {
    pub(super) edge: &'a EdgeObservation<'a>,
    pub(super) relative: Relative,
    pub(super) camera: &'a Pinhole,
    pub(super) options: &'a BundleOptions,
    pub(super) cells: usize,
}

impl EdgeCells<'_> {
    /// Cells `at..at + LANES`.
    #[inline(always)]
    pub(super) fn view(&self, at: usize, x: Lanes, y: Lanes, d: Lanes) -> View {
        let [px, py, pz] = self.relative.point(x, y, d);
        let least = self.options.min_depth;
        let inverse = Lanes::splat(1.0) / pz.or_one_below(least);
        let inverse = inverse.where_at_least(pz, least);
        let (a, b, h) = (px * inverse, py * inverse, d * inverse);
        let scale = Lanes::splat(self.options.weight_scale);
        let Pinhole { fx, fy, cx, cy } = *self.camera;
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(Lanes::splat);
        let [tx, ty, tz] = self.relative.translation.map(Lanes::splat);
        let (at_u, at_v) = self.edge.at.split_at(self.cells);
        let (weight_u, weight_v) = self.edge.weight.split_at(self.cells);
        let weight = |plane| (Lanes::load_f32(plane, at) * scale).where_at_least(pz, least);
        View {
            a,
            b,
            h,
            weight: [weight(weight_u), weight(weight_v)],
            residual: [
                Lanes::load_f32(at_u, at) - (fx * a + cx),
                Lanes::load_f32(at_v, at) - (fy * b + cy),
            ],
            by_depth: [
                fx * ((tx - a * tz) * inverse),
                fy * ((ty - b * tz) * inverse),
            ],
        }
    }

    /// Adds a block's cells: to the edge's sums, to the depths' diagonal and right-hand side; writes
    /// the coupling.
    #[inline(always)]
    fn accumulate(
        &self,
        block: std::ops::Range<usize>,
        rays: [&[f64]; 2],
        depths: &[f64],
        coupling: &mut [f64],
        (diagonal, rhs): (&mut [f64], &mut [f64]),
        sums: &mut [f64; SUMS],
    ) {
        let [fx, fy] = [self.camera.fx, self.camera.fy].map(Lanes::splat);
        let one = Lanes::splat(1.0);
        let mut total = [Lanes::ZERO; SUMS];
        let (e0, rest) = coupling.split_at_mut(BLOCK);
        let (e1, rest) = rest.split_at_mut(BLOCK);
        let (e2, rest) = rest.split_at_mut(BLOCK);
        let (e3, rest) = rest.split_at_mut(BLOCK);
        let (e4, e5) = rest.split_at_mut(BLOCK);
        let mut at = block.start;
        while at < block.end {
            let view = self.view(
                at,
                Lanes::load(rays[0], at),
                Lanes::load(rays[1], at),
                Lanes::load(depths, at),
            );
            let View {
                a,
                b,
                h,
                weight: [wu, wv],
                residual: [ru, rv],
                by_depth: [zu, zv],
            } = view;
            // Derivatives without the focal length: (h, 0, p, q, s, n) and (0, h, g, m, −q, a).
            let zero = Lanes::ZERO;
            let (p, q, s, n) = (zero - a * h, zero - a * b, one + a * a, zero - b);
            let (g, m, q2) = (zero - b * h, zero - (one + b * b), a * b);
            let (fu, fv) = (wu * fx, wv * fy);

            let (cu, cv) = (fu * zu, fv * zv);
            let local = at - block.start;
            (cu * h).store(e0, local);
            (cv * h).store(e1, local);
            (cu * p + cv * g).store(e2, local);
            (cu * q + cv * m).store(e3, local);
            (cu * s + cv * q2).store(e4, local);
            (cu * n + cv * a).store(e5, local);
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
                wu * ru * ru + wv * rv * rv,
            ];
            for (sum, term) in total.iter_mut().zip(terms) {
                *sum = *sum + term;
            }
            at += LANES;
        }
        for (sum, lanes) in sums.iter_mut().zip(total) {
            *sum += lanes.sum();
        }
    }
}

/// Carries one source's sums to the poses' system: block (k, l) of S is only kept for k ≥ l.
fn scatter(
    problem: &Problem<'_>,
    options: &BundleOptions,
    index: usize,
    workspace: &mut Workspace,
) {
    let Workspace {
        order,
        sources,
        products,
        reduced,
        sums,
        adjoints,
        matrix,
        pose_diagonal,
        rhs,
        cost,
        ..
    } = workspace;
    let (source, places) = sources[index].clone();
    let edges = &order[places];
    let degree = edges.len();
    let unknown = |frame: usize| {
        let free = &problem.free;
        free.contains(&frame).then(|| (frame - free.start) * DOF)
    };
    let at_source = unknown(source);
    let mut add = |row: usize, column: usize, block: &Matrix6<f64>| {
        // The transposed block belongs to the upper triangle, which is not kept.
        if row >= column {
            let mut view = matrix.fixed_view_mut::<DOF, DOF>(row, column);
            view += block;
        }
    };
    for (slot_a, &edge_a) in edges.iter().enumerate() {
        let at_target = unknown(problem.edges[edge_a].target);
        let (hessian, mut gradient) = unpack(&sums[slot_a]);
        *cost += sums[slot_a][SUMS - 1];
        let adjoint_a = &adjoints[slot_a];
        if let Some(j) = at_target {
            for k in 0..DOF {
                pose_diagonal[j + k] += hessian[(k, k)];
            }
        }
        if let Some(i) = at_source {
            let carried = adjoint_a.tr_mul(&(hessian * adjoint_a));
            for k in 0..DOF {
                pose_diagonal[i + k] += carried[(k, k)];
            }
        }
        if !options.motion_only {
            for k in 0..DOF {
                gradient[k] -= reduced[slot_a * DOF + k];
            }
        }
        if let Some(j) = at_target {
            let mut view = rhs.fixed_rows_mut::<DOF>(j);
            view += gradient;
        }
        if let Some(i) = at_source {
            let mut view = rhs.fixed_rows_mut::<DOF>(i);
            view -= adjoint_a.tr_mul(&gradient);
        }
        for (slot_b, &edge_b) in edges.iter().enumerate().skip(slot_a) {
            if options.motion_only && slot_b > slot_a {
                break;
            }
            let mut block = if slot_a == slot_b {
                hessian
            } else {
                Matrix6::zeros()
            };
            if !options.motion_only {
                let from = (slot_a * degree + slot_b) * DOF * DOF;
                block -= Matrix6::from_row_slice(&products[from..from + DOF * DOF]);
            }
            let at_target_b = unknown(problem.edges[edge_b].target);
            let by_source_b = -(block * adjoints[slot_b]);
            let by_source_a = -adjoint_a.tr_mul(&block);
            let by_both = -adjoint_a.tr_mul(&by_source_b);
            let is_pair = slot_a != slot_b;
            // vₐᵀ M v_b, and its transpose for a pair of different edges.
            let mut add_term = |row: Option<usize>, column: Option<usize>, block: &Matrix6<f64>| {
                if let (Some(row), Some(column)) = (row, column) {
                    add(row, column, block);
                    if is_pair {
                        add(column, row, &block.transpose());
                    }
                }
            };
            add_term(at_target, at_target_b, &block);
            add_term(at_target, at_source, &by_source_b);
            add_term(at_source, at_target_b, &by_source_a);
            add_term(at_source, at_source, &by_both);
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
