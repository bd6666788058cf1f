//! From nothing to scores with two workers, as the README says; the same bytes whoever measures.

use std::collections::BTreeSet;

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
