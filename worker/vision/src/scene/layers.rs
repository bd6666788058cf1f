//! What no piecewise-rigid motion explains: a camera, and rigid bodies that move before it.
//!
//! On one edge, with correspondences `i` of weight `wᵢ` (from `xᵢ`, to `yᵢ`) and the residuals `cᵢ` that
//! the clip's camera model leaves ([`super::clip`]):
//!
//! - moving cells `M = {i : cᵢ ≥ τ}`, with τ the distance at which the criterion stops to count an error
//!   of that model ([`super::GricParams`]): √8 σ = 1.41 px before a still or turning camera, √2 σ = 0.71 px
//!   off the epipolar line before one that travels;
//! - layers: `U = M`; at most [`LayerParams::max_layers`] times, while U has
//!   [`LayerParams::min_layer_cells`] cells, fit an affine motion `Aₖ` to U (the module `affine`), take the
//!   cells of U within √8 σ of it as its own, and go on with the others; a layer of fewer cells than
//!   `min_layer_cells` is none and ends the search;
//! - residual of a moving cell: `rᵢ = min(cᵢ, minₖ |Aₖ xᵢ − yᵢ|)`: the camera and every layer may explain
//!   it, whoever claimed it. It is not cut off.
//!
//! `layer_residual_px` of an edge is `Σ wᵢ rᵢ / Σ wᵢ` over M, that of a clip the same over the moving cells
//! of all edges between adjacent frames. An edge with fewer than `min_cells` moving cells has none, and a
//! clip with fewer than `min_edges` such edges has none: too little moves to say anything, which is not 0.
//! px of a 256-px-high picture, in the target picture. Weights say how well forward and backward flow
//! agree, so that the rim of a moving body, which is covered or uncovered, counts little.
//!
//! Sequential RANSAC (Torr and Murray, "Outlier detection and motion segmentation", 1993), seeded per edge:
//! a result depends on the edge, the parameters and the seed alone, in f64 with one order of operations.
//!
//! Chosen by measuring on recorded and generated clips: the dense adjustment's grid of 32 rows gives what
//! 64 rows give, for a quarter of the time; a gate of 0.75 px, or homographies for layers, change nothing
//! that the measure is used for. In pixels it grows with motion, as the camera's residual does; P
//! ([`crate::signals::piecewise_residual`]) is the relative measure of consistent cells.

use nalgebra::Matrix3;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::clip::{ClipGeometry, EdgeGeometry};
use super::correspondence::Correspondence;
use super::evidence::MotionModel;
use super::gric::{GricParams, Loss};
use super::homography::{to_px, transfer_residual_px};
use super::points::PointSet;
use super::ransac::RansacParams;
use super::{SceneError, affine};

#[cfg(test)]
mod tests;

/// How layers are sought.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LayerParams {
    /// Fewest moving cells of an edge that is judged.
    pub min_cells: usize,
    /// Fewest cells of a layer: any three would have an affine motion of their own.
    pub min_layer_cells: usize,
    /// Most layers of an edge.
    pub max_layers: usize,
    /// Fewest judged edges of a clip that has a value.
    pub min_edges: usize,
    /// The robust estimation.
    pub ransac: RansacParams,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for LayerParams {
    fn default() -> Self {
        Self {
            min_cells: 16,
            min_layer_cells: 8,
            max_layers: 4,
            min_edges: 3,
            // 60 draws find an all-inlier three with 99% up to 58% outliers.
            ransac: RansacParams {
                max_samples: 60,
                confidence: 0.99,
                local_steps: 2,
                final_steps: 6,
                ..RansacParams::default()
            },
            seed: 0x6c61_7965_7273,
        }
    }
}

impl LayerParams {
    /// # Errors
    /// [`SceneError::Parameter`].
    pub fn validate(&self) -> Result<(), SceneError> {
        self.ransac.validate()?;
        for (name, cells) in [
            ("min_cells", self.min_cells),
            ("min_layer_cells", self.min_layer_cells),
        ] {
            if cells <= SAMPLE_POINTS {
                return Err(SceneError::Parameter { name });
            }
        }
        if self.min_edges == 0 {
            return Err(SceneError::Parameter { name: "min_edges" });
        }
        Ok(())
    }
}

/// Points that fix an affine motion.
const SAMPLE_POINTS: usize = 3;

/// What rigid layers leave of a clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClipLayers {
    /// Weighted mean over the moving cells of all judged edges, px; `None` with too few such edges.
    pub residual_px: Option<f64>,
    /// Later frame and weighted mean of each judged edge, px, in the order of the edges.
    pub series: Vec<(usize, f64)>,
}

/// Splits what the clip's camera leaves on the edges between adjacent frames into rigid layers.
///
/// # Errors
/// [`SceneError::Parameter`]; [`SceneError::Cells`] or [`SceneError::Coordinate`] where an edge's residuals
/// do not match its cells or are not finite.
pub fn clip_layers(
    geometry: &ClipGeometry,
    gric: &GricParams,
    params: &LayerParams,
) -> Result<ClipLayers, SceneError> {
    gric.validate()?;
    params.validate()?;
    let model = geometry.model;
    let gates = Gates {
        moving_px: gric.cap_px(model),
        layer_px: gric.cap_px(MotionModel::Homography),
    };
    let (mut weight, mut residual_px, mut series) = (0.0, 0.0, Vec::new());
    for edge in geometry.edges.iter().filter(|edge| is_adjacent(edge)) {
        let Some(fit) = edge.fit(model) else {
            continue;
        };
        let points = &edge.correspondences;
        let (from, to) = (edge.from_frame as u64, edge.to_frame as u64);
        let stream = (from << 32) ^ to;
        if let Some(found) = edge_layers(points, &fit.residuals_px, gates, stream, params)? {
            weight += found.weight;
            residual_px += found.weighted_residual_px;
            let later = edge.from_frame.max(edge.to_frame);
            series.push((later, found.weighted_residual_px / found.weight));
        }
    }
    let enough = series.len() >= params.min_edges;
    Ok(ClipLayers {
        residual_px: enough.then(|| residual_px / weight),
        series,
    })
}

fn is_adjacent(edge: &EdgeGeometry) -> bool {
    edge.from_frame.abs_diff(edge.to_frame) == 1
}

/// Distances that decide what moves and what belongs together.
#[derive(Debug, Clone, Copy)]
struct Gates {
    /// A cell moves from this camera residual on, px.
    moving_px: f64,
    /// A cell belongs to a layer below this distance, px.
    layer_px: f64,
}

/// The layers of one edge.
#[derive(Debug, Clone, PartialEq)]
struct EdgeLayers {
    /// Affine motions in pixel coordinates, last row `[0, 0, 1]`, in the order in which they were found.
    layers: Vec<[[f64; 3]; 3]>,
    /// Σ wᵢ over the moving cells.
    weight: f64,
    /// Σ wᵢ rᵢ over them, px.
    weighted_residual_px: f64,
}

/// Layers of one edge, whose camera residuals are px, one per correspondence. `None` with too few moving
/// cells.
fn edge_layers(
    correspondences: &[Correspondence],
    camera_residuals_px: &[f32],
    gates: Gates,
    stream: u64,
    params: &LayerParams,
) -> Result<Option<EdgeLayers>, SceneError> {
    if correspondences.len() != camera_residuals_px.len() {
        return Err(SceneError::Cells);
    }
    if let Some(index) = camera_residuals_px.iter().position(|r| !r.is_finite()) {
        return Err(SceneError::Coordinate { index });
    }
    let (moving, mut residuals_px): (Vec<Correspondence>, Vec<f64>) = correspondences
        .iter()
        .zip(camera_residuals_px)
        .map(|(c, &residual)| (*c, f64::from(residual)))
        .filter(|&(_, residual)| residual >= gates.moving_px)
        .unzip();
    if moving.len() < params.min_cells {
        return Ok(None);
    }
    let mut rng = Pcg32::new(params.seed, stream);
    let mut layers = Vec::new();
    let mut unclaimed = moving.clone();
    while layers.len() < params.max_layers && unclaimed.len() >= params.min_layer_cells {
        let Some(layer) = largest_layer(&unclaimed, gates, params, &mut rng) else {
            break;
        };
        let before = unclaimed.len();
        unclaimed.retain(|c| {
            let residual = transfer_residual_px(&layer, c);
            !residual.is_some_and(|residual| residual < gates.layer_px)
        });
        if before - unclaimed.len() < params.min_layer_cells {
            break;
        }
        for (least, c) in residuals_px.iter_mut().zip(&moving) {
            *least = transfer_residual_px(&layer, c).map_or(*least, |r| r.min(*least));
        }
        layers.push(layer);
    }
    let weighted = moving.iter().zip(&residuals_px);
    Ok(Some(EdgeLayers {
        layers,
        weight: moving.iter().map(|c| c.weight).sum(),
        weighted_residual_px: weighted.map(|(c, residual)| c.weight * residual).sum(),
    }))
}

/// The affine motion that most points share, in pixel coordinates.
fn largest_layer(
    points: &[Correspondence],
    gates: Gates,
    params: &LayerParams,
    rng: &mut Pcg32,
) -> Option<[[f64; 3]; 3]> {
    let points = PointSet::new(points, rng);
    let loss = Loss {
        per_square: 1.0 / (gates.layer_px * gates.layer_px),
        cap: 1.0,
    };
    let model = affine::fit(&points, loss, &params.ransac, rng).ok()?.model;
    let px: Matrix3<f64> = to_px(&points, &model)?;
    // Of unit norm there; an affine motion ends on 1.
    let last = px[(2, 2)];
    let layer = std::array::from_fn(|r| std::array::from_fn(|c| px[(r, c)] / last));
    let finite = layer.iter().flatten().all(|value: &f64| value.is_finite());
    finite.then_some(layer)
}
