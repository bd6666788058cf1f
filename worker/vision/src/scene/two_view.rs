//! The three models on one edge: each fitted on demand, with its GRIC and residuals.
//!
//! A fit depends only on the edge, the parameters and the seed, not on when it is asked for.

use nalgebra::Matrix3;
use rand_pcg::Pcg32;

use super::correspondence::Correspondence;
use super::evidence::{ModelEvidence, ModelFit, MotionEstimate, MotionModel};
use super::points::{PointSet, distance};
use super::ransac::Scored;
use super::solver::TwoViewParams;
use super::{FitError, fundamental, homography};

/// One edge's points, ready for fitting.
pub(super) struct TwoView<'a> {
    correspondences: &'a [Correspondence],
    params: &'a TwoViewParams,
    points: PointSet,
    /// One random stream per edge, so that edges do not depend on each other.
    stream: u64,
    /// The homography's fit is the start of the rigid model's.
    homography: Option<Result<(Scored, bool), FitError>>,
}

impl<'a> TwoView<'a> {
    pub(super) fn new(
        correspondences: &'a [Correspondence],
        from_frame: usize,
        to_frame: usize,
        params: &'a TwoViewParams,
    ) -> Self {
        let stream = ((from_frame as u64) << 32) ^ to_frame as u64;
        let points = PointSet::new(correspondences, &mut Pcg32::new(params.seed, stream));
        Self {
            correspondences,
            params,
            points,
            stream,
            homography: None,
        }
    }

    /// Fits one model.
    pub(super) fn fit(&mut self, model: MotionModel) -> ModelEvidence {
        let fit = match model {
            MotionModel::Static => Ok(self.static_camera()),
            MotionModel::Homography => self.homography(),
            MotionModel::Rigid => self.rigid(),
        };
        fit.map_or_else(ModelEvidence::Unfit, ModelEvidence::Fitted)
    }

    fn static_camera(&self) -> ModelFit {
        let loss = self.params.gric.loss(MotionModel::Static);
        let squared = |c: &Correspondence| {
            let (dx, dy) = (c.to_px[0] - c.from_px[0], c.to_px[1] - c.from_px[1]);
            dx * dx + dy * dy
        };
        let costs = || {
            self.correspondences
                .iter()
                .map(|c| (c.weight, loss.of(squared(c))))
        };
        let cost = costs().map(|(weight, cost)| weight * cost).sum();
        let inliers: f64 = costs()
            .filter(|(_, cost)| *cost < loss.cap)
            .map(|(weight, _)| weight)
            .sum();
        let residuals = self
            .correspondences
            .iter()
            .map(|c| distance(c.from_px, c.to_px))
            .collect();
        let inlier_fraction = inliers / self.points.total_weight;
        self.finished(
            MotionModel::Static,
            cost,
            inlier_fraction,
            false,
            MotionEstimate::Static,
            residuals,
        )
    }

    fn homography(&mut self) -> Result<ModelFit, FitError> {
        let (scored, inherited) = self.normalised_homography()?;
        let h = rows(&homography::to_px(&self.points, &scored.model).ok_or(FitError::Degenerate)?);
        let residuals = self.residuals(|c| homography::transfer_residual_px(&h, c))?;
        let estimate = MotionEstimate::Homography(h);
        Ok(self.finished(
            MotionModel::Homography,
            scored.cost,
            scored.inlier_fraction,
            inherited,
            estimate,
            residuals,
        ))
    }

    fn rigid(&mut self) -> Result<ModelFit, FitError> {
        let (plane, _) = self.normalised_homography()?;
        let gric = &self.params.gric;
        let off_plane = homography::outliers(
            &self.points,
            &plane.model,
            gric.loss(MotionModel::Homography),
        );
        let (scored, inherited) = fundamental::fit(
            &self.points,
            &plane.model,
            &off_plane,
            gric.loss(MotionModel::Rigid),
            &self.params.ransac,
            &mut self.rng(MotionModel::Rigid),
        )?;
        let f = rows(&fundamental::to_px(&self.points, &scored.model).ok_or(FitError::Degenerate)?);
        let residuals = self.residuals(|c| fundamental::epipolar_residual_px(&f, c))?;
        let estimate = MotionEstimate::Fundamental(f);
        Ok(self.finished(
            MotionModel::Rigid,
            scored.cost,
            scored.inlier_fraction,
            inherited,
            estimate,
            residuals,
        ))
    }

    fn normalised_homography(&mut self) -> Result<(Scored, bool), FitError> {
        let fitted = self.homography.take().unwrap_or_else(|| {
            let loss = self.params.gric.loss(MotionModel::Homography);
            homography::fit(
                &self.points,
                loss,
                &self.params.ransac,
                &mut self.rng(MotionModel::Homography),
            )
        });
        self.homography = Some(fitted);
        fitted
    }

    fn rng(&self, model: MotionModel) -> Pcg32 {
        let offset = match model {
            MotionModel::Static => 0,
            MotionModel::Homography => 1,
            MotionModel::Rigid => 2,
        };
        Pcg32::new(self.params.seed.wrapping_add(offset), self.stream)
    }

    fn residuals(
        &self,
        residual: impl Fn(&Correspondence) -> Option<f64>,
    ) -> Result<Vec<f64>, FitError> {
        self.correspondences
            .iter()
            .map(|c| residual(c).ok_or(FitError::Degenerate))
            .collect()
    }

    fn finished(
        &self,
        model: MotionModel,
        cost: f64,
        inlier_fraction: f64,
        inherited: bool,
        estimate: MotionEstimate,
        residuals: Vec<f64>,
    ) -> ModelFit {
        ModelFit {
            gric: cost + self.params.gric.penalty(model, self.points.total_weight),
            residual_px: residuals.iter().sum::<f64>() / residuals.len() as f64,
            inlier_fraction,
            inherited,
            estimate,
            residuals_px: residuals.iter().map(|&r| r as f32).collect(),
        }
    }
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}
