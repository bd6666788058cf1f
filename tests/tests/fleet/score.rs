//! From nothing to scores with two workers, as the README says; the same bytes whoever measures.

use std::collections::BTreeSet;

use futures_util::TryStreamExt;
use plumbline_common::store::{ObjectKey, ObjectStore, fetch};
use plumbline_tests::binary::{plumbline, worker};
use plumbline_tests::published::names;
use plumbline_tests::run::Started;

use crate::setup::Fleet;

#[tokio::test]
async fn two_workers_score_a_bucket_and_every_file_is_what_one_machine_makes() {
    let fleet = Fleet::with_clips("score", 12).await;
    // Manifests say where videos are, corpus.json what was typed: these differ from a directory's.
    fleet
        .place
        .run(
            "local",
            &["--group-by", "path:1", "--format", "jsonl,parquet,csv"],
        )
        .expect_code(3);
    let format = ["--format", "jsonl,parquet,csv"];
    Started::start(&mut fleet.score("embedded", &format))
        .wait()
        .expect_code(3);

    let _first = fleet.worker("first", &[]);
    let _second = fleet.worker("second", &[]);
    let on_fleet = Started::start(&mut fleet.score("out", &[&format[..], &["--queue"]].concat()));
    on_fleet
        .wait()
        .expect_code(3)
        .expect_line(&["passed over", "1 .txt"]);

    let (out, embedded, local) = (
        fleet.place.published("out"),
        fleet.place.published("embedded"),
        fleet.place.published("local"),
    );
    assert_eq!(out.rows().len(), 14);
    let (found, expected) = (out.stable_files(), embedded.stable_files());
    assert_eq!(
        found.keys().collect::<Vec<_>>(),
        expected.keys().collect::<Vec<_>>()
    );
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{name} differs");
    }
    // A row that has no score names its video's address: else the scores are a directory's, too.
    let without_reasons = |mut rows: Vec<plumbline_tests::published::Row>| {
        for row in &mut rows {
            row.remove("status_reason");
        }
        rows
    };
    assert_eq!(without_reasons(out.rows()), without_reasons(local.rows()));
    assert_eq!(names(&out.rows()), names(&local.rows()));
    let workers: BTreeSet<String> =
        plumbline_tests::published::values(&out.jsonl("costs.jsonl"), "worker");
    assert!(
        workers.is_subset(&BTreeSet::from(["first".into(), "second".into()])),
        "{workers:?}"
    );
}

#[tokio::test]
async fn the_readme_takes_a_new_user_to_scores_with_two_workers() {
    let fleet = Fleet::with_clips("readme", 4).await;
    let readme = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md"));
    let readme = readme.unwrap();
    let (_, section) = readme.split_once("\n## On many machines\n").unwrap();
    let blocks: Vec<&str> = section.split("```\n").skip(1).step_by(2).collect();
    let commands = blocks[1];
    assert_eq!(
        commands.matches("plumbline-worker --name").count(),
        2,
        "{commands}"
    );
    let commands = commands
        .replace(
            "target/release/plumbline-worker",
            worker().to_str().unwrap(),
        )
        .replace("target/release/plumbline", plumbline().to_str().unwrap())
        .replace("s3://BUCKET/rollouts", &fleet.address("videos"))
        .replace("s3://BUCKET/scores", &fleet.address("scores"));
    let script = format!("trap 'kill $(jobs -p); wait' EXIT\n{commands}");
    let mut shell = fleet.command("bash".as_ref());
    Started::start(shell.args(["-c", &script]))
        .wait()
        .expect_code(3)
        .expect_line(&["6 videos for the fleet"]);
    let store = fleet.store("scores").await;
    let rows = store
        .head(&ObjectKey::new("scores.jsonl").unwrap())
        .await
        .unwrap();
    let rows = fetch(&store, &rows, 1 << 20).await.unwrap();
    assert_eq!(rows.iter().filter(|byte| **byte == b'\n').count(), 6);
}

#[tokio::test]
async fn an_out_in_a_bucket_holds_the_same_files_and_is_resumed_from() {
    let fleet = Fleet::with_clips("bucket", 6).await;
    Started::start(&mut fleet.score("embedded", &[]))
        .wait()
        .expect_code(3);
    let out = fleet.address("out");
    // Measured here and kept there; the fleet, asked for more rules, has nothing left to measure.
    let first = Started::start(&mut fleet.score(&out, &["--json"])).wait();
    assert_eq!(first.expect_code(3).json()["measured_now"], 8);
    let keep = ["--keep", "2", "--queue", "--json"];
    let again = Started::start(&mut fleet.score(&out, &keep)).wait();
    assert_eq!(again.expect_code(3).json()["measured_now"], 0);
    // Everything anew, by a worker.
    let _worker = fleet.worker("worker", &[]);
    let anew = ["--queue", "--no-resume", "--json"];
    let anew = Started::start(&mut fleet.score(&out, &anew)).wait();
    assert_eq!(anew.expect_code(3).json()["measured_now"], 8);

    let store = fleet.store("out").await;
    let objects: Vec<_> = store.list("").try_concat().await.unwrap();
    let keys: Vec<&str> = objects.iter().map(|object| object.key.as_str()).collect();
    assert!(keys.contains(&"report.html"), "{keys:?}");
    assert!(keys.iter().any(|key| key.contains("/parts/")), "{keys:?}");
    for (name, expected) in fleet.place.published("embedded").stable_files() {
        let object = objects.iter().find(|object| object.key.as_str() == name);
        let object = object.unwrap_or_else(|| panic!("{name} is not in {keys:?}"));
        let found = fetch(&store, object, 64 << 20).await.unwrap();
        assert!(found == expected, "{name} differs");
    }
}

#[tokio::test]
async fn what_belongs_to_workers_is_refused() {
    let fleet = Fleet::new("refused");
    for flag in [["--jobs", "2"], ["--deadline", "5"], ["--memory", "512"]] {
        Started::start(&mut fleet.score("out", &[&flag[..], &["--queue"]].concat()))
            .wait()
            .expect_code(2)
            .expect_line(&[flag[0], "plumbline-worker"]);
    }
    let bad_name = ["--queue", "--run", "Night 1"];
    fleet.upload().await;
    Started::start(&mut fleet.score("out", &bad_name))
        .wait()
        .expect_code(2);
    let mut unreachable = fleet.score("out", &["--queue", "http://127.0.0.1:1/"]);
    Started::start(&mut unreachable).wait().expect_code(2);
}
