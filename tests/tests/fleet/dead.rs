//! Jobs that no worker gets done: a row with its reason, a dead letter, and a second chance.

use std::time::Duration;

use plumbline_tests::clips;
use plumbline_tests::run::Started;

use crate::setup::Fleet;

#[tokio::test]
async fn a_job_past_its_deadline_is_a_row_and_a_dead_letter_and_is_measured_after_a_fix() {
    let fleet = Fleet::with_clips("dead", 3).await;
    // Seconds at this profile, on a worker that gives it half of one.
    let once = clips::frames(&clips::spec(7));
    let long = vec![once; 30].concat();
    clips::write(&fleet.place.video("pick/long.mp4"), &long);
    fleet.upload().await;
    let score = || fleet.score("out", &["--queue", "--json"]);
    let mut hasty = fleet.worker("hasty", &["--deadline", "0.5"]);
    let ended = Started::start(&mut score()).wait().expect_code(3);
    let run = ended.json()["run"].as_str().unwrap().to_owned();
    let row = fleet.place.published("out").row("pick/long.mp4");
    assert_eq!(row["status"], "failed");
    assert!(
        row["status_reason"].as_str().unwrap().contains("0.5 s"),
        "{row:?}"
    );

    // On a busy machine others may have been too slow, too.
    let dead = fleet
        .run(&["fleet", "dead", "--json"])
        .expect_code(0)
        .json();
    let dead = dead.as_array().unwrap();
    assert!(
        dead.iter().any(|letter| letter["video"] == "pick/long.mp4"),
        "{dead:?}"
    );
    for letter in dead {
        assert_eq!(letter["run"], run.as_str());
        assert!(
            letter["reason"].as_str().unwrap().contains("0.5 s"),
            "{letter}"
        );
        let row = fleet
            .place
            .published("out")
            .row(letter["video"].as_str().unwrap());
        assert_eq!(row["status"], "failed");
    }
    let status = fleet.run(&["fleet", "status", "--json"]).expect_code(0);
    let status = status.json();
    assert_eq!(
        status["dead"],
        serde_json::json!({ run.clone(): dead.len() })
    );
    assert_eq!(status["jobs"]["consumers"], 1);

    // The fix: a worker with time. What is scored already is not measured again.
    hasty.terminate(Duration::from_secs(20)).unwrap();
    let _patient = fleet.worker("patient", &["--deadline", "600"]);
    fleet
        .run(&["fleet", "retry", &run])
        .expect_code(0)
        .expect_line(&[&format!("{} job", dead.len()), "plumbline score"]);
    let ended = Started::start(&mut score()).wait().expect_code(3);
    assert_eq!(ended.json()["measured_now"], dead.len());
    let row = fleet.place.published("out").row("pick/long.mp4");
    assert_eq!(row["status"], "scored", "{row:?}");
    let none = fleet.run(&["fleet", "dead", "--json"]).expect_code(0);
    assert_eq!(none.json(), serde_json::json!([]));
}

#[tokio::test]
async fn a_cancelled_run_stops_and_can_go_on() {
    let fleet = Fleet::with_clips("cancel", 4).await;
    let mut started = Started::start(&mut fleet.score("out", &["--queue", "--run", "night"]));
    let journal = fleet.place.published("out").journal();
    plumbline_tests::process::wait_until("jobs are out", Duration::from_secs(60), || {
        let status = fleet.run(&["fleet", "status", "--json"]);
        journal.exists() && status.json()["jobs"]["ready"] == 6
    });
    assert!(started.is_running());
    let run_id = std::fs::read_to_string(fleet.place.path("out/.plumbline/run")).unwrap();
    let run_id = run_id.trim();
    assert!(run_id.starts_with("night-"), "{run_id}");
    fleet.run(&["fleet", "cancel", run_id]).expect_code(0);
    started
        .wait()
        .expect_code(1)
        .expect_line(&["was cancelled", "run the same command again"]);
    // Workers drop what belongs to nobody, and the same command starts over.
    let _worker = fleet.worker("worker", &[]);
    Started::start(&mut fleet.score("out", &["--queue", "--run", "night"]))
        .wait()
        .expect_code(3);
    assert_eq!(fleet.place.published("out").rows().len(), 6);
}
