//! Pictures that explain a measurement: heat maps over frames, and the whole clip with its residual.
//!
//! The clip is measured once more, the same way, while its frames are drawn: pictures show the very maps
//! behind the numbers. End-point errors are drawn in pixels of a 256-px-high picture on one fixed scale,
//! so that pictures of different videos compare; fault maps have no unit and a scale of their own.
//! Pictures hold no text from the video or its name.

mod canvas;
mod heat;
mod overlay;
pub mod plot;
mod scale;
pub mod scatter;

use std::ops::ControlFlow;
use std::path::Path;

use plumbline_common::message::Job;
use plumbline_vision::faults::{FaultEvent, FaultKind};
use plumbline_vision::image::{Plane, Rgb8};
use serde::{Deserialize, Serialize};

use crate::decode::DecodedFrame;
use crate::measure::{MeasureError, Models, View, measure_in_detail};
use crate::profile::Profile;
pub use canvas::{DrawError, FONT, load_font};

/// What a heat map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Subject {
    /// A detector's map; a freeze has none.
    Fault(FaultKind),
    /// The end-point error against the frame before.
    EndPointError,
    /// The paper's M_{i*}: what the best rigid camera and scene leave on the worst edge of the frame t*;
    /// shown on the frame whose cells the edge follows.
    RigidResidual,
}

/// Which pictures of which video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawJob {
    /// The video.
    pub job: Job,
    /// Heat maps, by subject and frame.
    pub heat_maps: Vec<(Subject, u32)>,
    /// Whether to draw every frame with its residual, too.
    pub overlay: bool,
    /// Faults marked in those frames.
    pub marked: Marked,
}

/// What the overlay marks.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Marked {
    /// The faults, the most severe first.
    pub events: Vec<FaultEvent>,
    /// Columns and rows of the grid that their places are on.
    pub grid_size: Option<(usize, usize)>,
    /// Presentation time of every frame, seconds.
    pub times_s: Vec<f64>,
    /// Later frame of the first pair.
    pub first_frame: u32,
    /// Mean end-point error of every pair from there on, px of a 256-px-high picture.
    pub aepe_px: Vec<Option<f64>>,
}

/// A finished picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// Which one.
    pub name: PictureName,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height, width, 3]`, sRGB.
    #[serde(with = "serde_bytes")]
    pub rgb: Vec<u8>,
}

/// Which picture of a [`DrawJob`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum PictureName {
    /// The heat map at this place of `heat_maps`.
    HeatMap(usize),
    /// The next frame of the overlay; they come in order and are all of one size.
    OverlayFrame,
}

impl Picture {
    /// Whether its bytes are as many as its size asks for.
    pub(crate) fn is_whole(&self) -> bool {
        let bytes = u64::from(self.width) * u64::from(self.height) * 3;
        bytes > 0 && self.rgb.len() as u64 == bytes
    }

    fn new(name: PictureName, drawn: Rgb8) -> Self {
        Self {
            name,
            width: drawn.width as u32,
            height: drawn.height as u32,
            rgb: drawn.data,
        }
    }
}

/// Why no picture was drawn.
#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    /// The job is wrong.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The drawing library failed.
    #[error(transparent)]
    Draw(#[from] DrawError),
    /// Nobody takes the pictures.
    #[error("a picture cannot be handed over: {0}")]
    HandOver(Box<dyn std::error::Error + Send + Sync>),
}

/// The value of the pair whose later frame is `frame`, in a series that begins at `first_frame`.
fn pair_value(series: &[Option<f64>], first_frame: u32, frame: u32) -> Option<f64> {
    *series.get(frame.checked_sub(first_frame)? as usize)?
}

/// A frame kept for a heat map.
struct Kept {
    frame: u32,
    time_s: f64,
    rgb: Rgb8,
    error_px: Option<Plane>,
}

/// Draws the pictures of `request` and hands each to `take`: overlay frames while the clip streams by,
/// heat maps after it. Gives the reason where the clip ended before its end.
///
/// # Errors
/// [`ExplainError`].
pub(crate) fn draw(
    request: &DrawJob,
    copy: Option<&Path>,
    models: &mut Models<'_>,
    take: &mut dyn FnMut(Picture) -> Result<(), Box<dyn std::error::Error + Send + Sync>>,
) -> Result<Option<String>, ExplainError> {
    let profile: Profile =
        serde_json::from_slice(&request.job.profile).map_err(MeasureError::from)?;
    let wanted_maps = request.heat_maps.iter().filter_map(|(subject, frame)| {
        let Subject::Fault(kind) = subject else {
            return None;
        };
        Some((*kind, *frame as usize))
    });
    let mut kept: Vec<Kept> = Vec::new();
    let mut failure = None;
    let mut on_frame = |decoded: DecodedFrame, error_px: Option<Plane>| {
        let result = if request.overlay {
            overlay::frame(&decoded, error_px.as_ref(), &request.marked)
                .map_err(ExplainError::from)
                .and_then(|drawn| {
                    take(Picture::new(PictureName::OverlayFrame, drawn))
                        .map_err(ExplainError::HandOver)
                })
        } else {
            Ok(())
        };
        let wanted = |(_, frame): &(Subject, u32)| *frame == decoded.index;
        if request.heat_maps.iter().any(wanted) {
            kept.push(Kept {
                frame: decoded.index,
                time_s: decoded.time_s,
                rgb: decoded.rgb,
                error_px,
            });
        }
        match result {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failure = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    let view = View {
        wanted_maps: wanted_maps.collect(),
        on_frame: &mut on_frame,
    };
    let detailed = measure_in_detail(&request.job, copy, models, Some(view))?;
    if let Some(failure) = failure {
        return Err(failure);
    }
    for (index, &(subject, frame)) in request.heat_maps.iter().enumerate() {
        let Some(shown) = kept.iter().find(|kept| kept.frame == frame) else {
            continue;
        };
        let drawn = match subject {
            Subject::EndPointError => match &shown.error_px {
                Some(error_px) => {
                    let series = &detailed.outcome.measurement.series;
                    let mean_px = pair_value(&series.aepe_px, series.first_frame, frame);
                    heat::end_point_error(frame, shown.time_s, &shown.rgb, error_px, mean_px)?
                }
                None => continue,
            },
            Subject::RigidResidual => match &detailed.worst_edge {
                Some(edge) => heat::rigid_residual(edge, shown.time_s, &shown.rgb)?,
                None => continue,
            },
            Subject::Fault(kind) => {
                let is_it = |map: &&plumbline_vision::faults::KeptMap| {
                    map.kind == kind && map.point.frame == frame as usize
                };
                let Some(map) = detailed.faults.kept_maps().iter().find(is_it) else {
                    continue;
                };
                heat::fault(map, shown.time_s, &shown.rgb, &profile)?
            }
        };
        take(Picture::new(PictureName::HeatMap(index), drawn)).map_err(ExplainError::HandOver)?;
    }
    let row = detailed.outcome.measurement;
    let whole = row.frames.is_some();
    Ok(row.status_reason.filter(|_| !whole))
}
