//! GRIC: the geometric robust information criterion that chooses between motion models.
//!
//! P. Torr, "Geometric motion segmentation and model selection", Phil. Trans. R. Soc. A 356,
//! 1998: `GRIC = Σ ρ(eᵢ²) + λ1 d n + λ2 k`, `ρ(e²) = min(e²/σ², λ3 (r - d))`, with `r` = 4 the
//! dimension of a correspondence, `d` that of the model's manifold, `k` its parameters,
//! λ1 = ln r, λ2 = ln(r n), λ3 = 2. Unit: nats; lower is better.
//!
//! | model | e² | d | k |
//! |---|---|---|---|
//! | static | squared displacement / 2 | 2 | 0 |
//! | homography | squared one-sided transfer error / 2 | 2 | 8 |
//! | rigid | squared Sampson error | 3 | 7 |
//!
//! The halving makes e² the squared distance to the manifold in the joint image (both pictures
//! share the error), which Sampson's is already; the same choice as the prototype's `rigid`.
//! `n` is the sum of the weights (at least 1 inside the logarithm). Does not fail.

use serde::{Deserialize, Serialize};

use super::SceneError;
use super::evidence::MotionModel;

/// `r`: a correspondence has four coordinates.
const CORRESPONDENCE_DIMENSION: f64 = 4.0;

/// The criterion's scale and the margin asked of the rigid model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GricParams {
    /// Standard deviation of a flow coordinate, px of a 256-px-high picture.
    pub sigma_px: f64,
    /// λ3: where a squared error stops to count, per missing dimension.
    pub lambda3: f64,
    /// Nats per cell by which the rigid model must beat the others. A fundamental matrix also
    /// fits a static camera with one translating object (any epipole on the object's path), so a
    /// near tie is no evidence of parallax.
    pub rigid_margin_per_cell: f64,
}

impl Default for GricParams {
    fn default() -> Self {
        Self {
            sigma_px: 0.5,
            lambda3: 2.0,
            rigid_margin_per_cell: 0.1,
        }
    }
}

/// How one model's squared pixel errors become the data term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Loss {
    /// Nats per squared pixel (or per squared normalised unit, see [`Loss::in_units_of`]).
    pub(super) per_square: f64,
    /// Nats at which an error stops to count.
    pub(super) cap: f64,
}

impl Loss {
    /// `min(e²/σ², λ3 (r - d))`.
    pub(super) fn of(self, squared_error: f64) -> f64 {
        let cost = squared_error * self.per_square;
        if cost < self.cap { cost } else { self.cap }
    }

    /// The same loss for errors measured in units of which one pixel has `units_per_px`.
    pub(super) fn in_units_of(self, units_per_px: f64) -> Self {
        Self {
            per_square: self.per_square / (units_per_px * units_per_px),
            cap: self.cap,
        }
    }
}

impl GricParams {
    /// The loss of `model` for one-sided squared errors (static, homography) or squared Sampson
    /// errors (rigid), in px².
    pub(super) fn loss(&self, model: MotionModel) -> Loss {
        let share = match model {
            MotionModel::Static | MotionModel::Homography => 0.5,
            MotionModel::Rigid => 1.0,
        };
        Loss {
            per_square: share / (self.sigma_px * self.sigma_px),
            cap: self.lambda3 * (CORRESPONDENCE_DIMENSION - model.dimension()),
        }
    }

    /// The distance at which an error of `model` stops to count, px: of a transfer error (static,
    /// homography) or a Sampson error (rigid).
    #[must_use]
    pub fn cap_px(&self, model: MotionModel) -> f64 {
        let loss = self.loss(model);
        (loss.cap / loss.per_square).sqrt()
    }

    /// `λ1 d n + λ2 k`: what `model` costs before any error, and so the least its GRIC can be.
    #[must_use]
    pub fn penalty(&self, model: MotionModel, n: f64) -> f64 {
        let lambda1 = libm::log(CORRESPONDENCE_DIMENSION);
        let lambda2 = libm::log(CORRESPONDENCE_DIMENSION * n.max(1.0));
        lambda1 * model.dimension() * n + lambda2 * model.parameters()
    }

    /// The margin that is added to `model`'s GRIC where models are compared, nats.
    #[must_use]
    pub fn margin(&self, model: MotionModel, n: f64) -> f64 {
        match model {
            MotionModel::Static | MotionModel::Homography => 0.0,
            MotionModel::Rigid => self.rigid_margin_per_cell * n,
        }
    }

    /// # Errors
    /// [`SceneError::Parameter`] for a value that is not finite or not positive (the margin may
    /// be 0).
    pub fn validate(&self) -> Result<(), SceneError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        for (name, ok) in [
            ("sigma_px", positive(self.sigma_px)),
            ("lambda3", positive(self.lambda3)),
            (
                "rigid_margin_per_cell",
                self.rigid_margin_per_cell == 0.0 || positive(self.rigid_margin_per_cell),
            ),
        ] {
            if !ok {
                return Err(SceneError::Parameter { name });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn penalties_and_caps_are_torrs() {
        let (gric, n) = (GricParams::default(), 1500.0);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        // ln 4 = 1.386294361, ln 6000 = 8.699514748.
        close(
            gric.penalty(MotionModel::Static, n),
            2.0 * 1500.0 * 1.386_294_361_119_890_6,
        );
        close(
            gric.penalty(MotionModel::Homography, n),
            4_158.883_083_359_672 + 8.0 * 8.699_514_748_210_191,
        );
        close(
            gric.penalty(MotionModel::Rigid, n),
            6_238.324_625_039_508 + 7.0 * 8.699_514_748_210_191,
        );
        assert_eq!(
            gric.loss(MotionModel::Homography),
            Loss {
                per_square: 2.0,
                cap: 4.0
            }
        );
        assert_eq!(
            gric.loss(MotionModel::Rigid),
            Loss {
                per_square: 4.0,
                cap: 2.0
            }
        );
        assert_eq!(gric.loss(MotionModel::Static).of(1.0), 2.0);
        close(gric.cap_px(MotionModel::Static), 8.0_f64.sqrt() * 0.5);
        close(gric.cap_px(MotionModel::Rigid), 2.0_f64.sqrt() * 0.5);
        assert_eq!(gric.loss(MotionModel::Static).of(f64::MAX), 4.0);
    }

    #[test]
    fn parameters_are_checked() {
        assert!(GricParams::default().validate().is_ok());
        for sigma_px in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let bad = GricParams {
                sigma_px,
                ..GricParams::default()
            };
            assert_eq!(
                bad.validate(),
                Err(SceneError::Parameter { name: "sigma_px" })
            );
        }
    }
}
