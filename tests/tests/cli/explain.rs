//! `plumbline explain`: the files of one video, against the score row, the known fault and the decoder.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use plumbline_sample::corpus::{ClipSpec, sample_corpus};
use plumbline_sample::fault::FaultKind;
use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::process::{children_of, wait_until};
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_vision::faults::FaultThresholds;
use plumbline_worker::decode::{DecodeLimits, decode_video};
use plumbline_worker::profile::{MEASURE_VERSION, Profile, Rung};
use rustix::process::Signal;
use serde_json::Value;

/// Explains `videos/<video>` into `out`.
fn explain(place: &Place, video: &str, out: &str, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    let video = format!("videos/{video}");
    command.args(["explain", &video, "--out", out]).args(words);
    Started::start(&mut command).wait()
}

fn json(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&bytes).unwrap()
}

/// Every file below a directory but the lock.
fn files_below(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for directory in ["", "heatmaps"] {
        let Ok(entries) = std::fs::read_dir(root.join(directory)) else {
            continue;
        };
        for entry in entries
            .map(Result::unwrap)
            .filter(|entry| entry.path().is_file())
        {
            let name = entry.file_name().into_string().unwrap();
            let bytes = std::fs::read(entry.path()).unwrap();
            files.insert(format!("{directory}/{name}"), bytes);
        }
    }
    files
}

/// The sample's first clip with this fault, as `plumbline sample` renders it.
fn write_faulty(place: &Place, kind: FaultKind) -> ClipSpec {
    let with_kind = |clip: &ClipSpec| clip.fault.is_some_and(|fault| fault.kind == kind);
    let clip = sample_corpus(0).into_iter().find(with_kind).unwrap();
    clips::write(
        &place.video(format!("{}.mp4", clip.name)),
        &clips::frames(&clip),
    );
    clip
}

/// Thresholds of rendered clips, as a file for the profile `standard`: those shipped are of recorded ones,
/// whose noise hides a teleported arm.
fn write_rendered_thresholds(path: &Path) {
    let profile = Profile::new(Rung::Standard);
    let file = serde_json::json!({
        "format": 1,
        "plumbline_version": env!("CARGO_PKG_VERSION"),
        "measure_version": MEASURE_VERSION,
        "profile": "standard",
        "fault_scores_digest": profile.fault_scores_digest().unwrap(),
        "quantile": 0.99,
        "clips": 72,
        "thresholds": FaultThresholds::STANDARD,
        "kinds": {},
    });
    std::fs::write(path, file.to_string()).unwrap();
}

/// Where the heat of a heat map is brightest, as shares of the video's width and height. The right one of
/// the two pictures; heat is more red than blue, the frame below it is grey and the marks are blue.
fn brightest(path: &Path) -> [f64; 2] {
    const GAP_PX: u32 = 10;
    const TITLE_PX: u32 = 52;
    const FRAME_HEIGHT_PX: u32 = 432;
    let picture = image::open(path).unwrap().to_rgb8();
    let width = (picture.width() - 3 * GAP_PX) / 2;
    let left = 2 * GAP_PX + width;
    let mut best = (0, [0, 0]);
    for y in 0..FRAME_HEIGHT_PX {
        for x in 0..width {
            let [r, g, b] = picture.get_pixel(left + x, TITLE_PX + y).0.map(i32::from);
            if r > b + 30 && r + g + b > best.0 {
                best = (r + g + b, [x, y]);
            }
        }
    }
    let share = |at: u32, length: u32| f64::from(at) / f64::from(length);
    [share(best.1[0], width), share(best.1[1], FRAME_HEIGHT_PX)]
}

/// The most severe fault is at the true frame, the true kind is among those of that frame, and its place
/// lies in the true region: in the numbers and in the picture. The map's cells are 1.5 px wide and its boxes 9 cells, so that the peak of
/// a region's border may lie half a box (7 px) outside.
#[test]
fn known_faults_are_found_when_and_where_they_are() {
    const SLACK_PX: f64 = 7.0;
    let place = Place::new();
    write_rendered_thresholds(&place.path("rendered.json"));
    for (kind, detector) in [(FaultKind::Vanish, "vanish"), (FaultKind::Teleport, "jump")] {
        let clip = write_faulty(&place, kind);
        let truth = clip.fault_truth().unwrap().unwrap();
        let video = format!("{}.mp4", clip.name);
        let words = ["--json", "--fault-thresholds", "rendered.json"];
        let told = explain(&place, &video, &clip.name, &words)
            .expect_code(0)
            .json();
        let faults = told["faults"].as_array().unwrap();
        assert_eq!(faults[0]["frame"], truth.first_frame, "{faults:?}");
        let is_true =
            |fault: &&Value| fault["kind"] == detector && fault["frame"] == truth.first_frame;
        let fault = faults.iter().find(is_true).unwrap();
        let time_s = fault["time_s"].as_f64().unwrap();
        assert!((time_s - truth.first_frame as f64 / clip.fps).abs() < 1e-6);
        assert!(fault["severity"].as_f64().unwrap() > 1.0);

        let [x0, y0, x1, y1] = truth.bbox_px.map(|at| at as f64);
        let inside = |x: f64, y: f64| {
            (x0 - SLACK_PX..x1 + SLACK_PX).contains(&x)
                && (y0 - SLACK_PX..y1 + SLACK_PX).contains(&y)
        };
        let peak = [0, 1].map(|axis| fault["peak_px"][axis].as_f64().unwrap());
        assert!(
            inside(peak[0], peak[1]),
            "{fault}, truth {:?}",
            truth.bbox_px
        );
        let file = fault["heat_map"].as_str().unwrap();
        let [x, y] = brightest(&place.path(&clip.name).join(file));
        let (x, y) = (x * clip.width as f64, y * clip.height as f64);
        assert!(
            inside(x, y),
            "{file} at {x}, {y}, truth {:?}",
            truth.bbox_px
        );
        let found = json(&place.path(&clip.name).join("faults.json"));
        assert_eq!(found["faults"], told["faults"]);
    }
}

/// Whatever becomes of a video: the same numbers, to the last bit, as in its row.
#[test]
fn numbers_are_those_of_the_score_row() {
    let place = Place::with_clips(3);
    clips::write_still(&place.video("still.mp4"), 1);
    clips::write_short(&place.video("short.mp4"), 1, 3);
    std::fs::write(place.video("text.mp4"), "just some text\n").unwrap();
    std::fs::write(place.video("huge.gif"), clips::huge_gif(8192)).unwrap();
    let mut score = place.score(&["videos", "--out", "out", "--jobs", "1"]);
    Started::start(&mut score).wait().expect_code(3);
    let rows = place.published("out").rows();
    assert_eq!(rows.len(), 7);
    for row in rows {
        let video = row["video"].as_str().unwrap();
        let complete = row["status"] == "scored" || row["status"] == "static";
        let told = explain(&place, video, "explained", &["--json"])
            .expect_code(if complete { 0 } else { 3 })
            .json();
        let measured = told["measured"].as_object().unwrap();
        assert!(measured.len() > 25, "{measured:?}");
        for (name, value) in measured {
            assert_eq!(row[name], *value, "{name} of {video}");
        }
        assert_eq!(row["profile_digest"], told["profile"]["digest"]);
        assert_eq!(json(&place.path("explained/explain.json")), told);
    }
}

/// The table's columns, the pictures' sizes, and the overlay's frames.
#[test]
fn files_are_whole_and_the_same_every_time() {
    let place = Place::with_clips(1);
    for out in ["one", "two"] {
        explain(&place, "clip-00.mp4", out, &[]).expect_code(0);
    }
    let files = files_below(&place.path("one"));
    assert_eq!(files, files_below(&place.path("two")));
    let told = json(&place.path("one/explain.json"));
    let listed: Vec<String> = told["files"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap())
        .map(|name| {
            if name.contains('/') {
                name.to_owned()
            } else {
                format!("/{name}")
            }
        })
        .collect();
    for name in &listed {
        assert!(files.contains_key(name), "{name} in {:?}", files.keys());
    }
    assert_eq!(listed.len(), files.len(), "{:?}", files.keys());

    let mut csv = csv::Reader::from_reader(files["/series.csv"].as_slice());
    let rows: Vec<BTreeMap<String, String>> = csv.deserialize().map(Result::unwrap).collect();
    assert_eq!(rows.len(), clips::FRAMES);
    let number = |row: usize, column: &str| rows[row][column].parse::<f64>().ok();
    // Frame 0 is left out, frame 1 has no frame before; j_t needs two pairs.
    assert_eq!(number(1, "aepe_px"), None);
    assert_eq!(number(2, "reproj_jump_px"), None);
    let jump = number(3, "reproj_px").unwrap() - number(2, "reproj_px").unwrap();
    assert_eq!(number(3, "reproj_jump_px"), Some(jump));
    let aepe: Vec<f64> = (2..clips::FRAMES)
        .filter_map(|row| number(row, "aepe_px"))
        .collect();
    let mean = aepe.iter().sum::<f64>() / aepe.len() as f64;
    assert_eq!(told["measured"]["aepe_px"].as_f64(), Some(mean));
    for (frame, row) in rows.iter().enumerate() {
        assert_eq!(row["frame"], frame.to_string());
        if let Some(score) = number(frame, "jump") {
            let above = score > number(frame, "jump_threshold").unwrap();
            assert_eq!(row["jump_flag"], u8::from(above).to_string());
        }
    }

    // 64×48 drawn 576×432: two of them side by side in a heat map, one in the overlay.
    let map = listed
        .iter()
        .find(|name| name.contains("end_point_error"))
        .unwrap();
    let map = image::load_from_memory(&files[map]).unwrap();
    assert_eq!((map.width(), map.height()), (1182, 566));
    let plot = image::load_from_memory(&files["/series.png"]).unwrap();
    assert_eq!((plot.width(), plot.height()), (1100, 870));
    let (mut frames, mut sizes) = (0, Vec::new());
    let bytes: Arc<[u8]> = files["/overlay.mp4"].clone().into();
    let info = decode_video(bytes, &DecodeLimits::default(), &mut |frame| {
        frames += 1;
        sizes.push((frame.rgb.width, frame.rgb.height));
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(frames, clips::FRAMES);
    sizes.dedup();
    assert_eq!(sizes, [(596, 570)]);
    assert_eq!(info.fps, Some(10.0));
}

/// Another explanation into the same place leaves nothing of the one before.
#[test]
fn an_earlier_explanation_is_replaced() {
    let place = Place::with_clips(1);
    std::fs::write(place.video("text.mp4"), "just some text\n").unwrap();
    explain(&place, "clip-00.mp4", "out", &[]).expect_code(0);
    std::fs::write(place.path("out/notes.txt"), "mine").unwrap();
    std::fs::write(place.path("out/.plumbline-killed.mp4"), "half").unwrap();
    let ended = explain(&place, "text.mp4", "out", &[]).expect_code(3);
    ended.expect_line(&["undecodable", "give a video"]);
    let names: Vec<String> = files_below(&place.path("out")).into_keys().collect();
    assert_eq!(names, ["/explain.json", "/faults.json", "/notes.txt"]);
    assert!(json(&place.path("out/faults.json"))["faults"].is_null());
}

#[test]
fn wrong_use_is_told_and_nothing_is_written() {
    let place = Place::with_clips(2);
    let run = |words: &[&str]| {
        let mut command = place.command(plumbline());
        Started::start(command.arg("explain").args(words)).wait()
    };
    run(&["videos/no.mp4", "--out", "out"])
        .expect_code(2)
        .expect_line(&["no such file", "check the path"]);
    run(&["videos", "--out", "out"])
        .expect_code(2)
        .expect_line(&["holds 2 videos", "name one"]);
    assert!(!place.path("out").exists());
    place.run("scored", &[]).expect_code(0);
    let before = place.published("scored").stable_files();
    run(&["videos/clip-00.mp4", "--out", "scored"])
        .expect_code(2)
        .expect_line(&["holds the results of a score run", "choose another"]);
    assert_eq!(place.published("scored").stable_files(), before);
}

/// Time and memory bind as they do for a score row.
#[test]
fn limits_bind() {
    let place = Place::with_clips(1);
    let told = explain(
        &place,
        "clip-00.mp4",
        "slow",
        &["--deadline", "0.001", "--json"],
    )
    .expect_code(3)
    .expect_line(&["failed: not measured within 0.001 s", "raise --deadline"])
    .json();
    assert_eq!(told["measured"]["status"], "failed");
}

#[test]
fn an_interrupt_leaves_no_explanation_and_no_child() {
    let place = Place::new();
    clips::write_long(&place.video("long.mp4"), 0);
    let mut command = place.command(plumbline());
    command.args(["explain", "videos/long.mp4", "--out", "out"]);
    let started = Started::start(&mut command);
    let pid = started.pid();
    let deadline = Duration::from_secs(30);
    wait_until("a child at work", deadline, || {
        children_of(pid).iter().any(|child| child.has_worked())
    });
    let children = children_of(pid);
    started.signal(Signal::INT);
    started
        .wait()
        .expect_code(130)
        .expect_line(&["interrupted", "run the same command again"]);
    wait_until("the child's end", deadline, || {
        !children.iter().any(|child| child.is_alive())
    });
    assert!(!place.path("out/explain.json").exists());
}
