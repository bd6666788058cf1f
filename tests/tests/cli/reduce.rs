//! `plumbline reduce` over what `plumbline score` published.

use std::fs;

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::Value;

fn reduce(place: &Place, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    Started::start(command.arg("reduce").args(words)).wait()
}

const FILES: [&str; 5] = [
    "manifests/keep.jsonl",
    "manifests/drop.jsonl",
    "manifests/review.jsonl",
    "scores.jsonl",
    "corpus.json",
];

/// The same settings give the same bytes, with paths and intervals, from every format.
#[test]
fn the_same_settings_give_what_score_published() {
    let place = Place::with_clips(6);
    fs::write(place.video("broken.mp4"), b"no video").unwrap();
    place
        .run("out", &["--recipe", "paper", "--keep", "50%"])
        .expect_code(3);
    for rows in ["out", "out/scores.parquet", "out/scores.jsonl"] {
        let words = [rows, "--out", "again", "--recipe", "paper", "--keep", "50%"];
        reduce(&place, &words).expect_code(3);
        for file in FILES {
            let read = |out: &str| fs::read_to_string(place.path(out).join(file)).unwrap();
            assert_eq!(read("again"), read("out"), "{file} of {rows}");
        }
    }
    assert!(!place.path("again/report.html").exists());
}

#[test]
fn other_settings_need_no_video() {
    let place = Place::with_clips(5);
    place.run("out", &["--recipe", "paper"]).expect_code(0);
    fs::remove_dir_all(place.path("videos")).unwrap();
    let words = [
        "out", "--out", "again", "--recipe", "balanced", "--keep", "2", "--json",
    ];
    let summary = reduce(&place, &words).expect_code(0).json();
    assert_eq!(summary["decisions"]["keep"], 2);
    let corpus: Value =
        serde_json::from_slice(&fs::read(place.path("again/corpus.json")).unwrap()).unwrap();
    assert_eq!(
        (corpus["recipe"].as_str(), corpus["keep"].as_str()),
        (Some("balanced"), Some("2"))
    );
    assert_eq!(corpus["profile"]["name"], "draft");
    let keep = place.published("again").jsonl("manifests/keep.jsonl");
    assert!(
        keep.iter()
            .all(|row| row["path"].as_str().unwrap().ends_with(".mp4"))
    );
    // Scores of another recipe have no interval without the series behind them.
    assert!(
        place
            .published("again")
            .jsonl("scores.jsonl")
            .iter()
            .all(|row| row["anomaly_lo"].is_null())
    );
}

#[test]
fn what_cannot_be_reduced_is_refused() {
    let place = Place::with_clips(1);
    place.run("out", &[]).expect_code(0);
    reduce(&place, &["out", "--out", "out"])
        .expect_code(2)
        .expect_line(&["choose another --out"]);
    assert!(place.published("out").is_finished());
    reduce(&place, &["absent", "--out", "again"])
        .expect_code(2)
        .expect_line(&["absent", "check the path"]);
    reduce(&place, &["videos", "--out", "again"])
        .expect_code(2)
        .expect_line(&["neither scores.parquet"]);
}
