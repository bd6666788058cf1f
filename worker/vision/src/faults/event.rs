//! A fault: an unbroken run of frames whose score is above the threshold.

use serde::{Deserialize, Serialize};

use super::FaultKind;
use super::peak::Place;
use super::series::FaultPoint;

/// A fault of a clip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FaultEvent {
    /// What is wrong.
    pub kind: FaultKind,
    /// The run's worst frame.
    pub frame: usize,
    /// The run's first frame.
    pub first_frame: usize,
    /// The run's last frame, inclusive.
    pub last_frame: usize,
    /// The worst frame's score, no unit.
    pub score: f64,
    /// The threshold it exceeds.
    pub threshold: f64,
    /// Where on the evidence grid, on the worst frame; `None` for a freeze (everywhere).
    pub place: Option<Place>,
}

impl FaultEvent {
    pub(super) fn new(kind: FaultKind, point: &FaultPoint, threshold: f64) -> Self {
        Self {
            kind,
            frame: point.frame,
            first_frame: point.frame,
            last_frame: point.frame,
            score: point.score,
            threshold,
            place: point.place,
        }
    }

    /// Takes in the run's next frame.
    pub(super) fn extend(&mut self, next: &Self) {
        let first_frame = self.first_frame;
        if next.score > self.score {
            *self = *next;
        }
        self.first_frame = first_frame;
        self.last_frame = next.last_frame;
    }

    /// Score over threshold: above 1, and comparable between kinds of one calibration.
    #[must_use]
    pub fn severity(&self) -> f64 {
        if self.threshold > 0.0 {
            self.score / self.threshold
        } else {
            f64::MAX
        }
    }
}
