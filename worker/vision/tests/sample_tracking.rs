//! The tracker on rendered clips against their exact poses and depths (seed 0): flow as `standard`
//! computes it, the truth's intrinsics unless said otherwise.

#![expect(clippy::unwrap_used, reason = "what cannot be computed fails the test")]

mod support;
mod tracking;

use plumbline_sample::{ClipSpec, Family, FrameTruth, sample_corpus};
use plumbline_vision::slam::intrinsics::{Intrinsics, focal_evidence};
use plumbline_vision::slam::tracker::{FlowGraph, Solution, TrackParams, solve};
use plumbline_vision::slam::trajectory::{AbsoluteError, absolute_error};
use support::{on_two_threads, picture};
use tracking::{Pictures, intrinsics, pose, trajectory};

/// Two clean clips of a camera's kind.
fn clean(family: Family) -> Vec<ClipSpec> {
    let clips = sample_corpus(0).into_iter();
    clips
        .filter(|clip| clip.fault.is_none() && clip.family == family)
        .take(2)
        .collect()
}

struct Tracked {
    truth: Vec<FrameTruth>,
    graph: FlowGraph,
    solution: Solution,
}

/// `focal_factor` of the true focal length.
fn track(clip: &ClipSpec, params: &TrackParams, focal_factor: f64) -> Tracked {
    let frames = 0..clip.frames;
    let pictures = frames
        .clone()
        .map(|f| picture(clip.render_frame(f).unwrap()));
    let pictures = Pictures::new(&pictures.collect::<Vec<_>>());
    let truth: Vec<FrameTruth> = frames.map(|f| clip.truth(f).unwrap()).collect();
    let camera = pictures.camera(&intrinsics(&truth[0]).with_focal_factor(focal_factor));
    let graph = pictures.graph(params);
    let solution = solve(&graph, camera, params).unwrap();
    Tracked {
        truth,
        graph,
        solution,
    }
}

impl Tracked {
    fn error(&self) -> AbsoluteError {
        let truth = self.truth.iter().map(pose).enumerate();
        let estimate = self.solution.trajectory.iter().copied();
        absolute_error(&trajectory(estimate), &trajectory(truth)).unwrap()
    }

    /// Median of |d / d_true − 1| over the cells whose depth is observable, the scale being that of the
    /// trajectory.
    fn inverse_depth_error(&self, scale: f64, params: &TrackParams) -> f64 {
        let known = self.solution.observability(&self.graph, params).unwrap();
        let (grid, camera) = (self.graph.grid, &self.truth[0].camera);
        let mut errors = Vec::new();
        for (slot, &frame) in self.graph.frames.iter().enumerate() {
            for cell in 0..grid.cells() {
                let at = slot * grid.cells() + cell;
                if !known.mask()[at] {
                    continue;
                }
                // The cell's working pixel (8 k + 4 of 256 rows), in pixels of the video.
                let px = |k: usize, length: usize, working: f64| {
                    let share = ((8 * k + 4) as f64 + 0.5) / working;
                    ((share * length as f64) as usize).min(length - 1)
                };
                let working_width = (camera.width * 256) as f64 / camera.height as f64;
                let x = px(cell % grid.columns, camera.width, working_width.round());
                let y = px(cell / grid.columns, camera.height, 256.0);
                let depth_m = f64::from(self.truth[frame].depth_m[y * camera.width + x]);
                let found = self.solution.scene.inverse_depths[at] / scale;
                errors.push((found * depth_m - 1.0).abs());
            }
        }
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }
}

#[test]
fn a_travelling_camera_is_followed_and_its_depths_are_found() {
    let params = TrackParams::default();
    let tracked = on_two_threads(&clean(Family::Dolly), |clip| track(clip, &params, 1.0));
    assert_eq!(tracked.len(), 2);
    for tracked in &tracked {
        let known = tracked.solution.observability(&tracked.graph, &params);
        assert!(known.unwrap().fraction() > 0.9);
        let error = tracked.error();
        // The camera travels 0.5 m; about 1 mm is found. Flow errors of a third of a pixel at 2 m and a
        // focal length of 300 px are 2 mm a cell; hundreds of cells share them.
        assert!(error.rmse < 0.003, "{error:?}");
        // The camera turns by 24° as it travels sideways; the two are told apart by perspective alone, to
        // about 1.3%.
        assert!(error.rotation_rmse_rad.to_degrees() < 0.6, "{error:?}");
        let depth = tracked.inverse_depth_error(error.truth_from_estimate.scale, &params);
        // Half a pixel of a parallax of 12 px (two keyframes) is 4%.
        assert!(depth < 0.04, "{depth}");
    }
}

#[test]
fn depth_is_not_observable_where_the_camera_stands_or_turns() {
    let params = TrackParams {
        // Every frame, as `score` does.
        keyframe_motion_px: 0.0,
        span: 2,
        rounds: 1,
        ..TrackParams::default()
    };
    let mut clips = clean(Family::Pan);
    clips.truncate(1);
    clips.extend(clean(Family::Pick).into_iter().take(1));
    for tracked in on_two_threads(&clips, |clip| track(clip, &params, 1.0)) {
        let known = tracked.solution.observability(&tracked.graph, &params);
        let fraction = known.unwrap().fraction();
        // A tenth was seen: the arm, and noise; a travelling camera has nine tenths and more.
        assert!(fraction < 0.2, "{fraction}");
        assert!(fraction < params.least_observable);
    }
}

#[test]
fn a_wrong_focal_length_is_found_out() {
    let params = TrackParams::default();
    let clip = &clean(Family::Dolly)[0];
    let tracked = track(clip, &params, 0.75);
    let evidence = focal_evidence(&tracked.graph, &tracked.solution, &params).unwrap();
    assert!(evidence.is_determined(), "{evidence:?}");
    // Started a quarter too short; two standard deviations of what is accepted.
    assert!((0.75 * evidence.factor - 1.0).abs() < 0.1, "{evidence:?}");
    let prior = Intrinsics::prior(clip.width, clip.height);
    assert!((prior.fx / tracked.truth[0].camera.fx - 1.0).abs() < 0.1);
}
