//! Above which score a fault is reported: a calibration of one profile on one corpus.
//!
//! A threshold is a high percentile of the largest scores of clean clips, so that this share of clean
//! clips stays without an event of the kind (the largest score grows slowly with length: calibrate on
//! clips as long as those judged). The freeze rule has a meaning of its own and is not fitted. Fails
//! with [`ThresholdError`] on a percentile out of range.

use serde::{Deserialize, Serialize};

use super::{FaultKind, FaultSeries};

/// Mean |ΔG| of a frozen pair is below this share of the clip's median (`evidence.md`, section 4):
/// with coding noise it is not quite zero.
pub(super) const FREEZE_SHARE: f64 = 0.12;

/// The thresholds of each kind; `None` where the kind was not calibrated and is not reported.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultThresholds {
    /// Of V.
    pub bad_frame: Option<f64>,
    /// Of xr.
    pub jump: Option<f64>,
    /// Of step.
    pub appear: Option<f64>,
    /// Of vanq.
    pub vanish: Option<f64>,
    /// Of pers.
    pub flicker: Option<f64>,
    /// Of the freeze score, 1 − the share of a frozen pair (.12).
    pub freeze: Option<f64>,
}

/// Why no threshold was fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ThresholdError {
    /// The percentile is not in 0..=100.
    #[error("percentile {percentile} is not in 0..=100")]
    Percentile {
        /// The one given.
        percentile: f64,
    },
}

impl FaultThresholds {
    /// Of pictures of 128 px (DIS finest scale 2, adjacent pairs only), rendered clips.
    ///
    /// This, `STANDARD` and `ACCURATE`: the 99th percentile over the clean clips of the rendered sample,
    /// seeds 1 to 6, 72 clips of 32 frames at 256×192 (48 with a static camera), as
    /// `examples/fit_fault_thresholds.rs` prints them, upwards to three digits. For rendered clips only:
    /// most recorded ones are above some of them. `vanish` was fitted again for `STANDARD` alone since its
    /// gate became wider, so the other two do not report it.
    pub const DRAFT: Self = Self {
        bad_frame: None,
        jump: Some(0.0315),
        appear: Some(0.487),
        vanish: None,
        flicker: Some(0.507),
        freeze: Some(1.0 - FREEZE_SHARE),
    };

    /// Of the profile `standard` (256 px high, DIS finest scale 1), rendered clips.
    pub const STANDARD: Self = Self {
        bad_frame: Some(0.0113),
        jump: Some(0.0146),
        appear: Some(0.477),
        vanish: Some(0.166),
        flicker: Some(0.201),
        freeze: Some(1.0 - FREEZE_SHARE),
    };

    /// Of the profile `accurate` (512 px high, DIS finest scale 0), rendered clips.
    pub const ACCURATE: Self = Self {
        bad_frame: Some(0.0167),
        jump: Some(0.00683),
        appear: Some(0.482),
        vanish: None,
        flicker: Some(0.148),
        freeze: Some(1.0 - FREEZE_SHARE),
    };

    /// Of the profile `standard`, recorded clips: the 99th percentile over 29 real clips of static
    /// cameras, 26 frames each (the first half of `examples/injected_faults.rs`, as it prints them;
    /// upwards to three digits). Of so few clips that is almost the largest score. A stand-in until the
    /// clean clips of the corpus at hand are fitted: cameras and codecs differ more than faults do.
    pub const STANDARD_RECORDED: Self = Self {
        bad_frame: Some(0.0592),
        jump: Some(0.0246),
        appear: Some(0.739),
        vanish: Some(0.282),
        flicker: Some(0.166),
        freeze: Some(1.0 - FREEZE_SHARE),
    };

    /// No kind is reported.
    pub const UNCALIBRATED: Self = Self {
        bad_frame: None,
        jump: None,
        appear: None,
        vanish: None,
        flicker: None,
        freeze: None,
    };

    /// The threshold of a kind.
    #[must_use]
    pub fn of(&self, kind: FaultKind) -> Option<f64> {
        match kind {
            FaultKind::BadFrame => self.bad_frame,
            FaultKind::Jump => self.jump,
            FaultKind::Appear => self.appear,
            FaultKind::Vanish => self.vanish,
            FaultKind::Flicker => self.flicker,
            FaultKind::Freeze => self.freeze,
        }
    }
}

/// Thresholds that `percentile` of the clean clips stay below, kind by kind (linear interpolation
/// between the clips' largest scores); `None` for a kind that no clip could be judged by.
///
/// # Errors
/// [`ThresholdError`] when the percentile is not in 0..=100.
pub fn fit_thresholds<'a>(
    clean: impl IntoIterator<Item = &'a FaultSeries>,
    percentile: f64,
) -> Result<FaultThresholds, ThresholdError> {
    if !(0.0..=100.0).contains(&percentile) {
        return Err(ThresholdError::Percentile { percentile });
    }
    let mut largest: [Vec<f64>; FaultKind::ALL.len()] = Default::default();
    for series in clean {
        for kind in FaultKind::ALL {
            largest[kind as usize].extend(series.largest(kind).map(|point| point.score));
        }
    }
    let mut fit = |kind: FaultKind| {
        let scores = &mut largest[kind as usize];
        scores.sort_by(f64::total_cmp);
        quantile(scores, percentile / 100.0)
    };
    Ok(FaultThresholds {
        bad_frame: fit(FaultKind::BadFrame),
        jump: fit(FaultKind::Jump),
        appear: fit(FaultKind::Appear),
        vanish: fit(FaultKind::Vanish),
        flicker: fit(FaultKind::Flicker),
        freeze: Some(1.0 - FREEZE_SHARE),
    })
}

/// The quantile of sorted values, linear between ranks; `None` of nothing.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let rank = share * last as f64;
    let below = (rank.floor() as usize).min(last);
    let above = (below + 1).min(last);
    let fraction = rank - below as f64;
    Some(sorted[below] + fraction * (sorted[above] - sorted[below]))
}
