//! What a finished run leaves: every input once in every table, nothing on standard output unless
//! asked for.

use plumbline_tests::clips;
use plumbline_tests::published::{Row, names, number};
use plumbline_tests::run::{Place, Started};

const SIX: [&str; 6] = [
    "left/clip-0.mp4",
    "left/clip-1.mp4",
    "left/deep/clip-2.mp4",
    "right/clip-3.mp4",
    "right/clip-4.mp4",
    "top.mp4",
];

fn six_clips() -> Place {
    let place = Place::new();
    for (seed, name) in SIX.iter().enumerate() {
        clips::write_moving(&place.video(name), seed as u64);
    }
    std::fs::write(place.video("left/notes.txt"), "no video").unwrap();
    place
}

#[test]
fn every_video_is_scored_once_and_standard_output_stays_empty() {
    let place = six_clips();
    let ended = place.run("out", &[]).expect_code(0);
    assert_eq!(ended.stdout, "");
    let ended = ended
        .expect_line(&["passed over", "1 .txt"])
        .expect_line(&["6 measured now"])
        .expect_line(&["report:", "report.html"]);
    assert!(
        !ended.stderr.contains('\u{1b}'),
        "no colours or bars where nobody looks"
    );

    let published = place.published("out");
    published.expect_whole(&SIX);
    let corpus = published.corpus();
    assert_eq!(corpus["statuses"]["scored"], 6);
    assert_eq!(
        (&corpus["decisions"]["keep"], &corpus["keep"]),
        (&5.into(), &"80%".into())
    );
    let mut anomalies: Vec<f64> = published
        .rows()
        .iter()
        .map(|row| number(row, "anomaly"))
        .collect();
    anomalies.sort_by(f64::total_cmp);
    let median = format!("{:+.3}", (anomalies[2] + anomalies[3]) / 2.0);
    // Videos, scored, keep, drop, review, median anomaly.
    let words: Vec<&str> = ended
        .stderr
        .lines()
        .nth(2)
        .unwrap()
        .split_whitespace()
        .collect();
    assert_eq!(
        words,
        ["all", "6", "6", "5", "1", "0", &median],
        "{}",
        ended.stderr
    );
    for row in published.rows() {
        assert_eq!(
            (&row["width"], &row["height"], &row["frames"]),
            (&64.into(), &48.into(), &10.into())
        );
        assert_eq!(row["digest"].as_str().unwrap().len(), 64);
        assert!(number(&row, "motion_px") > 0.0);
        assert_eq!(number(&row, "reward"), -number(&row, "anomaly"));
    }
    let rewards = published.parquet("rewards.parquet");
    assert_eq!(names(&rewards), names(&published.rows()));
    let costs = published.jsonl("costs.jsonl");
    assert_eq!(costs.len(), 6);
    let spent = |row: &Row, of: &str| row[of].as_f64().is_some_and(|s| s > 0.0);
    assert!(
        costs
            .iter()
            .all(|row| spent(row, "total_s") && spent(row, "cpu_s"))
    );
    let report = std::fs::read_to_string(published.path("report.html")).unwrap();
    assert!(
        SIX.iter().all(|video| report.contains(video)),
        "the report names every video"
    );
}

#[test]
fn the_json_summary_is_all_of_standard_output() {
    let place = six_clips();
    let ended = place
        .run("out", &["--json", "--keep", "2"])
        .expect_code(0)
        .expect_line(&["report:"]);
    let summary = ended.json();
    assert_eq!(
        (&summary["videos"], &summary["measured_now"]),
        (&6.into(), &6.into())
    );
    assert_eq!(summary["statuses"]["scored"], 6);
    assert_eq!(
        (&summary["decisions"]["keep"], &summary["decisions"]["drop"]),
        (&2.into(), &4.into())
    );
    for file in summary["files"].as_array().unwrap() {
        assert!(
            place.path("out").join(file.as_str().unwrap()).is_file(),
            "{file}"
        );
    }
    assert_eq!(
        summary["files"].as_array().unwrap().last().unwrap(),
        "corpus.json"
    );
    place.published("out").expect_whole(&SIX);
}

#[test]
fn formats_are_what_was_asked_for_and_older_ones_go() {
    let place = Place::with_clips(2);
    place.run("out", &[]).expect_code(0);
    place
        .run("out", &["--format", "csv"])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    let published = place.published("out");
    assert_eq!(published.csv("scores.csv").len(), 2);
    for stale in [
        "scores.jsonl",
        "scores.parquet",
        "manifests/keep.parquet",
        "costs.parquet",
    ] {
        assert!(
            !published.path(stale).exists(),
            "{stale} would contradict this run"
        );
    }
    assert_eq!(published.jsonl("manifests/keep.jsonl").len(), 2);
}

#[test]
fn a_still_clip_is_static_and_that_is_no_failure() {
    let place = Place::with_clips(3);
    clips::write_still(&place.video("still.mp4"), 1);
    place
        .run("out", &[])
        .expect_code(0)
        .expect_line(&["static: still.mp4", "insufficient evidence"]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "clip-01.mp4", "clip-02.mp4", "still.mp4"]);
    let row = published.row("still.mp4");
    assert_eq!(
        (&row["status"], &row["decision"]),
        (&"static".into(), &"review".into())
    );
    assert!(row["anomaly"].is_null() && row["reward"].is_null());
}

/// One video has no corpus to stand out of: score 0, and the reader is told.
#[test]
fn a_corpus_of_one() {
    let place = Place::with_clips(1);
    place.run("out", &[]).expect_code(0).expect_line(&["note:"]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4"]);
    assert_eq!(number(&published.row("clip-00.mp4"), "anomaly"), 0.0);
}

#[test]
fn usage_errors_say_what_to_do_and_write_nothing() {
    let place = Place::with_clips(1);
    let cases: [(&[&str], &str); 8] = [
        (&["videos"], "--out"),
        (&["--out", "out"], "SOURCE"),
        (&["videos", "--out", "out", "--keep", "0%"], "keeps nothing"),
        (
            &["videos", "--out", "out", "--group-by", "path:0"],
            "path:1",
        ),
        (&["videos", "--out", "out", "--group-by", "task"], "path:N"),
        (&["videos", "--out", "out", "--deadline", "0"], "above 0"),
        (&["videos", "--out", "out", "--memory", "1"], "320 or more"),
        (&["s3:///videos", "--out", "out"], "s3://bucket/prefix"),
    ];
    for (words, remedy) in cases {
        let ended = Started::start(&mut place.score(words))
            .wait()
            .expect_code(2);
        assert!(ended.stderr.contains(remedy), "{words:?}: {}", ended.stderr);
        assert!(!place.path("out").exists(), "{words:?}");
    }
    std::fs::write(place.path("plumbline.toml"), "[compute]\nmemory = 3\n").unwrap();
    let ended = place.run("out", &[]).expect_code(2);
    assert!(
        ended.stderr.contains("plumbline.toml") && ended.stderr.contains("memory"),
        "{}",
        ended.stderr
    );
}
