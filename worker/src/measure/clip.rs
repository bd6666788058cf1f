//! The clip while its frames stream by, and its row at the end.
//!
//! Working frames have the profile's height with the aspect kept; errors are reported in pixels of
//! a 256-px-high picture. Frame indices are those of the input, 0-based.

use std::collections::VecDeque;
use std::rc::Rc;
use std::time::{Duration, Instant};

use plumbline_common::message::Thumbnails;
use plumbline_common::row::{Measurement, Scene, Status};
use plumbline_vision::consistency::{
    ConsistencyParams, EndPointError, Evidence, GridFlow, Structure, worldscore_epe,
};
use plumbline_vision::faults::{ChangePair, FaultKind, FaultSeries};
use plumbline_vision::image::{Plane, Rgb8};
use plumbline_vision::scene::clip::worst_edge;
use plumbline_vision::scene::{AdjustedEdge, ClipGeometry, clip_layers};
use plumbline_vision::signals::PairSignals;

use super::edges::{Edges, Flows, PairFlows};
use super::error::{ClipError, at};
use super::fill;
use super::geometry::DenseWork;
use super::learned::{LearnedMeasures, LearnedWork};
use super::network_flow::NetworkFlow;
use super::observers::{Across, Observers};
use super::prepared::{FlowSearch, Prepared, working_picture};
use super::thumbnail::thumbnails;
use super::verdict::{PairEvidence, verdict};
use crate::decode::{DecodedFrame, VideoInfo};
use crate::learned::Networks;
use crate::profile::Profile;

/// Wall time by stage, but for the search for flows.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Spent {
    pub(super) signals: Duration,
    pub(super) geometry: Duration,
    pub(super) learned: LearnedWork,
}

/// One adjacent pair's numbers.
struct Pair {
    /// Index of the later frame.
    frame: u32,
    signals: PairSignals,
    /// Share of the structured cells that correspond; `None` with too little structure.
    corresponding_fraction: Option<f64>,
}

/// The worst pair so far, for the report's pictures.
struct Peak {
    error_px: f64,
    frame: Rgb8,
    heat: Plane,
}

/// Forward and backward flow between two frames, and what changed.
pub(super) struct Edge {
    flows: Flows,
    pub(super) change: ChangePair,
}

/// What the edges that end at one frame leave for the observers.
#[derive(Default)]
struct Seen {
    /// The edge from the frame before.
    adjacent: Option<Edge>,
    /// What changed since the frame before that.
    across: Across,
    /// Flows that were searched for, by the frame that they start from.
    flows: Vec<(u32, Flows)>,
}

/// Both flows of a pair on the evidence grid.
fn grid_flows(
    flows: &PairFlows,
    params: &ConsistencyParams,
    to: u32,
) -> Result<[GridFlow; 2], ClipError> {
    let [ahead, back] = &flows.ways;
    let error = at("consistency", to);
    Ok([
        GridFlow::new(ahead, params).map_err(&error)?,
        GridFlow::new(back, params).map_err(&error)?,
    ])
}

/// A clip being measured.
pub(super) struct Clip<'a> {
    profile: &'a Profile,
    pub(super) search: FlowSearch<'a>,
    learned: LearnedMeasures<'a>,
    recent: VecDeque<Rc<Prepared>>,
    usable_frames: u32,
    pairs: Vec<Pair>,
    edges: Edges<'a>,
    pub(super) dense_work: DenseWork,
    geometry: Option<ClipGeometry>,
    observers: Option<Observers>,
    peak: Option<Peak>,
    views: Views,
    faults: FaultSeries,
    /// Behind e_t, where learned networks have found it.
    tracked: Option<Vec<AdjustedEdge>>,
    pub(super) spent: Spent,
}

/// What is kept for pictures beside the numbers; nothing unless asked.
#[derive(Default)]
struct Views {
    all_faults: bool,
    wanted_maps: Vec<(FaultKind, usize)>,
    error_maps: bool,
    latest_error_px: Option<Plane>,
}

impl<'a> Clip<'a> {
    pub(super) fn new(profile: &'a Profile, networks: Networks<'a>) -> Self {
        let (learned, sea_raft) = LearnedMeasures::new(profile, networks);
        Self {
            profile,
            search: FlowSearch::new(profile, sea_raft.map(NetworkFlow::new)),
            learned,
            recent: VecDeque::new(),
            usable_frames: 0,
            pairs: Vec::new(),
            edges: Edges::new(profile),
            dense_work: DenseWork::default(),
            geometry: None,
            observers: None,
            peak: None,
            views: Views::default(),
            faults: FaultSeries::default(),
            tracked: None,
            spent: Spent::default(),
        }
    }

    /// Every fault score is wanted, also those that the row does not show.
    pub(super) fn keep_faults(&mut self) {
        self.views.all_faults = true;
    }

    /// Keeps, from now on, the fault maps of these kinds and frames, and each frame's end-point error.
    pub(super) fn keep_views(&mut self, wanted_maps: Vec<(FaultKind, usize)>) {
        self.views.wanted_maps = wanted_maps;
        self.views.error_maps = true;
    }

    /// The end-point error of the frame pushed last against the one before, on its working grid, px of
    /// a 256-px-high picture, 0 where out of frame. `None` without a pair, or when not kept.
    pub(super) fn take_error_px(&mut self) -> Option<Plane> {
        self.views.latest_error_px.take()
    }

    /// Every fault score of the finished clip, with the maps that were kept.
    pub(super) fn take_faults(&mut self) -> FaultSeries {
        std::mem::take(&mut self.faults)
    }

    /// The edge behind the paper's heat map: of those that end at t*, the one of the largest mean residual.
    pub(super) fn take_worst_edge(&mut self, peak_frame: Option<u32>) -> Option<AdjustedEdge> {
        let frame = peak_frame? as usize;
        match self.tracked.take() {
            Some(edges) => worst_edge(edges.into_iter(), frame),
            None => self.geometry.take()?.worst_edge(frame),
        }
    }

    /// Takes the next frame and measures it against the frames before.
    pub(super) fn push(&mut self, frame: DecodedFrame) -> Result<(), ClipError> {
        if frame.index < self.profile.conditioning_frames {
            return Ok(());
        }
        self.usable_frames += 1;
        self.learned.push(frame.index, &frame.rgb)?;
        let rgb = working_picture(self.profile, &frame)?;
        let video = (frame.rgb.width, frame.rgb.height);
        self.edges.sized(video, (rgb.width, rgb.height));
        let current = self.search.prepare(frame.index, rgb, self.recent.back())?;
        let recent = self.recent.clone();
        let mut seen = Seen::default();
        if let Some(earlier) = recent.back() {
            seen.adjacent = Some(self.adjacent(earlier, &current)?);
        }
        for earlier in &recent {
            let (from, to) = (earlier.index, current.index);
            if !self.profile.edge_spans.contains(&(to - from)) {
                continue;
            }
            self.search.work.pairs_in_full += 1;
            match &seen.adjacent {
                Some(edge) if to - from == 1 => {
                    self.geometric(|edges| edges.measured(from, to, &edge.flows))?;
                }
                _ => self.longer(earlier, &current, &mut seen)?,
            }
        }
        self.observe(&current, &seen)?;
        self.remember(current);
        Ok(())
    }

    /// The edge to the frame before; its numbers are taken.
    fn adjacent(&mut self, earlier: &Prepared, current: &Prepared) -> Result<Edge, ClipError> {
        let edge = self.edge(earlier, current)?;
        let end_point = self.end_point(current.index, &edge.flows)?;
        self.photometric([earlier, current], &edge, &end_point)?;
        self.edges.adjacent(Rc::clone(&edge.flows));
        Ok(edge)
    }

    /// An edge to a frame further back, for the motion models: with flows of its own, where none may be followed.
    /// What changed is seen where a bad frame may lie between.
    fn longer(
        &mut self,
        earlier: &Prepared,
        current: &Prepared,
        seen: &mut Seen,
    ) -> Result<(), ClipError> {
        let (from, to) = (earlier.index, current.index);
        if self.profile.follow_flow {
            self.geometric(|edges| edges.followed(from, to))?;
        } else {
            let flows = self.search.flows(earlier, current)?;
            self.geometric(|edges| edges.measured(from, to, &flows))?;
            seen.flows.push((from, flows));
        }
        if let Some(adjacent) = seen.adjacent.as_ref().filter(|_| to - from == 2)
            && self.may_be_bad(adjacent, None)
        {
            let flows = match seen.flows.last() {
                Some((start, flows)) if *start == from => Rc::clone(flows),
                _ => self.search.flows(earlier, current)?,
            };
            seen.across = self.across(earlier, current, &flows, adjacent)?;
        }
        Ok(())
    }

    fn may_be_bad(&self, adjacent: &Edge, ahead: Option<&Plane>) -> bool {
        let observers = self.observers.as_ref();
        observers.is_some_and(|observers| observers.may_be_bad(adjacent, ahead))
    }

    /// What changed across the frame between two: one way, and the other only where the frame may still be bad.
    fn across(
        &mut self,
        earlier: &Prepared,
        later: &Prepared,
        flows: &PairFlows,
        adjacent: &Edge,
    ) -> Result<Across, ClipError> {
        let started = Instant::now();
        let params = &self.profile.consistency;
        let error = at("consistency", later.index);
        let [ahead, back] = grid_flows(flows, params, later.index)?;
        let (first, second) = (&earlier.normalised, &later.normalised);
        let forward = Evidence::new(&ahead, &back, first, second, params).map_err(&error)?;
        let forward_change = forward.change_map();
        let across = if self.may_be_bad(adjacent, Some(&forward_change)) {
            let backward = Evidence::new(&back, &ahead, second, first, params).map_err(&error)?;
            Across::Whole(Box::new(ChangePair {
                backward_change: backward.change_map(),
                forward,
                forward_change,
                backward,
            }))
        } else {
            Across::Ahead(forward_change)
        };
        self.spent.signals += started.elapsed();
        Ok(across)
    }

    /// Whether the clip is to be decoded once more, frame by frame into [`Self::push_again`].
    pub(super) fn need_second_look(&mut self) -> Result<bool, ClipError> {
        let mut needed = false;
        self.geometric(|edges| {
            needed = edges.need_second_look();
            if needed {
                edges.look_again();
            }
            Ok(())
        })?;
        self.recent.clear();
        Ok(needed)
    }

    /// Takes the next frame again, for edges that need flows of their own.
    pub(super) fn push_again(&mut self, frame: &DecodedFrame) -> Result<(), ClipError> {
        if frame.index < self.profile.conditioning_frames {
            return Ok(());
        }
        let rgb = working_picture(self.profile, frame)?;
        let current = self.search.prepare(frame.index, rgb, self.recent.back())?;
        for earlier in self.recent.clone() {
            let (from, to) = (earlier.index, current.index);
            match to - from {
                1 => self.geometric(|edges| edges.keep(from, to))?,
                span if self.profile.edge_spans.contains(&span) => {
                    let flows = self.search.flows(&earlier, &current)?;
                    self.geometric(|edges| edges.measured(from, to, &flows))?;
                }
                _ => {}
            }
        }
        self.remember(current);
        Ok(())
    }

    fn remember(&mut self, current: Rc<Prepared>) {
        let longest = self.profile.edge_spans.last().copied().unwrap_or(1) as usize;
        if self.recent.len() == longest {
            self.recent.pop_front();
        }
        self.recent.push_back(current);
    }

    /// The end-point error of the way there, earlier → later.
    fn end_point(&mut self, to: u32, flows: &PairFlows) -> Result<EndPointError, ClipError> {
        let started = Instant::now();
        let [there, back] = &flows.ways;
        let measured = EndPointError::without_map(there, back, &self.profile.consistency);
        self.spent.signals += started.elapsed();
        measured.map_err(at("consistency", to))
    }

    /// The evidence of a step of constant motion, earlier → later, between frames that are not adjacent.
    fn step_evidence(
        &mut self,
        earlier: &Prepared,
        later: &Prepared,
        flows: &PairFlows,
    ) -> Result<Evidence, ClipError> {
        let started = Instant::now();
        let params = &self.profile.consistency;
        let [ahead, back] = grid_flows(flows, params, later.index)?;
        let (first, second) = (&earlier.normalised, &later.normalised);
        let evidence = Evidence::new(&ahead, &back, first, second, params);
        self.spent.signals += started.elapsed();
        evidence.map_err(at("consistency", later.index))
    }

    /// Both flows between two frames, and the evidence on them.
    fn edge(&mut self, earlier: &Prepared, later: &Prepared) -> Result<Edge, ClipError> {
        let flows = self.search.flows(earlier, later)?;
        let started = Instant::now();
        let params = &self.profile.consistency;
        let error = at("consistency", later.index);
        let [ahead, back] = grid_flows(&flows, params, later.index)?;
        let evidence = |flow, other, first: &Prepared, second: &Prepared| {
            Evidence::new(flow, other, &first.normalised, &second.normalised, params)
                .map_err(&error)
        };
        let change = ChangePair::new(
            evidence(&ahead, &back, earlier, later)?,
            evidence(&back, &ahead, later, earlier)?,
        );
        self.spent.signals += started.elapsed();
        Ok(Edge { flows, change })
    }

    /// Faults, contact, and the steps of constant visual motion.
    fn observe(&mut self, current: &Rc<Prepared>, seen: &Seen) -> Result<(), ClipError> {
        let started = Instant::now();
        let adjacent = seen.adjacent.as_ref();
        let mut observers = match self.observers.take() {
            Some(observers) => observers,
            None => {
                let mut observers = Observers::new(self.profile, current.index)?;
                observers.keep_maps(&self.views.wanted_maps);
                if !self.views.all_faults {
                    observers.only_what_the_row_shows(self.profile);
                }
                observers
            }
        };
        observers.frame(current, adjacent, &seen.across)?;
        let is_step = observers.is_step(current)?;
        self.spent.signals += started.elapsed();
        if is_step {
            let evidence = match observers.kept() {
                None => None,
                Some(kept) => Some(match (current.index - kept.index, adjacent) {
                    (1, Some(edge)) => edge.change.forward.clone(),
                    (span, _) => {
                        let is_edge = self.profile.edge_spans.contains(&span);
                        self.search.work.pairs_in_full += u64::from(!is_edge);
                        let known = seen.flows.iter().find(|(from, _)| *from == kept.index);
                        let flows = match known {
                            Some((_, flows)) => Rc::clone(flows),
                            None => self.search.flows(kept, current)?,
                        };
                        self.step_evidence(kept, current, &flows)?
                    }
                }),
            };
            observers.step(Rc::clone(current), evidence)?;
        }
        self.observers = Some(observers);
        Ok(())
    }

    /// End-point errors and signals of an adjacent pair.
    fn photometric(
        &mut self,
        [earlier, later]: [&Prepared; 2],
        edge: &Edge,
        end_point: &EndPointError,
    ) -> Result<(), ClipError> {
        let started = Instant::now();
        let params = &self.profile.consistency;
        let error = at("consistency", later.index);
        let [forward, backward] = &edge.flows.ways;
        let worldscore = worldscore_epe(forward, backward).map_err(&error)?;
        let signals = PairSignals::new(
            &edge.change.forward,
            end_point,
            &worldscore,
            params,
            &self.profile.signals,
        );
        let is_worst = |error_px: &f64| {
            let peak = self.peak.as_ref();
            peak.is_none_or(|peak| *error_px > peak.error_px)
        };
        let worst = signals.aepe_px.filter(is_worst);
        if worst.is_some() || self.views.error_maps {
            // The map of the way back lies on the later frame, which is the one shown.
            let back = EndPointError::new(backward, forward, params).map_err(&error)?;
            let shown = |error_px: &Option<f32>| error_px.unwrap_or(0.0);
            let heat = Plane {
                width: back.width,
                height: back.height,
                data: back.error_px.iter().map(shown).collect(),
            };
            if self.views.error_maps {
                self.views.latest_error_px = Some(heat.clone());
            }
            if let Some(error_px) = worst {
                let frame = later.rgb.clone();
                self.peak = Some(Peak {
                    error_px,
                    frame,
                    heat,
                });
            }
        }
        let structure = [
            Structure::new(&edge.change.forward, &earlier.structure).map_err(&error)?,
            Structure::new(&edge.change.backward, &later.structure).map_err(&error)?,
        ];
        self.pairs.push(Pair {
            frame: later.index,
            signals,
            corresponding_fraction: Structure::corresponding_fraction(
                structure,
                self.profile.verdict.min_structured_fraction,
            ),
        });
        self.spent.signals += started.elapsed();
        Ok(())
    }

    /// Work on the motion models, timed.
    fn geometric(
        &mut self,
        work: impl FnOnce(&mut Edges<'a>) -> Result<(), ClipError>,
    ) -> Result<(), ClipError> {
        let started = Instant::now();
        let done = work(&mut self.edges);
        self.spent.geometry += started.elapsed();
        done
    }

    /// The clip's row.
    pub(super) fn finish(&mut self, info: &VideoInfo) -> Measurement {
        let started = Instant::now();
        let geometry = self.edges.settle();
        let layers = geometry.as_ref().ok().map(|(geometry, _)| {
            clip_layers(geometry, &self.profile.two_view.gric, &self.profile.layers)
        });
        self.spent.geometry += started.elapsed();
        let mut row = Measurement::without_score(Status::Scored, "");
        row.frames = Some(info.frames);
        row.fps = info.fps;
        row.width = Some(info.width);
        row.height = Some(info.height);
        row.duration_s = info.duration_s;
        let pairs: Vec<(u32, &PairSignals)> = self
            .pairs
            .iter()
            .map(|pair| (pair.frame, &pair.signals))
            .collect();
        fill::photometric(&mut row, &pairs);
        if let Ok((geometry, work)) = geometry {
            fill::geometric(&mut row, &geometry, self.profile.warmup_frames);
            self.dense_work = work;
            self.geometry = Some(geometry);
        }
        if let Some(Ok(layers)) = &layers {
            fill::layers(&mut row, layers);
        }
        let static_camera = row.scene == Some(Scene::StaticCamera);
        if let Some(observers) = self.observers.take().filter(|_| !pairs.is_empty()) {
            let observed = observers.finish(static_camera);
            fill::observed(&mut row, &observed);
            self.faults = observed.faults;
        }
        let (learned, problem) = std::mem::take(&mut self.learned).finish();
        self.spent.learned = learned.work;
        fill::learned(&mut row, &learned, self.profile);
        self.tracked = learned.residuals;
        (row.status, row.status_reason) = self.verdict();
        if row.status == Status::Scored
            && let Some(problem) = problem
        {
            row.status = problem.status();
            row.status_reason = Some(problem.to_string());
        }
        if row.status == Status::Scored
            && self.profile.droid.is_some()
            && row.reproj_droid_px.is_none()
        {
            row.status = Status::Failed;
            row.status_reason = Some("3D consistency: nothing lies before the camera".into());
        }
        if row.status == Status::Scored && row.reproj_px.is_none() && row.aepe_px.is_none() {
            row.status = Status::Failed;
            row.status_reason = Some("no frame pair could be measured".into());
        }
        row
    }

    /// The pictures of the worst pair; none where no pair was measured.
    pub(super) fn thumbnails(&self) -> Option<Thumbnails> {
        let peak = self.peak.as_ref()?;
        match thumbnails(&peak.frame, &peak.heat) {
            Ok(pictures) => Some(pictures),
            Err(error) => {
                tracing::warn!(%error, "no thumbnail");
                None
            }
        }
    }

    fn verdict(&self) -> (Status, Option<String>) {
        let evidence: Vec<PairEvidence> = self
            .pairs
            .iter()
            .map(|pair| PairEvidence {
                frame: pair.frame,
                moving_fraction: pair.signals.moving_fraction.unwrap_or(0.0),
                consistent_fraction: pair.signals.in_frame_fraction
                    * (1.0 - pair.signals.occluded_fraction.unwrap_or(1.0)),
                corresponding_fraction: pair.corresponding_fraction,
            })
            .collect();
        let bad_frames = self.faults.points(FaultKind::BadFrame);
        verdict(
            self.usable_frames,
            &evidence,
            bad_frames,
            &self.profile.verdict,
        )
    }
}
