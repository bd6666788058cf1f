//! Constants of the fault detectors, in cells of the evidence grid, reference pixels and grey levels
//! (`evidence.md`, section 4).

use serde::{Deserialize, Serialize};

use super::FaultError;

/// Frames on each side of a transition whose median and range `appear` and `vanish` compare: three is
/// the least that has a median, and a longer window meets the next motion.
pub(super) const WINDOW_FRAMES: usize = 3;
/// Adjacent pairs in all of which a flickering cell must differ: texture that merely moves past does
/// not differ that long.
pub(super) const PERSISTENCE_PAIRS: usize = 4;

/// Constants of the fault detectors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FaultParams {
    /// Cells at the grid's border that no statistic counts.
    pub margin_cells: usize,
    /// A map's peak is that of its mean over the `(2 r + 1)²` box of this radius, cells.
    pub peak_radius_cells: usize,
    /// A fault's bounds hold the cells around the peak above this share of it.
    pub bounds_share: f32,
    /// Radius of the box mean before and after `appear` compares, cells.
    pub step_radius_cells: usize,
    /// Radius of the box mean of the appearance residual for `flicker`, cells.
    pub persistence_radius_cells: usize,
    /// Radius of the box mean of the flow for `flicker`, cells.
    pub drift_radius_cells: usize,
    /// Mean drift at which `flicker` keeps 1/e of its weight, reference pixels per pair.
    pub drift_scale_px: f32,
    /// Radius of the box in which `vanish` measures the deviation of grey levels, cells.
    pub texture_radius_cells: usize,
    /// Added to that deviation before its logarithm, grey levels.
    pub texture_offset: f32,
    /// A cell is not quiet when its flow is longer than this, reference pixels.
    pub quiet_speed_px: f32,
    /// Radius of the box in which unquiet cells are counted, cells.
    pub quiet_radius_cells: usize,
    /// Share of unquiet cells at which `vanish` keeps 1/e of its weight. The evidence has .15; on 16
    /// recorded clips (`tests/inject`, first half) .15, .3 and .5 gave an AUROC of .78, .89 and .91: most
    /// of what vanishes has an arm passing nearby.
    pub quiet_scale: f32,
    /// Successive pairs that must stand still for a freeze.
    pub freeze_pairs: usize,
    /// Whether a freeze must begin and end abruptly and not recur at one regular distance; without it,
    /// the rule of the evidence.
    pub freeze_needs_motion_around: bool,
}

impl Default for FaultParams {
    fn default() -> Self {
        Self {
            margin_cells: 4,
            peak_radius_cells: 4,
            bounds_share: 0.5,
            step_radius_cells: 1,
            persistence_radius_cells: 2,
            drift_radius_cells: 4,
            drift_scale_px: 1.0,
            texture_radius_cells: 3,
            texture_offset: 2.0,
            quiet_speed_px: 0.8,
            quiet_radius_cells: 4,
            quiet_scale: 0.5,
            freeze_pairs: 2,
            freeze_needs_motion_around: true,
        }
    }
}

impl FaultParams {
    /// Whether every field has a meaning.
    ///
    /// # Errors
    /// [`FaultError::InvalidParameter`] naming the first field that has none.
    pub fn validate(&self) -> Result<(), FaultError> {
        let positive = [
            ("bounds_share", f64::from(self.bounds_share)),
            ("texture_offset", f64::from(self.texture_offset)),
            ("quiet_scale", f64::from(self.quiet_scale)),
            ("drift_scale_px", f64::from(self.drift_scale_px)),
            ("freeze_pairs", self.freeze_pairs as f64),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(FaultError::InvalidParameter { name, value });
            }
        }
        let finite = f64::from(self.quiet_speed_px);
        if !finite.is_finite() {
            return Err(FaultError::InvalidParameter {
                name: "quiet_speed_px",
                value: finite,
            });
        }
        Ok(())
    }
}
