//! How far a point is from the truth of rendered scenes: flow, camera, depth.
//!
//! Flow: mean end-point error against the exact flow, over the pixels that are visible in both pictures, and
//! over those of them that move, px of a 256-px-high picture. Camera: absolute trajectory error of travelling
//! cameras after the similarity that makes it least, in percent of the length of the true path. Depth: median
//! |d/d̂ − 1| over the cells that the adjustment calls observable, after the one scale of the clip that makes
//! it right in the median. The camera's intrinsics are given.

use std::collections::HashMap;
use std::sync::Arc;

use plumbline_common::id::VideoId;
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::render::Camera;
use plumbline_sample::{FlowTruth, SampleError};
use plumbline_vision::flow::accuracy::FlowAccuracy;
use plumbline_vision::flow::dis::{Dis, DisFrame};
use plumbline_vision::flow::file::KnownFlow;
use plumbline_vision::flow::{Flow, FlowError};
use plumbline_vision::image::{Rgb8, resize_rgb};
use plumbline_vision::slam::intrinsics::Intrinsics;
use plumbline_worker::profile::Profile;
use plumbline_worker::slam::SlamOutcome;
use serde::{Deserialize, Serialize};

use super::camera::camera_errors;
use super::known::Rendered;
use super::rendered::profile_for;
use super::{TradeoffError, TradeoffOptions};
use crate::fanout::{Fanout, Tracking};
use crate::measuring;
use crate::run::RunError;

/// Earlier frames of the pairs whose flow is compared, of clips of 32 frames.
const PAIR_FRAMES: [usize; 3] = [7, 15, 23];
/// Height of the picture in whose pixels errors are given.
const REFERENCE_HEIGHT_PX: f64 = 256.0;
/// A pixel moves from here on, px of that picture.
const MOVING_PX: f64 = 0.5;

/// Two pictures and the exact flow between them.
pub(super) struct FlowPair {
    first: Rgb8,
    second: Rgb8,
    /// Known where visible in both.
    truth: KnownFlow,
}

/// What a point makes of the scenes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TruthErrors {
    /// Mean end-point error, px of a 256-px-high picture.
    pub flow_epe_px: Option<f64>,
    /// The same over pixels that move.
    pub flow_epe_moving_px: Option<f64>,
    /// Scenes with a travelling camera.
    pub travelling: usize,
    /// Of those, the ones whose depths were estimated.
    pub tracked: usize,
    /// Absolute trajectory error, percent of the path, mean over them.
    pub pose_error_percent: Option<f64>,
    /// Median relative depth error, mean over them.
    pub depth_error: Option<f64>,
}

/// Renders the pairs of scenes.
///
/// # Errors
/// [`SampleError`], of a defect of the scenes alone.
pub(super) fn flow_pairs(scenes: &[ClipSpec]) -> Result<Vec<FlowPair>, SampleError> {
    let pairs = scenes
        .iter()
        .flat_map(|scene| PAIR_FRAMES.map(|frame| (scene, frame)));
    pairs
        .map(|(scene, frame)| {
            let picture = |frame| -> Result<Rgb8, SampleError> {
                let shown = scene.render_frame(frame)?;
                Ok(Rgb8 {
                    width: shown.width,
                    height: shown.height,
                    data: shown.rgb,
                })
            };
            let truth = scene.truth(frame)?.flow;
            let FlowTruth {
                flow_px, visible, ..
            } = truth.ok_or(SampleError::FrameOutOfRange {
                frame: frame + 1,
                frames: scene.frames,
            })?;
            Ok(FlowPair {
                first: picture(frame)?,
                second: picture(frame + 1)?,
                truth: KnownFlow {
                    flow: Flow {
                        width: scene.width,
                        height: scene.height,
                        data: flow_px,
                    },
                    known: visible,
                },
            })
        })
        .collect()
}

/// Mean end-point errors of a profile's flow: over all known pixels, and over those that move. Each pair
/// weighs the same.
pub(super) fn flow_errors(
    pairs: &[FlowPair],
    profile: &Profile,
) -> Result<[Option<f64>; 2], FlowError> {
    let mut dis = Dis::new(profile.flow.clone());
    let mut errors: [Vec<f64>; 2] = Default::default();
    for pair in pairs {
        let (width, height) = (pair.first.width, pair.first.height);
        let (working_width, working_height) = profile.working_size(width, height);
        let frame = |picture: &Rgb8| {
            let small = resize_rgb(picture, working_width, working_height);
            DisFrame::new(&small.grey(), &profile.flow)
        };
        let found = dis.flow(&frame(&pair.first)?, &frame(&pair.second)?)?;
        let found = on_grid(&found, width, height);
        let unit_px = REFERENCE_HEIGHT_PX / height as f64;
        let moving = pair.truth.flow.data.iter().zip(&pair.truth.known);
        let moving = moving.map(|(&[u, v], &known)| {
            let (u, v) = (f64::from(u) * unit_px, f64::from(v) * unit_px);
            known && u * u + v * v >= MOVING_PX * MOVING_PX
        });
        let moving = KnownFlow {
            flow: pair.truth.flow.clone(),
            known: moving.collect(),
        };
        for (errors, truth) in errors.iter_mut().zip([&pair.truth, &moving]) {
            let accuracy = FlowAccuracy::new(&found, truth)?;
            errors.extend(accuracy.map(|accuracy| accuracy.mean_epe_px * unit_px));
        }
    }
    Ok(errors.map(|errors| mean(&errors)))
}

/// A flow on another grid of the same picture: bilinear, pixel centres at half-pixels, vectors in the new
/// grid's pixels; beyond the outermost centres their value.
fn on_grid(flow: &Flow, width: usize, height: usize) -> Flow {
    let scale = [
        width as f32 / flow.width as f32,
        height as f32 / flow.height as f32,
    ];
    let place = |to: usize, scale: f32, length: usize| {
        let last = (length - 1) as f32;
        let at = ((to as f32 + 0.5) / scale - 0.5).clamp(0.0, last);
        let low = at as usize;
        (low, (low + 1).min(length - 1), at - low as f32)
    };
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        let (y0, y1, fy) = place(y, scale[1], flow.height);
        for x in 0..width {
            let (x0, x1, fx) = place(x, scale[0], flow.width);
            let at = |x: usize, y: usize, k: usize| flow.data[y * flow.width + x][k];
            data.push([0, 1].map(|k| {
                let top = at(x0, y0, k) * (1.0 - fx) + at(x1, y0, k) * fx;
                let bottom = at(x0, y1, k) * (1.0 - fx) + at(x1, y1, k) * fx;
                (top * (1.0 - fy) + bottom * fy) * scale[k]
            }));
        }
    }
    Flow {
        width,
        height,
        data,
    }
}

/// Holds a point against the truth.
///
/// # Errors
/// [`TradeoffError`]: a scene that cannot be tracked is counted, not an error.
pub(super) async fn errors(
    rendered: &Arc<Rendered>,
    profile: &Profile,
    options: &TradeoffOptions,
) -> Result<TruthErrors, TradeoffError> {
    let (rendered_for_flow, profile_for_flow) = (Arc::clone(rendered), profile.clone());
    let flow = tokio::task::spawn_blocking(move || {
        flow_errors(&rendered_for_flow.pairs, &profile_for_flow)
    });
    let [flow_epe_px, flow_epe_moving_px] = flow.await??;
    let travelling: HashMap<&VideoId, &ClipSpec> = rendered
        .travelling
        .iter()
        .map(|clip| (&clip.entry.video, &clip.spec))
        .collect();
    let mut jobs = Vec::new();
    for clip in &rendered.travelling {
        let camera = Camera::new(clip.spec.width, clip.spec.height)?;
        let profile = Profile {
            intrinsics: Some(Intrinsics {
                fx: camera.fx,
                fy: camera.fy,
                cx: camera.cx,
                cy: camera.cy,
            }),
            ..profile_for(profile)
        };
        let job = measuring::job(&clip.entry, &profile).map_err(RunError::Profile)?;
        jobs.extend(job.map(Tracking));
    }
    let mut by_video: Vec<(VideoId, [f64; 2])> = Vec::new();
    let mut slots = Fanout::start(jobs, &options.slots);
    while let Some(answer) = slots.next().await {
        let (video, outcome) = answer.map_err(RunError::Slot)?;
        let (SlamOutcome::Tracked(tracked), Some(spec)) = (outcome, travelling.get(&video)) else {
            continue;
        };
        by_video.extend(camera_errors(&tracked, spec)?.map(|errors| (video, errors)));
    }
    // The order of completion differs between runs; sums do not.
    by_video.sort_by(|a, b| a.0.cmp(&b.0));
    let of = |k: usize| mean(&by_video.iter().map(|(_, e)| e[k]).collect::<Vec<_>>());
    Ok(TruthErrors {
        flow_epe_px,
        flow_epe_moving_px,
        travelling: travelling.len(),
        tracked: by_video.len(),
        pose_error_percent: of(0),
        depth_error: of(1),
    })
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field that is linear in the picture's coordinates is the same on any grid, away from the border.
    #[test]
    fn a_linear_flow_survives_another_grid() {
        let linear = |width: usize, height: usize| Flow {
            width,
            height,
            data: (0..width * height)
                .map(|k| {
                    let x = ((k % width) as f32 + 0.5) / width as f32;
                    let y = ((k / width) as f32 + 0.5) / height as f32;
                    [(x + 2.0 * y) * width as f32, (3.0 - y) * height as f32]
                })
                .collect(),
        };
        let (found, expected) = (on_grid(&linear(12, 8), 36, 16), linear(36, 16));
        for y in 1..15 {
            for x in 2..34 {
                let [a, b] = [&found, &expected].map(|flow| flow.data[y * 36 + x]);
                // Rounding of values up to 100.
                assert!(
                    (a[0] - b[0]).abs() < 1e-4 && (a[1] - b[1]).abs() < 1e-4,
                    "{x} {y}"
                );
            }
        }
        assert_eq!(on_grid(&expected, 36, 16), expected);
    }
}
