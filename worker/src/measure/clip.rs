//! The clip while its frames stream by, and its row at the end.
//!
//! Working frames have the profile's height with the aspect kept; errors are reported in pixels of
//! a 256-px-high picture. Frame indices are those of the input, 0-based.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use plumbline_common::message::Thumbnails;
use plumbline_common::row::{GeometryMethod, Measurement, Scene, Series, Status};
use plumbline_vision::consistency::{
    ConsistencyError, EndPointError, Evidence, GridFlow, NormalisedFrame, worldscore_epe,
};
use plumbline_vision::flow::dis::{Dis, DisFrame};
use plumbline_vision::flow::{Flow, FlowError};
use plumbline_vision::image::{Plane, Rgb8, resize_rgb};
use plumbline_vision::scene::{
    ClipGeometry, EdgeInput, RigidSolver, SceneError, SceneKind, TwoViewSolver, sample_grid,
};
use plumbline_vision::signals::PairSignals;

use super::assess::{assess, median};
use super::thumbnail::thumbnails;
use super::verdict::{PairEvidence, verdict};
use crate::decode::{DecodedFrame, VideoInfo};
use crate::profile::Profile;

/// Wider pictures would blow up at the working height; no camera makes them.
const MAX_ASPECT: usize = 8;

/// P and T of a clip are medians; fewer defined pairs are no evidence.
const MIN_DEFINED_PAIRS: usize = 3;

/// Weight of a correspondence whose forward and backward flow disagree utterly: not zero, since the
/// models must not be chosen on the consistent part alone.
const LEAST_WEIGHT: f64 = 1e-3;

/// Why a decoded clip cannot be measured.
#[derive(Debug, thiserror::Error)]
pub(super) enum ClipError {
    #[error("the picture is {width}×{height}, an aspect beyond {MAX_ASPECT}:1; crop it")]
    Aspect { width: usize, height: usize },
    #[error("optical flow at frame {frame}: {source}")]
    Flow { frame: u32, source: FlowError },
    #[error("consistency at frame {frame}: {source}")]
    Consistency {
        frame: u32,
        source: ConsistencyError,
    },
    #[error("geometry at frame {frame}: {source}")]
    Geometry { frame: u32, source: SceneError },
}

/// Wall time by stage.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Spent {
    pub(super) flow: Duration,
    pub(super) signals: Duration,
    pub(super) geometry: Duration,
}

/// A frame, prepared once for all pairs that it takes part in.
struct Prepared {
    index: u32,
    rgb: Rgb8,
    dis: DisFrame,
    normalised: NormalisedFrame,
}

/// One adjacent pair's numbers.
struct Pair {
    /// Index of the later frame.
    frame: u32,
    signals: PairSignals,
}

/// The worst pair so far, for the report's pictures.
struct Peak {
    error_px: f64,
    frame: Rgb8,
    heat: Plane,
}

/// Forward and backward flow between two frames, and how well they agree.
struct BothWays {
    forward: Flow,
    backward: Flow,
    end_point: EndPointError,
}

/// A clip being measured.
pub(super) struct Clip<'a> {
    profile: &'a Profile,
    dis: Dis,
    recent: VecDeque<Prepared>,
    usable_frames: u32,
    pairs: Vec<Pair>,
    solver: Option<TwoViewSolver>,
    geometry_problem: Option<SceneError>,
    peak: Option<Peak>,
    pub(super) spent: Spent,
}

impl<'a> Clip<'a> {
    pub(super) fn new(profile: &'a Profile) -> Self {
        let (solver, geometry_problem) = match TwoViewSolver::new(profile.two_view) {
            Ok(solver) => (Some(solver), None),
            Err(problem) => (None, Some(problem)),
        };
        Self {
            profile,
            dis: Dis::new(profile.flow.clone()),
            recent: VecDeque::new(),
            usable_frames: 0,
            pairs: Vec::new(),
            solver,
            geometry_problem,
            peak: None,
            spent: Spent::default(),
        }
    }

    /// Takes the next frame and measures it against the frames before.
    pub(super) fn push(&mut self, frame: DecodedFrame) -> Result<(), ClipError> {
        if frame.index < self.profile.conditioning_frames {
            return Ok(());
        }
        self.usable_frames += 1;
        let current = self.prepare(frame)?;
        let spans = self.profile.edge_spans.clone();
        let recent = std::mem::take(&mut self.recent);
        for earlier in &recent {
            let span = current.index - earlier.index;
            if spans.contains(&span) {
                let flows = self.flows(earlier, &current)?;
                if span == 1 {
                    self.photometric(earlier, &current, &flows)?;
                }
                self.geometric(earlier.index, current.index, &flows)?;
            }
        }
        self.recent = recent;
        let longest = spans.last().copied().unwrap_or(1) as usize;
        if self.recent.len() == longest {
            self.recent.pop_front();
        }
        self.recent.push_back(current);
        Ok(())
    }

    fn prepare(&mut self, frame: DecodedFrame) -> Result<Prepared, ClipError> {
        let (width, height) = (frame.rgb.width, frame.rgb.height);
        if width > MAX_ASPECT * height || height > MAX_ASPECT * width {
            return Err(ClipError::Aspect { width, height });
        }
        let working_height = self.profile.working_height_px as usize;
        let working_width = (width * working_height + height / 2) / height;
        let rgb = resize_rgb(&frame.rgb, working_width.max(1), working_height);
        let grey = rgb.grey();
        let started = Instant::now();
        let dis = DisFrame::new(&grey, &self.profile.flow).map_err(|source| ClipError::Flow {
            frame: frame.index,
            source,
        })?;
        self.spent.flow += started.elapsed();
        let normalised =
            NormalisedFrame::new(&grey, &self.profile.consistency).map_err(|source| {
                ClipError::Consistency {
                    frame: frame.index,
                    source,
                }
            })?;
        Ok(Prepared {
            index: frame.index,
            rgb,
            dis,
            normalised,
        })
    }

    fn flows(&mut self, earlier: &Prepared, later: &Prepared) -> Result<BothWays, ClipError> {
        let error = |source| ClipError::Flow {
            frame: later.index,
            source,
        };
        let started = Instant::now();
        let forward = self.dis.flow(&earlier.dis, &later.dis).map_err(error)?;
        let backward = self.dis.flow(&later.dis, &earlier.dis).map_err(error)?;
        self.spent.flow += started.elapsed();
        let started = Instant::now();
        let end_point = EndPointError::new(&forward, &backward, &self.profile.consistency)
            .map_err(|source| ClipError::Consistency {
                frame: later.index,
                source,
            })?;
        self.spent.signals += started.elapsed();
        Ok(BothWays {
            forward,
            backward,
            end_point,
        })
    }

    /// End-point errors and signals of an adjacent pair.
    fn photometric(
        &mut self,
        earlier: &Prepared,
        later: &Prepared,
        flows: &BothWays,
    ) -> Result<(), ClipError> {
        let error = |source| ClipError::Consistency {
            frame: later.index,
            source,
        };
        let started = Instant::now();
        let params = &self.profile.consistency;
        let worldscore = worldscore_epe(&flows.forward, &flows.backward).map_err(error)?;
        let forward = GridFlow::new(&flows.forward, params).map_err(error)?;
        let backward = GridFlow::new(&flows.backward, params).map_err(error)?;
        let evidence = Evidence::new(
            &forward,
            &backward,
            &earlier.normalised,
            &later.normalised,
            params,
        )
        .map_err(error)?;
        let signals = PairSignals::new(
            &evidence,
            &flows.end_point,
            &worldscore,
            params,
            &self.profile.signals,
        );
        let is_worst = |error_px: f64| {
            self.peak
                .as_ref()
                .is_none_or(|peak| error_px > peak.error_px)
        };
        if let Some(error_px) = signals.aepe_px.filter(|error_px| is_worst(*error_px)) {
            // The map of the way back lies on the later frame, which is the one shown.
            let back =
                EndPointError::new(&flows.backward, &flows.forward, params).map_err(error)?;
            self.peak = Some(Peak {
                error_px,
                frame: later.rgb.clone(),
                heat: Plane {
                    width: back.width,
                    height: back.height,
                    data: back
                        .error_px
                        .iter()
                        .map(|error| error.unwrap_or(0.0))
                        .collect(),
                },
            });
        }
        self.pairs.push(Pair {
            frame: later.index,
            signals,
        });
        self.spent.signals += started.elapsed();
        Ok(())
    }

    /// Motion models of one edge; each correspondence weighs by how well the two directions agree.
    fn geometric(&mut self, from: u32, to: u32, flows: &BothWays) -> Result<(), ClipError> {
        let Some(solver) = &mut self.solver else {
            return Ok(());
        };
        let started = Instant::now();
        let error = |source| ClipError::Geometry { frame: to, source };
        let width = flows.forward.width;
        let unit_px = self.profile.consistency.reference_height_px / flows.forward.height as f64;
        let weight_at = |x: usize, y: usize| {
            let error_px = f64::from(flows.end_point.error_px[y * width + x]?);
            Some((1.0 / (1.0 + error_px * error_px)).max(LEAST_WEIGHT))
        };
        let field =
            sample_grid(&flows.forward, unit_px, &self.profile.grid, weight_at).map_err(error)?;
        let edge = EdgeInput {
            from_frame: from as usize,
            to_frame: to as usize,
            field,
        };
        match solver.edge(edge) {
            // Too little in frame to judge this edge; the others may do.
            Ok(()) | Err(SceneError::TooFewCells { .. }) => {}
            Err(source) => return Err(error(source)),
        }
        self.spent.geometry += started.elapsed();
        Ok(())
    }

    /// The clip's row.
    pub(super) fn finish(&mut self, info: &VideoInfo) -> Measurement {
        let started = Instant::now();
        let geometry = match (self.solver.take(), self.geometry_problem.take()) {
            (Some(solver), _) => solver.finish(),
            (None, problem) => Err(problem.unwrap_or(SceneError::NoEdges)),
        };
        self.spent.geometry += started.elapsed();
        let (status, status_reason) = self.verdict();
        let mut row = Measurement::without_score(status, "");
        row.status_reason = status_reason;
        row.frames = Some(info.frames);
        row.fps = info.fps;
        row.width = Some(info.width);
        row.height = Some(info.height);
        row.duration_s = info.duration_s;
        self.fill_photometric(&mut row);
        if let Ok(geometry) = geometry {
            fill_geometric(&mut row, &geometry, self.profile.warmup_frames);
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
            })
            .collect();
        verdict(self.usable_frames, &evidence, &self.profile.verdict)
    }

    fn fill_photometric(&self, row: &mut Measurement) {
        let series = |value: fn(&PairSignals) -> Option<f64>| -> Vec<Option<f64>> {
            self.pairs.iter().map(|pair| value(&pair.signals)).collect()
        };
        row.series = Series {
            first_frame: self.pairs.first().map_or(0, |pair| pair.frame),
            aepe_px: series(|signals| signals.aepe_px),
            aepe_worldscore_px: series(|signals| signals.aepe_worldscore_px),
            reproj_px: vec![None; self.pairs.len()],
            reproj_cells: vec![0; self.pairs.len()],
            piecewise_residual: series(|signals| signals.piecewise_residual),
            appearance_ratio: series(|signals| signals.appearance_ratio),
            motion_px: series(|signals| signals.motion_px),
        };
        row.aepe_px = mean(&row.series.aepe_px);
        row.aepe_worldscore_px = mean(&row.series.aepe_worldscore_px);
        row.motion_px = mean(&row.series.motion_px);
        row.occluded_fraction = mean(&series(|signals| signals.occluded_fraction));
        row.piecewise_residual = median_of_defined(&row.series.piecewise_residual);
        row.appearance_ratio = median_of_defined(&row.series.appearance_ratio);
    }
}

fn fill_geometric(row: &mut Measurement, geometry: &ClipGeometry, warmup_frames: u32) {
    row.scene = Some(match geometry.scene {
        SceneKind::StaticCamera => Scene::StaticCamera,
        SceneKind::Rotation => Scene::Rotation,
        SceneKind::Parallax => Scene::Parallax,
    });
    row.reproj_method = Some(GeometryMethod::TwoViewGric);
    row.reproj_px = Some(geometry.residual_px);
    let first_frame = row.series.first_frame;
    let mut series = Vec::with_capacity(geometry.series.len());
    for residual in &geometry.series {
        let frame = residual.frame as u32;
        series.push((frame, residual.residual_px));
        let place = frame.checked_sub(first_frame).map(|place| place as usize);
        if let Some(place) = place.filter(|&place| place < row.series.reproj_px.len()) {
            row.series.reproj_px[place] = Some(residual.residual_px);
            row.series.reproj_cells[place] = u32::try_from(residual.cells).unwrap_or(u32::MAX);
        }
    }
    let assessment = assess(&series, warmup_frames);
    row.mean_error = assessment.mean_error;
    row.max_jump = assessment.max_jump;
    row.paper_peak_frame = assessment.peak_frame;
    row.peak_reliable = assessment.peak_reliable;
}

fn mean(values: &[Option<f64>]) -> Option<f64> {
    let defined = values.iter().flatten();
    let (sum, count) = defined.fold((0.0, 0usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    (count > 0).then(|| sum / count as f64)
}

fn median_of_defined(values: &[Option<f64>]) -> Option<f64> {
    let defined: Vec<f64> = values.iter().flatten().copied().collect();
    if defined.len() < MIN_DEFINED_PAIRS {
        None
    } else {
        median(&defined)
    }
}
