//! What the map leaves unexplained on each edge.

use super::{CELL_PX, FlowEdge, FlowGraph, depth_rule};
use crate::scene::clip::{FrameResidual, series_of};
use crate::slam::bundle::Scene;
use crate::slam::camera::project;

/// The residual of one directed edge.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeResidual {
    /// Keyframe whose cells these are.
    pub source: usize,
    /// Keyframe they are found in.
    pub target: usize,
    /// δ: distance of reprojection and target for every cell of the source, `[rows, columns]`, px of a
    /// 256-px-high picture; `None` where the flow leaves the picture or the point is not before the
    /// camera.
    pub map_px: Vec<Option<f32>>,
    /// Sum over the cells that have one, px.
    pub sum_px: f64,
    /// How many those are.
    pub cells: usize,
}

impl EdgeResidual {
    /// S: the mean over its cells, px; `None` without any.
    #[must_use]
    pub fn mean_px(&self) -> Option<f64> {
        (self.cells > 0).then(|| self.sum_px / self.cells as f64)
    }
}

/// e_t: the mean residual of the edges whose later keyframe is t, by input frame. `residuals` are those of
/// the graph's edges.
#[must_use]
pub fn series(graph: &FlowGraph, residuals: &[EdgeResidual]) -> Vec<FrameResidual> {
    let mut sums: Vec<(usize, f64, usize)> = residuals
        .iter()
        .map(|r| (graph.frames[r.source.max(r.target)], r.sum_px, r.cells))
        .collect();
    series_of(&mut sums)
}

/// Residual of one edge at the scene as it is.
pub(super) fn residual(scene: &Scene, edge: &FlowEdge) -> EdgeResidual {
    let (grid, cells) = (scene.grid, scene.grid.cells());
    let relative = scene.poses[edge.target].relative_to(&scene.poses[edge.source]);
    let rule = depth_rule();
    let mut residual = EdgeResidual {
        source: edge.source,
        target: edge.target,
        map_px: vec![None; cells],
        sum_px: 0.0,
        cells: 0,
    };
    for (cell, &d) in scene.inverse_depths_of(edge.source).iter().enumerate() {
        if edge.answer.weight[cell] <= 0.0 {
            continue;
        }
        let from = [(cell % grid.columns) as f64, (cell / grid.columns) as f64];
        let (to, point) = project(&scene.camera, &relative, from, d, rule);
        if point.z <= rule.valid_above {
            continue;
        }
        let du = to.x - f64::from(edge.answer.at[cell]);
        let dv = to.y - f64::from(edge.answer.at[cells + cell]);
        let distance_px = CELL_PX * libm::sqrt(du * du + dv * dv);
        residual.map_px[cell] = Some(distance_px as f32);
        residual.sum_px += distance_px;
        residual.cells += 1;
    }
    residual
}

/// An edge's weights where residuals beyond `huber_px` count linearly: w min(1, k/|r|).
pub(super) fn robust_weights(scene: &Scene, edge: &FlowEdge, huber_px: f64) -> Vec<f32> {
    let mut weight = edge.answer.weight.clone();
    let cells = scene.grid.cells();
    for (cell, distance_px) in residual(scene, edge).map_px.iter().enumerate() {
        let distance_px = f64::from(distance_px.unwrap_or(0.0));
        if distance_px > huber_px {
            let factor = (huber_px / distance_px) as f32;
            weight[cell] *= factor;
            weight[cells + cell] *= factor;
        }
    }
    weight
}
