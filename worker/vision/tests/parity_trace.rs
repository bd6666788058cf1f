//! The reference's front and back end on three sequences (`tests/golden/README.md`,
//! droid_trace.npz), with this file's oracle in place of the networks, as in the archive.
//!
//! Edge lists, their order, ages and keyframes are compared exactly. Poses and inverse depths are f32
//! buffers between adjustments on both sides: over some hundred adjustments roundings of 6e-8 grow
//! to some 1e-5; 1e-3 is allowed, absolute below 1 and relative above.
//!
//! `main_18frames` holds cells that come as near as the least depth at which a cell counts, with
//! residuals of up to 190 cells: one of them counting or not moves poses by 1e-3. Its score is a matter
//! of rounding: with the oracle's answers moved at random by at most one unit in the last place of
//! f32, 59 runs scored 0.283 to 0.390, with 12 or 13 keyframes (the archive: 0.304; we: 0.325);
//! `oscillating_20frames` moves by less than 1e-7. The back end is therefore compared from the archive's
//! state before each of its runs, and the score from end to end against that spread.

#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "what cannot be read fails the test"
)]

mod archive;

use std::convert::Infallible;

use archive::{Archive, worst};
use plumbline_vision::slam::camera::{Grid, Pinhole};
use plumbline_vision::slam::graph::Edge;
use plumbline_vision::slam::operator::{CorrespondenceOperator, EdgeAnswer, EdgeQuery};
use plumbline_vision::slam::reference::{ReferenceParams, ReferenceTracker, TrackError};
use plumbline_vision::slam::se3::Se3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const SIDE: usize = 16;
const CELLS: usize = SIDE * SIDE;
const TOLERANCE: f64 = 1e-3;
/// The networks see motion clamped to this many cells.
const MOTION_CLAMP: f32 = 64.0;

/// Knows the truth, with a smooth error that depends on the frames.
struct Oracle {
    /// `[frames, frames, rows, columns, 2]`.
    truth: Vec<f32>,
    frames: usize,
    /// Moves each answer to a neighbouring f32, or not.
    nudge: Option<Pcg64>,
}

impl CorrespondenceOperator for Oracle {
    type Error = Infallible;

    fn update(
        &mut self,
        queries: &[EdgeQuery<'_>],
        answers: &mut [EdgeAnswer<'_>],
    ) -> Result<(), Infallible> {
        for (query, answer) in queries.iter().zip(answers) {
            let (a, b) = (query.source_frame as f64, query.target_frame as f64);
            for cell in 0..CELLS {
                let (x, y) = ((cell % SIDE) as f64, (cell / SIDE) as f64);
                let noise = [
                    0.25 * (0.7 * x + 1.3 * y + 2.1 * a + 0.9 * b).sin(),
                    0.25 * (1.1 * x - 0.6 * y + 1.7 * a + 0.5 * b).cos(),
                ];
                let weight = [
                    0.5 + 0.4 * (0.3 * x + 0.2 * y + a - b).sin(),
                    0.5 + 0.4 * (0.25 * x - 0.35 * y + a + b).cos(),
                ];
                let pair = query.source_frame * self.frames + query.target_frame;
                for axis in 0..2 {
                    let at = axis * CELLS + cell;
                    let grid = [x, y][axis] as f32;
                    let seen =
                        grid + (query.reprojected[at] - grid).clamp(-MOTION_CLAMP, MOTION_CLAMP);
                    let delta =
                        self.truth[(pair * CELLS + cell) * 2 + axis] + noise[axis] as f32 - seen;
                    let exact = query.reprojected[at] + delta;
                    answer.at[at] = match &mut self.nudge {
                        None => exact,
                        Some(random) => {
                            [exact, exact.next_up(), exact.next_down()][random.random_range(0..3)]
                        }
                    };
                    answer.weight[at] = weight[axis] as f32;
                }
            }
        }
        Ok(())
    }

    fn depth_damping(
        &mut self,
        source_frame: usize,
        damping: &mut [f32],
    ) -> Result<(), Infallible> {
        for (cell, out) in damping.iter_mut().enumerate() {
            let (x, y) = ((cell % SIDE) as f64, (cell / SIDE) as f64);
            *out = (0.002 * (1.5 + (0.4 * x + 0.5 * y + source_frame as f64).sin())) as f32;
        }
        Ok(())
    }
}

/// The trace's tracker and its number of frames; with a seed, the oracle's answers are nudged.
fn tracker(
    archive: &mut Archive,
    trace: &str,
    nudge: Option<u64>,
) -> (ReferenceTracker<Oracle>, usize) {
    let shape = archive.shape(&format!("trace/{trace}/gt_coords"));
    let frames = shape[0];
    let k = archive.f64(&format!("trace/{trace}/intrinsics"));
    let oracle = Oracle {
        truth: archive.f32(&format!("trace/{trace}/gt_coords")),
        frames,
        nudge: nudge.map(Pcg64::seed_from_u64),
    };
    let camera = Pinhole {
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
    };
    let grid = Grid {
        columns: SIDE,
        rows: SIDE,
    };
    (
        ReferenceTracker::new(camera, grid, oracle, ReferenceParams::default()),
        frames,
    )
}

fn ends(edges: &[Edge]) -> [Vec<usize>; 2] {
    [
        edges.iter().map(|e| e.source).collect(),
        edges.iter().map(|e| e.target).collect(),
    ]
}

/// Compares poses and inverse depths of the first slots; returns the largest difference.
fn compare_state(archive: &mut Archive, prefix: &str, tracker: &ReferenceTracker<Oracle>) -> f64 {
    let poses = archive.f64(&format!("{prefix}/poses"));
    let depths = archive.f64(&format!("{prefix}/disps"));
    let scene = &tracker.keyframes.scene;
    let found = scene
        .poses
        .iter()
        .flat_map(|p| p.to_array())
        .take(poses.len());
    let in_poses = worst(found, &poses);
    let in_depths = worst(
        scene.inverse_depths.iter().copied().take(depths.len()),
        &depths,
    );
    assert!(
        in_poses < TOLERANCE && in_depths < TOLERANCE,
        "{prefix}: poses {in_poses:e}, inverse depths {in_depths:e}"
    );
    in_poses.max(in_depths)
}

fn compare_frame(archive: &mut Archive, prefix: &str, tracker: &ReferenceTracker<Oracle>) -> f64 {
    let count = archive.indices(&format!("{prefix}/counter"))[0];
    assert_eq!(tracker.keyframes.len(), count, "{prefix}");
    if !archive.has(&format!("{prefix}/ii")) {
        assert_eq!(tracker.tracked, 0, "{prefix}");
        return 0.0;
    }
    let mut list = |key: &str| archive.indices(&format!("{prefix}/{key}"));
    let [ii, jj] = ends(&tracker.graph.active);
    assert_eq!(ii, list("ii"), "{prefix}: sources");
    assert_eq!(jj, list("jj"), "{prefix}: targets");
    let ages: Vec<usize> = tracker
        .graph
        .active
        .iter()
        .map(|e| e.age as usize)
        .collect();
    assert_eq!(ages, list("age"), "{prefix}: ages");
    let [ii, jj] = ends(&tracker.graph.inactive);
    assert_eq!(ii, list("ii_inac"), "{prefix}: inactive sources");
    assert_eq!(jj, list("jj_inac"), "{prefix}: inactive targets");
    assert_eq!(vec![tracker.tracked], list("t1"), "{prefix}");
    assert_eq!(
        tracker.keyframes.frames,
        list("frame_ids"),
        "{prefix}: keyframes"
    );
    let distance = archive.f64(&format!("{prefix}/keyframe_distance"))[0];
    match tracker.keyframe_distance {
        Some(found) => assert!(
            (found - distance).abs() < TOLERANCE * distance,
            "{prefix}: {found} {distance}"
        ),
        None => assert!(distance < 0.0, "{prefix}"),
    }
    compare_state(archive, prefix, tracker)
}

/// `score_tolerance` is for the score from end to end.
fn follow(trace: &str, score_tolerance: f64) {
    let mut archive = Archive::open("droid_trace.npz");
    let (mut tracker, frames) = tracker(&mut archive, trace, None);
    let mut largest: f64 = 0.0;
    for frame in 0..frames {
        tracker.push(frame).unwrap();
        let difference = compare_frame(
            &mut archive,
            &format!("trace/{trace}/frame{frame:02}"),
            &tracker,
        );
        largest = largest.max(difference);
    }
    let own = tracker.keyframes.clone();
    let mut before = format!("trace/{trace}/frame{:02}", frames - 1);
    for (run, steps) in ReferenceParams::default()
        .backend_steps
        .into_iter()
        .enumerate()
    {
        let prefix = format!("trace/{trace}/backend{run}");
        load_state(&mut archive, &before, &mut tracker);
        let scale = archive.f64(&format!("{prefix}/disp_mean_before"))[0];
        let found = tracker.keyframes.clone().normalise_scale();
        assert!(
            (found - scale).abs() < TOLERANCE * scale,
            "{prefix}: {found} {scale}"
        );
        let error = tracker.global(steps).unwrap();
        let [ii, jj] = ends(&tracker.graph.active);
        assert_eq!(ii, archive.indices(&format!("{prefix}/ii")), "{prefix}");
        assert_eq!(jj, archive.indices(&format!("{prefix}/jj")), "{prefix}");
        largest = largest.max(compare_state(&mut archive, &prefix, &tracker));
        assert_eq!(
            error.valid,
            archive.indices(&format!("{prefix}/n_valid"))[0],
            "{prefix}"
        );
        assert_eq!(
            error.total,
            archive.indices(&format!("{prefix}/n_total"))[0],
            "{prefix}"
        );
        let score = error.mean_cells.unwrap();
        let expected = archive.f64(&format!("{prefix}/mean_error"))[0];
        assert!(
            (score - expected).abs() < TOLERANCE,
            "{prefix}: {score} {expected}"
        );
        before = prefix;
    }
    // And on our own state from end to end.
    tracker.keyframes = own;
    let score = tracker.finish().unwrap().mean_cells.unwrap();
    let expected = archive.f64(&format!("trace/{trace}/final_mean_error"))[0];
    println!("{trace}: largest difference of state {largest:e}; score {score} of {expected}");
    assert!(
        (score - expected).abs() < score_tolerance,
        "{trace}: {score} {expected}"
    );
}

/// Puts the archive's state where there is one into the tracker.
fn load_state(archive: &mut Archive, prefix: &str, tracker: &mut ReferenceTracker<Oracle>) {
    if !archive.has(&format!("{prefix}/poses")) {
        return;
    }
    let poses = archive.f64(&format!("{prefix}/poses"));
    let depths = archive.f64(&format!("{prefix}/disps"));
    let scene = &mut tracker.keyframes.scene;
    for (pose, stored) in scene.poses.iter_mut().zip(poses.chunks_exact(7)) {
        *pose = Se3::from_array(stored.try_into().unwrap());
    }
    scene.inverse_depths[..depths.len()].copy_from_slice(&depths);
}

#[test]
fn eighteen_frames() {
    // Rounding decides here (see above): 0.1 is the spread that rounding alone makes.
    follow("main_18frames", 0.1);
}

#[test]
fn five_frames_that_never_start_tracking() {
    follow("short_5frames_never_initialised", TOLERANCE);
}

#[test]
fn twenty_frames_to_and_fro() {
    follow("oscillating_20frames", TOLERANCE);
}

/// Scores of a trace whose answers are rounded otherwise; the archive's and our own.
fn scores_within_rounding(trace: &str, runs: u64) -> (Vec<f64>, f64, f64) {
    let mut archive = Archive::open("droid_trace.npz");
    let mut score = |nudge| {
        let (mut tracker, frames) = tracker(&mut archive, trace, nudge);
        for frame in 0..frames {
            tracker.push(frame).unwrap();
        }
        tracker.finish().unwrap().mean_cells.unwrap()
    };
    let own = score(None);
    let mut nudged: Vec<f64> = (1..=runs).map(|seed| score(Some(seed))).collect();
    nudged.sort_by(f64::total_cmp);
    let expected = archive.f64(&format!("trace/{trace}/final_mean_error"))[0];
    println!("{trace}: own {own}, archive {expected}, nudged {nudged:?}");
    (nudged, own, expected)
}

#[test]
fn rounding_alone_reaches_the_score_of_eighteen_frames() {
    let (nudged, own, expected) = scores_within_rounding("main_18frames", 8);
    for score in [own, expected] {
        assert!(nudged[0] < score && score < nudged[nudged.len() - 1]);
    }
    // The yardstick is not loose by itself: where no cell is at the least depth, nothing moves.
    let (nudged, own, _) = scores_within_rounding("oscillating_20frames", 2);
    assert!(nudged.iter().all(|score| (score - own).abs() < 1e-6));
}

#[test]
fn what_has_no_score_is_a_typed_error() {
    let mut archive = Archive::open("droid_trace.npz");
    let (mut tracker, _) = tracker(&mut archive, "short_5frames_never_initialised", None);
    assert!(matches!(tracker.finish(), Err(TrackError::NoEdges)));
    tracker.push(0).unwrap();
    assert!(matches!(tracker.finish(), Err(TrackError::NoEdges)));
    let full = ReferenceParams {
        buffer: 2,
        ..ReferenceParams::default()
    };
    let (scene, oracle) = (
        tracker.keyframes.scene.clone(),
        Oracle {
            truth: Vec::new(),
            frames: 0,
            nudge: None,
        },
    );
    let mut small = ReferenceTracker::new(scene.camera, scene.grid, oracle, full);
    small.push(0).unwrap();
    small.push(1).unwrap();
    assert!(matches!(
        small.push(2),
        Err(TrackError::TooManyKeyframes { most: 2 })
    ));
}
