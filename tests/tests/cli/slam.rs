//! `plumbline slam`: trajectory, depths and verdicts of rendered clips, held against their truth.

use std::path::Path;

use plumbline_sample::corpus::{ClipSpec, sample_corpus};
use plumbline_sample::scene::Family;
use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_vision::slam::se3::Se3;
use plumbline_vision::slam::trajectory::{TimedPose, parse_tum, to_tum};
use serde_json::Value;

fn slam(place: &Place, clip: &str, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    let video = format!("videos/{clip}");
    command
        .args(["slam", &video, "--out", "out", "--json"])
        .args(words);
    Started::start(&mut command).wait()
}

/// A clean clip of a camera's kind, written as a video, and its intrinsics.
fn write(place: &Place, family: Family) -> ClipSpec {
    let is_it = |clip: &ClipSpec| clip.fault.is_none() && clip.family == family;
    // The last of each: the first dolly looks at so plain a scene that a rotation passes for its motion.
    let clip = sample_corpus(0).into_iter().rfind(is_it).unwrap();
    clips::write(&place.video("clip.mp4"), &clips::frames(&clip));
    clip
}

/// The true trajectory.
fn write_truth(clip: &ClipSpec, path: &Path) {
    let pose = |frame: usize| {
        let pose = clip.truth(frame).unwrap().camera_from_world;
        let [tx, ty, tz] = pose.translation_m;
        let [qx, qy, qz, qw] = pose.quaternion_xyzw();
        TimedPose {
            time_s: frame as f64 / clip.fps,
            world_from_camera: Se3::from_array([tx, ty, tz, qx, qy, qz, qw]).inverse(),
        }
    };
    let truth: Vec<TimedPose> = (0..clip.frames).map(pose).collect();
    std::fs::write(path, to_tum(&truth)).unwrap();
}

#[test]
fn a_travelling_camera_is_followed() {
    let place = Place::new();
    let clip = write(&place, Family::Dolly);
    write_truth(&clip, &place.path("truth.txt"));
    let camera = clip.truth(0).unwrap().camera;
    let intrinsics = format!("{},{},{},{}", camera.fx, camera.fy, camera.cx, camera.cy);
    let words = ["--gt", "truth.txt", "--intrinsics", &intrinsics];
    let ended = slam(&place, "clip.mp4", &words);
    assert_eq!(ended.status.code(), Some(0), "{}", ended.stderr);
    let json: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(json["depth"], "estimated", "{json}");
    assert_eq!(json["intrinsics"], "given");
    // As in the tracker's own tests (3 mm of a path of 0.5 m), and the video codec.
    let ate = json["against_truth"]["ate_rmse"].as_f64().unwrap();
    assert!(ate < 0.006, "{json}");
    let text = std::fs::read_to_string(place.path("out/trajectory.txt")).unwrap();
    assert_eq!(parse_tum(&text).unwrap().len(), clip.frames);
    let bytes = std::fs::read(place.path("out/depths.npz")).unwrap();
    let mut npz = npyz::npz::NpzArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let depths = npz.by_name("inverse_depth").unwrap().unwrap();
    let keyframes = json["keyframes"].as_u64().unwrap();
    assert_eq!(depths.shape()[..2], [keyframes, 32]);
    assert!(depths.into_vec::<f32>().unwrap().iter().all(|d| *d > 0.0));
    let residuals = std::fs::read_to_string(place.path("out/residuals.csv")).unwrap();
    assert_eq!(residuals.lines().count() as u64, keyframes);
}

#[test]
fn no_depth_is_estimated_where_the_camera_stands_or_turns() {
    for (family, depth) in [(Family::Pick, "static_camera"), (Family::Pan, "rotation")] {
        let place = Place::new();
        let clip = write(&place, family);
        let ended = slam(&place, "clip.mp4", &[]);
        assert_eq!(ended.status.code(), Some(0), "{}", ended.stderr);
        assert!(
            ended.stderr.contains("no depth is estimated"),
            "{}",
            ended.stderr
        );
        let json: Value = serde_json::from_str(&ended.stdout).unwrap();
        assert_eq!(json["depth"], depth);
        assert_eq!(json["depth_cells"], 0);
        assert!(json["depth_cells_saved"].as_u64().unwrap() > 0);
        assert_eq!(json["intrinsics"], "prior");
        assert!(!place.path("out/depths.npz").exists());
        let text = std::fs::read_to_string(place.path("out/trajectory.txt")).unwrap();
        let poses = parse_tum(&text).unwrap();
        assert_eq!(poses.len(), clip.frames);
        let places = poses.iter().map(|pose| pose.world_from_camera.translation);
        assert!(places.into_iter().all(|place| place.norm() < 1e-6));
    }
}

#[test]
fn what_cannot_be_tracked_says_why() {
    let place = Place::new();
    std::fs::write(place.video("clip.mp4"), b"no video").unwrap();
    let ended = slam(&place, "clip.mp4", &[]);
    assert_eq!(ended.status.code(), Some(3), "{}", ended.stderr);
    let json: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(json["status"], "undecodable");
    assert!(json["status_reason"].is_string());
    for bad in ["1,2,3", "0,1,2,3", "a,b,c,d"] {
        let ended = slam(&place, "clip.mp4", &["--intrinsics", bad]);
        assert_eq!(ended.status.code(), Some(2), "{}", ended.stderr);
    }
    std::fs::write(place.path("bad.txt"), "0 0 0\n").unwrap();
    let ended = slam(&place, "clip.mp4", &["--gt", "bad.txt"]);
    assert_eq!(ended.status.code(), Some(2));
    assert!(ended.stderr.contains("bad.txt: line 1"), "{}", ended.stderr);
}
