//! `plumbline slam` in the compute child: one video in, its camera's trajectory out, and its depths
//! where they can be known.
//!
//! Frames stream by; only the pictures of the last few keyframes are kept. When all correspondences are
//! there, GRIC says what the camera did: for a camera that stands or turns no depth is estimated. Under
//! parallax, and where homographies suffice but rotations do not (a camera that travels before a plane),
//! the map is solved, and its own Hessian has the last word on whether depth was observable.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use plumbline_common::message::Job;
use plumbline_common::row::Status;
use plumbline_vision::flow::dis::{Dis, DisFrame};
use plumbline_vision::flow::{Flow, FlowError};
use plumbline_vision::scene::clip::FrameResidual;
use plumbline_vision::scene::{EdgeInput, RigidSolver, SceneError, SceneKind, TwoViewSolver};
use plumbline_vision::slam::flow_operator::{FlowOperator, FlowSource, grid_of};
use plumbline_vision::slam::intrinsics::{
    FocalEvidence, Intrinsics, IntrinsicsOrigin, focal_evidence,
};
use plumbline_vision::slam::se3::Se3;
use plumbline_vision::slam::tracker::{
    EdgeResidual, FlowGraph, FrontEnd, Solution, TrackError, rotate_only, series, solve,
};
use serde::{Deserialize, Serialize};

use crate::decode::{DecodedFrame, VideoInfo};
use crate::measure::read::Input;
use crate::measure::{MeasureError, refusal, working_picture};
use crate::profile::Profile;

/// A rotation that leaves more than this many times what a homography leaves on the widest pairs does not
/// explain the clip. (A wrong focal length costs a turning camera a few per cent.)
const ROTATION_EXPLAINS: f64 = 1.5;

/// What came of a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum SlamOutcome {
    /// It was tracked.
    Tracked(Box<Tracked>),
    /// It was not.
    Refused {
        /// As in a score row.
        status: Status,
        /// One sentence, with the remedy.
        reason: String,
    },
}

/// Whether depths were estimated, and why not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthVerdict {
    /// They were.
    Estimated,
    /// The camera stands still: all poses are the identity.
    StaticCamera,
    /// The camera turns: poses are rotations.
    Rotation,
    /// The camera seems to travel, but the flows do not determine any depth: poses are rotations.
    NotObservable,
}

/// A tracked video. Poses are `camera_from_world` (tx, ty, tz, qx, qy, qz, qw); lengths are in units of
/// the inverse of the median inverse depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tracked {
    /// What was decoded.
    pub info: VideoInfo,
    /// Presentation time of every frame, seconds.
    pub times_s: Vec<f64>,
    /// What the camera did, by the motion models.
    pub scene: SceneKind,
    /// Whether depths were estimated.
    pub depth: DepthVerdict,
    /// Intrinsics that were used, px of the video as decoded.
    pub intrinsics: Intrinsics,
    /// Where they come from.
    pub intrinsics_origin: IntrinsicsOrigin,
    /// What is known of the focal length, where it was looked for.
    pub focal: Option<FocalEvidence>,
    /// Pose of every frame.
    pub poses: Vec<(u32, [f64; 7])>,
    /// Input frame of every keyframe.
    pub keyframes: Vec<u32>,
    /// Columns and rows of the grid.
    pub grid: (usize, usize),
    /// Place of cell (0, 0) and distance of cells, px of the video as decoded: x, y, then along x, y.
    pub grid_px: [f64; 4],
    /// `[keyframes, rows, columns]`; empty where none were estimated.
    pub inverse_depths: Vec<f32>,
    /// Standard deviation of their logarithm, likewise; `None` where nothing is known.
    pub relative_deviation: Vec<Option<f32>>,
    /// Share of the cells whose depth is observable.
    pub observable_fraction: Option<f64>,
    /// What is left on every edge.
    pub edges: Vec<EdgeSummary>,
    /// Mean over all cells of all edges, px of a 256-px-high picture.
    pub residual_px: Option<f64>,
    /// The same by the later keyframe of the edges.
    pub series: Vec<FrameResidual>,
    /// Steps of all adjustments.
    pub adjustment_steps: usize,
    /// Whether the last refinement ended by its tolerance.
    pub converged: bool,
    /// Inverse depths that were estimated.
    pub depth_cells: usize,
    /// Inverse depths that did not have to be.
    pub depth_cells_saved: usize,
    /// Seconds by stage.
    pub seconds: StageSeconds,
}

/// Wall time by stage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StageSeconds {
    /// Reading, decoding, resizing.
    pub decode: f64,
    /// Optical flow.
    pub flow: f64,
    /// Motion models.
    pub models: f64,
    /// Adjustment, the search for the focal length included.
    pub adjustment: f64,
}

/// One edge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EdgeSummary {
    /// Frame whose cells are sought.
    pub from_frame: usize,
    /// Frame they are sought in.
    pub to_frame: usize,
    /// Mean residual, px of a 256-px-high picture; `None` where no cell stays in the picture.
    pub residual_px: Option<f64>,
    /// Cells behind it.
    pub cells: usize,
}

/// Tracks one video, an object by its copy on this machine.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub(crate) fn track(job: &Job, copy: Option<&Path>) -> Result<SlamOutcome, MeasureError> {
    let profile: Profile = serde_json::from_slice(&job.profile)?;
    let input = match Input::open(job, copy, &profile.limits) {
        Ok(input) => input,
        Err(error) => {
            let row = error.row(job);
            return Ok(SlamOutcome::Refused {
                status: row.status,
                reason: row.status_reason.unwrap_or_default(),
            });
        }
    };
    Ok(match Take::new(&profile).of(&input) {
        Ok(tracked) => SlamOutcome::Tracked(Box::new(tracked)),
        Err((status, reason)) => SlamOutcome::Refused { status, reason },
    })
}

/// Pictures of the frames that flows may still be asked for.
struct RecentFrames {
    dis: Dis,
    frames: VecDeque<(usize, DisFrame)>,
    flow_s: f64,
}

/// Why there is no flow.
#[derive(Debug, thiserror::Error)]
enum RecentError {
    #[error(transparent)]
    Flow(#[from] FlowError),
    #[error("the picture of frame {0} is no longer kept")]
    Forgotten(usize),
}

impl RecentFrames {
    fn frame(&self, index: usize) -> Result<&DisFrame, RecentError> {
        let kept = self.frames.iter().find(|(frame, _)| *frame == index);
        kept.map(|(_, picture)| picture)
            .ok_or(RecentError::Forgotten(index))
    }
}

impl FlowSource for RecentFrames {
    type Error = RecentError;

    fn flows(&mut self, first: usize, second: usize) -> Result<[Flow; 2], RecentError> {
        let started = Instant::now();
        let mut dis = std::mem::replace(&mut self.dis, Dis::new(Default::default()));
        let found = (|| {
            let (a, b) = (self.frame(first)?, self.frame(second)?);
            Ok([dis.flow(a, b)?, dis.flow(b, a)?])
        })();
        self.dis = dis;
        self.flow_s += started.elapsed().as_secs_f64();
        found
    }
}

/// Why a video was not tracked.
type Refused = (Status, String);

fn untracked(error: TrackError) -> Refused {
    let status = match &error {
        TrackError::TooLong { .. } => Status::OverLimit,
        _ => Status::Failed,
    };
    (status, error.to_string())
}

fn failed(error: impl std::fmt::Display) -> Refused {
    (Status::Failed, error.to_string())
}

/// A video being taken in.
struct Take<'a> {
    profile: &'a Profile,
    front_end: Option<FrontEnd<RecentFrames>>,
    /// Columns and rows of the pictures, as decoded and as worked on.
    sizes: [(usize, usize); 2],
    times_s: Vec<f64>,
    seconds: StageSeconds,
}

impl<'a> Take<'a> {
    fn new(profile: &'a Profile) -> Self {
        Self {
            profile,
            front_end: None,
            sizes: [(0, 0); 2],
            times_s: Vec::new(),
            seconds: StageSeconds::default(),
        }
    }

    fn of(mut self, input: &Input) -> Result<Tracked, Refused> {
        let started = Instant::now();
        let mut refused = None;
        let info = input.decode(self.profile, &mut |frame| match self.push(frame) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                refused = Some(error);
                ControlFlow::Break(())
            }
        });
        if let Some(refused) = refused {
            return Err(refused);
        }
        let info = info.map_err(|error| refusal(&error))?;
        let mut front_end = self.front_end.take().ok_or_else(too_short)?;
        self.seconds.flow = front_end.source_mut().flow_s;
        let graph = front_end.finish().map_err(untracked)?;
        self.seconds.decode = started.elapsed().as_secs_f64() - self.seconds.flow;
        if graph.edges.is_empty() {
            return Err(too_short());
        }
        self.solved(info, &graph)
    }

    fn push(&mut self, frame: DecodedFrame) -> Result<(), Refused> {
        let index = frame.index as usize;
        self.times_s.push(frame.time_s);
        let picture = working_picture(self.profile, &frame)
            .map_err(|error| (Status::OverLimit, error.to_string()))?;
        let step = self.profile.grid.step;
        let dis = &self.profile.flow;
        let prepared = DisFrame::new(&picture.grey(), dis).map_err(failed)?;
        self.sizes = [
            (frame.rgb.width, frame.rgb.height),
            (picture.width, picture.height),
        ];
        let front_end = self.front_end.get_or_insert_with(|| {
            let recent = RecentFrames {
                dis: Dis::new(dis.clone()),
                frames: VecDeque::new(),
                flow_s: 0.0,
            };
            let grid = grid_of(picture.width, picture.height, step);
            let operator = FlowOperator::new(recent, step);
            FrontEnd::new(operator, grid, self.profile.tracking.clone())
        });
        front_end.source_mut().frames.push_back((index, prepared));
        front_end.push(index).map_err(untracked)?;
        let needed = front_end.needed_from().unwrap_or(0);
        // The last frame stays: the end makes it a keyframe.
        let recent = &mut front_end.source_mut().frames;
        recent.retain(|(frame, _)| *frame >= needed);
        Ok(())
    }

    fn solved(mut self, info: VideoInfo, graph: &FlowGraph) -> Result<Tracked, Refused> {
        let started = Instant::now();
        let (scene, explained_px) = self.scene(graph)?;
        self.seconds.models = started.elapsed().as_secs_f64();
        let started = Instant::now();
        let params = &self.profile.tracking;
        let [video, working] = self.sizes;
        let step = self.profile.grid.step;
        let mut intrinsics = self
            .profile
            .intrinsics
            .unwrap_or_else(|| Intrinsics::prior(video.0, video.1));
        let mut origin = match self.profile.intrinsics {
            Some(_) => IntrinsicsOrigin::Given,
            None => IntrinsicsOrigin::Prior,
        };
        let camera = |intrinsics: &Intrinsics| intrinsics.on_grid(video, working, step);
        let mut focal = None;
        let mut map = None;
        let turned = match scene {
            SceneKind::StaticCamera => None,
            _ => Some(rotate_only(graph, camera(&intrinsics), params).map_err(failed)?),
        };
        // A homography also explains a camera that travels before a plane; a rotation does not.
        let turns = |turned: &Solution| {
            let widest = turned.residuals.iter();
            let widest = widest.filter(|r| self.is_widest(graph, r.source, r.target));
            let (sum_px, cells) = widest.fold((0.0, 0), |(sum, cells), r| {
                (sum + r.sum_px, cells + r.cells)
            });
            let least_px = explained_px.max(params.sigma_px);
            sum_px <= ROTATION_EXPLAINS * least_px * cells as f64
        };
        let travels = match scene {
            SceneKind::StaticCamera => false,
            SceneKind::Rotation => !turned.as_ref().is_some_and(turns),
            SceneKind::Parallax => true,
        };
        if travels {
            let mut found = solve(graph, camera(&intrinsics), params).map_err(failed)?;
            if origin == IntrinsicsOrigin::Prior {
                let evidence = focal_evidence(graph, &found, params).map_err(failed)?;
                focal = Some(evidence);
                if evidence.is_determined() {
                    intrinsics = intrinsics.with_focal_factor(evidence.factor);
                    origin = IntrinsicsOrigin::Refined;
                    found = solve(graph, camera(&intrinsics), params).map_err(failed)?;
                }
            }
            let known = found.observability(graph, params).map_err(failed)?;
            map = Some((found, known));
        }
        let observable_fraction = map.as_ref().map(|(_, known)| known.fraction());
        let depth = match (scene, observable_fraction) {
            (SceneKind::StaticCamera, _) => DepthVerdict::StaticCamera,
            (_, Some(share)) if share >= params.least_observable => DepthVerdict::Estimated,
            (_, Some(_)) => DepthVerdict::NotObservable,
            (_, None) => DepthVerdict::Rotation,
        };
        let (solution, relative_deviation) = match (map, turned) {
            (Some((solution, known)), _) if depth == DepthVerdict::Estimated => {
                (solution, known.relative_deviation)
            }
            (_, Some(turned)) => (turned, Vec::new()),
            (_, None) => (Solution::standing(graph, camera(&intrinsics)), Vec::new()),
        };
        self.seconds.adjustment = started.elapsed().as_secs_f64();
        let estimated = depth == DepthVerdict::Estimated;
        let cells = graph.frames.len() * graph.grid.cells();
        let first = (step / 2) as f64;
        let px = |working: usize, video: usize, at: f64| {
            (at + 0.5) * video as f64 / working as f64 - 0.5
        };
        let scale = |working: usize, video: usize| (step * video) as f64 / working as f64;
        let pose = |&(frame, pose): &(usize, Se3)| (frame as u32, pose.to_array());
        Ok(Tracked {
            info,
            times_s: self.times_s,
            scene,
            depth,
            intrinsics,
            intrinsics_origin: origin,
            focal,
            poses: solution.trajectory.iter().map(pose).collect(),
            keyframes: graph.frames.iter().map(|&frame| frame as u32).collect(),
            grid: (graph.grid.columns, graph.grid.rows),
            grid_px: [
                px(working.0, video.0, first),
                px(working.1, video.1, first),
                scale(working.0, video.0),
                scale(working.1, video.1),
            ],
            inverse_depths: match estimated {
                true => {
                    let depths = solution.scene.inverse_depths.iter();
                    depths.map(|&d| d as f32).collect()
                }
                false => Vec::new(),
            },
            relative_deviation,
            observable_fraction,
            edges: solution
                .residuals
                .iter()
                .map(|residual| summary(graph, residual))
                .collect(),
            residual_px: solution.mean_residual_px(),
            series: series(graph, &solution.residuals),
            adjustment_steps: solution.effort.steps,
            converged: solution.effort.converged,
            depth_cells: solution.effort.depth_cells,
            depth_cells_saved: if estimated { 0 } else { cells },
            seconds: self.seconds,
        })
    }

    /// Whether an edge goes from a keyframe to the last that it is joined to.
    fn is_widest(&self, graph: &FlowGraph, source: usize, target: usize) -> bool {
        let last = graph.frames.len() - 1;
        target > source && target == last.min(source + self.profile.tracking.span)
    }

    /// What the camera did, by the motion models on the widest pairs: from each keyframe to the last that
    /// it is joined to, since parallax grows with the distance while errors of the flow do not. Where the
    /// picture hardly moves there are few of them, and the frames between decide. With what that model
    /// leaves, px.
    fn scene(&self, graph: &FlowGraph) -> Result<(SceneKind, f64), Refused> {
        let mut solver = TwoViewSolver::new(self.profile.two_view).map_err(failed)?;
        let step = self.profile.grid.step;
        let few = graph.frames.len() <= self.profile.tracking.span + 1;
        let widest = graph.edges.iter();
        let widest = widest.filter(|e| self.is_widest(graph, e.source, e.target));
        let widest = widest.map(|e| (e.source, graph.frames[e.target], &e.answer));
        let between = graph.followers.iter().filter(|_| few);
        let between = between.map(|f| (f.keyframe, f.frame, &f.answer));
        for (keyframe, to_frame, answer) in widest.chain(between) {
            let judged = solver.edge(EdgeInput {
                from_frame: graph.frames[keyframe],
                to_frame,
                field: answer.field(graph.grid, step, self.sizes[1].1),
            });
            match judged {
                Ok(()) | Err(SceneError::TooFewCells { .. }) => {}
                Err(error) => return Err(failed(error)),
            }
        }
        match solver.finish() {
            Ok(geometry) => Ok((geometry.scene, geometry.residual_px)),
            Err(SceneError::NoEdges) => Err((
                Status::Collapsed,
                "no frame corresponds to the one before: cuts, or broken frames".into(),
            )),
            Err(error) => Err(failed(error)),
        }
    }
}

fn summary(graph: &FlowGraph, residual: &EdgeResidual) -> EdgeSummary {
    EdgeSummary {
        from_frame: graph.frames[residual.source],
        to_frame: graph.frames[residual.target],
        residual_px: residual.mean_px(),
        cells: residual.cells,
    }
}

fn too_short() -> Refused {
    (
        Status::TooShort,
        "a trajectory needs two frames or more".into(),
    )
}
