//! A clip's geometry: what its edges say together.
//!
//! Each model's GRIC is summed over the edges (they are independent data), and the least sum
//! gives the clip's verdict. The clip's residual, its series and its heat maps are all taken under
//! that *one* model, on every edge, so that they are one quantity. px of a 256-px-high picture.

use serde::{Deserialize, Serialize};

use super::correspondence::Correspondence;
use super::evidence::{Method, ModelEvidence, ModelFit, MotionModel, PerModel, SceneKind};

/// What the models leave unexplained on one frame pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeGeometry {
    /// Source frame.
    pub from_frame: usize,
    /// Target frame.
    pub to_frame: usize,
    /// Grid columns.
    pub columns: usize,
    /// Grid rows.
    pub rows: usize,
    /// Row-major index of each valid cell; `n` is their number.
    pub cells: Vec<u32>,
    /// Where each of those cells is in the target, and what it weighs.
    pub correspondences: Vec<Correspondence>,
    /// Sum of the cells' weights.
    pub weight: f64,
    /// The model of least GRIC for this edge alone (the clip may decide otherwise).
    pub model: MotionModel,
    /// Mean residual over all valid cells under `model`, px.
    pub residual_px: f64,
    /// Fraction of valid cells, by weight, that `model` explains.
    pub inlier_fraction: f64,
    /// What is known of each model.
    pub evidence: PerModel<ModelEvidence>,
}

impl EdgeGeometry {
    /// Number of valid cells.
    #[must_use]
    pub fn n(&self) -> usize {
        self.cells.len()
    }

    /// The fit of `model`, if it was fitted.
    #[must_use]
    pub fn fit(&self, model: MotionModel) -> Option<&ModelFit> {
        self.evidence.get(model).fit()
    }

    /// The edge's residuals under `model`; `None` if it was not fitted.
    fn under(&self, model: MotionModel) -> Option<AdjustedEdge> {
        Some(AdjustedEdge {
            from_frame: self.from_frame,
            to_frame: self.to_frame,
            columns: self.columns,
            rows: self.rows,
            sum_px: self.fit(model)?.residual_px * self.n() as f64,
            cells: self.n(),
            map_px: self.residual_map_px(model)?,
        })
    }

    /// Residual of every grid cell under `model`, `[rows, columns]` row-major, `None` where the
    /// cell is not valid; `None` if the model was not fitted. For heat maps.
    #[must_use]
    pub fn residual_map_px(&self, model: MotionModel) -> Option<Vec<Option<f32>>> {
        let fit = self.fit(model)?;
        let mut map = vec![None; self.columns * self.rows];
        for (&cell, &residual) in self.cells.iter().zip(&fit.residuals_px) {
            if let Some(slot) = map.get_mut(cell as usize) {
                *slot = Some(residual);
            }
        }
        Some(map)
    }
}

/// The residual of one frame: all edges whose later frame it is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameResidual {
    /// The later frame of the edges.
    pub frame: usize,
    /// Mean over all valid cells of those edges, px.
    pub residual_px: f64,
    /// Number of those cells.
    pub cells: usize,
}

/// What was fitted, and what was provably not needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Work {
    /// Edges judged.
    pub edges: usize,
    /// Edges with too few valid cells.
    pub edges_rejected: usize,
    /// Homographies estimated.
    pub homographies_fitted: usize,
    /// Homographies not estimated.
    pub homographies_skipped: usize,
    /// Fundamental matrices estimated.
    pub fundamentals_fitted: usize,
    /// Fundamental matrices not estimated.
    pub fundamentals_skipped: usize,
}

/// The geometric verdict of a clip and the residual it leaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClipGeometry {
    /// How it was found.
    pub method: Method,
    /// The verdict.
    pub scene: SceneKind,
    /// The model class behind it.
    pub model: MotionModel,
    /// Sum of each model's GRIC over the edges, margin included, nats: a lower bound for a model
    /// that was skipped on some edge, infinite for one that is unfit on some edge.
    pub gric: PerModel<f64>,
    /// Mean residual over all valid cells of all edges under `model`, px.
    pub residual_px: f64,
    /// Valid cells of all edges.
    pub cells: usize,
    /// e_t by later frame, increasing, under `model`.
    pub series: Vec<FrameResidual>,
    /// The edges, in the order given, under two-view models.
    pub edges: Vec<EdgeGeometry>,
    /// Both directions of every edge after dense adjustment; empty where there was none.
    pub adjusted: Vec<AdjustedEdge>,
    /// The work done and saved.
    pub work: Work,
}

impl ClipGeometry {
    /// Sums up edges under `model`. `None` without edges, or if `model` was not fitted on one.
    #[must_use]
    pub fn summarise(
        method: Method,
        model: MotionModel,
        gric: PerModel<f64>,
        edges: Vec<EdgeGeometry>,
        work: Work,
    ) -> Option<Self> {
        if edges.is_empty() {
            return None;
        }
        // (later frame, sum of residuals, cells), in the order of the edges within a frame.
        let mut sums = edges
            .iter()
            .map(|e| {
                Some((
                    e.from_frame.max(e.to_frame),
                    e.fit(model)?.residual_px * e.n() as f64,
                    e.n(),
                ))
            })
            .collect::<Option<Vec<_>>>()?;
        let series = series_of(&mut sums);
        let cells = sums.iter().map(|s| s.2).sum::<usize>();
        let total: f64 = sums.iter().map(|s| s.1).sum();
        Some(Self {
            method,
            scene: model.into(),
            model,
            gric,
            residual_px: total / cells as f64,
            cells,
            series,
            edges,
            adjusted: Vec::new(),
            work,
        })
    }

    /// The same clip after dense adjustment: mean, series and heat maps are those of `edges`.
    #[must_use]
    pub fn adjusted(mut self, edges: Vec<AdjustedEdge>) -> Self {
        let mut sums: Vec<_> = edges
            .iter()
            .map(|e| (e.from_frame.max(e.to_frame), e.sum_px, e.cells))
            .collect();
        let cells = sums.iter().map(|s| s.2).sum::<usize>();
        if cells == 0 {
            return self;
        }
        self.method = Method::DenseAdjustment;
        self.series = series_of(&mut sums);
        self.cells = cells;
        self.residual_px = sums.iter().map(|s| s.1).sum::<f64>() / cells as f64;
        self.adjusted = edges;
        self
    }

    /// i*: of the edges whose later frame is `frame`, the one of the largest mean residual, with its map;
    /// the first of equals.
    #[must_use]
    pub fn worst_edge(&self, frame: usize) -> Option<AdjustedEdge> {
        if self.method == Method::DenseAdjustment {
            return worst_edge(self.adjusted.iter().cloned(), frame);
        }
        let edges = self.edges.iter().filter_map(|e| e.under(self.model));
        worst_edge(edges, frame)
    }
}

/// What is left on one directed edge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AdjustedEdge {
    /// Frame whose cells these are.
    pub from_frame: usize,
    /// Frame they are found in.
    pub to_frame: usize,
    /// Grid columns.
    pub columns: usize,
    /// Grid rows.
    pub rows: usize,
    /// Sum of the residuals, px.
    pub sum_px: f64,
    /// Cells that have one.
    pub cells: usize,
    /// `[rows, columns]`, on the source frame, px; `None` where a cell has none.
    pub map_px: Vec<Option<f32>>,
}

impl AdjustedEdge {
    /// S: the mean residual, px; `None` without cells.
    #[must_use]
    pub fn mean_px(&self) -> Option<f64> {
        (self.cells > 0).then(|| self.sum_px / self.cells as f64)
    }
}

/// i*: of the edges whose later frame is `frame`, the one of the largest mean residual; the first of equals.
pub fn worst_edge(edges: impl Iterator<Item = AdjustedEdge>, frame: usize) -> Option<AdjustedEdge> {
    edges
        .filter(|edge| edge.from_frame.max(edge.to_frame) == frame && edge.cells > 0)
        .reduce(|worst, edge| match edge.mean_px() > worst.mean_px() {
            true => edge,
            false => worst,
        })
}

/// e_t: the mean residual of the edges whose later frame is t, by frame.
#[must_use]
pub fn series(edges: &[AdjustedEdge]) -> Vec<FrameResidual> {
    let sum = |e: &AdjustedEdge| (e.from_frame.max(e.to_frame), e.sum_px, e.cells);
    series_of(&mut edges.iter().map(sum).collect::<Vec<_>>())
}

/// e_t from edges: (later frame, sum of residuals in px, cells), which are sorted by frame here. The order of edges
/// within a frame is kept, so that sums have one order; a frame without cells has no entry.
pub(crate) fn series_of(sums: &mut [(usize, f64, usize)]) -> Vec<FrameResidual> {
    sums.sort_by_key(|&(frame, _, _)| frame);
    let frames = sums.chunk_by(|a, b| a.0 == b.0).map(|group| {
        let cells = group.iter().map(|g| g.2).sum::<usize>();
        let total: f64 = group.iter().map(|g| g.1).sum();
        FrameResidual {
            frame: group[0].0,
            residual_px: total / cells as f64,
            cells,
        }
    });
    frames.filter(|residual| residual.cells > 0).collect()
}
