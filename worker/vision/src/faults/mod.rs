//! Faults of single frames and transitions: which frame, which kind, where (`evidence.md`, section 4;
//! yardstick `prototype/feat.py`, `detectors.py`).
//!
//! Six detectors read the evidence of adjacent pairs (t − 1, t) and of pairs one frame apart
//! (t − 1, t + 1), all on the evidence grid: `bad_frame` (V, one frame fits neither neighbour, while
//! they fit each other), `jump` (xr), `appear` (step), `vanish` (quiet-gated), `flicker` (pers) and
//! `freeze`. Each gives one score per frame and the place of its peak; scores have no unit. Frames
//! stream by: the last six frames' planes are held, then only numbers. Frame numbers are the caller's.
//!
//! A score becomes an event above a threshold that belongs to a profile and a corpus
//! ([`FaultThresholds`]). Fails with [`FaultError`] on frames out of order or of changing size.
//!
//! Morphs are not found. Tried on 16 recorded clips, AUROC / peak inside: change over 8 frames where
//! nothing moved through .58 / .31, slow steady flow that starts at once .61 / .38, its local
//! deformation .58 / .25, a tracked patch against its own past 8 frames before .52 / .12, deformation
//! times long change .65 / .50. None is above chance by a margin that a report could stand on.

mod event;
mod freeze;
mod maps;
mod pair;
mod params;
mod peak;
mod series;
mod stream;
mod thresholds;

pub use event::FaultEvent;
pub use pair::ChangePair;
pub use params::FaultParams;
pub use peak::Place;
pub use series::{FaultPoint, FaultSeries, KeptMap, PeakMap};
pub use stream::{FaultInput, FaultStream};
pub use thresholds::{FaultThresholds, ThresholdError, fit_thresholds};

use serde::{Deserialize, Serialize};

/// What a detector looks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// One frame fits neither of its neighbours, while they fit each other.
    BadFrame,
    /// Something is suddenly elsewhere.
    Jump,
    /// Something still appears at once and stays.
    Appear,
    /// Something still is gone at once and stays away.
    Vanish,
    /// A region's texture changes on every frame.
    Flicker,
    /// The picture stands still although the clip moves.
    Freeze,
}

impl FaultKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [Self; 6] = [
        Self::BadFrame,
        Self::Jump,
        Self::Appear,
        Self::Vanish,
        Self::Flicker,
        Self::Freeze,
    ];

    /// The name in rows and reports.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::BadFrame => "bad_frame",
            Self::Jump => "jump",
            Self::Appear => "appear",
            Self::Vanish => "vanish",
            Self::Flicker => "flicker",
            Self::Freeze => "freeze",
        }
    }

    /// Whether the detector compares cells in place over six frames and so needs a static camera.
    #[must_use]
    pub const fn needs_static_camera(self) -> bool {
        matches!(self, Self::Appear | Self::Vanish)
    }
}

/// Why a frame was not judged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FaultError {
    /// Frames must come one after the other.
    #[error("frame {frame} does not follow frame {previous}")]
    OutOfOrder {
        /// The frame given.
        frame: usize,
        /// The one before it.
        previous: usize,
    },
    /// Every frame but the first needs the evidence of the pair with the frame before it.
    #[error("frame {frame} came without the evidence of the pair before it")]
    MissingPair {
        /// The frame given.
        frame: usize,
    },
    /// Inputs are not on one grid.
    #[error("frame {frame} is on a grid of {actual:?}, not {expected:?} (width, height)")]
    SizeMismatch {
        /// The frame given.
        frame: usize,
        /// The grid of the first frame.
        expected: (usize, usize),
        /// The grid of the input.
        actual: (usize, usize),
    },
    /// A parameter has no meaning.
    #[error("{name} = {value} has no meaning")]
    InvalidParameter {
        /// The field's name.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

#[cfg(test)]
mod tests;
