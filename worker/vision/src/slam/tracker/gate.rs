//! The parallax gate: which depths the flows determine.
//!
//! C = Σ w (∂p/∂d)² is a cell's block of the adjustment's Hessian after all edges of its source, so that
//! d² C = Σ w (∂p/∂ln d)² is its squared parallax, and σ/√(d² C) the standard deviation of ln d under
//! flow errors of σ. A depth is observable where that is at most 1: known to a factor e. Poses are taken
//! as known, so this is the most that could be known.

use super::solve::Solution;
use super::{CELL_PX, FlowGraph, TrackError, TrackParams};
use crate::slam::bundle::{EdgeObservation, Problem, normal_equations};

/// Largest standard deviation of ln d that is an observation.
const MOST_RELATIVE_DEVIATION: f64 = 1.0;

/// What of the depth is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// Standard deviation of ln d, `[keyframes, rows, columns]`; `None` where no flow sees the cell, or
    /// nothing is known.
    pub relative_deviation: Vec<Option<f32>>,
    /// Cells that some flow sees.
    pub seen: usize,
    /// Cells whose depth is observable.
    pub observable: usize,
}

impl Observability {
    /// Share of the seen cells whose depth is observable; 0 without any.
    #[must_use]
    pub fn fraction(&self) -> f64 {
        self.observable as f64 / self.seen.max(1) as f64
    }

    /// Whether a cell's depth is observable, `[keyframes, rows, columns]`.
    #[must_use]
    pub fn mask(&self) -> Vec<bool> {
        let known = |deviation: &Option<f32>| {
            deviation.is_some_and(|deviation| f64::from(deviation) <= MOST_RELATIVE_DEVIATION)
        };
        self.relative_deviation.iter().map(known).collect()
    }
}

impl Solution {
    /// The gate at this map.
    ///
    /// # Errors
    /// [`TrackError::Bundle`].
    pub fn observability(
        &self,
        graph: &FlowGraph,
        params: &TrackParams,
    ) -> Result<Observability, TrackError> {
        let (scene, cells) = (&self.scene, self.scene.grid.cells());
        let edges: Vec<EdgeObservation<'_>> =
            graph.edges.iter().map(|edge| edge.observation()).collect();
        let problem = Problem {
            edges: &edges,
            // Depths only: no pose is free.
            free: 0..0,
            depth_damping: None,
            measured: None,
        };
        let system = normal_equations(scene, &problem, &params.options(0))?;
        let mut seen = vec![false; scene.inverse_depths.len()];
        for edge in &graph.edges {
            let source = &mut seen[edge.source * cells..(edge.source + 1) * cells];
            for (seen, weight) in source.iter_mut().zip(&edge.answer.weight) {
                *seen |= *weight > 0.0;
            }
        }
        let sigma = params.sigma_px / CELL_PX;
        let mut known = Observability {
            relative_deviation: Vec::with_capacity(seen.len()),
            seen: 0,
            observable: 0,
        };
        for ((seen, c), d) in seen
            .iter()
            .zip(&system.depth_diagonal)
            .zip(&scene.inverse_depths)
        {
            let parallax = d * libm::sqrt(*c);
            let deviation = (*seen && parallax > 0.0).then(|| sigma / parallax);
            known.seen += usize::from(*seen);
            known.observable +=
                usize::from(deviation.is_some_and(|d| d <= MOST_RELATIVE_DEVIATION));
            let storable = deviation.map(|d| d as f32).filter(|d| d.is_finite());
            known.relative_deviation.push(storable);
        }
        Ok(known)
    }
}
