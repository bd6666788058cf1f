//! The seam between edges and a clip's geometry, and its two-view implementation.
//!
//! A [`RigidSolver`] takes edges one by one and hands back a [`ClipGeometry`]. [`TwoViewSolver`]
//! fits the models of each edge by themselves and shares no depth between edges.
//!
//! **Early exit, exact.** A model's GRIC is at least its penalty terms. If another model's GRIC is
//! not above that bound, the model cannot win and is not fitted. Per edge that decides the edge's
//! verdict. For the clip the sums hold a bound where a model was skipped; while the least sum is
//! not exact, the models it lacks are fitted. The verdict is thus the one of fitting everything.

use serde::{Deserialize, Serialize};

use super::SceneError;
use super::clip::{ClipGeometry, EdgeGeometry, Work};
use super::correspondence::CorrespondenceField;
use super::evidence::{Method, ModelEvidence, MotionModel, PerModel};
use super::gric::GricParams;
use super::ransac::RansacParams;
use super::two_view::TwoView;

/// A seven-point sample and one to judge it by.
const LEAST_CELLS: usize = 8;

/// One frame pair's correspondences.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeInput {
    /// Source frame.
    pub from_frame: usize,
    /// Target frame.
    pub to_frame: usize,
    /// Where the source's grid cells are in the target.
    pub field: CorrespondenceField,
}

/// Finds what the best rigid camera and scene leave unexplained in a clip.
pub trait RigidSolver {
    /// Adds one frame pair.
    ///
    /// # Errors
    /// [`SceneError::TooFewCells`] leaves the edge out, and the clip can go on; every other error
    /// is a malformed edge, which is left out too.
    fn edge(&mut self, edge: EdgeInput) -> Result<(), SceneError>;

    /// The clip's geometry.
    ///
    /// # Errors
    /// [`SceneError::NoEdges`].
    fn finish(self) -> Result<ClipGeometry, SceneError>;
}

/// Parameters of [`TwoViewSolver`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TwoViewParams {
    /// The criterion.
    pub gric: GricParams,
    /// The robust estimation.
    pub ransac: RansacParams,
    /// Fewest valid cells of an edge that is judged; at least 8.
    pub min_cells: usize,
    /// Seed of the random samples.
    pub seed: u64,
    /// Fit every model on every edge, needed or not. The verdicts are the same.
    pub fit_all: bool,
}

impl Default for TwoViewParams {
    fn default() -> Self {
        Self {
            gric: GricParams::default(),
            ransac: RansacParams::default(),
            min_cells: 60,
            seed: 0x706c_756d_626c_696e,
            fit_all: false,
        }
    }
}

/// Two-view models per edge, chosen by GRIC.
#[derive(Debug, Clone)]
pub struct TwoViewSolver {
    params: TwoViewParams,
    edges: Vec<EdgeGeometry>,
    edges_rejected: usize,
}

impl TwoViewSolver {
    /// A solver without edges.
    ///
    /// # Errors
    /// [`SceneError::Parameter`].
    pub fn new(params: TwoViewParams) -> Result<Self, SceneError> {
        params.gric.validate()?;
        params.ransac.validate()?;
        if params.min_cells < LEAST_CELLS {
            return Err(SceneError::Parameter { name: "min_cells" });
        }
        Ok(Self {
            params,
            edges: Vec::new(),
            edges_rejected: 0,
        })
    }

    /// The edges so far, in the order given.
    #[must_use]
    pub fn edges(&self) -> &[EdgeGeometry] {
        &self.edges
    }

    /// Adds an edge that another solver of these parameters has judged.
    pub fn adopt(&mut self, edge: EdgeGeometry) {
        self.edges.push(edge);
    }

    /// The model of least GRIC over all edges so far, exact: fits what only that needs. The cheapest
    /// without edges.
    pub fn verdict(&mut self) -> MotionModel {
        // Each pass completes one model, so that there are at most three.
        for _ in MotionModel::ALL {
            let least = self.sums().least();
            if self.is_exact(least) {
                break;
            }
            self.complete(least);
        }
        self.sums().least()
    }

    /// The clip's geometry under `model`, whatever the criterion says.
    ///
    /// # Errors
    /// [`SceneError::NoEdges`], also where `model` cannot be fitted to every edge.
    pub fn finish_under(mut self, model: MotionModel) -> Result<ClipGeometry, SceneError> {
        self.complete(model);
        let (gric, work) = (self.sums(), self.work());
        ClipGeometry::summarise(Method::TwoViewGric, model, gric, self.edges, work)
            .ok_or(SceneError::NoEdges)
    }

    /// The clip's sums: bounds where a model was skipped.
    fn sums(&self) -> PerModel<f64> {
        PerModel::from_fn(|model| {
            let gric = |e: &EdgeGeometry| bound(&self.params.gric, e.weight, &e.evidence, model);
            self.edges.iter().map(gric).sum()
        })
    }

    /// Fits `model` on the edges that lack it.
    fn complete(&mut self, model: MotionModel) {
        for edge in &mut self.edges {
            if matches!(edge.evidence.get(model), ModelEvidence::Skipped { .. }) {
                let mut view = TwoView::new(
                    &edge.correspondences,
                    edge.from_frame,
                    edge.to_frame,
                    &self.params,
                );
                *edge.evidence.get_mut(model) = view.fit(model);
            }
        }
    }

    fn is_exact(&self, model: MotionModel) -> bool {
        !self
            .edges
            .iter()
            .any(|e| matches!(e.evidence.get(model), ModelEvidence::Skipped { .. }))
    }

    fn work(&self) -> Work {
        let count = |model| {
            let skipped =
                |e: &&EdgeGeometry| matches!(e.evidence.get(model), ModelEvidence::Skipped { .. });
            self.edges.iter().filter(skipped).count()
        };
        let (homographies_skipped, fundamentals_skipped) =
            (count(MotionModel::Homography), count(MotionModel::Rigid));
        Work {
            edges: self.edges.len(),
            edges_rejected: self.edges_rejected,
            homographies_fitted: self.edges.len() - homographies_skipped,
            homographies_skipped,
            fundamentals_fitted: self.edges.len() - fundamentals_skipped,
            fundamentals_skipped,
        }
    }
}

/// A lower bound of what `model` enters into the comparison with, margin included.
fn bound(gric: &GricParams, n: f64, evidence: &PerModel<ModelEvidence>, model: MotionModel) -> f64 {
    evidence.get(model).gric_at_least() + gric.margin(model, n)
}

impl RigidSolver for TwoViewSolver {
    fn edge(&mut self, edge: EdgeInput) -> Result<(), SceneError> {
        let EdgeInput {
            from_frame,
            to_frame,
            field,
        } = edge;
        if from_frame == to_frame {
            return Err(SceneError::SelfEdge { frame: from_frame });
        }
        field.validate()?;
        let have = field.cells.len();
        if have < self.params.min_cells {
            self.edges_rejected += 1;
            return Err(SceneError::TooFewCells {
                have,
                need: self.params.min_cells,
            });
        }
        let gric = &self.params.gric;
        let weight: f64 = field.correspondences.iter().map(|c| c.weight).sum();
        let mut view = TwoView::new(&field.correspondences, from_frame, to_frame, &self.params);
        let mut evidence = PerModel::from_fn(|model| ModelEvidence::Skipped {
            gric_at_least: gric.penalty(model, weight),
        });
        // Cheapest first: each model is fitted only if its penalty leaves it a chance.
        let mut least = f64::INFINITY;
        for model in MotionModel::ALL {
            if self.params.fit_all || bound(gric, weight, &evidence, model) < least {
                *evidence.get_mut(model) = view.fit(model);
                least = least.min(bound(gric, weight, &evidence, model));
            }
        }
        let model = PerModel::from_fn(|model| bound(gric, weight, &evidence, model)).least();
        let (residual_px, inlier_fraction) = match evidence.get(model).fit() {
            Some(fit) => (fit.residual_px, fit.inlier_fraction),
            // The least bound is exact by construction: a skipped model's is not below `least`.
            None => return Err(SceneError::NoEdges),
        };
        self.edges.push(EdgeGeometry {
            from_frame,
            to_frame,
            columns: field.columns,
            rows: field.rows,
            cells: field.cells,
            correspondences: field.correspondences,
            weight,
            model,
            residual_px,
            inlier_fraction,
            evidence,
        });
        Ok(())
    }

    fn finish(mut self) -> Result<ClipGeometry, SceneError> {
        let verdict = self.verdict();
        self.finish_under(verdict)
    }
}
