//! The story of `plumbline slam`: one video's camera trajectory and depths, and what they leave.
//!
//! OUT then holds `trajectory.txt` (TUM format: camera to world), `residuals.csv` (e_t), `edges.csv`,
//! where depths were estimated `depths.npz` (a NumPy archive: what is read most easily, and lossless), and
//! last `slam.json`, which is there exactly when everything else is.

use std::io::{self, Cursor};
use std::path::PathBuf;

use plumbline_vision::slam::se3::Se3;
use plumbline_vision::slam::trajectory::{AbsoluteError, TimedPose, absolute_error, to_tum};
use plumbline_worker::profile::Profile;
use plumbline_worker::slam::{DepthVerdict, SlamOutcome, Tracked};
use serde_json::{Value, json};

use crate::explain::{Claimed, OneVideo, RunError, claim};
use crate::fanout::Slots;
use crate::npz::Npz;
use crate::publish::OutDir;
use crate::run::unreadable;
use crate::stop::StopSignals;

/// The mark of a finished run.
const SLAM_FILE: &str = "slam.json";
const TRAJECTORY_FILE: &str = "trajectory.txt";
const DEPTHS_FILE: &str = "depths.npz";
const RESIDUALS_FILE: &str = "residuals.csv";
const EDGES_FILE: &str = "edges.csv";

/// A usable `plumbline slam`.
#[derive(Debug, Clone)]
pub struct SlamOptions {
    /// Which video.
    pub video: OneVideo,
    /// Where results go.
    pub out: PathBuf,
    /// How it is tracked.
    pub profile: Profile,
    /// The true trajectory, where there is one.
    pub truth: Option<Vec<TimedPose>>,
    /// Who computes; one slot is used.
    pub slots: Slots,
}

/// What came of it.
#[derive(Debug)]
pub struct SlamResult {
    /// Whether there is a trajectory.
    pub tracked: bool,
    /// What a person wants to know first, a line each.
    pub summary: Vec<String>,
    /// The content of `slam.json`.
    pub json: Value,
}

/// Tracks the camera of one video.
///
/// # Errors
/// [`RunError`]; `slam.json` is then absent.
pub async fn slam(options: &SlamOptions) -> Result<SlamResult, RunError> {
    let claimed = claim(&options.video, &options.out)?;
    for name in [
        SLAM_FILE,
        TRAJECTORY_FILE,
        DEPTHS_FILE,
        RESIDUALS_FILE,
        EDGES_FILE,
    ] {
        claimed.out.remove(name)?;
    }
    claimed.out.sweep_partials()?;
    let mut stop = StopSignals::listen();
    tokio::select! {
        result = slam_into(options, &claimed) => result,
        () = stop.recv() => Err(RunError::Interrupted),
    }
}

async fn slam_into(options: &SlamOptions, claimed: &Claimed) -> Result<SlamResult, RunError> {
    let Claimed { entry, out, .. } = claimed;
    let mut slot = options.slots.slot();
    let job = crate::measuring::job(entry, &options.profile).map_err(RunError::Profile)?;
    let outcome = match job {
        Some(job) => slot.track(&job).await?,
        None => {
            let row = unreadable(entry);
            SlamOutcome::Refused {
                status: row.status,
                reason: row.status_reason.unwrap_or_default(),
            }
        }
    };
    let about = json!({
        "plumbline_version": env!("CARGO_PKG_VERSION"),
        "video": entry.video,
        "profile": {
            "name": options.profile.name(),
            "digest": options.profile.digest().map_err(RunError::Profile)?,
        },
    });
    let (tracked, summary, result) = match &outcome {
        SlamOutcome::Refused { status, reason } => {
            let line = format!("{}: {reason}", status.as_str());
            let result = json!({"status": status.as_str(), "status_reason": reason});
            (false, vec![line], result)
        }
        SlamOutcome::Tracked(tracked) => {
            let (summary, result) = tell(options, tracked, out)?;
            (true, summary, result)
        }
    };
    let mut json = about;
    merge(&mut json, result);
    let text = serde_json::to_string_pretty(&json).map_err(RunError::Profile)?;
    out.put_atomic(SLAM_FILE, format!("{text}\n").as_bytes())?;
    Ok(SlamResult {
        tracked,
        summary,
        json,
    })
}

/// Puts the fields of one object behind those of another.
fn merge(into: &mut Value, fields: Value) {
    if let (Value::Object(into), Value::Object(fields)) = (into, fields) {
        into.extend(fields);
    }
}

/// Writes the files of a tracked video; gives what is to be said of it.
fn tell(
    options: &SlamOptions,
    tracked: &Tracked,
    out: &OutDir,
) -> Result<(Vec<String>, Value), RunError> {
    let trajectory = trajectory(tracked);
    let mut files = vec![TRAJECTORY_FILE, RESIDUALS_FILE, EDGES_FILE];
    out.put_atomic(TRAJECTORY_FILE, to_tum(&trajectory).as_bytes())?;
    out.put_atomic(RESIDUALS_FILE, residuals_csv(tracked).as_bytes())?;
    out.put_atomic(EDGES_FILE, edges_csv(tracked).as_bytes())?;
    if tracked.depth == DepthVerdict::Estimated {
        out.put_atomic_with(DEPTHS_FILE, |file| {
            let bytes = depths(tracked)?;
            Ok(file.write_all(&bytes)?)
        })?;
        files.push(DEPTHS_FILE);
    }
    files.push(SLAM_FILE);
    let error = options
        .truth
        .as_ref()
        .map(|truth| absolute_error(&trajectory, truth));
    let seconds = &tracked.seconds;
    let mut result = json!({
        "status": "tracked",
        "scene": tracked.scene,
        "depth": tracked.depth,
        "intrinsics_px": tracked.intrinsics,
        "intrinsics": tracked.intrinsics_origin,
        "focal_search": tracked.focal,
        "frames": tracked.info.frames,
        "width": tracked.info.width,
        "height": tracked.info.height,
        "fps": tracked.info.fps,
        "keyframes": tracked.keyframes.len(),
        "edges": tracked.edges.len(),
        "residual_px": tracked.residual_px,
        "observable_fraction": tracked.observable_fraction,
        "adjustment_steps": tracked.adjustment_steps,
        "converged": tracked.converged,
        "depth_cells": tracked.depth_cells,
        "depth_cells_saved": tracked.depth_cells_saved,
        "seconds": {
            "decode": seconds.decode,
            "flow": seconds.flow,
            "models": seconds.models,
            "adjustment": seconds.adjustment,
        },
        "files": files,
    });
    let mut summary = vec![story(tracked), camera_line(tracked)];
    match &error {
        None => {}
        Some(Ok(error)) => {
            summary.push(error_line(error));
            merge(&mut result, json!({"against_truth": error_json(error)}));
        }
        Some(Err(reason)) => {
            summary.push(format!("no comparison with the truth: {reason}"));
            merge(
                &mut result,
                json!({"against_truth": null, "against_truth_reason": reason.to_string()}),
            );
        }
    }
    summary.push(format!("results: {}", options.out.display()));
    Ok((summary, result))
}

fn story(tracked: &Tracked) -> String {
    let frames = tracked.poses.len();
    let residual = tracked
        .residual_px
        .map_or("-".to_owned(), |px| format!("{px:.2}"));
    let keyframes = tracked.keyframes.len();
    match tracked.depth {
        DepthVerdict::Estimated => format!(
            "the camera travels: {frames} poses, {keyframes} keyframes with depth, residual {residual} px (of a 256-px-high picture)"
        ),
        DepthVerdict::StaticCamera => format!(
            "static camera: no depth is estimated, all {frames} poses are the same; residual {residual} px"
        ),
        DepthVerdict::Rotation => format!(
            "the camera turns: no depth is estimated, {frames} rotations; residual {residual} px"
        ),
        DepthVerdict::NotObservable => format!(
            "the flow does not determine any depth: none is given, {frames} rotations; residual {residual} px"
        ),
    }
}

fn camera_line(tracked: &Tracked) -> String {
    let intrinsics = &tracked.intrinsics;
    let origin = tracked.intrinsics_origin.as_str();
    format!(
        "intrinsics ({origin}): fx {:.1}, fy {:.1}, cx {:.1}, cy {:.1} px",
        intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    )
}

fn error_line(error: &AbsoluteError) -> String {
    format!(
        "ATE {:.4} (RMSE, scale-aligned, in the truth's unit), mean {:.4}, max {:.4}, turns {:.2}°, {} poses",
        error.rmse,
        error.mean,
        error.max,
        error.rotation_rmse_rad.to_degrees(),
        error.pairs
    )
}

fn error_json(error: &AbsoluteError) -> Value {
    json!({
        "ate_rmse": error.rmse,
        "ate_mean": error.mean,
        "ate_max": error.max,
        "rotation_rmse_deg": error.rotation_rmse_rad.to_degrees(),
        "scale": error.truth_from_estimate.scale,
        "poses": error.pairs,
    })
}

/// Camera to world, by presentation time.
fn trajectory(tracked: &Tracked) -> Vec<TimedPose> {
    let timed = |&(frame, pose): &(u32, [f64; 7])| {
        Some(TimedPose {
            time_s: *tracked.times_s.get(frame as usize)?,
            world_from_camera: Se3::from_array(pose).inverse(),
        })
    };
    tracked.poses.iter().filter_map(timed).collect()
}

/// e_t: numbers in full, so that reading them back gives the same bits.
fn residuals_csv(tracked: &Tracked) -> String {
    let mut text = String::from("frame,time_s,residual_px,cells\n");
    for residual in &tracked.series {
        let time = tracked.times_s.get(residual.frame);
        let time = time.map_or(String::new(), f64::to_string);
        let (frame, px, cells) = (residual.frame, residual.residual_px, residual.cells);
        text.push_str(&format!("{frame},{time},{px},{cells}\n"));
    }
    text
}

fn edges_csv(tracked: &Tracked) -> String {
    let mut text = String::from("from_frame,to_frame,residual_px,cells\n");
    for edge in &tracked.edges {
        let px = edge.residual_px.map_or(String::new(), |px| px.to_string());
        text.push_str(&format!(
            "{},{},{px},{}\n",
            edge.from_frame, edge.to_frame, edge.cells
        ));
    }
    text
}

/// For K keyframes and a grid of R × C cells: `frame` `[K]`, `inverse_depth` `[K, R, C]` in the unit of
/// `trajectory.txt`, `observable` `[K, R, C]` (1 where the flows determine it), `log_deviation` `[K, R, C]`
/// (standard deviation of ln d; infinite where nothing is known), `cell_px` `[4]` (x and y of cell (0, 0),
/// then the cells' distance along x and y, px of the video), `intrinsics_px` `[4]` (fx, fy, cx, cy),
/// `camera_from_world` `[K, 7]` (t xyz, q xyzw).
fn depths(tracked: &Tracked) -> io::Result<Vec<u8>> {
    let mut npz = Npz::new(Cursor::new(Vec::new()));
    let keyframes = tracked.keyframes.len() as u64;
    let grid = [keyframes, tracked.grid.1 as u64, tracked.grid.0 as u64];
    npz.array("frame", &[keyframes], tracked.keyframes.iter().copied())?;
    let depths = tracked.inverse_depths.iter().copied();
    npz.array("inverse_depth", &grid, depths)?;
    let deviations = &tracked.relative_deviation;
    npz.array(
        "observable",
        &grid,
        deviations
            .iter()
            .map(|deviation| u8::from(deviation.is_some_and(|deviation| deviation <= 1.0))),
    )?;
    npz.array(
        "log_deviation",
        &grid,
        deviations
            .iter()
            .map(|deviation| deviation.unwrap_or(f32::INFINITY)),
    )?;
    npz.array("cell_px", &[4], tracked.grid_px)?;
    let camera = &tracked.intrinsics;
    npz.array(
        "intrinsics_px",
        &[4],
        [camera.fx, camera.fy, camera.cx, camera.cy],
    )?;
    let keyframe = |frame: &&(u32, [f64; 7])| tracked.keyframes.binary_search(&frame.0).is_ok();
    let poses = tracked.poses.iter().filter(keyframe);
    npz.array(
        "camera_from_world",
        &[keyframes, 7],
        poses.flat_map(|(_, pose)| *pose),
    )?;
    Ok(npz.finish()?.into_inner())
}
