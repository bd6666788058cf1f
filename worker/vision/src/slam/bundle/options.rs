//! What the adjustment may do: the reference's choices, and the clean ones.

use super::BundleError;

/// Where the poses' diagonal is damped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damping {
    /// diag(S) ← (1 + lm) diag(S) + ep, after the depths are eliminated (the reference kernels).
    AfterSchur,
    /// diag(A) ← (1 + lm) diag(A) + ep, before (Levenberg-Marquardt proper).
    BeforeSchur,
}

/// Whether a step must lower the cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepControl {
    /// Every step is taken (the reference).
    Always,
    /// A step that raises the cost is tried again with ten times the damping, at most so often.
    Decrease {
        /// Tries after the first.
        retries: usize,
    },
}

impl StepControl {
    pub(super) fn is_adaptive(self) -> bool {
        matches!(self, Self::Decrease { .. })
    }
}

/// What happens when the poses' system has no Cholesky factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OnNotPositiveDefinite {
    /// The poses stay, the depths step as if they had not moved (the reference); it is counted in the
    /// report.
    ZeroPoseStep,
    /// The damping is raised tenfold, at most so often; then the adjustment fails.
    RaiseDamping {
        /// Tries after the first.
        retries: usize,
    },
}

/// Parameters of [`adjust`](super::adjust).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleOptions {
    /// Most steps.
    pub iterations: usize,
    /// Where the poses are damped.
    pub damping: Damping,
    /// Relative damping of the poses, at the start.
    pub lm: f64,
    /// Absolute damping of the poses.
    pub ep: f64,
    /// Relative damping of the depths, as a multiple of the current relative damping of the poses.
    pub depth_lm_ratio: f64,
    /// Every weight is multiplied by this.
    pub weight_scale: f64,
    /// Huber's kernel (B. Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 3.3),
    /// δ in cells: each coordinate's residual r costs r² up to δ and 2 δ |r| − δ² beyond; the normal
    /// equations use the weight w min(1, δ/|r|). A wrong correspondence then pulls with a bounded
    /// force, also one that starts to count at `min_depth`. `None`: squares (the reference).
    ///
    /// Measured on synthetic scenes (5 frames, median over 12, error of the rotations): with 10% of
    /// the cells wrong by up to 8 cells and noise of up to 0.1 cells, 0.5 leaves 0.0072 rad, squares
    /// 0.032; with 30%, 0.017 and 0.049. Without wrong cells it loses nothing up to that noise and 1% at
    /// noise of up to 0.5 cells, where 0.25 would lose 38%. Steps are more: up to 10 instead of 6.
    pub huber_cells: Option<f64>,
    /// Least relative depth z at which a cell counts.
    pub min_depth: f64,
    /// Leave the first free pose's step out when the depths are computed: a comparison `<= 0` in the
    /// reference kernel drops it.
    pub first_free_pose_quirk: bool,
    /// Weight of a measured inverse depth.
    pub depth_prior_weight: f64,
    /// Adjust poses only.
    pub motion_only: bool,
    /// Inverse depths are kept in this range, at the start and after every step.
    pub inverse_depth_bounds: Option<(f64, f64)>,
    /// Set the quaternions' norm to 1 after every step.
    pub normalise_rotations: bool,
    /// Whether a step must lower the cost.
    pub control: StepControl,
    /// What a failed factorisation leads to.
    pub on_not_positive_definite: OnNotPositiveDefinite,
    /// With step control: stop when a step lowers the cost by less than this share.
    pub tolerance: f64,
}

impl Default for BundleOptions {
    fn default() -> Self {
        Self {
            iterations: 10,
            damping: Damping::BeforeSchur,
            lm: 1e-4,
            ep: 1e-8,
            depth_lm_ratio: 1.0,
            weight_scale: 1.0,
            huber_cells: Some(0.5),
            min_depth: 0.1,
            first_free_pose_quirk: false,
            depth_prior_weight: 0.05,
            motion_only: false,
            inverse_depth_bounds: Some((1e-3, 1e3)),
            normalise_rotations: true,
            control: StepControl::Decrease { retries: 6 },
            on_not_positive_definite: OnNotPositiveDefinite::RaiseDamping { retries: 8 },
            tolerance: 1e-4,
        }
    }
}

impl BundleOptions {
    /// The reference's front end: two iterations, lm 1e-4, ep 0.1. Its back end has lm 1e-5, ep 0.01.
    #[must_use]
    pub fn worldscore() -> Self {
        // The reference passes both as f32.
        Self {
            iterations: 2,
            damping: Damping::AfterSchur,
            lm: f64::from(1e-4f32),
            ep: f64::from(0.1f32),
            depth_lm_ratio: 0.0,
            weight_scale: 0.001,
            huber_cells: None,
            min_depth: 0.25,
            first_free_pose_quirk: true,
            depth_prior_weight: 0.05,
            motion_only: false,
            inverse_depth_bounds: None,
            normalise_rotations: false,
            control: StepControl::Always,
            on_not_positive_definite: OnNotPositiveDefinite::ZeroPoseStep,
            tolerance: 0.0,
        }
    }

    /// The reference's back end.
    #[must_use]
    pub fn worldscore_backend() -> Self {
        Self {
            lm: f64::from(1e-5f32),
            ep: f64::from(1e-2f32),
            ..Self::worldscore()
        }
    }

    pub(super) fn validate(&self) -> Result<(), BundleError> {
        let in_range = |value: f64, least: f64, most: f64| value >= least && value <= most;
        let checks = [
            ("lm", in_range(self.lm, 0.0, 1e9)),
            ("ep", in_range(self.ep, 0.0, 1e9)),
            ("depth_lm_ratio", in_range(self.depth_lm_ratio, 0.0, 1e9)),
            ("weight_scale", in_range(self.weight_scale, 1e-9, 1e9)),
            (
                "huber_cells",
                self.huber_cells
                    .is_none_or(|cells| in_range(cells, 1e-3, 1e6)),
            ),
            ("min_depth", in_range(self.min_depth, 1e-3, 1e3)),
            (
                "depth_prior_weight",
                in_range(self.depth_prior_weight, 0.0, 1e9),
            ),
            ("tolerance", in_range(self.tolerance, 0.0, 1.0)),
            (
                "inverse_depth_bounds",
                self.inverse_depth_bounds
                    .is_none_or(|(least, most)| least <= most && least >= -1e6 && most <= 1e6),
            ),
        ];
        match checks.iter().find(|(_, good)| !good) {
            Some(&(name, _)) => Err(BundleError::Parameter { name }),
            None => Ok(()),
        }
    }
}
