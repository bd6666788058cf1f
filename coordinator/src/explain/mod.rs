//! The story of `plumbline explain`: measure one video as `score` does, draw it, write it down.
//!
//! The numbers come from the same compute child and the same code as a score row and are equal to it,
//! bit for bit. `explain.json` disappears first and is written last, so that it is there exactly when
//! everything else is.

mod document;
mod series;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use plumbline_common::row::{Measurement, Status};
use plumbline_vision::faults::{FaultEvent, FaultKind, FaultSeries};
use plumbline_vision::image::Rgb8;
use plumbline_vision::scene::AdjustedEdge;
use plumbline_worker::child::{ComputeSlot, Drawing, SlotError};
use plumbline_worker::encode::{EncodeError, Mp4Writer};
use plumbline_worker::explain::{DrawError, DrawJob, Marked, Picture, PictureName, Subject};
use plumbline_worker::measure::Detailed;
use plumbline_worker::profile::Profile;

use crate::corpus::{self, Choice, CorpusError, Entry};
use crate::fanout::Slots;
use crate::lease::Lease;
use crate::picture::{self, PngError};
use crate::publish::{CORPUS_FILE, OutDir, PublishError};
use crate::run::{STATE_DIRECTORY, unreadable};
use crate::stop::StopSignals;
use crate::thresholds::FaultCalibration;

/// The mark of a finished explanation.
const EXPLAIN_FILE: &str = "explain.json";
const FAULTS_FILE: &str = "faults.json";
const SERIES_CSV: &str = "series.csv";
const SERIES_PNG: &str = "series.png";
const OVERLAY_FILE: &str = "overlay.mp4";
/// Where heat maps are.
pub(crate) const HEAT_MAP_DIRECTORY: &str = "heatmaps";

/// Faults drawn, the most severe first: a broken clip has dozens, and who looks wants the worst.
const DRAWN_FAULTS: usize = 8;

/// Rate of the overlay where the video has none (a single frame).
const DEFAULT_FPS: f64 = 10.0;

/// The video of a command on one.
#[derive(Debug, Clone)]
pub struct OneVideo {
    /// The video, or a source that holds it, as typed.
    pub source: String,
    /// Its name among those of the source, where that holds several.
    pub name: Option<String>,
}

/// A usable `plumbline explain`.
#[derive(Debug, Clone)]
pub struct ExplainOptions {
    /// Which video.
    pub video: OneVideo,
    /// Where results go.
    pub out: PathBuf,
    /// How it is measured.
    pub profile: Profile,
    /// Where its fault thresholds come from, if not from the profile.
    pub fault_calibration: Option<FaultCalibration>,
    /// Who computes; one slot is used.
    pub slots: Slots,
}

/// An explained video.
#[derive(Debug)]
pub struct Explained {
    /// Where it is.
    pub out: PathBuf,
    /// The row's part that does not depend on a corpus.
    pub measured: Measurement,
    /// Its faults, the most severe first.
    pub faults: Vec<FaultEvent>,
    /// Presentation time of every frame, seconds.
    pub times_s: Vec<f64>,
    /// Why pictures are missing, where some are.
    pub undrawn: Option<String>,
    /// The content of `explain.json`.
    pub json: String,
}

impl Explained {
    /// Whether the video is judged and every picture drawn.
    #[must_use]
    pub fn complete(&self) -> bool {
        matches!(self.measured.status, Status::Scored | Status::Static) && self.undrawn.is_none()
    }

    /// What a person wants to know first, a line each.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        document::summary(self)
    }
}

/// Why nothing came of a command on one video.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The video is not there.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// Several videos.
    #[error("{source_text}: holds {videos} videos; name one of them by --video, as {first}")]
    NotOne {
        /// As typed.
        source_text: String,
        /// How many.
        videos: usize,
        /// The name of the first.
        first: String,
    },
    /// No video of that name.
    #[error("{source_text}: holds no video named {name}, but {videos} others, such as {first}")]
    NoSuchVideo {
        /// As typed.
        source_text: String,
        /// As typed.
        name: String,
        /// How many there are.
        videos: usize,
        /// The name of the first.
        first: String,
    },
    /// OUT belongs to a run of `score`.
    #[error("{out}: holds the results of a score run; choose another --out")]
    ScoresThere {
        /// OUT.
        out: String,
    },
    /// Another run writes to the same place.
    #[error("{out}: another plumbline run is writing there; wait for it or choose another --out")]
    OutInUse {
        /// OUT.
        out: String,
    },
    /// The profile cannot be written down.
    #[error("the profile cannot be encoded: {0}")]
    Profile(serde_json::Error),
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// A picture does not encode.
    #[error(transparent)]
    Png(#[from] PngError),
    /// The plot cannot be drawn.
    #[error(transparent)]
    Draw(#[from] DrawError),
    /// The overlay does not encode.
    #[error(transparent)]
    Overlay(#[from] EncodeError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted before everything was written; run the same command again")]
    Interrupted,
}

/// Explains one video.
///
/// # Errors
/// [`RunError`]; `explain.json` is then absent.
pub async fn explain(options: &ExplainOptions) -> Result<Explained, RunError> {
    let Claimed { entry, out, _lease } = claim(&options.video, &options.out)?;
    clear(&out)?;

    let mut stop = StopSignals::listen();
    tokio::select! {
        explained = explain_into(options, &entry, &out) => explained,
        () = stop.recv() => Err(RunError::Interrupted),
    }
}

/// The one video of a command, and the place for its results, which is this run's alone.
pub(crate) struct Claimed {
    pub(crate) entry: Entry,
    pub(crate) out: OutDir,
    pub(crate) _lease: Lease,
}

/// Finds the video and takes hold of OUT.
pub(crate) fn claim(video: &OneVideo, out: &Path) -> Result<Claimed, RunError> {
    let entry = the_video(video, out)?;
    let out_name = || out.display().to_string();
    let directory = OutDir::create(out)?;
    if directory.root().join(CORPUS_FILE).exists() {
        return Err(RunError::ScoresThere { out: out_name() });
    }
    let state = OutDir::create(out.join(STATE_DIRECTORY))?;
    let lease = Lease::take(&state)?.ok_or_else(|| RunError::OutInUse { out: out_name() })?;
    Ok(Claimed {
        entry,
        out: directory,
        _lease: lease,
    })
}

fn the_video(video: &OneVideo, out: &Path) -> Result<Entry, RunError> {
    let sources = [video.source.clone()];
    let mut entries = corpus::freeze(&sources, &Choice::default(), out)?.entries;
    let videos = entries.len();
    // A frozen corpus is not empty.
    let first = entries.first().map(|entry| entry.video.to_string());
    let (source_text, first) = (video.source.clone(), first.unwrap_or_default());
    match &video.name {
        Some(name) => {
            let found = entries
                .into_iter()
                .find(|entry| entry.video.as_str() == *name);
            found.ok_or_else(|| RunError::NoSuchVideo {
                source_text,
                name: name.clone(),
                videos,
                first,
            })
        }
        None => match entries.pop() {
            Some(entry) if entries.is_empty() => Ok(entry),
            _ => Err(RunError::NotOne {
                source_text,
                videos,
                first,
            }),
        },
    }
}

/// Removes what an earlier explanation left, its mark first.
fn clear(out: &OutDir) -> Result<(), PublishError> {
    for name in [
        EXPLAIN_FILE,
        FAULTS_FILE,
        SERIES_CSV,
        SERIES_PNG,
        OVERLAY_FILE,
    ] {
        out.remove(name)?;
    }
    out.sweep_partials()?;
    for name in picture::videos_left_in(out)?
        .into_iter()
        .chain(picture::heat_maps_in(out)?)
    {
        out.remove(&name)?;
    }
    Ok(())
}

async fn explain_into(
    options: &ExplainOptions,
    entry: &Entry,
    out: &OutDir,
) -> Result<Explained, RunError> {
    let mut slot = options.slots.slot();
    let job = crate::measuring::job(entry, &options.profile).map_err(RunError::Profile)?;
    let Detailed {
        outcome,
        times_s,
        faults,
        worst_edge,
    } = match &job {
        Some(job) => slot.measure_in_detail(job).await?,
        None => unread(entry),
    };
    let measured = outcome.measurement;
    let events = match measured.fault_frames {
        Some(_) => faults.events(&options.profile.fault_thresholds),
        None => Vec::new(),
    };
    let plan = Plan::new(&measured, &events, worst_edge.as_ref());
    let mut files = Vec::new();
    let mut undrawn = None;
    if let Some(job) = job.filter(|_| measured.frames.is_some()) {
        let request = DrawJob {
            job,
            heat_maps: plan.heat_maps.iter().map(|map| map.what).collect(),
            overlay: true,
            marked: Marked {
                events: events.clone(),
                grid_size: faults.grid_size,
                times_s: times_s.clone(),
                first_frame: measured.series.first_frame,
                aepe_px: measured.series.aepe_px.clone(),
            },
        };
        undrawn = draw(&mut slot, &request, &plan, &measured, out, &mut files).await?;
    }
    if !times_s.is_empty() {
        let table = series::Table {
            measured: &measured,
            faults: &faults,
            thresholds: &options.profile.fault_thresholds,
            times_s: &times_s,
        };
        out.put_atomic(SERIES_CSV, &table.csv())?;
        let plot = table.plot()?;
        out.put_atomic(SERIES_PNG, &picture::png(&plot)?)?;
        files.extend([SERIES_CSV.to_owned(), SERIES_PNG.to_owned()]);
    }
    files.extend([FAULTS_FILE.to_owned(), EXPLAIN_FILE.to_owned()]);
    let story = document::Story {
        options,
        entry,
        measured: &measured,
        events: &events,
        grid_size: faults.grid_size,
        times_s: &times_s,
        plan: &plan,
        files: &files,
        undrawn: undrawn.as_deref(),
    };
    let pretty =
        |value: &serde_json::Value| serde_json::to_string_pretty(value).map_err(RunError::Profile);
    out.put_atomic(
        FAULTS_FILE,
        format!("{}\n", pretty(&story.faults())?).as_bytes(),
    )?;
    let json = pretty(&story.explanation().map_err(RunError::Profile)?)?;
    out.put_atomic(EXPLAIN_FILE, format!("{json}\n").as_bytes())?;
    Ok(Explained {
        out: options.out.clone(),
        measured,
        faults: events,
        times_s,
        undrawn,
        json,
    })
}

/// What an entry that cannot be looked at gives.
fn unread(entry: &Entry) -> Detailed {
    Detailed {
        outcome: plumbline_common::message::Outcome {
            video: entry.video.clone(),
            measurement: unreadable(entry),
            cost: plumbline_common::row::Cost::default(),
            thumbnails: None,
        },
        times_s: Vec::new(),
        faults: FaultSeries::default(),
        worst_edge: None,
    }
}

/// A heat map to draw.
struct HeatMap {
    what: (Subject, u32),
    file: String,
    /// Which of the faults, if one.
    fault: Option<usize>,
}

/// The heat maps of an explanation: the most severe faults, the worst end-point error, and the paper's own
/// (the worst edge of its peak frame).
struct Plan {
    heat_maps: Vec<HeatMap>,
    /// Frame and mean end-point error of the worst pair.
    worst_pair: Option<(u32, f64)>,
    /// i*: from frame, to frame, and mean residual of the worst edge of the paper's peak frame.
    worst_edge: Option<(usize, usize, Option<f64>)>,
}

impl Plan {
    fn new(
        measured: &Measurement,
        events: &[FaultEvent],
        worst_edge: Option<&AdjustedEdge>,
    ) -> Self {
        let has_map = |event: &FaultEvent| event.kind != FaultKind::Freeze;
        let faults = events.iter().enumerate();
        let drawn = faults
            .filter(|(_, event)| has_map(event))
            .take(DRAWN_FAULTS);
        let mut heat_maps: Vec<HeatMap> = drawn
            .enumerate()
            .map(|(place, (fault, event))| HeatMap {
                what: (Subject::Fault(event.kind), event.frame as u32),
                file: picture::heat_map_name(place + 1, event.kind.as_str(), event.frame as u32),
                fault: Some(fault),
            })
            .collect();
        let worst_pair = picture::worst_pair(measured);
        if let Some((frame, _)) = worst_pair {
            heat_maps.push(HeatMap {
                what: (Subject::EndPointError, frame),
                file: picture::heat_map_name(heat_maps.len() + 1, "end_point_error", frame),
                fault: None,
            });
        }
        if let (Some(edge), Some(peak)) = (worst_edge, measured.paper_peak_frame) {
            heat_maps.push(HeatMap {
                what: (Subject::RigidResidual, edge.from_frame as u32),
                file: picture::heat_map_name(heat_maps.len() + 1, "rigid_residual", peak),
                fault: None,
            });
        }
        Self {
            heat_maps,
            worst_pair,
            worst_edge: worst_edge.map(|edge| (edge.from_frame, edge.to_frame, edge.mean_px())),
        }
    }
}

/// Draws and writes the pictures; gives the reason where some are missing.
async fn draw(
    slot: &mut ComputeSlot,
    request: &DrawJob,
    plan: &Plan,
    measured: &Measurement,
    out: &OutDir,
    files: &mut Vec<String>,
) -> Result<Option<String>, RunError> {
    let mut overlay: Option<Mp4Writer> = None;
    let mut write = |picture: Picture| -> Result<(), RunError> {
        let rgb = Rgb8 {
            width: picture.width as usize,
            height: picture.height as usize,
            data: picture.rgb,
        };
        match picture.name {
            PictureName::HeatMap(place) => {
                let Some(map) = plan.heat_maps.get(place) else {
                    return Ok(());
                };
                out.put_atomic(&map.file, &picture::png(&rgb)?)?;
                files.push(map.file.clone());
                Ok(())
            }
            PictureName::OverlayFrame => {
                let writer = match &mut overlay {
                    Some(writer) => writer,
                    None => overlay.insert(Mp4Writer::create(
                        &out.root().join(OVERLAY_FILE),
                        picture.width,
                        picture.height,
                        measured.fps.unwrap_or(DEFAULT_FPS),
                    )?),
                };
                Ok(writer.push(&rgb)?)
            }
        }
    };
    let mut failure = None;
    let mut take = |picture| match write(picture) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            failure = Some(error);
            ControlFlow::Break(())
        }
    };
    let drawing = slot.draw(request, &mut take).await?;
    if let Some(failure) = failure {
        return Err(failure);
    }
    match drawing {
        Drawing::Missing(reason) => Ok(Some(reason)),
        Drawing::Whole | Drawing::Stopped => {
            if let Some(writer) = overlay {
                writer.finish()?;
                files.push(OVERLAY_FILE.to_owned());
            }
            Ok(None)
        }
    }
}
