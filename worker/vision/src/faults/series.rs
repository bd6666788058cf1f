//! What the detectors found in a clip: one score per kind and frame, and the map of each kind's peak.

use serde::{Deserialize, Serialize};

use super::peak::Place;
use super::{FaultEvent, FaultKind, FaultThresholds};
use crate::image::Plane;

/// A kind's score of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FaultPoint {
    /// The frame that is wrong, or the first after a wrong transition.
    pub frame: usize,
    /// Its score, no unit; higher is worse.
    pub score: f64,
    /// Where; `None` for a freeze (everywhere) and for maps that are zero.
    pub place: Option<Place>,
}

/// The map of a kind's largest score.
#[derive(Debug, Clone, PartialEq)]
pub struct PeakMap {
    /// The frame it lies on.
    pub frame: usize,
    /// The score.
    pub score: f64,
    /// `[H, W]` on the evidence grid, no unit, before the box mean of the peak.
    pub map: Plane,
}

/// The map behind one score, kept because it was asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptMap {
    /// The detector.
    pub kind: FaultKind,
    /// Its score on the map's frame, and where.
    pub point: FaultPoint,
    /// `[H, W]` on the evidence grid, no unit, before the box mean of the peak.
    pub map: Plane,
}

/// The scores of a clip. Its serial form has the scores and no map.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FaultSeries {
    /// Columns and rows of the evidence grid; `None` of an empty clip.
    pub grid_size: Option<(usize, usize)>,
    pub(super) points: [Vec<FaultPoint>; FaultKind::ALL.len()],
    #[serde(skip)]
    pub(super) peaks: [Option<PeakMap>; FaultKind::ALL.len()],
    #[serde(skip)]
    pub(super) wanted: Vec<(FaultKind, usize)>,
    #[serde(skip)]
    pub(super) kept: Vec<KeptMap>,
}

impl FaultSeries {
    /// A kind's scores, in frame order; empty where the kind could not be judged (too few frames, a
    /// moving camera, no pairs one frame apart, a clip that never moves).
    #[must_use]
    pub fn points(&self, kind: FaultKind) -> &[FaultPoint] {
        &self.points[kind as usize]
    }

    /// A kind's largest score, the earliest of equals.
    #[must_use]
    pub fn largest(&self, kind: FaultKind) -> Option<FaultPoint> {
        largest(self.points(kind))
    }

    /// The map of a kind's largest score; `None` for a freeze.
    #[must_use]
    pub fn peak_map(&self, kind: FaultKind) -> Option<&PeakMap> {
        self.peaks[kind as usize].as_ref()
    }

    /// The maps that [`super::FaultStream::keep_maps`] asked for, in the order in which they were
    /// settled; a freeze has none.
    #[must_use]
    pub fn kept_maps(&self) -> &[KeptMap] {
        &self.kept
    }

    /// The events above the thresholds, the most severe first (by score over threshold, then frame,
    /// then kind): one for each unbroken run of frames of one kind, at the run's largest score.
    #[must_use]
    pub fn events(&self, thresholds: &FaultThresholds) -> Vec<FaultEvent> {
        let mut events = Vec::new();
        for kind in FaultKind::ALL {
            let Some(threshold) = thresholds.of(kind) else {
                continue;
            };
            let mut run: Option<FaultEvent> = None;
            for point in self.points(kind) {
                if point.score.is_nan() || point.score <= threshold {
                    continue;
                }
                let event = FaultEvent::new(kind, point, threshold);
                match &mut run {
                    Some(current) if point.frame == current.last_frame + 1 => {
                        current.extend(&event);
                    }
                    _ => events.extend(run.replace(event)),
                }
            }
            events.extend(run);
        }
        events.sort_by(|a, b| {
            let by_severity = b.severity().total_cmp(&a.severity());
            by_severity
                .then(a.frame.cmp(&b.frame))
                .then(a.kind.cmp(&b.kind))
        });
        events
    }

    pub(super) fn add(&mut self, kind: FaultKind, point: FaultPoint, map: Plane) {
        if self.wanted.contains(&(kind, point.frame)) {
            let map = map.clone();
            self.kept.push(KeptMap { kind, point, map });
        }
        let slot = &mut self.peaks[kind as usize];
        if slot.as_ref().is_none_or(|peak| point.score > peak.score) {
            *slot = Some(PeakMap {
                frame: point.frame,
                score: point.score,
                map,
            });
        }
        self.points[kind as usize].push(point);
    }
}

pub(super) fn largest(points: &[FaultPoint]) -> Option<FaultPoint> {
    points.iter().copied().reduce(|best, point| {
        if point.score > best.score {
            point
        } else {
            best
        }
    })
}
