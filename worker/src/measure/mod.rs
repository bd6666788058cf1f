//! One video in, one row out.
//!
//! Frames stream through: decode, resize to the working size, optical flow to the frames before
//! (forward and backward), end-point errors and signals per adjacent pair, motion models per edge;
//! dense adjustment under parallax; then the clip's numbers and its verdict (design, section 4). Memory is bounded by a few frames
//! and, of each edge, its correspondences on the grid.

mod assess;
mod clip;
mod edges;
mod error;
mod fill;
pub mod frames;
mod geometry;
mod learned;
mod network_flow;
mod observers;
mod prepared;
pub(crate) mod read;
pub mod shape;
mod thumbnail;
mod verdict;

use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use plumbline_common::message::{Job, Outcome};
use plumbline_common::row::{Cost, Measurement, Status};

use plumbline_vision::faults::{FaultKind, FaultSeries};
use plumbline_vision::image::Plane;
use plumbline_vision::scene::AdjustedEdge;
use serde::{Deserialize, Serialize};

use crate::decode::{DecodeError, DecodedFrame, VideoInfo};
use crate::learned::{Loaded, ModelPlaces, Networks};
use crate::profile::Profile;
use clip::Clip;
use error::ClipError;
pub(crate) use prepared::working_picture;
use read::{Input, ReadError};

/// Why there is no outcome at all: the job itself is wrong.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The profile is not one of this build's.
    #[error(
        "the job's profile does not decode: {0}; coordinator and worker must be of one version"
    )]
    Profile(#[from] serde_json::Error),
}

/// An outcome with what a row has no room for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detailed {
    /// The same as without detail, bit for bit.
    pub outcome: Outcome,
    /// Presentation time of every decoded frame, seconds since the first.
    pub times_s: Vec<f64>,
    /// Every fault score; empty where no pair was measured.
    pub faults: FaultSeries,
    /// The edge of the paper's heat map: of those whose later frame is t*, the one of the largest mean
    /// residual.
    pub worst_edge: Option<AdjustedEdge>,
}

/// What is looked at while a clip is measured, for pictures of it.
pub(crate) struct View<'a> {
    /// Fault maps to keep.
    pub(crate) wanted_maps: Vec<(FaultKind, usize)>,
    /// Takes every frame, with its end-point error against the frame before where there is one (px of a
    /// 256-px-high picture, 0 where out of frame), and says whether to go on.
    pub(crate) on_frame: &'a mut dyn FnMut(DecodedFrame, Option<Plane>) -> ControlFlow<()>,
}

/// Measures one video. Whatever is wrong with the video becomes a typed row.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub fn measure(job: &Job) -> Result<Outcome, MeasureError> {
    let mut models = Models {
        loaded: &mut Loaded::default(),
        places: None,
    };
    measure_copy(job, None, &mut models)
}

/// The networks that a child has, and where it finds those that a job needs.
pub(crate) struct Models<'a> {
    pub(crate) loaded: &'a mut Loaded,
    pub(crate) places: Option<&'a ModelPlaces>,
}

/// As [`measure`]; an object by its copy on this machine.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub(crate) fn measure_copy(
    job: &Job,
    copy: Option<&Path>,
    models: &mut Models<'_>,
) -> Result<Outcome, MeasureError> {
    Ok(measured(job, copy, models, None, false)?.outcome)
}

/// Measures one video and gives what is behind the row, too; an object by its copy on this machine.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub(crate) fn measure_in_detail(
    job: &Job,
    copy: Option<&Path>,
    models: &mut Models<'_>,
    view: Option<View<'_>>,
) -> Result<Detailed, MeasureError> {
    measured(job, copy, models, view, true)
}

fn measured(
    job: &Job,
    copy: Option<&Path>,
    models: &mut Models<'_>,
    mut view: Option<View<'_>>,
    in_detail: bool,
) -> Result<Detailed, MeasureError> {
    let profile: Profile = serde_json::from_slice(&job.profile)?;
    let (started, cpu_started) = (Instant::now(), cpu_time());
    let (networks, missing) = match models.loaded.networks(&profile, models.places) {
        Ok(networks) => (networks, None),
        Err(error) => (Networks::default(), Some(error)),
    };
    let mut clip = Clip::new(&profile, networks);
    if in_detail {
        clip.keep_faults();
    }
    if let Some(view) = &mut view {
        clip.keep_views(std::mem::take(&mut view.wanted_maps));
    }
    let mut times_s = Vec::new();
    let mut cost = Cost::default();
    let input = Input::open(job, copy, &profile.limits);
    let measurement = match (&input, missing) {
        (Ok(_), Some(missing)) => Measurement::without_score(Status::Failed, missing.to_string()),
        (Ok(input), None) => {
            let mut row = match stream(input, &profile, &mut clip, &mut times_s, view) {
                Ok(info) => clip.finish(&info),
                Err(refused) => refused.row(),
            };
            row.digest = Some(input.digest.clone());
            row.bytes = Some(job.bytes_read());
            row
        }
        (Err(error), _) => error.row(job),
    };
    cost.total_s = started.elapsed().as_secs_f64();
    cost.cpu_s = cpu_time().saturating_sub(cpu_started).as_secs_f64();
    cost.flow_s = clip.search.spent.as_secs_f64();
    cost.signals_s = clip.spent.signals.as_secs_f64();
    cost.geometry_s = clip.spent.geometry.as_secs_f64();
    cost.flow_pairs = clip.search.work.pairs;
    cost.flow_pairs_saved = clip
        .search
        .work
        .pairs_in_full
        .saturating_sub(clip.search.work.pairs);
    cost.frames_repeated = clip.search.work.frames_repeated;
    cost.photometric_s = clip.spent.learned.photometric.as_secs_f64();
    cost.tracking_s = clip.spent.learned.tracking.as_secs_f64();
    cost.edge_updates = clip.spent.learned.edge_updates;
    cost.peak_memory_mib = peak_memory_mib();
    cost.adjustment_steps = clip.dense_work.steps as u64;
    cost.depth_cells = clip.dense_work.depth_cells as u64;
    cost.depth_cells_saved = clip.dense_work.depth_cells_saved as u64;
    let stages = [
        cost.flow_s,
        cost.signals_s,
        cost.geometry_s,
        cost.photometric_s,
        cost.tracking_s,
    ];
    cost.decode_s = (cost.total_s - stages.iter().sum::<f64>()).max(0.0);
    let worst_edge = clip.take_worst_edge(measurement.paper_peak_frame);
    Ok(Detailed {
        outcome: Outcome {
            video: job.video.clone(),
            measurement,
            cost,
            thumbnails: clip.thumbnails(),
        },
        times_s,
        faults: clip.take_faults(),
        worst_edge,
    })
}

/// Processor time of this process, over all threads.
fn cpu_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    Duration::try_from(clock_gettime(ClockId::ProcessCPUTime)).unwrap_or_default()
}

/// The most memory that this process has had so far, whatever video it was for; 0 where the system does not say.
fn peak_memory_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = peak.and_then(|peak| peak.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) / 1024
}

/// Why a readable video gives no numbers.
enum Refused {
    Decode(DecodeError),
    Clip(ClipError),
}

fn stream(
    input: &Input,
    profile: &Profile,
    clip: &mut Clip<'_>,
    times_s: &mut Vec<f64>,
    mut view: Option<View<'_>>,
) -> Result<VideoInfo, Refused> {
    check_length(input, profile)?;
    let mut refused = None;
    let info = input.decode(profile, &mut |frame| {
        times_s.push(frame.time_s);
        let shown = view.as_ref().map(|_| frame.clone());
        match clip.push(frame) {
            Ok(()) => match (&mut view, shown) {
                (Some(view), Some(shown)) => (view.on_frame)(shown, clip.take_error_px()),
                _ => ControlFlow::Continue(()),
            },
            Err(error) => {
                refused = Some(error);
                ControlFlow::Break(())
            }
        }
    });
    let info = match (info, refused) {
        (_, Some(error)) => return Err(Refused::Clip(error)),
        (Err(error), None) => return Err(Refused::Decode(error)),
        (Ok(info), None) => info,
    };
    if clip.need_second_look().map_err(Refused::Clip)? {
        second_look(input, profile, clip)?;
    }
    Ok(info)
}

/// Decodes the clip once more, for edges that turned out to need flows of their own: to keep the frames of a
/// long clip until that is known would take memory without bound.
fn second_look(input: &Input, profile: &Profile, clip: &mut Clip<'_>) -> Result<(), Refused> {
    let mut refused = None;
    let decoded = input.decode(profile, &mut |frame| match clip.push_again(&frame) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            refused = Some(error);
            ControlFlow::Break(())
        }
    });
    match refused {
        Some(error) => Err(Refused::Clip(error)),
        None => decoded.map(|_| ()).map_err(Refused::Decode),
    }
}

/// Counts the frames first where each takes minutes: a clip that is too long is refused at once.
fn check_length(input: &Input, profile: &Profile) -> Result<(), Refused> {
    let Some(droid) = &profile.droid else {
        return Ok(());
    };
    let counted = input.decode(profile, &mut |_| ControlFlow::Continue(()));
    let (frames, most) = (counted.map_err(Refused::Decode)?.frames, droid.most_frames);
    match frames > most {
        true => Err(Refused::Clip(ClipError::TooLong { frames, most })),
        false => Ok(()),
    }
}

impl Refused {
    fn row(&self) -> Measurement {
        match self {
            Self::Decode(error) => Measurement::without_score(status_of(error), error.to_string()),
            Self::Clip(error) => Measurement::without_score(error.status(), error.to_string()),
        }
    }
}

/// Status and reason of a video that does not decode.
pub(crate) fn refusal(error: &DecodeError) -> (Status, String) {
    (status_of(error), error.to_string())
}

impl ReadError {
    pub(crate) fn row(&self, job: &Job) -> Measurement {
        let status = match self {
            Self::Decode(error) => status_of(error),
            Self::Outside { .. } => Status::Undecodable,
            Self::Changed { .. } | Self::NotRead { .. } | Self::Profile(_) | Self::Models(_) => {
                Status::Failed
            }
        };
        let mut row = Measurement::without_score(status, self.to_string());
        row.bytes = Some(job.bytes_read());
        row
    }
}

fn status_of(error: &DecodeError) -> Status {
    match error {
        DecodeError::OverLimit { .. } => Status::OverLimit,
        DecodeError::Io { .. } | DecodeError::InvalidRate { .. } | DecodeError::OutOfMemory => {
            Status::Failed
        }
        DecodeError::Undecodable { .. }
        | DecodeError::NoVideoStream
        | DecodeError::NotAVideo { .. }
        | DecodeError::Empty { .. } => Status::Undecodable,
    }
}
