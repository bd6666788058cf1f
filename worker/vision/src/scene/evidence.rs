//! What is known of each motion model on one edge, and the names of models, scenes and methods.
//!
//! Residuals are px of a 256-px-high picture, in the target picture. Nothing here fails.

use serde::{Deserialize, Serialize};

use super::FitError;

/// A motion model for a frame pair, from cheap to dear. Each contains the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionModel {
    /// The identity: nothing moves but objects.
    Static,
    /// A homography: a rotating or zooming camera, or any camera before a planar scene.
    Homography,
    /// A rigid scene with a free depth per point, seen by a moving camera: epipolar geometry.
    Rigid,
}

impl MotionModel {
    /// All models, cheapest first.
    pub const ALL: [Self; 3] = [Self::Static, Self::Homography, Self::Rigid];

    /// `d`: dimension of the manifold of exact correspondences.
    #[must_use]
    pub fn dimension(self) -> f64 {
        match self {
            Self::Static | Self::Homography => 2.0,
            Self::Rigid => 3.0,
        }
    }

    /// `k`: number of parameters.
    #[must_use]
    pub fn parameters(self) -> f64 {
        match self {
            Self::Static => 0.0,
            Self::Homography => 8.0,
            Self::Rigid => 7.0,
        }
    }
}

/// What kind of scene a clip shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// The camera stands still.
    StaticCamera,
    /// One homography per frame pair is enough: the camera rotates or zooms, *or* it translates
    /// before a planar or distant scene (the two cannot be told apart from two views).
    Rotation,
    /// The camera translates before a scene with depth.
    Parallax,
}

impl From<MotionModel> for SceneKind {
    fn from(model: MotionModel) -> Self {
        match model {
            MotionModel::Static => Self::StaticCamera,
            MotionModel::Homography => Self::Rotation,
            MotionModel::Rigid => Self::Parallax,
        }
    }
}

/// How a clip's geometry was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Two-view models per edge, chosen by GRIC; no depth is shared between edges.
    TwoViewGric,
    /// Poses and one depth per cell, shared by all edges of a frame, by dense bundle adjustment.
    DenseAdjustment,
}

/// One value per motion model.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PerModel<T> {
    /// Of the static camera.
    pub static_camera: T,
    /// Of the homography.
    pub homography: T,
    /// Of the rigid scene.
    pub rigid: T,
}

impl<T> PerModel<T> {
    /// The value of each model, cheapest first.
    pub fn from_fn(mut f: impl FnMut(MotionModel) -> T) -> Self {
        Self {
            static_camera: f(MotionModel::Static),
            homography: f(MotionModel::Homography),
            rigid: f(MotionModel::Rigid),
        }
    }

    /// The value of `model`.
    pub fn get(&self, model: MotionModel) -> &T {
        match model {
            MotionModel::Static => &self.static_camera,
            MotionModel::Homography => &self.homography,
            MotionModel::Rigid => &self.rigid,
        }
    }

    /// The value of `model`, to change it.
    pub fn get_mut(&mut self, model: MotionModel) -> &mut T {
        match model {
            MotionModel::Static => &mut self.static_camera,
            MotionModel::Homography => &mut self.homography,
            MotionModel::Rigid => &mut self.rigid,
        }
    }
}

impl PerModel<f64> {
    /// The model of least value; the cheaper one in a tie.
    #[must_use]
    pub fn least(&self) -> MotionModel {
        let mut best = MotionModel::Static;
        for model in MotionModel::ALL {
            if self.get(model) < self.get(best) {
                best = model;
            }
        }
        best
    }
}

/// The estimated motion, in pixel coordinates (column vectors `[x, y, 1]`), row-major.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionEstimate {
    /// The identity.
    Static,
    /// `target ~ H source`, Frobenius norm 1, positive third coordinate over the picture.
    Homography([[f64; 3]; 3]),
    /// `targetᵀ F source = 0`, rank 2, Frobenius norm 1.
    Fundamental([[f64; 3]; 3]),
}

/// One model fitted to one edge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelFit {
    /// The criterion, nats, without any margin.
    pub gric: f64,
    /// Mean residual over *all* valid cells, outliers included, not truncated, px.
    pub residual_px: f64,
    /// Fraction of valid cells, by weight, whose error is below the criterion's cap.
    pub inlier_fraction: f64,
    /// True where nothing beat the simpler model's own solution, which this class contains
    /// (identity; homography with an arbitrary epipole): the points determine no more. With noise
    /// something always does, by a little, so false does not mean well determined.
    pub inherited: bool,
    /// The estimate itself.
    pub estimate: MotionEstimate,
    /// Residual of each valid cell, in the order of the edge's cells, px.
    pub residuals_px: Vec<f32>,
}

/// What is known of one model on one edge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelEvidence {
    /// It was fitted.
    Fitted(ModelFit),
    /// It was not fitted: its penalty alone, nats, already exceeds what another model reaches.
    Skipped {
        /// The least its GRIC could be.
        gric_at_least: f64,
    },
    /// It cannot be fitted and is out of the choice.
    Unfit(FitError),
}

impl ModelEvidence {
    /// The fit, if there is one.
    #[must_use]
    pub fn fit(&self) -> Option<&ModelFit> {
        match self {
            Self::Fitted(fit) => Some(fit),
            Self::Skipped { .. } | Self::Unfit(_) => None,
        }
    }

    /// A lower bound of the GRIC, exact where fitted, infinite where unfit.
    #[must_use]
    pub fn gric_at_least(&self) -> f64 {
        match self {
            Self::Fitted(fit) => fit.gric,
            Self::Skipped { gric_at_least } => *gric_at_least,
            Self::Unfit(_) => f64::INFINITY,
        }
    }
}
