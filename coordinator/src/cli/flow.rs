//! `plumbline flow`: the optical flow of one pair of pictures, its time, and its error against ground
//! truth. Pixels are those of the pictures as given; nothing is resized.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use plumbline_vision::flow::accuracy::FlowAccuracy;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::flow::file::{FlowFileError, KnownFlow, MAX_PIXELS, kitti, middlebury};
use plumbline_vision::flow::{Flow, FlowError};
use plumbline_vision::image::{Plane, Rgb8};
use plumbline_vision::signals::median;
use plumbline_worker::decode::{DecodeError, DecodeLimits, LimitKind, decode_image};
use serde_json::{Value, json};

use super::{Failure, exit, print_json};
use crate::progress::say;
use crate::publish::out_dir::OutDir;
use plumbline_worker::settings::Settings;

/// Largest flow file that is read, bytes: the largest `.flo`.
const MAX_FLOW_BYTES: u64 = 12 + 8 * MAX_PIXELS;

/// Finds the optical flow from one picture to the next (Dense Inverse Search), one thread
#[derive(Debug, Args)]
pub(super) struct FlowArgs {
    /// First picture, png or jpeg
    #[arg(value_name = "FRAME1")]
    first: PathBuf,
    /// Second picture, of the same size
    #[arg(value_name = "FRAME2")]
    second: PathBuf,
    /// Where the flow goes: .flo (Middlebury) or .png (KITTI, 16 bits)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Ground truth to measure the error against: .flo or KITTI .png
    #[arg(long, value_name = "FILE")]
    gt: Option<PathBuf>,
    /// OpenCV's presets of the same name
    #[arg(long, value_enum, default_value = "medium")]
    preset: Preset,
    /// Scale at which the search stops, halvings of the picture [default: the preset's: 2, 2, 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=16))]
    finest_scale: Option<u32>,
    /// Timed runs of the pair
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeat: u32,
    /// Print the result as JSON on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Preset {
    /// No refinement
    Ultrafast,
    /// Refined, coarse
    Fast,
    /// Refined, one scale finer, denser patches
    Medium,
}

/// File formats of a flow, by the name's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FlowFormat {
    Middlebury,
    Kitti,
}

/// Milliseconds of the timed runs; a run prepares both frames and finds the flow.
struct PairTime {
    median_ms: f64,
    min_ms: f64,
}

pub(super) fn run(args: &FlowArgs) -> Result<u8, Failure> {
    let out_format = FlowFormat::of(&args.out)?;
    let params = args.params();
    let limits = Settings::load().map_err(Failure::usage)?.decode;
    let first = read_picture(&args.first, &limits)?;
    let second = read_picture(&args.second, &limits)?;
    let size = |width: usize, height: usize| format!("{width}x{height}");
    if (first.width, first.height) != (second.width, second.height) {
        return Err(Failure::usage(format!(
            "{} is {} but {} is {}; bring both pictures to one size",
            args.first.display(),
            size(first.width, first.height),
            args.second.display(),
            size(second.width, second.height),
        )));
    }
    let truth = args.gt.as_deref().map(read_flow).transpose()?;
    if let (Some(path), Some(truth)) = (&args.gt, &truth)
        && (truth.flow.width, truth.flow.height) != (first.width, first.height)
    {
        return Err(Failure::usage(format!(
            "{} holds a flow of {} but the pictures are {}; give the ground truth of this very pair",
            path.display(),
            size(truth.flow.width, truth.flow.height),
            size(first.width, first.height),
        )));
    }

    let (flow, time) = find(&first.grey(), &second.grey(), &params, args.repeat)
        .map_err(|error| cannot_find(&args.first, &error))?;
    let accuracy = match &truth {
        Some(truth) => FlowAccuracy::new(&flow, truth).map_err(Failure::usage)?,
        None => None,
    };
    let flow = KnownFlow::dense(flow);
    write_flow(&args.out, out_format, &flow)?;
    tell(
        args,
        &params,
        &flow.flow,
        &time,
        truth.is_some(),
        accuracy.as_ref(),
    );
    if args.json {
        let result = json(args, &params, &flow.flow, &time, accuracy.as_ref());
        print_json(&result, &args.out)?;
    }
    Ok(exit::OK)
}

impl FlowArgs {
    fn params(&self) -> DisParams {
        let mut params = match self.preset {
            Preset::Ultrafast => DisParams::ultrafast(2),
            Preset::Fast => DisParams::fast(),
            Preset::Medium => DisParams::medium(),
        };
        if let Some(finest_scale) = self.finest_scale {
            params.finest_scale = finest_scale;
        }
        params
    }
}

impl FlowFormat {
    fn of(path: &Path) -> Result<Self, Failure> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("flo") => Ok(Self::Middlebury),
            Some("png") => Ok(Self::Kitti),
            _ => Err(Failure::usage(format!(
                "{}: the name tells no flow format; end it in .flo (Middlebury) or .png (KITTI)",
                path.display()
            ))),
        }
    }
}

fn read_picture(path: &Path, limits: &DecodeLimits) -> Result<Rgb8, Failure> {
    decode_image(path, limits).map_err(|error| match error {
        DecodeError::OverLimit { what, value, limit } => {
            let (unit, setting) = match what {
                LimitKind::PixelsPerFrame => ("pixels", "max_pixels_per_frame"),
                _ => ("bytes", "max_bytes"),
            };
            Failure::usage(format!(
                "{} has {value} {unit}, over the limit of {limit}; scale it down or raise {setting} in plumbline.toml ([decode])",
                path.display()
            ))
        }
        other => Failure::usage(other),
    })
}

fn read_flow(path: &Path) -> Result<KnownFlow, Failure> {
    let format = FlowFormat::of(path)?;
    let unreadable = |error: std::io::Error| {
        Failure::usage(format!(
            "{}: {error}; check that the file exists and may be read",
            path.display()
        ))
    };
    let metadata = fs::metadata(path).map_err(unreadable)?;
    if !metadata.is_file() || metadata.len() > MAX_FLOW_BYTES {
        return Err(Failure::usage(format!(
            "{}: no regular file of at most {MAX_FLOW_BYTES} bytes, as every flow is; check the path",
            path.display()
        )));
    }
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(MAX_FLOW_BYTES).read_to_end(&mut bytes))
        .map_err(unreadable)?;
    let flow = match format {
        FlowFormat::Middlebury => middlebury::decode(&bytes),
        FlowFormat::Kitti => kitti::decode(&bytes),
    };
    flow.map_err(|error| Failure::usage(format!("{} {error}", path.display())))
}

fn write_flow(path: &Path, format: FlowFormat, flow: &KnownFlow) -> Result<(), Failure> {
    let bytes = match format {
        FlowFormat::Middlebury => middlebury::encode(flow),
        FlowFormat::Kitti => kitti::encode(flow),
    };
    let bytes = bytes.map_err(|error| match error {
        FlowFileError::OutOfRange { .. } => Failure::usage(format!("{}: {error}", path.display())),
        other => Failure::stopped(format!("{}: {other}", path.display())),
    })?;
    let directory = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
        return Err(Failure::usage(format!(
            "{}: the name is not UTF-8; choose another --out",
            path.display()
        )));
    };
    OutDir::create(directory)
        .and_then(|out| out.put_atomic(name, &bytes))
        .map_err(|error| Failure::stopped(format!("{}: {error}", path.display())))
}

/// The flow, and the time of `repeat` runs. The first run also fills the buffers that later ones reuse.
fn find(
    first: &Plane,
    second: &Plane,
    params: &DisParams,
    repeat: u32,
) -> Result<(Flow, PairTime), FlowError> {
    let mut dis = Dis::new(params.clone());
    let mut flow = Flow::default();
    let mut times_ms = Vec::new();
    for _ in 0..repeat {
        let start = Instant::now();
        let frames = [
            DisFrame::new(first, params)?,
            DisFrame::new(second, params)?,
        ];
        dis.flow_into(&frames[0], &frames[1], &mut flow)?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    let time = PairTime {
        median_ms: median(&mut times_ms).unwrap_or(f64::INFINITY),
        min_ms: times_ms.iter().copied().fold(f64::INFINITY, f64::min),
    };
    Ok((flow, time))
}

fn cannot_find(first: &Path, error: &FlowError) -> Failure {
    let remedy = match error {
        FlowError::TooSmall { patch_size, .. } => {
            format!("; give pictures of at least {patch_size}x{patch_size}")
        }
        _ => String::new(),
    };
    Failure::usage(format!("{}: {error}{remedy}", first.display()))
}

fn preset_name(preset: Preset) -> String {
    preset
        .to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned())
}

/// The result in words, on standard error.
fn tell(
    args: &FlowArgs,
    params: &DisParams,
    flow: &Flow,
    time: &PairTime,
    has_truth: bool,
    accuracy: Option<&FlowAccuracy>,
) {
    say(&format!(
        "{}: {}x{}, {} at finest scale {}",
        args.out.display(),
        flow.width,
        flow.height,
        preset_name(args.preset),
        params.finest_scale
    ));
    say(&format!(
        "time per pair: median {:.3} ms, min {:.3} ms of {} (both frames prepared, one thread)",
        time.median_ms, time.min_ms, args.repeat
    ));
    match accuracy {
        Some(accuracy) => say(&format!(
            "end-point error: mean {:.4} px; above 1 px {:.2}%, above 3 px {:.2}%, Fl-all {:.2}% of {} known pixels",
            accuracy.mean_epe_px,
            100.0 * accuracy.outlier_share_1px,
            100.0 * accuracy.outlier_share_3px,
            100.0 * accuracy.fl_all_share,
            accuracy.known_pixels
        )),
        None if has_truth => say("end-point error: none, the ground truth knows no pixel"),
        None => {}
    }
}

fn json(
    args: &FlowArgs,
    params: &DisParams,
    flow: &Flow,
    time: &PairTime,
    accuracy: Option<&FlowAccuracy>,
) -> Value {
    json!({
        "out": args.out.to_string_lossy(),
        "width": flow.width,
        "height": flow.height,
        "preset": preset_name(args.preset),
        "finest_scale": params.finest_scale,
        "repeat": args.repeat,
        "pair_ms_median": time.median_ms,
        "pair_ms_min": time.min_ms,
        "accuracy": accuracy.map(|accuracy| json!({
            "known_pixels": accuracy.known_pixels,
            "mean_epe_px": accuracy.mean_epe_px,
            "outlier_share_1px": accuracy.outlier_share_1px,
            "outlier_share_3px": accuracy.outlier_share_3px,
            "fl_all_share": accuracy.fl_all_share,
        })),
    })
}
