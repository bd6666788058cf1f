//! What watches a clip beside its pairs and edges: the fault detectors, the contact statistic, and
//! the signals on steps of constant visual motion (ARC).

use std::rc::Rc;

use plumbline_vision::consistency::Evidence;
use plumbline_vision::faults::{
    ChangePair, FaultEvent, FaultInput, FaultKind, FaultSeries, FaultStream, FaultThresholds,
};
use plumbline_vision::image::Plane;
use plumbline_vision::signals::arc::{ArcClip, ArcSelector, ArcSignals};
use plumbline_vision::signals::contact::{Contact, ContactStream};

use super::clip::Edge;
use super::error::{ClipError, at};
use super::prepared::Prepared;
use crate::profile::Profile;

/// The observers of one clip.
pub(super) struct Observers {
    faults: FaultStream,
    thresholds: FaultThresholds,
    contact: ContactStream,
    selector: ArcSelector,
    arc: ArcSignals,
    kept: Option<Rc<Prepared>>,
}

/// What is known of the change across a frame, between the frames before and after it.
#[derive(Debug, Default)]
pub(super) enum Across {
    /// Nothing, and nothing needs it.
    #[default]
    Unread,
    /// That of the way there, which tells that the frame between is not bad.
    Ahead(Plane),
    /// All of it.
    Whole(Box<ChangePair>),
}

impl Across {
    fn whole(&self) -> Option<&ChangePair> {
        match self {
            Self::Whole(change) => Some(change),
            Self::Ahead(_) | Self::Unread => None,
        }
    }

    fn ahead(&self) -> Option<&Plane> {
        match self {
            Self::Ahead(change) => Some(change),
            Self::Whole(_) | Self::Unread => None,
        }
    }
}

/// What they saw.
pub(super) struct Observed {
    /// Faults, the most severe first; `None` where the profile is not calibrated for any.
    pub(super) events: Option<Vec<FaultEvent>>,
    /// Every score behind them.
    pub(super) faults: FaultSeries,
    /// U·R_c, where the camera stands still.
    pub(super) contact: Option<Contact>,
    /// accs, Sd and sh.
    pub(super) arc: ArcClip,
}

impl Observers {
    /// Observers that have seen nothing; `frame` is the first they will see.
    pub(super) fn new(profile: &Profile, frame: u32) -> Result<Self, ClipError> {
        Ok(Self {
            faults: FaultStream::new(profile.faults.clone()).map_err(at("faults", frame))?,
            thresholds: profile.fault_thresholds,
            contact: ContactStream::new(profile.contact.clone()),
            selector: ArcSelector::new(profile.arc_selector.clone()),
            arc: ArcSignals::new(profile.arc.clone()).map_err(at("constant motion", frame))?,
            kept: None,
        })
    }

    /// Keeps the fault maps of these kinds and frames.
    pub(super) fn keep_maps(&mut self, wanted: &[(FaultKind, usize)]) {
        self.faults.keep_maps(wanted);
    }

    /// Leaves scores out that can be neither an event nor a verdict of the row; they are recorded as 0. Likewise
    /// the places of scores that are no event.
    pub(super) fn only_what_the_row_shows(&mut self, profile: &Profile) {
        self.faults.place_only_events(profile.fault_thresholds);
        // Without flows across a frame there is no V, however small.
        if profile.edge_spans.contains(&2) {
            let reported = profile.fault_thresholds.bad_frame.unwrap_or(f64::INFINITY);
            let least = reported.min(profile.verdict.max_bad_frame);
            self.faults.leave_out_bad_frames_below(least);
        }
    }

    /// Whether the frame before the one that `adjacent` leads to may be bad: what the change across it decides,
    /// of which `ahead` is the map of the way there, where it is known.
    pub(super) fn may_be_bad(&self, adjacent: &Edge, ahead: Option<&Plane>) -> bool {
        self.faults.may_be_bad(&adjacent.change, ahead)
    }

    /// Takes the next frame with its edge to the frame before and the change since the one before that.
    pub(super) fn frame(
        &mut self,
        current: &Prepared,
        adjacent: Option<&Edge>,
        across: &Across,
    ) -> Result<(), ClipError> {
        let input = FaultInput {
            frame: current.index as usize,
            picture: &current.normalised,
            adjacent: adjacent.map(|edge| &edge.change),
            skip: across.whole(),
            skip_ahead: across.ahead(),
        };
        self.faults
            .push(input)
            .map_err(at("faults", current.index))?;
        self.contact
            .push(&current.rgb, adjacent.map(|edge| &edge.change))
            .map_err(at("contact", current.index))
    }

    /// Whether enough has moved since the kept frame that this one is to be kept.
    pub(super) fn is_step(&mut self, current: &Prepared) -> Result<bool, ClipError> {
        self.selector
            .push(&current.normalised)
            .map_err(at("constant motion", current.index))
    }

    /// The last kept frame.
    pub(super) fn kept(&self) -> Option<&Prepared> {
        self.kept.as_deref()
    }

    /// Keeps a frame, with the evidence from the last kept one to it.
    pub(super) fn step(
        &mut self,
        current: Rc<Prepared>,
        evidence: Option<Evidence>,
    ) -> Result<(), ClipError> {
        self.arc
            .push(current.index as usize, &current.normalised, evidence)
            .map_err(at("constant motion", current.index))?;
        self.kept = Some(current);
        Ok(())
    }

    /// What they saw of the whole clip.
    pub(super) fn finish(self, static_camera: bool) -> Observed {
        let series = self.faults.finish(static_camera);
        let calibrated = self.thresholds != FaultThresholds::UNCALIBRATED;
        Observed {
            events: calibrated.then(|| series.events(&self.thresholds)),
            faults: series,
            contact: self.contact.finish().filter(|_| static_camera),
            arc: self.arc.finish(),
        }
    }
}
