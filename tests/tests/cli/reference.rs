//! `plumbline reference fit --faults`, and runs with the thresholds that it wrote.

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::Value;

/// As many as a fit needs.
const CLIPS: u64 = 20;

fn fit(place: &Place, out: &str, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    command
        .args([
            "reference",
            "fit",
            "--faults",
            "videos",
            "--profile",
            "draft",
        ])
        .args(["--out", out])
        .args(words);
    Started::start(&mut command).wait()
}

fn read(place: &Place, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(place.path(name)).unwrap()).unwrap()
}

#[test]
fn thresholds_are_fitted_and_bind_later_runs() {
    let place = Place::with_clips(CLIPS);
    fit(&place, "all.json", &["--quantile", "1", "--jobs", "2"])
        .expect_code(0)
        .expect_line(&["jump: ", "20 clips"])
        // Eight of the twenty clips have a moving camera.
        .expect_line(&["vanish: not fitted", "20 are needed"])
        .expect_line(&["note:", "follows the largest"]);
    fit(&place, "half.json", &["--quantile", "0.5", "--jobs", "1"]).expect_code(0);
    fit(&place, "again.json", &["--quantile", "0.5", "--jobs", "2"]).expect_code(0);
    let (all, half) = (read(&place, "all.json"), read(&place, "half.json"));
    assert_eq!(half, read(&place, "again.json"));
    for (name, fitted) in all["kinds"].as_object().unwrap() {
        if fitted["clips"] == CLIPS && name != "freeze" {
            assert_eq!(all["thresholds"][name], fitted["largest"], "{name}");
            assert_eq!(half["thresholds"][name], fitted["median"], "{name}");
        }
    }
    assert_eq!(all["clips"], CLIPS);
    assert!(
        all["thresholds"]["bad_frame"].is_null(),
        "draft has no such pairs"
    );

    // Nothing is above the largest; half the clips are above the median.
    let with = |thresholds: &str| {
        place
            .run("out", &["--fault-thresholds", thresholds])
            .expect_code(0)
    };
    let faulty = || {
        let is_faulty = |row: &plumbline_tests::published::Row| {
            let kinds = row["fault_kinds"].as_array().expect("judged");
            kinds.iter().any(|kind| kind == "jump")
        };
        place
            .published("out")
            .rows()
            .iter()
            .filter(|row| is_faulty(row))
            .count()
    };
    with("all.json").expect_line(&["20 measured now"]);
    assert_eq!(faulty(), 0);
    let corpus = place.published("out").corpus();
    assert_eq!(corpus["fault_calibration"]["clips"], CLIPS);
    let jump = |corpus: &Value| corpus["profile"]["parameters"]["fault_thresholds"]["jump"].clone();
    assert_eq!(jump(&corpus), all["thresholds"]["jump"]);
    with("all.json").expect_line(&["0 measured now"]);
    // Other thresholds are another profile: nothing measured with the first ones is taken over.
    with("half.json").expect_line(&["20 measured now"]);
    assert_eq!(faulty(), CLIPS as usize / 2);

    // Of one video, too.
    let mut command = place.command(plumbline());
    command.args([
        "explain",
        "videos/clip-00.mp4",
        "--out",
        "one",
        "--profile",
        "draft",
    ]);
    let told = Started::start(command.args(["--fault-thresholds", "half.json", "--json"]))
        .wait()
        .expect_code(0)
        .json();
    assert_eq!(told["fault_calibration"]["quantile"], 0.5);
    assert_eq!(
        read(&place, "one/faults.json")["thresholds"]["jump"],
        half["thresholds"]["jump"]
    );

    // They do not fit another profile.
    let words = [
        "videos",
        "--out",
        "other",
        "--fault-thresholds",
        "half.json",
    ];
    Started::start(&mut place.score(&words))
        .wait()
        .expect_code(2)
        .expect_line(&["half.json", "fitted for profile draft", "fit them again"]);
    assert!(!place.path("other").exists());
}

#[test]
fn too_few_or_broken_clips_are_refused_with_the_reason() {
    let place = Place::with_clips(3);
    std::fs::write(place.video("a-text.mp4"), "text").unwrap();
    fit(&place, "few.json", &[]).expect_code(2).expect_line(&[
        "3 of 4 clips can be used",
        "20 are needed",
        "a-text.mp4",
        "undecodable",
    ]);
    assert!(!place.path("few.json").exists());
    fit(&place, "few.json", &["--quantile", "1.5"])
        .expect_code(2)
        .expect_line(&["--quantile"]);
    std::fs::write(place.path("not.json"), "{}").unwrap();
    place
        .run("out", &["--fault-thresholds", "not.json"])
        .expect_code(2)
        .expect_line(&["not.json: not a thresholds file", "reference fit --faults"]);
}
