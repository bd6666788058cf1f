//! The profile `reference` from end to end, over small converted models of random weights: what it measures
//! means nothing, but every part of the way is the real one.
//!
//! `deploy/test.sh` makes the models and installs ONNX Runtime. Clips are of 256 × 256 px, the least that
//! SEA-RAFT takes at half resolution; DROID-SLAM sees them at 128 × 128.

use std::path::{Path, PathBuf};

use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::scene::Family;
use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::published::Row;
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::Value;

const SMALL: &str =
    "rung = \"reference\"\n[droid]\narea_px = 16384\n[droid.tracker]\nbackend_steps = [2, 2]\n";

/// The model sets and the library.
fn models() -> Option<(PathBuf, PathBuf)> {
    let work = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (sets, library) = (
        work.join("models"),
        work.join("models-venv/libonnxruntime.so"),
    );
    if sets.join("done").is_file() && library.is_file() {
        return Some((sets, library));
    }
    eprintln!("skipped: no models; deploy/test.sh makes them");
    None
}

/// Two clips and a profile that is quick.
fn place() -> Place {
    let place = Place::new();
    for (seed, family) in [Family::Pan, Family::Dolly].into_iter().enumerate() {
        let spec = ClipSpec {
            frames: 5,
            fps: 10.0,
            ..ClipSpec::clean(family, 0, seed as u64).with_size(256, 256)
        };
        clips::write(
            &place.video(format!("clip-{seed}.mp4")),
            &clips::frames(&spec),
        );
    }
    std::fs::write(place.path("small.toml"), SMALL).unwrap();
    place
}

fn score(place: &Place, (sets, library): &(PathBuf, PathBuf), words: &[&str]) -> Ended {
    let mut command = place.score(&["videos", "--models"]);
    command.arg(sets).arg("--onnxruntime").arg(library);
    Started::start(command.args(words)).wait()
}

fn number(row: &Row, column: &str) -> f64 {
    row[column]
        .as_f64()
        .unwrap_or_else(|| panic!("{column} of {row:?}"))
}

fn digest(sets: &Path, network: &str) -> String {
    for set in ["sea-raft-small", "droid"] {
        let path = sets.join(set).join("model.json");
        let text = std::fs::read_to_string(&path).unwrap();
        let sidecar: Value = serde_json::from_str(&text).unwrap();
        if sidecar["network"] == network {
            // As `sha256sum model.json` prints it.
            let printed = std::process::Command::new("sha256sum")
                .arg(&path)
                .output()
                .unwrap();
            return String::from_utf8(printed.stdout).unwrap()[..64].to_owned();
        }
    }
    panic!("no {network} in {}", sets.display());
}

#[test]
fn the_reference_profile_measures_what_worldscore_measures_and_names_its_models() {
    let Some(models) = models() else {
        return;
    };
    let place = place();
    let words = [
        "--profile",
        "small.toml",
        "--recipe",
        "paper",
        "--format",
        "jsonl,parquet,csv",
    ];
    score(&place, &models, &[&words[..], &["--out", "out"]].concat()).expect_code(0);
    let out = place.published("out");
    let digests = ["sea-raft", "droid"].map(|network| digest(&models.0, network));
    let corpus = out.corpus();
    let parameters = &corpus["profile"]["parameters"];
    assert_eq!(parameters["sea_raft"]["model"], digests[0]);
    assert_eq!(parameters["droid"]["model"], digests[1]);
    let rows = out.rows();
    for row in &rows {
        assert_eq!(row["status"], "scored", "{row:?}");
        // WorldScore's normalisers.
        for (score, error, most) in [
            ("worldscore_3d", "reproj_droid_px", 1.0719),
            ("worldscore_photometric", "aepe_worldscore_px", 1.1920),
        ] {
            let error = number(row, error);
            let expected = 100.0 * (1.0 - error.min(most) / most);
            assert!(
                error > 0.0 && (number(row, score) - expected).abs() < 1e-9,
                "{row:?}"
            );
        }
        let named = format!("sea-raft {}, droid {}", digests[0], digests[1]);
        assert_eq!(row["models"], named);
        // The classical measures stand beside, at the height of `standard`.
        assert!(row["aepe_px"].is_number() && row["motion_px"].is_number());
    }
    // z of s_3 is DROID-SLAM's: of two values −1 and 1.
    let [a, b] = [0, 1].map(|k| number(&rows[k], "reproj_droid_px"));
    let z = [0, 1].map(|k| number(&rows[k], "z_reproj_px"));
    assert!(
        (z[0] - (a - b).signum()).abs() < 1e-9 && z[1] == -z[0],
        "{a} {b} {z:?}"
    );
    for costs in out.jsonl("costs.jsonl") {
        assert!(number(&costs, "photometric_s") > 0.0 && number(&costs, "tracking_s") > 0.0);
        assert!(number(&costs, "edge_updates") > 50.0 && number(&costs, "peak_memory_mib") > 20.0);
    }
    let table = out.csv("scores.csv");
    assert_eq!(
        table[0]["worldscore_3d"].parse::<f64>().unwrap(),
        number(&rows[0], "worldscore_3d")
    );

    // The same again, and by the rows alone.
    score(&place, &models, &[&words[..], &["--out", "again"]].concat()).expect_code(0);
    assert_eq!(out.stable_files(), place.published("again").stable_files());
    let mut reduce = place.command(plumbline());
    reduce.args([
        "reduce",
        "out/scores.parquet",
        "--recipe",
        "paper",
        "--out",
        "reduced",
    ]);
    Started::start(&mut reduce).wait().expect_code(0);
    for (row, reduced) in rows.iter().zip(place.published("reduced").rows()) {
        for column in [
            "anomaly",
            "z_reproj_px",
            "worldscore_3d",
            "reproj_droid_px",
            "models",
        ] {
            assert_eq!(row[column], reduced[column], "{column}");
        }
    }
}

#[test]
fn sea_raft_takes_the_place_of_the_classical_flow() {
    let Some(models) = models() else {
        return;
    };
    let place = place();
    // Random weights find random flow, and the verdict says so.
    score(&place, &models, &["--flow", "sea-raft", "--out", "learned"]).expect_code(3);
    score(&place, &models, &["--out", "classical"]).expect_code(0);
    let [learned, classical] = ["learned", "classical"].map(|out| place.published(out));
    assert_eq!(learned.corpus()["profile"]["name"], "standard, changed");
    for (learned, classical) in learned.rows().iter().zip(classical.rows()) {
        assert_eq!(
            (&learned["status"], &classical["status"]),
            (&"collapsed".into(), &"scored".into())
        );
        assert_ne!(learned["motion_px"], classical["motion_px"]);
        assert!(learned["models"].as_str().unwrap().starts_with("sea-raft "));
        for column in [
            "models",
            "reproj_droid_px",
            "worldscore_3d",
            "worldscore_photometric",
        ] {
            assert!(classical[column].is_null(), "{column}");
        }
    }
    score(
        &place,
        &models,
        &["--profile", "small.toml", "--flow", "dis", "--out", "none"],
    )
    .expect_code(2)
    .expect_line(&["--flow"]);
}

#[test]
fn clips_beyond_what_the_networks_take_are_told_why() {
    let Some(models) = models() else {
        return;
    };
    let place = place();
    clips::write_short(&place.video("little.mp4"), 0, 3);
    let few = SMALL.replace("area_px", "most_frames = 4\narea_px");
    std::fs::write(place.path("few.toml"), few).unwrap();
    score(&place, &models, &["--profile", "few.toml", "--out", "out"]).expect_code(3);
    let reason = |video: &str, status: &str| {
        let row = place.published("out").row(video);
        assert_eq!(row["status"], status, "{row:?}");
        row["status_reason"].as_str().unwrap().to_owned()
    };
    let long = reason("clip-0.mp4", "over_limit");
    assert!(
        long.contains("5 frames") && long.contains("droid.most_frames"),
        "{long}"
    );
    let little = reason("little.mp4", "failed");
    assert!(
        little.contains("64x48") && little.contains("242 px"),
        "{little}"
    );
}

/// One line says what is missing, before anything is made.
#[test]
fn without_models_or_library_nothing_begins() {
    let place = Place::with_clips(1);
    std::fs::create_dir(place.path("empty")).unwrap();
    std::fs::write(place.path("text"), "no library").unwrap();
    let refused = |words: &[&str], told: &[&str]| {
        let words = [
            &["videos", "--profile", "reference", "--out", "out"][..],
            words,
        ]
        .concat();
        let ended = Started::start(&mut place.score(&words)).wait();
        let ended = ended.expect_code(2).expect_line(told);
        assert_eq!(ended.stderr.lines().count(), 1, "{}", ended.stderr);
        assert!(!place.path("out").exists());
    };
    let remedy = [
        "convert.py",
        "droid.pth",
        "setup.sh",
        "--models",
        "--onnxruntime",
    ];
    refused(&[], &[&["SEA-RAFT"][..], &remedy[..]].concat());
    refused(
        &["--models", "empty"],
        &[&["empty holds no"][..], &remedy[..]].concat(),
    );
    let Some((sets, _)) = models() else {
        return;
    };
    let sets = sets.to_str().unwrap();
    refused(
        &["--models", sets],
        &["ONNX Runtime", "setup.sh", "--onnxruntime"],
    );
    let wrong = ["--models", sets, "--onnxruntime"];
    refused(
        &[&wrong[..], &["nowhere.so"]].concat(),
        &["no ONNX Runtime", "nowhere.so", "setup.sh"],
    );
    refused(
        &[&wrong[..], &["text"]].concat(),
        &["text is not an ONNX Runtime", "setup.sh"],
    );
}

#[test]
fn a_damaged_set_is_found_before_the_first_video() {
    let Some((sets, library)) = models() else {
        return;
    };
    let place = place();
    for set in ["sea-raft-small", "droid"] {
        let copy = place.path("sets").join(set);
        std::fs::create_dir_all(&copy).unwrap();
        for file in std::fs::read_dir(sets.join(set)).unwrap() {
            let file = file.unwrap().path();
            std::fs::copy(&file, copy.join(file.file_name().unwrap())).unwrap();
        }
    }
    let graph = place.path("sets/droid/update.onnx");
    let mut bytes = std::fs::read(&graph).unwrap();
    bytes[5000] ^= 1;
    std::fs::write(&graph, bytes).unwrap();
    let models = (place.path("sets"), library);
    score(&place, &models, &["--profile", "reference", "--out", "out"])
        .expect_code(2)
        .expect_line(&["update.onnx", "model.json", "convert"]);
    assert!(!place.path("out").exists());
}
