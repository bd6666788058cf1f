//! `plumbline profile`, and runs with knobs changed in a file.

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Ended, Place, Started};

fn profile(place: &Place, words: &[&str]) -> Ended {
    Started::start(place.command(plumbline()).arg("profile").args(words)).wait()
}

#[test]
fn a_changed_profile_measures_otherwise_and_says_so() {
    let place = Place::with_clips(2);
    let shown = profile(&place, &["show", "draft"]).expect_code(0).stdout;
    let (knob, changed) = ("working_height_px = 128", "working_height_px = 160");
    assert!(shown.contains(knob), "{shown}");
    std::fs::write(place.path("same.toml"), &shown).unwrap();
    std::fs::write(place.path("my.toml"), shown.replace(knob, changed)).unwrap();
    place.run("plain", &[]).expect_code(0);
    for (file, out) in [("same.toml", "same"), ("my.toml", "mine")] {
        let words = ["videos", "--profile", file, "--out", out];
        Started::start(&mut place.score(&words))
            .wait()
            .expect_code(0);
    }
    let plain = place.published("plain");
    assert_eq!(plain.stable_files(), place.published("same").stable_files());
    let (plain, mine) = (plain.corpus(), place.published("mine").corpus());
    assert_eq!(plain["profile"]["name"], "draft");
    assert_eq!(mine["profile"]["name"], "draft, changed");
    assert_eq!(mine["profile"]["parameters"]["working_height_px"], 160);
    assert_ne!(mine["profile"]["digest"], plain["profile"]["digest"]);

    let diff = profile(&place, &["diff", "draft", "my.toml", "--json"]).expect_code(0);
    assert_eq!(
        diff.json(),
        serde_json::json!({"working_height_px": [128, 160]})
    );
    let same = profile(&place, &["diff", "draft", "same.toml"]).expect_code(0);
    assert_eq!(same.stdout, "no difference\n");
}

#[test]
fn a_profile_that_cannot_work_is_refused_before_the_run() {
    let place = Place::with_clips(1);
    let refused = |text: &str, told: &[&str]| {
        std::fs::write(place.path("my.toml"), text).unwrap();
        let words = ["videos", "--profile", "my.toml", "--out", "out"];
        let ended = Started::start(&mut place.score(&words)).wait();
        ended.expect_code(2).expect_line(told);
        assert!(!place.path("out").exists());
    };
    refused("[flow]\nfinest = 1\n", &["my.toml", "finest"]);
    refused("[flow]\npatch_size = 7\n", &["my.toml", "patch"]);
    refused("edge_spans = []\n", &["my.toml", "cannot measure"]);
    refused("working_height_px = 0\n", &["my.toml", "cannot measure"]);
}
