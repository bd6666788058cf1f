//! The detectors while the frames stream by.
//!
//! With frame T come the pairs (T − 1, T) and, where the profile has them, (T − 2, T). They settle
//! `jump` of T, `bad_frame` of T − 1, `appear`, `vanish` and `flicker` of T − 2. Six frames' and five
//! pairs' planes are held.

use std::collections::VecDeque;

use super::freeze;
use super::maps::{self, TRANSITION_FRAMES};
use super::params::{PERSISTENCE_PAIRS, WINDOW_FRAMES};
use super::peak::{central_mean, peak};
use super::series::{FaultPoint, FaultSeries};
use super::{ChangePair, FaultError, FaultKind, FaultParams, FaultThresholds};
use crate::consistency::NormalisedFrame;
use crate::image::Plane;

/// Frames from a transition's first frame after it to the last one needed.
const TRANSITION_DELAY: usize = WINDOW_FRAMES - 1;
/// Frames from the middle of a flicker's window, which it is dated to, to its end.
const FLICKER_DELAY: usize = PERSISTENCE_PAIRS / 2;
/// Adjacent pairs among a transition's frames.
const TRANSITION_PAIRS: usize = TRANSITION_FRAMES - 1;

/// What comes with a frame.
#[derive(Debug, Clone, Copy)]
pub struct FaultInput<'a> {
    /// The caller's number of the frame; each is one more than the last.
    pub frame: usize,
    /// The frame.
    pub picture: &'a NormalisedFrame,
    /// The pair with the frame before; `None` only with the first frame.
    pub adjacent: Option<&'a ChangePair>,
    /// The pair with the frame before that; without it there is no `bad_frame`, unless it is known to be
    /// what [`FaultStream::leave_out_bad_frames_below`] was told.
    pub skip: Option<&'a ChangePair>,
    /// Where `skip` is left out, its change map of the way there, if that told so.
    pub skip_ahead: Option<&'a Plane>,
}

/// The detectors' state.
#[derive(Debug, Clone)]
pub struct FaultStream {
    params: FaultParams,
    least_bad_frame: f64,
    /// Scores that exceed these are placed; all of them, where it is `None`.
    placed: Option<FaultThresholds>,
    last_frame: Option<usize>,
    frames: VecDeque<FramePlanes>,
    pairs: VecDeque<PairPlanes>,
    /// (later frame, mean |ΔG|) of every adjacent pair.
    grey_changes: Vec<(usize, f64)>,
    series: FaultSeries,
}

#[derive(Debug, Clone)]
struct FramePlanes {
    grey: Plane,
    smoothed: Plane,
    texture: Plane,
}

#[derive(Debug, Clone)]
struct PairPlanes {
    forward_change: Plane,
    backward_change: Plane,
    residual: Plane,
    unquiet: Plane,
    drift_px: [Plane; 2],
}

impl FaultStream {
    /// Detectors that have seen nothing.
    ///
    /// # Errors
    /// [`FaultError::InvalidParameter`] when a parameter has no meaning.
    pub fn new(params: FaultParams) -> Result<Self, FaultError> {
        params.validate()?;
        Ok(Self {
            params,
            least_bad_frame: 0.0,
            placed: None,
            last_frame: None,
            frames: VecDeque::with_capacity(TRANSITION_FRAMES),
            pairs: VecDeque::with_capacity(TRANSITION_PAIRS),
            grey_changes: Vec::new(),
            series: FaultSeries::default(),
        })
    }

    /// Keeps the maps of these kinds and frames when they are settled; ask before the frames come. Each
    /// map costs its plane in memory.
    pub fn keep_maps(&mut self, wanted: &[(FaultKind, usize)]) {
        self.series.wanted.extend_from_slice(wanted);
    }

    /// From now on V is recorded as 0 where it is known to be below `least` and the pair across the frame is left
    /// out, which then costs no flow.
    pub fn leave_out_bad_frames_below(&mut self, least: f64) {
        self.least_bad_frame = least;
    }

    /// From now on the place of a score that is a mean over the picture is only looked for where the score
    /// exceeds the threshold, as an event does.
    pub fn place_only_events(&mut self, thresholds: FaultThresholds) {
        self.placed = Some(thresholds);
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`FaultError`] when frames are out of order, a pair is missing or grids differ; the state is
    /// then unchanged.
    pub fn push(&mut self, input: FaultInput<'_>) -> Result<(), FaultError> {
        self.check(&input)?;
        if let Some(pair) = input.adjacent.filter(|_| self.last_frame.is_some()) {
            self.jump(input.frame, pair);
            match input.skip {
                Some(skip) => self.bad_frame(input.frame, pair, skip),
                None => self.no_bad_frame(input.frame, pair, input.skip_ahead),
            }
            self.remember_pair(pair);
            self.flicker(input.frame);
        }
        self.remember_frame(&input);
        self.transition(input.frame);
        self.last_frame = Some(input.frame);
        Ok(())
    }

    /// The clip's scores. With a camera that moves, `appear` and `vanish` mean nothing and are left
    /// out.
    #[must_use]
    pub fn finish(mut self, camera_is_static: bool) -> FaultSeries {
        if !camera_is_static {
            self.series
                .kept
                .retain(|map| !map.kind.needs_static_camera());
            for kind in FaultKind::ALL {
                if kind.needs_static_camera() {
                    self.series.points[kind as usize].clear();
                    self.series.peaks[kind as usize] = None;
                }
            }
        }
        self.series.points[FaultKind::Freeze as usize] =
            freeze::scores(&self.grey_changes, &self.params);
        self.series
    }

    fn check(&mut self, input: &FaultInput<'_>) -> Result<(), FaultError> {
        let frame = input.frame;
        if let Some(previous) = self.last_frame {
            if previous.checked_add(1) != Some(frame) {
                return Err(FaultError::OutOfOrder { frame, previous });
            }
            if input.adjacent.is_none() {
                return Err(FaultError::MissingPair { frame });
            }
        }
        let picture = input.picture;
        let size = (picture.grey.width, picture.grey.height);
        let expected = self.series.grid_size.unwrap_or(size);
        let mismatch = |actual| FaultError::SizeMismatch {
            frame,
            expected,
            actual,
        };
        let normalised = (picture.normalised.width, picture.normalised.height);
        let whole = picture.grey.validate().is_ok() && picture.normalised.validate().is_ok();
        if size != expected || normalised != expected || !whole {
            return Err(mismatch(normalised));
        }
        for pair in [input.adjacent, input.skip].into_iter().flatten() {
            if pair.size() != Some(expected) {
                return Err(mismatch((pair.forward.width, pair.forward.height)));
            }
        }
        self.series.grid_size = Some(expected);
        Ok(())
    }

    fn jump(&mut self, frame: usize, pair: &ChangePair) {
        let map = maps::jump(&pair.forward, &pair.backward);
        let score = central_mean(&map, &self.params);
        self.add_mean(FaultKind::Jump, frame, score, map);
    }

    /// Whether V of the frame before needs the pair across that frame, were `pair` the next; `skip_ahead` is
    /// the change map of the way there of the pair across, where it is known.
    #[must_use]
    pub fn may_be_bad(&self, pair: &ChangePair, skip_ahead: Option<&Plane>) -> bool {
        let most = self.bad_frame_at_most(pair, skip_ahead);
        most.is_some_and(|most| most >= self.least_bad_frame)
    }

    /// An upper bound of V of the frame before, were `pair` the next: V without the flow across that frame, or
    /// without its way back, which can only lower it. `None` where there is no V.
    fn bad_frame_at_most(&self, pair: &ChangePair, skip_ahead: Option<&Plane>) -> Option<f64> {
        let earlier = self.pairs.back()?;
        if pair.size() != self.series.grid_size {
            return None;
        }
        let adjacent = adjacent(earlier, pair);
        let fits = |plane: &&Plane| plane.data.len() == pair.forward_change.data.len();
        let most = match skip_ahead.filter(fits) {
            Some(ahead) => maps::bad_frame(adjacent, [ahead, ahead]),
            None => maps::least(adjacent),
        };
        Some(central_mean(&most, &self.params))
    }

    /// The frame before `frame` is not bad, where that is known without the flow across it.
    fn no_bad_frame(&mut self, frame: usize, pair: &ChangePair, skip_ahead: Option<&Plane>) {
        let most = self.bad_frame_at_most(pair, skip_ahead);
        if most.is_some_and(|most| most < self.least_bad_frame) {
            self.series.points[FaultKind::BadFrame as usize].push(FaultPoint {
                frame: frame - 1,
                score: 0.0,
                place: None,
            });
        }
    }

    /// Judges the frame before `frame`.
    fn bad_frame(&mut self, frame: usize, pair: &ChangePair, skip: &ChangePair) {
        let Some(earlier) = self.pairs.back() else {
            return;
        };
        let map = maps::bad_frame(
            adjacent(earlier, pair),
            [&skip.forward_change, &skip.backward_change],
        );
        let score = central_mean(&map, &self.params);
        self.add_mean(FaultKind::BadFrame, frame - 1, score, map);
    }

    fn flicker(&mut self, frame: usize) {
        let Some(start) = self.pairs.len().checked_sub(PERSISTENCE_PAIRS) else {
            return;
        };
        let residuals = std::array::from_fn(|k| &self.pairs[start + k].residual);
        let drifts = std::array::from_fn(|k| &self.pairs[start + k].drift_px);
        let map = maps::flicker(residuals, drifts, &self.params);
        self.add_peak(FaultKind::Flicker, frame - FLICKER_DELAY, map);
    }

    /// `appear` and `vanish` between the third and fourth of the last six frames.
    fn transition(&mut self, frame: usize) {
        if self.frames.len() < TRANSITION_FRAMES || self.pairs.len() < TRANSITION_PAIRS {
            return;
        }
        let smoothed = std::array::from_fn(|k| &self.frames[k].smoothed);
        let appear = maps::appear(smoothed, &self.params);
        // All but the transition's own pair, which lies in the middle.
        let unquiet = [0, 1, 3, 4].map(|k| &self.pairs[k].unquiet);
        let textures = std::array::from_fn(|k| &self.frames[k].texture);
        let vanish = maps::vanish(textures, unquiet, &self.params);
        let first_after = frame - TRANSITION_DELAY;
        self.add_peak(FaultKind::Appear, first_after, appear);
        self.add_peak(FaultKind::Vanish, first_after, vanish);
    }

    fn add_mean(&mut self, kind: FaultKind, frame: usize, score: f64, map: Plane) {
        let is_event = |placed: &FaultThresholds| {
            let threshold = placed.of(kind);
            threshold.is_some_and(|threshold| score > threshold)
        };
        let place = match self.placed.as_ref().is_none_or(is_event) {
            true => peak(&map, &self.params).place,
            false => None,
        };
        let point = FaultPoint {
            frame,
            score,
            place,
        };
        self.series.add(kind, point, map);
    }

    fn add_peak(&mut self, kind: FaultKind, frame: usize, map: Plane) {
        let peak = peak(&map, &self.params);
        let point = FaultPoint {
            frame,
            score: peak.value,
            place: peak.place,
        };
        self.series.add(kind, point, map);
    }

    fn remember_pair(&mut self, pair: &ChangePair) {
        if self.pairs.len() == TRANSITION_PAIRS {
            self.pairs.pop_front();
        }
        self.pairs.push_back(PairPlanes {
            forward_change: pair.forward_change.clone(),
            backward_change: pair.backward_change.clone(),
            residual: maps::residual(&pair.forward, &self.params),
            unquiet: maps::unquiet(&pair.forward, &self.params),
            drift_px: maps::drift_px(&pair.forward, &self.params),
        });
    }

    fn remember_frame(&mut self, input: &FaultInput<'_>) {
        let grey = input.picture.grey.clone();
        if let Some(previous) = self.frames.back() {
            let change = maps::grey_change(&previous.grey, &grey);
            self.grey_changes.push((input.frame, change));
        }
        if self.frames.len() == TRANSITION_FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(FramePlanes {
            smoothed: maps::smoothed(input.picture, &self.params),
            texture: maps::texture(input.picture, &self.params),
            grey,
        });
    }
}

/// The change maps of two successive pairs, both directions.
fn adjacent<'a>(earlier: &'a PairPlanes, later: &'a ChangePair) -> [&'a Plane; 4] {
    [
        &earlier.forward_change,
        &earlier.backward_change,
        &later.forward_change,
        &later.backward_change,
    ]
}
