//! The buffers of an adjustment, kept between steps and calls.

use nalgebra::{DMatrix, DVector, Matrix6};

use super::{Problem, Scene};
use crate::slam::lanes::LANES;
use crate::slam::se3::Se3;

/// Cells per block: the coupling of some twenty edges (6 doubles a cell) then stays in the
/// second-level cache.
pub(super) const BLOCK: usize = 128;

/// Tangent unknowns of a pose.
pub(super) const DOF: usize = 6;

/// Sums over one edge's cells: upper triangle of the target's Hessian (21), its gradient (6), cost.
pub(super) const SUMS: usize = 28;

/// Buffers of [`adjust`](super::adjust), and what the last step was.
#[derive(Debug, Clone)]
pub struct Workspace {
    pub(super) cells: usize,
    /// `cells`, rounded up to whole lanes.
    pub(super) padded: usize,
    /// X₀ and Y₀ of every cell, `[padded]`.
    pub(super) rays: [Vec<f64>; 2],
    /// Positions of the edges, grouped by source.
    pub(super) order: Vec<usize>,
    /// Source frame and its range of `order`, in increasing order of frames.
    pub(super) sources: Vec<(usize, std::ops::Range<usize>)>,
    /// Inverse depths, `[frames, padded]`.
    pub(super) depths: Vec<f64>,
    /// Of one source's edges: E by the target, `[edges, 6, BLOCK]`; the same times C⁻¹, `[6, BLOCK]`.
    pub(super) coupling: Vec<f64>,
    pub(super) scaled: Vec<f64>,
    /// Of one source's edges: E C⁻¹ Eᵀ, upper triangle of blocks, `[edges, edges, 6, 6]`.
    pub(super) products: Vec<f64>,
    /// Of one source's edges: E C⁻¹ w, `[edges, 6]`.
    pub(super) reduced: Vec<f64>,
    /// Of one source's edges: what is summed over cells.
    pub(super) sums: Vec<[f64; SUMS]>,
    /// Of one source's edges.
    pub(super) relatives: Vec<Se3>,
    pub(super) adjoints: Vec<Matrix6<f64>>,
    /// C and w, `[frames, padded]`.
    pub(super) depth_diagonal: Vec<f64>,
    pub(super) depth_rhs: Vec<f64>,
    /// Lower triangle of S, `[6 P, 6 P]`.
    pub(super) matrix: DMatrix<f64>,
    /// diag(A), for damping before the elimination.
    pub(super) pose_diagonal: DVector<f64>,
    pub(super) rhs: DVector<f64>,
    pub(super) factor: Option<DMatrix<f64>>,
    pub(super) pose_step: DVector<f64>,
    /// dz, `[frames, padded]`.
    pub(super) depth_step: Vec<f64>,
    pub(super) candidate_poses: Vec<Se3>,
    /// `[frames, padded]`.
    pub(super) candidate_depths: Vec<f64>,
    pub(super) cost: f64,
}

impl Default for Workspace {
    fn default() -> Self {
        Self {
            cells: 0,
            padded: 0,
            rays: [Vec::new(), Vec::new()],
            order: Vec::new(),
            sources: Vec::new(),
            depths: Vec::new(),
            coupling: Vec::new(),
            scaled: Vec::new(),
            products: Vec::new(),
            reduced: Vec::new(),
            sums: Vec::new(),
            relatives: Vec::new(),
            adjoints: Vec::new(),
            depth_diagonal: Vec::new(),
            depth_rhs: Vec::new(),
            matrix: DMatrix::zeros(0, 0),
            pose_diagonal: DVector::zeros(0),
            rhs: DVector::zeros(0),
            factor: None,
            pose_step: DVector::zeros(0),
            depth_step: Vec::new(),
            candidate_poses: Vec::new(),
            candidate_depths: Vec::new(),
            cost: 0.0,
        }
    }
}

impl Workspace {
    /// The last step's tangents, `[6 P]` over the free poses.
    #[must_use]
    pub fn pose_step(&self) -> &[f64] {
        self.pose_step.as_slice()
    }

    /// The last step's changes of inverse depth, `[frames, rows, columns]`.
    #[must_use]
    pub fn depth_step(&self) -> Vec<f64> {
        self.unpadded(&self.depth_step)
    }

    pub(super) fn unpadded(&self, values: &[f64]) -> Vec<f64> {
        let frames = values.chunks_exact(self.padded.max(1));
        frames.flat_map(|f| &f[..self.cells]).copied().collect()
    }

    /// Sizes every buffer for this problem.
    pub(super) fn plan(&mut self, scene: &Scene, problem: &Problem<'_>) {
        let (frames, grid) = (scene.poses.len(), scene.grid);
        self.cells = grid.cells();
        self.padded = self.cells.next_multiple_of(LANES);
        for axis in &mut self.rays {
            axis.clear();
        }
        for cell in 0..self.padded {
            let (u, v) = (cell % grid.columns, cell / grid.columns);
            let [x, y] = scene.camera.ray(u as f64, v as f64);
            // The padding looks straight ahead.
            let inside = if cell < self.cells { 1.0 } else { 0.0 };
            self.rays[0].push(inside * x);
            self.rays[1].push(inside * y);
        }
        self.order.clear();
        self.order.extend(0..problem.edges.len());
        // Unstable sorts do not allocate; the position makes the order unique.
        self.order
            .sort_unstable_by_key(|&e| (problem.edges[e].source, e));
        self.sources.clear();
        for (place, &edge) in self.order.iter().enumerate() {
            let source = problem.edges[edge].source;
            match self.sources.last_mut() {
                Some((last, range)) if *last == source => range.end = place + 1,
                _ => self.sources.push((source, place..place + 1)),
            }
        }
        let degree = self.sources.iter().map(|(_, r)| r.len()).max().unwrap_or(0);
        self.coupling.resize(degree * DOF * BLOCK, 0.0);
        self.scaled.resize(DOF * BLOCK, 0.0);
        self.products.resize(degree * degree * DOF * DOF, 0.0);
        self.reduced.resize(degree * DOF, 0.0);
        self.sums.resize(degree, [0.0; SUMS]);
        self.relatives.resize(degree, Se3::IDENTITY);
        self.adjoints.resize(degree, Matrix6::zeros());
        for buffer in [
            &mut self.depth_diagonal,
            &mut self.depth_rhs,
            &mut self.depth_step,
            &mut self.candidate_depths,
            &mut self.depths,
        ] {
            buffer.clear();
            buffer.resize(frames * self.padded, 0.0);
        }
        self.candidate_poses.clear();
        self.candidate_poses.extend_from_slice(&scene.poses);
        let unknowns = DOF * problem.free.len();
        if self.rhs.len() != unknowns {
            self.matrix = DMatrix::zeros(unknowns, unknowns);
            self.factor = None;
            self.pose_diagonal = DVector::zeros(unknowns);
            self.rhs = DVector::zeros(unknowns);
            self.pose_step = DVector::zeros(unknowns);
        }
        self.load_depths(scene);
    }

    /// Takes the scene's inverse depths over into the padded buffer.
    pub(super) fn load_depths(&mut self, scene: &Scene) {
        let rows = self.depths.chunks_exact_mut(self.padded);
        for (to, from) in rows.zip(scene.inverse_depths.chunks_exact(self.cells)) {
            to[..self.cells].copy_from_slice(from);
        }
    }
}
