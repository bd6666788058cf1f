//! Parameters of Dense Inverse Search and their presets, named and valued as OpenCV's
//! `DISOpticalFlow`. Scales count halvings of the full frame.

use serde::{Deserialize, Serialize};

use crate::flow::FlowError;

/// Patch sides that have a compiled kernel, pixels.
pub(super) const PATCH_SIZES: [usize; 4] = [4, 8, 12, 16];

// 2^16 px is beyond any frame that fits in memory here; a larger scale is a typing error.
const LARGEST_SCALE: u32 = 16;

// OpenCV's presets. The stripes are there for its threads, but they also keep a wrong vector
// from running over the whole frame: on `shared/data/flow` they lower the error of large motions.
const PRESET_STRIPES: usize = 8;
const PRESET_REFINEMENT_ITERATIONS: usize = 5;

// Convergence needs tens; more is a typing error.
const MOST_ITERATIONS: usize = 1000;

// Weights and scales between these keep every intermediate of the refinement well inside f32.
const SMALLEST_SCALE: f32 = 1e-6;
const LARGEST_CONSTANT: f32 = 1e6;

/// Parameters of [`Dis`](super::Dis).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DisParams {
    /// Scale at which the search stops; the field is upsampled by `2^finest_scale` from there.
    /// Frames too small for it stop at the coarsest scale they have.
    pub finest_scale: u32,
    /// Side of the square patches, pixels: 4, 8, 12 or 16.
    pub patch_size: usize,
    /// Distance between patches, pixels; at most `patch_size`, or pixels would stay uncovered.
    pub patch_stride: usize,
    /// Search iterations per patch and scale, over both sweeps.
    pub gradient_descent_iterations: usize,
    /// Compare patches after removing their means: robust to changing light.
    pub mean_normalisation: bool,
    /// Try the neighbours' vectors as starting points, in two sweeps of opposite direction.
    pub spatial_propagation: bool,
    /// Bands of patch rows that vectors do not leave while they propagate; 1 is the whole frame.
    pub propagation_stripes: usize,
    /// Share of the full Gauss-Newton step taken in each iteration, in (0, 1].
    pub step_length: f32,
    /// Fixed-point iterations of the variational refinement at each scale; 0 leaves it out.
    pub refinement_iterations: usize,
    /// Constants of the variational refinement.
    pub refinement: RefinementParams,
}

/// Constants of the variational refinement; the defaults are those of OpenCV's `DISOpticalFlow`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefinementParams {
    /// Weight α of the smoothness of the field.
    pub smoothness: f32,
    /// Weight δ of brightness constancy.
    pub brightness: f32,
    /// Weight γ of gradient constancy.
    pub gradient: f32,
    /// ε below which the robust penalties become quadratic: normalised grey levels, or pixels.
    pub epsilon: f32,
    /// ζ added to gradient magnitudes in the normalisation, grey levels: below it a gradient says
    /// nothing. Its square also keeps flat ground solvable.
    pub normalisation: f32,
    /// Factor on differences between a pixel's two neighbours: 1 as OpenCV, which takes half
    /// Gauss-Newton steps thereby; 0.5 makes them true derivatives.
    pub difference_scale: f32,
    /// Sweeps of red-black over-relaxation per fixed-point iteration.
    pub sor_iterations: usize,
    /// Over-relaxation ω, in (0, 2).
    pub relaxation: f32,
}

impl DisParams {
    /// OpenCV's ULTRAFAST with a free finest scale (OpenCV: 2).
    #[must_use]
    pub fn ultrafast(finest_scale: u32) -> Self {
        Self {
            finest_scale,
            patch_size: 8,
            patch_stride: 4,
            gradient_descent_iterations: 12,
            mean_normalisation: true,
            spatial_propagation: true,
            propagation_stripes: PRESET_STRIPES,
            // OpenCV differentiates with an unnormalised Sobel kernel, eight times the gradient, so
            // that its steps are an eighth of Gauss-Newton's.
            step_length: 0.125,
            refinement_iterations: 0,
            refinement: RefinementParams::default(),
        }
    }

    /// OpenCV's FAST: finest scale 2, 16 iterations, refined.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            gradient_descent_iterations: 16,
            refinement_iterations: PRESET_REFINEMENT_ITERATIONS,
            ..Self::ultrafast(2)
        }
    }

    /// OpenCV's MEDIUM: finest scale 1, stride 3, 25 iterations, refined.
    #[must_use]
    pub fn medium() -> Self {
        Self {
            patch_stride: 3,
            gradient_descent_iterations: 25,
            refinement_iterations: PRESET_REFINEMENT_ITERATIONS,
            ..Self::ultrafast(1)
        }
    }

    /// Whether every field has a meaning.
    ///
    /// # Errors
    /// [`FlowError::InvalidParameter`] naming the first field that has none.
    pub fn validate(&self) -> Result<(), FlowError> {
        let check = |ok: bool, name, value, reason| {
            if ok {
                Ok(())
            } else {
                Err(FlowError::InvalidParameter {
                    name,
                    value,
                    reason,
                })
            }
        };
        check(
            self.finest_scale <= LARGEST_SCALE,
            "finest_scale",
            f64::from(self.finest_scale),
            "at most 16",
        )?;
        check(
            PATCH_SIZES.contains(&self.patch_size),
            "patch_size",
            self.patch_size as f64,
            "4, 8, 12 or 16",
        )?;
        check(
            (1..=self.patch_size).contains(&self.patch_stride),
            "patch_stride",
            self.patch_stride as f64,
            "from 1 to patch_size",
        )?;
        check(
            self.step_length > 0.0 && self.step_length <= 1.0,
            "step_length",
            f64::from(self.step_length),
            "in (0, 1]",
        )?;
        check(
            self.propagation_stripes >= 1,
            "propagation_stripes",
            self.propagation_stripes as f64,
            "at least 1",
        )?;
        check(
            self.refinement_iterations <= MOST_ITERATIONS,
            "refinement_iterations",
            self.refinement_iterations as f64,
            "at most 1000",
        )?;
        let constants = &self.refinement;
        check(
            constants.sor_iterations <= MOST_ITERATIONS,
            "refinement.sor_iterations",
            constants.sor_iterations as f64,
            "at most 1000",
        )?;
        check(
            constants.relaxation > 0.0 && constants.relaxation < 2.0,
            "refinement.relaxation",
            f64::from(constants.relaxation),
            "in (0, 2)",
        )?;
        for (name, value) in [
            ("refinement.smoothness", constants.smoothness),
            ("refinement.brightness", constants.brightness),
            ("refinement.gradient", constants.gradient),
        ] {
            let ok = (0.0..=LARGEST_CONSTANT).contains(&value);
            check(ok, name, f64::from(value), "from 0 to 1e6")?;
        }
        for (name, value) in [
            ("refinement.epsilon", constants.epsilon),
            ("refinement.normalisation", constants.normalisation),
            ("refinement.difference_scale", constants.difference_scale),
        ] {
            let ok = (SMALLEST_SCALE..=LARGEST_CONSTANT).contains(&value);
            check(ok, name, f64::from(value), "from 1e-6 to 1e6")?;
        }
        Ok(())
    }

    /// Sweeps over the patches at each scale.
    pub(super) fn sweeps(&self) -> usize {
        if self.spatial_propagation { 2 } else { 1 }
    }
}

impl Default for DisParams {
    /// The `standard` profile's: [`ultrafast`](Self::ultrafast) at finest scale 1.
    fn default() -> Self {
        Self::ultrafast(1)
    }
}

impl Default for RefinementParams {
    fn default() -> Self {
        Self {
            smoothness: 20.0,
            brightness: 5.0,
            gradient: 10.0,
            epsilon: 0.01,
            normalisation: 0.1,
            difference_scale: 1.0,
            sor_iterations: 5,
            relaxation: 1.6,
        }
    }
}
