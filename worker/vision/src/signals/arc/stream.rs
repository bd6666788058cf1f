//! The three signals while the kept frames stream by; as many steps are held as points are followed.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::detail::{DetailFrame, detail_change};
use super::{ArcError, ArcParams, CellSummary, interior_shear, layer_acceleration};
use crate::consistency::{Evidence, NormalisedFrame};
use crate::signals::median;

/// What one kept frame settled.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArcStep {
    /// The caller's number of the kept frame.
    pub frame: usize,
    /// accs of the two steps that end here.
    pub layer_acceleration: Option<f64>,
    /// Lower quartile of the same.
    pub layer_acceleration_q25: Option<f64>,
    /// Sd of the step that ends here, 1/px.
    pub interior_shear: Option<f64>,
    /// sh of the points that end here; only at every second kept frame.
    pub detail_change: Option<f64>,
    /// Lower quartile of the same.
    pub detail_change_q25: Option<f64>,
}

/// The clip's values: medians over the steps; `None` with too few of them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ArcClip {
    /// accs.
    pub layer_acceleration: Option<f64>,
    /// The same, of the lower quartile over cells.
    pub layer_acceleration_q25: Option<f64>,
    /// Sd, 1/px.
    pub interior_shear: Option<f64>,
    /// sh.
    pub detail_change: Option<f64>,
    /// The same, of the lower quartile over cells.
    pub detail_change_q25: Option<f64>,
    /// One per kept frame but the first.
    pub steps: Vec<ArcStep>,
}

/// The signals' state.
#[derive(Debug, Clone)]
pub struct ArcSignals {
    params: ArcParams,
    /// Number of frames taken.
    frames: usize,
    /// Detail of the last frames, one more than there are steps.
    details: VecDeque<DetailFrame>,
    evidence: VecDeque<Evidence>,
    steps: Vec<ArcStep>,
}

impl ArcSignals {
    /// Signals that have seen nothing.
    ///
    /// # Errors
    /// [`ArcError::InvalidParameter`] when points would never start, be followed or end.
    pub fn new(params: ArcParams) -> Result<Self, ArcError> {
        for (name, value) in [
            ("steps", params.detail.steps),
            ("stride", params.detail.stride),
            ("reach_cells", params.shear.reach_cells),
        ] {
            if value == 0 {
                return Err(ArcError::InvalidParameter { name, value: 0.0 });
            }
        }
        let ratios = (params.acceleration.min_ratio, params.acceleration.max_ratio);
        if ratios.0.is_nan() || ratios.1.is_nan() || ratios.0 > ratios.1 {
            return Err(ArcError::InvalidParameter {
                name: "max_ratio",
                value: f64::from(ratios.1),
            });
        }
        Ok(Self {
            params,
            frames: 0,
            details: VecDeque::new(),
            evidence: VecDeque::new(),
            steps: Vec::new(),
        })
    }

    /// Takes the next kept frame with the evidence previous kept → this one (`None` only with the
    /// first); `frame` is the caller's number of it.
    ///
    /// # Errors
    /// [`ArcError`] when the evidence is missing or the grid changes; the state is then unchanged.
    pub fn push(
        &mut self,
        frame: usize,
        picture: &NormalisedFrame,
        from_previous: Option<Evidence>,
    ) -> Result<(), ArcError> {
        self.check(frame, picture, from_previous.as_ref())?;
        let detail = DetailFrame::new(picture, &self.params.detail);
        if let Some(evidence) = from_previous.filter(|_| self.frames > 0) {
            let step = self.step(frame, &detail, evidence);
            self.steps.push(step);
        }
        if self.details.len() > self.params.detail.steps {
            self.details.pop_front();
        }
        self.details.push_back(detail);
        self.frames += 1;
        Ok(())
    }

    /// The clip's values.
    #[must_use]
    pub fn finish(self) -> ArcClip {
        let clip_value = |value: fn(&ArcStep) -> Option<f64>| {
            let mut defined: Vec<f64> = self.steps.iter().filter_map(value).collect();
            if defined.len() < self.params.min_steps {
                None
            } else {
                median(&mut defined)
            }
        };
        ArcClip {
            layer_acceleration: clip_value(|step| step.layer_acceleration),
            layer_acceleration_q25: clip_value(|step| step.layer_acceleration_q25),
            interior_shear: clip_value(|step| step.interior_shear),
            detail_change: clip_value(|step| step.detail_change),
            detail_change_q25: clip_value(|step| step.detail_change_q25),
            steps: self.steps,
        }
    }

    fn step(&mut self, frame: usize, detail: &DetailFrame, evidence: Evidence) -> ArcStep {
        let params = &self.params;
        let layer_acceleration = self
            .evidence
            .back()
            .and_then(|previous| layer_acceleration(previous, &evidence, params));
        let interior_shear = interior_shear(&evidence, params);
        if self.evidence.len() == params.detail.steps {
            self.evidence.pop_front();
        }
        self.evidence.push_back(evidence);
        let detail_change = self.detail_change(detail);
        ArcStep {
            frame,
            layer_acceleration: layer_acceleration.map(|cells| cells.mean),
            layer_acceleration_q25: layer_acceleration.map(|cells| cells.lower_quartile),
            interior_shear,
            detail_change: detail_change.map(|cells| cells.mean),
            detail_change_q25: detail_change.map(|cells| cells.lower_quartile),
        }
    }

    /// sh of the points that started `steps` kept frames before this one, if any did there.
    fn detail_change(&self, last: &DetailFrame) -> Option<CellSummary> {
        let detail = &self.params.detail;
        let start = self.frames.checked_sub(detail.steps)?;
        if start % detail.stride != 0 {
            return None;
        }
        let first = self.details.get(self.details.len() - detail.steps)?;
        detail_change(first, &self.evidence, last, &self.params)
    }

    fn check(
        &self,
        frame: usize,
        picture: &NormalisedFrame,
        evidence: Option<&Evidence>,
    ) -> Result<(), ArcError> {
        let actual = (picture.grey.width, picture.grey.height);
        let expected = self.details.back().map_or(actual, DetailFrame::size);
        let whole = picture.grey.validate().is_ok();
        if actual != expected || !whole {
            return Err(ArcError::SizeMismatch {
                frame,
                expected,
                actual,
            });
        }
        match evidence {
            None if self.frames > 0 => Err(ArcError::MissingEvidence { frame }),
            Some(step) if (step.width, step.height) != expected => Err(ArcError::SizeMismatch {
                frame,
                expected,
                actual: (step.width, step.height),
            }),
            _ => Ok(()),
        }
    }
}
