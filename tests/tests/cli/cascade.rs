//! `score --budget`: draft for all, the profile for whom it matters; the same bytes however it is run.

use std::collections::BTreeSet;
use std::time::Duration;

use plumbline_tests::clips;
use plumbline_tests::process::wait_until;
use plumbline_tests::published::{Published, values};
use plumbline_tests::run::{Ended, Place, Started};
use rustix::process::Signal;

/// More than twice the smallest sample, so that not all are measured at the top.
const VIDEOS: u64 = 40;

const PATIENCE: Duration = Duration::from_secs(60);

fn start(place: &Place, out: &str, words: &[&str]) -> Started {
    let mut command = place.score(&["videos", "--out", out, "--profile", "standard", "--json"]);
    Started::start(command.args(["--group-by", "path:1"]).args(words))
}

fn cascade(place: &Place, out: &str, words: &[&str]) -> Ended {
    let words = [&["--budget", "agreement=90%"], words].concat();
    start(place, out, &words).wait_within(Duration::from_secs(300))
}

/// Moving clips in two groups, one that stands still, and one that is no video.
fn corpus() -> (Place, Vec<String>) {
    let place = Place::new();
    let mut names = Vec::new();
    for seed in 0..VIDEOS {
        let name = format!("{}/clip-{seed:02}.mp4", ["a", "b"][(seed % 2) as usize]);
        clips::write_moving(&place.video(&name), seed);
        names.push(name);
    }
    clips::write_still(&place.video("a/still.mp4"), 0);
    std::fs::write(place.video("b/text.mp4"), b"just some text\n").unwrap();
    names.extend(["a/still.mp4".to_owned(), "b/text.mp4".to_owned()]);
    (place, names)
}

fn rung<'a>(published: &'a serde_json::Value, name: &str) -> &'a serde_json::Value {
    let profiles = published["cascade"]["profiles"].as_array().unwrap();
    profiles.iter().find(|rung| rung["name"] == name).unwrap()
}

/// Every video once, from one of two profiles, with what is known of its decision.
fn expect_cascade(published: &Published, names: &[String]) {
    published.expect_whole(names);
    let rows = published.rows();
    assert_eq!(
        values(&rows, "rung"),
        BTreeSet::from(["draft".into(), "standard".into()])
    );
    let corpus = published.corpus();
    assert_eq!(corpus["cascade"]["sample"], 16);
    assert_eq!(corpus["cascade"]["reproducible"], true);
    let mut flips = 0.0;
    for row in &rows {
        let flip = row["flip_probability"].as_f64().unwrap();
        let of_rung = rung(&corpus, row["rung"].as_str().unwrap());
        assert_eq!(row["profile_digest"], of_rung["digest"], "{row:?}");
        assert!((0.0..=1.0).contains(&flip));
        flips += flip;
    }
    let expected = corpus["cascade"]["expected_flips"].as_f64().unwrap();
    assert!((flips - expected).abs() < 1e-9 && flips <= 0.1 * rows.len() as f64);
    assert_eq!(rung(&corpus, "draft")["measured"], rows.len());
    let at_top = rung(&corpus, "standard")["measured"].as_u64().unwrap();
    assert!((16 - 2..rows.len() as u64).contains(&at_top), "{at_top}");
    // What no profile can decode is not asked again.
    let text = published.row("b/text.mp4");
    assert_eq!(
        (&text["rung"], &text["status"]),
        (&"draft".into(), &"undecodable".into())
    );
    let kept = published.jsonl("manifests/keep.jsonl");
    assert!(
        kept.iter()
            .all(|line| line.contains_key("flip_probability"))
    );
    let costs = published.jsonl("costs.jsonl");
    assert_eq!(costs.len() as u64, rows.len() as u64 + at_top);
}

#[test]
fn a_cascade_has_the_same_bytes_whatever_the_jobs_and_after_a_kill() {
    let (place, names) = corpus();
    cascade(&place, "one", &["--jobs", "1"]).expect_code(3);
    expect_cascade(&place.published("one"), &names);
    let expected = place.published("one").stable_files();
    cascade(&place, "two", &["--jobs", "2"]).expect_code(3);
    let same = |out: &str| {
        let found = place.published(out).stable_files();
        assert!(found.keys().eq(expected.keys()), "{:?}", found.keys());
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "{name} of {out} differs");
        }
    };
    same("two");

    let mut killed = start(
        &place,
        "killed",
        &["--budget", "agreement=90%", "--jobs", "1"],
    );
    let journal = place.published("killed").journal();
    wait_until("the top profile is at work", PATIENCE, || {
        assert!(killed.is_running(), "it ended before it could be killed");
        journal.metadata().is_ok_and(|file| file.len() > 0)
    });
    killed.signal(Signal::KILL);
    killed.wait().expect_signal(Signal::KILL);
    assert!(!place.published("killed").is_finished());
    let resumed = cascade(&place, "killed", &[]).expect_code(3);
    let resumed = resumed.expect_line(&["of an earlier run are taken over"]);
    let measured_now = resumed.json()["measured_now"].as_u64().unwrap();
    assert!((1..VIDEOS).contains(&measured_now), "{measured_now}");
    same("killed");

    // With the profile alone, what the cascade has measured with it is taken over.
    let all = start(&place, "killed", &[])
        .wait_within(PATIENCE * 5)
        .expect_code(3);
    let all = all.json()["measured_now"].as_u64().unwrap();
    assert!(all < VIDEOS, "{all}");
    let whole = place.published("killed");
    whole.expect_whole(&names);
    assert!(whole.rows().iter().all(|row| !row.contains_key("rung")));
}

#[test]
fn too_few_videos_are_all_measured_with_the_profile() {
    let place = Place::with_clips(5);
    start(&place, "plain", &[]).wait().expect_code(0);
    cascade(&place, "out", &[])
        .expect_code(0)
        .expect_line(&["too few videos for a sample"]);
    let (found, plain) = (place.published("out"), place.published("plain"));
    assert_eq!(
        values(&found.rows(), "rung"),
        BTreeSet::from(["standard".into()])
    );
    for (row, plain) in found.rows().iter().zip(plain.rows()) {
        for column in [
            "video",
            "anomaly",
            "anomaly_lo",
            "rank",
            "decision",
            "profile_digest",
        ] {
            assert_eq!(row[column], plain[column], "{column}");
        }
    }
}

#[test]
fn a_budget_that_pays_for_no_sample_leaves_drafts_and_says_so() {
    let place = Place::with_clips(3);
    let out = start(&place, "out", &["--budget", "cpu=0.001s"])
        .wait()
        .expect_code(0);
    let out = out.expect_line(&["note:", "does not pay for a sample"]);
    let cascade = &out.json()["cascade"];
    assert_eq!(
        (&cascade["reproducible"], &cascade["expected_flips"]),
        (&false.into(), &serde_json::Value::Null)
    );
    let rows = place.published("out").rows();
    assert!(
        rows.iter()
            .all(|row| row["rung"] == "draft" && row["flip_probability"].is_null())
    );
}

#[test]
fn what_cannot_be_is_refused() {
    let place = Place::with_clips(1);
    for (words, told) in [
        (vec!["--budget", "soon"], "cpu=2h"),
        (
            vec!["--budget", "auto", "--profile", "draft"],
            "nothing to save",
        ),
        (
            vec!["--budget", "auto", "--normalise-within", "group"],
            "leave out",
        ),
        (
            vec!["--budget", "auto", "--reference", "x.json"],
            "cannot be used with",
        ),
    ] {
        let words = [&["videos", "--out", "out"][..], &words].concat();
        let refused = Started::start(&mut place.score(&words)).wait();
        refused.expect_code(2).expect_line(&[told]);
    }
}
