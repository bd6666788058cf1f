//! Parameters of Dense Inverse Search and their presets, named and valued as OpenCV's
//! `DISOpticalFlow` (without its variational refinement). Scales count halvings of the full frame.

use serde::{Deserialize, Serialize};

use crate::flow::FlowError;

/// Patch sides that have a compiled kernel, pixels.
pub(super) const PATCH_SIZES: [usize; 4] = [4, 8, 12, 16];

// 2^16 px is beyond any frame that fits in memory here; a larger scale is a typing error.
const LARGEST_SCALE: u32 = 16;

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
    /// Share of the full Gauss-Newton step taken in each iteration, in (0, 1].
    pub step_length: f32,
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
            // OpenCV differentiates with an unnormalised Sobel kernel, eight times the gradient, so
            // that its steps are an eighth of Gauss-Newton's.
            step_length: 0.125,
        }
    }

    /// OpenCV's FAST: finest scale 2, 16 iterations.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            gradient_descent_iterations: 16,
            ..Self::ultrafast(2)
        }
    }

    /// OpenCV's MEDIUM: finest scale 1, stride 3, 25 iterations.
    #[must_use]
    pub fn medium() -> Self {
        Self {
            patch_stride: 3,
            gradient_descent_iterations: 25,
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
        )
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
