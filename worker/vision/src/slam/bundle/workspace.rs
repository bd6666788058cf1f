//! The buffers of an adjustment, kept between steps and calls.

use std::num::NonZeroUsize;
use std::ops::Range;

use super::envelope::Envelope;
use super::linearise::SourcePart;
use super::{Problem, Scene};
use crate::slam::lanes::LANES;
use crate::slam::se3::Se3;

/// Cells per block: the coupling of one pair of edges (12 doubles a cell) stays in the first-level
/// cache, that of some twenty edges in the second.
pub(super) const BLOCK: usize = 256;

/// Tangent unknowns of a pose.
pub(super) const DOF: usize = 6;

/// A thread is started for at least so many cells of edges: they take some 0.5 ms, starting it 0.05.
pub(super) const CELLS_PER_THREAD: usize = 1 << 15;

/// Buffers of [`adjust`](super::adjust), and what the last step was.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    /// Threads besides the caller's.
    further_threads: usize,
    pub(super) cells: usize,
    /// `cells`, rounded up to whole lanes.
    pub(super) padded: usize,
    /// X₀ and Y₀ of every cell, `[padded]`.
    pub(super) rays: [Vec<f64>; 2],
    /// Positions of the edges, grouped by source.
    pub(super) order: Vec<usize>,
    /// In increasing order of frames.
    pub(super) sources: Vec<Source>,
    /// What each source adds to the system.
    pub(super) parts: Vec<SourcePart>,
    /// One for each thread that is worth starting.
    pub(super) scratch: Vec<Scratch>,
    /// Inverse depths, `[frames, padded]`.
    pub(super) depths: Vec<f64>,
    /// C and w, `[frames, padded]`.
    pub(super) depth_diagonal: Vec<f64>,
    pub(super) depth_rhs: Vec<f64>,
    /// First pose that each pose is coupled with through depths.
    first_coupled: Vec<usize>,
    /// S, over the free poses.
    pub(super) matrix: Envelope,
    /// Damped, then factored.
    pub(super) factor: Envelope,
    /// diag(A), for damping before the elimination.
    pub(super) pose_diagonal: Vec<f64>,
    pub(super) rhs: Vec<f64>,
    pub(super) pose_step: Vec<f64>,
    /// dz, `[frames, padded]`.
    pub(super) depth_step: Vec<f64>,
    pub(super) candidate_poses: Vec<Se3>,
    /// `[frames, padded]`.
    pub(super) candidate_depths: Vec<f64>,
    pub(super) cost: f64,
}

/// A frame whose cells are sought, and where its edges stand in [`Workspace::order`].
#[derive(Debug, Clone)]
pub(super) struct Source {
    pub(super) frame: usize,
    pub(super) edges: Range<usize>,
}

/// What one thread needs for one source.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    /// E by the target, `[edges, 6, BLOCK]`.
    pub(super) coupling: Vec<f64>,
    /// One edge's, times C⁻¹, `[6, BLOCK]`.
    pub(super) scaled: Vec<f64>,
    /// C⁻¹, `[BLOCK]`.
    pub(super) inverse: Vec<f64>,
}

impl Workspace {
    /// A workspace whose adjustments run on up to so many threads. The results are the same to the
    /// last bit, whatever the number; starting threads allocates. The default is one thread.
    #[must_use]
    pub fn with_threads(threads: NonZeroUsize) -> Self {
        Self {
            further_threads: threads.get() - 1,
            ..Self::default()
        }
    }

    /// The last step's tangents, `[6 P]` over the free poses.
    #[must_use]
    pub fn pose_step(&self) -> &[f64] {
        &self.pose_step
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
        self.group_edges(problem);
        self.size_scratch(problem);
        for buffer in [
            &mut self.depth_diagonal,
            &mut self.depth_rhs,
            &mut self.depth_step,
            &mut self.depths,
        ] {
            buffer.clear();
            buffer.resize(frames * self.padded, 0.0);
        }
        self.load_depths(scene);
        self.candidate_poses.clone_from(&scene.poses);
        self.shape_system(problem);
    }

    fn group_edges(&mut self, problem: &Problem<'_>) {
        self.order.clear();
        self.order.extend(0..problem.edges.len());
        // Unstable sorts do not allocate; the position makes the order unique.
        self.order
            .sort_unstable_by_key(|&e| (problem.edges[e].source, e));
        self.sources.clear();
        for (place, &edge) in self.order.iter().enumerate() {
            let frame = problem.edges[edge].source;
            match self.sources.last_mut() {
                Some(last) if last.frame == frame => last.edges.end = place + 1,
                _ => self.sources.push(Source {
                    frame,
                    edges: place..place + 1,
                }),
            }
        }
    }

    fn size_scratch(&mut self, problem: &Problem<'_>) {
        let degree = self.sources.iter().map(|s| s.edges.len()).max();
        let edge_cells = problem.edges.len() * self.cells;
        let threads = 1 + self.further_threads.min(edge_cells / CELLS_PER_THREAD);
        self.scratch.resize_with(threads, Scratch::default);
        for scratch in &mut self.scratch {
            scratch
                .coupling
                .resize(degree.unwrap_or(0) * DOF * BLOCK, 0.0);
            scratch.scaled.resize(DOF * BLOCK, 0.0);
            scratch.inverse.resize(BLOCK, 0.0);
        }
        // Never fewer than before: their buffers are kept.
        let parts = self.parts.len().max(self.sources.len());
        self.parts.resize_with(parts, SourcePart::default);
        for (part, source) in self.parts.iter_mut().zip(&self.sources) {
            part.resize(source.edges.len());
        }
    }

    /// The poses of a source and of its targets are all coupled through its depths.
    fn shape_system(&mut self, problem: &Problem<'_>) {
        let poses = problem.free.len();
        for buffer in [&mut self.pose_diagonal, &mut self.rhs, &mut self.pose_step] {
            buffer.clear();
            buffer.resize(poses * DOF, 0.0);
        }
        let first = &mut self.first_coupled;
        first.clear();
        first.extend(0..poses);
        for source in &self.sources {
            let edges = &self.order[source.edges.clone()];
            let targets = edges.iter().map(|&e| problem.edges[e].target);
            let coupled = || {
                let frames = targets.clone().chain([source.frame]);
                frames.filter_map(|f| problem.unknown(f))
            };
            if let Some(least) = coupled().min() {
                coupled().for_each(|pose| first[pose] = first[pose].min(least));
            }
        }
        self.matrix.shape(first);
    }

    /// Takes the scene's inverse depths over into the padded buffers.
    pub(super) fn load_depths(&mut self, scene: &Scene) {
        let rows = self.depths.chunks_exact_mut(self.padded);
        for (to, from) in rows.zip(scene.inverse_depths.chunks_exact(self.cells)) {
            to[..self.cells].copy_from_slice(from);
        }
        self.candidate_depths.clone_from(&self.depths);
    }
}

/// Joins each source to its item among those of all frames.
pub(super) fn of_sources<T>(
    sources: &[Source],
    mut frames: impl Iterator<Item = T>,
) -> impl Iterator<Item = (&Source, T)> {
    let mut next = 0;
    sources.iter().map_while(move |source| {
        let item = frames.nth(source.frame - next)?;
        next = source.frame + 1;
        Some((source, item))
    })
}
