//! Frozen references: `plumbline reference fit SCORES`, `--reference`, and `--watch`.

use std::fs;
use std::io::Write;
use std::time::{Duration, Instant};

use plumbline_tests::binary::plumbline;
use plumbline_tests::published::Row;
use plumbline_tests::run::{DEADLINE, Ended, Place, Started};
use rustix::process::Signal;
use serde_json::Value;

fn run(place: &Place, words: &[&str]) -> Ended {
    Started::start(place.command(plumbline()).args(words)).wait()
}

/// Clips, scored into `out`, and `ref.json` of them.
fn with_reference(clips: u64) -> Place {
    let place = Place::with_clips(clips);
    place.run("out", &["--recipe", "paper"]).expect_code(0);
    run(&place, &["reference", "fit", "out", "--out", "ref.json"])
        .expect_code(0)
        .expect_line(&["reference of", "ref.json"]);
    place
}

fn json(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&fs::read(place.path(name)).unwrap()).unwrap()
}

#[test]
fn one_video_is_scored_as_in_the_corpus_of_the_reference() {
    let place = with_reference(6);
    let whole = place.published("out").row("clip-03.mp4");
    let words = [
        "videos/clip-03.mp4",
        "--out",
        "one",
        "--profile",
        "draft",
        "--recipe",
        "paper",
    ];
    Started::start(place.score(&words).args(["--reference", "ref.json"]))
        .wait()
        .expect_code(0)
        .expect_line(&["with 1 rows against 6 it cannot be judged"]);
    let one = place.published("one").row("clip-03.mp4");
    for (name, value) in &whole {
        if !["rank", "decision"].contains(&name.as_str()) {
            assert_eq!(&one[name], value, "{name}");
        }
    }
    let corpus = place.published("one").corpus();
    assert_eq!(
        corpus["reference"]["digest"],
        json(&place, "ref.json")["digest"]
    );
    assert_eq!(
        corpus["reference"]["drift"]["anomaly"]["verdict"],
        "too_few"
    );
    assert!(
        fs::read_to_string(place.path("one/report.html"))
            .unwrap()
            .contains("Against the reference")
    );

    // Rows that exist give the same bytes, by the other recipe, too.
    for recipe in ["paper", "balanced"] {
        let rest = ["--reference", "ref.json", "--recipe", recipe];
        place.run("again", &rest).expect_code(0);
        let mut words = vec!["reduce", "out", "--out", "reduced"];
        words.extend(rest);
        run(&place, &words).expect_code(0);
        // Intervals, which corpus.json counts, are lost with another recipe: they need the frame pairs.
        let files = ["rewards.jsonl", "manifests/keep.jsonl", "corpus.json"];
        for file in &files[..if recipe == "paper" { 3 } else { 2 }] {
            let read = |out: &str| fs::read(place.path(out).join(file)).unwrap();
            assert!(read("reduced") == read("again"), "{file}, {recipe}");
        }
    }
}

#[test]
fn references_that_do_not_fit_are_refused_with_the_reason() {
    let place = with_reference(4);
    let refused = |words: &[&str], line: &[&str]| {
        let mut all = vec!["score", "videos", "--out", "no"];
        all.extend(words);
        run(&place, &all).expect_code(2).expect_line(line);
        assert!(!place.path("no").exists());
    };
    refused(
        &["--reference", "ref.json"],
        &[
            "ref.json",
            "another profile",
            "working_height_px 128, not 256",
            "fit it again",
        ],
    );
    let draft = ["--profile", "draft", "--reference"];
    let with = |more: &[&'static str]| [&draft[..], more].concat();
    refused(
        &with(&["ref.json", "--conditioning-frames", "2"]),
        &["conditioning_frames 1, not 2"],
    );
    refused(&with(&["absent.json"]), &["absent.json", "reference fit"]);
    let text = fs::read_to_string(place.path("ref.json")).unwrap();
    let changed = text.replacen("\"n\": 4", "\"n\": 5", 1);
    assert_ne!(text, changed);
    fs::write(place.path("changed.json"), changed).unwrap();
    refused(
        &with(&["changed.json"]),
        &["changed.json", "changed after it was written"],
    );
    refused(&with(&["out/corpus.json"]), &["not a reference"]);
    let refused_by_form = |words: &[&str], line: &[&str]| {
        run(&place, words).expect_code(2).expect_line(line);
    };
    let base = ["score", "videos", "--out", "no"];
    refused_by_form(
        &[&base[..], &["--reference", "ref.json", "--bins", "9"]].concat(),
        &["cannot be used with"],
    );
    refused_by_form(&[&base[..], &["--watch"]].concat(), &["required"]);
    let fit = ["reference", "fit", "--out", "no.json"];
    refused_by_form(
        &[&fit[..], &["out", "--profile", "draft"]].concat(),
        &["cannot be used with"],
    );
    refused_by_form(&fit, &["required"]);
    refused_by_form(
        &[&fit[..], &["absent"]].concat(),
        &["absent", "check the path"],
    );
    let mut store = place.score(&["s3://bucket/videos", "--out", "no", "--profile", "draft"]);
    Started::start(store.args(["--reference", "ref.json", "--watch"]))
        .wait()
        .expect_code(2)
        .expect_line(&["s3://bucket/videos", "copy the videos to a directory"]);
    assert!(!place.path("no").exists() && !place.path("no.json").exists());
}

fn lines(text: &str) -> Vec<Row> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// Waits until the watch has handed on so many rows.
fn wait_for_rows(place: &Place, out: &str, rows: usize) {
    let started = Instant::now();
    let read = || fs::read_to_string(place.path(out).join("stream.jsonl")).unwrap_or_default();
    while read().lines().count() < rows {
        assert!(started.elapsed() < DEADLINE, "{}", read());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Videos that arrive one by one, one of them slowly, come to what a run over all of them comes to.
#[test]
fn a_watch_publishes_what_a_run_does() {
    let place = with_reference(5);
    fs::write(place.video("broken.mp4"), b"no video").unwrap();
    let rest = ["--reference", "ref.json", "--keep", "s<=0"];
    place.run("batch", &rest).expect_code(3);
    fs::rename(place.path("videos"), place.path("held")).unwrap();
    fs::create_dir(place.path("videos")).unwrap();

    let mut command = place.score(&["videos", "--out", "live", "--profile", "draft", "--watch"]);
    command
        .args(rest)
        .args(["--watch-poll-s", "1", "--watch-until", "done", "--json"]);
    let watch = Started::start(&mut command);
    fs::copy(place.path("held/clip-02.mp4"), place.video("clip-02.mp4")).unwrap();
    wait_for_rows(&place, "live", 1);
    // Slowly: it changes between any two looks until it is whole.
    let bytes = fs::read(place.path("held/clip-00.mp4")).unwrap();
    let mut slow = fs::File::create(place.video("clip-00.mp4")).unwrap();
    for chunk in bytes.chunks(bytes.len().div_ceil(40)) {
        slow.write_all(chunk).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
    for name in ["clip-01.mp4", "clip-03.mp4", "clip-04.mp4", "broken.mp4"] {
        fs::copy(place.path("held").join(name), place.video(name)).unwrap();
    }
    fs::write(place.path("done"), "").unwrap();
    let ended = watch.wait().expect_code(3);

    for file in [
        "scores.jsonl",
        "scores.parquet",
        "scores.csv",
        "corpus.json",
        "rewards.parquet",
        "manifests/keep.jsonl",
        "manifests/drop.jsonl",
        "manifests/review.jsonl",
    ] {
        let read = |out: &str| fs::read(place.path(out).join(file)).unwrap();
        assert!(read("live") == read("batch"), "{file}");
    }
    let stream = fs::read_to_string(place.path("live/stream.jsonl")).unwrap();
    assert_eq!(ended.stdout, stream);
    let streamed = lines(&stream);
    assert_eq!(streamed[0]["video"], "clip-02.mp4");
    for mut row in place.published("live").rows() {
        row.remove("rank");
        assert_eq!(
            streamed.iter().filter(|line| **line == row).count(),
            1,
            "{row:?}"
        );
    }
    assert_eq!(streamed.len(), 6);
}

/// Ctrl-C ends the watch and publishes; the next one measures nothing twice.
#[test]
fn a_watch_ends_and_goes_on() {
    let place = with_reference(3);
    let watch = |words: &[&str]| {
        let mut command =
            place.score(&["videos", "--out", "live", "--profile", "draft", "--watch"]);
        command
            .args(["--reference", "ref.json", "--watch-poll-s", "0.2"])
            .args(words);
        Started::start(&mut command)
    };
    let first = watch(&[]);
    wait_for_rows(&place, "live", 3);
    first.signal(Signal::INT);
    first
        .wait()
        .expect_code(0)
        .expect_line(&["ending the watch"])
        .expect_line(&["3 measured now"]);
    assert_eq!(place.published("live").rows().len(), 3);
    let streamed = lines(&fs::read_to_string(place.path("live/stream.jsonl")).unwrap());
    // What depends on the others is not in a line.
    assert!(
        streamed
            .iter()
            .all(|row| !row.contains_key("rank") && !row.contains_key("decision"))
    );

    fs::copy(place.path("videos/clip-00.mp4"), place.video("more.mp4")).unwrap();
    watch(&["--watch-idle-s", "0.5"])
        .wait()
        .expect_code(0)
        .expect_line(&["1 measured now"]);
    assert_eq!(place.published("live").rows().len(), 4);
    assert_eq!(
        lines(&fs::read_to_string(place.path("live/stream.jsonl")).unwrap()).len(),
        4
    );

    fs::remove_dir_all(place.path("videos")).unwrap();
    fs::create_dir(place.path("videos")).unwrap();
    watch(&["--watch-idle-s", "0.3"])
        .wait()
        .expect_code(2)
        .expect_line(&["no video found"]);
}
