//! A cascade on a fleet: the second wave is asked of the same workers, under a name of its own.

use plumbline_tests::run::Started;

use crate::setup::Fleet;

#[tokio::test]
async fn a_fleet_climbs_as_one_machine_does() {
    let fleet = Fleet::with_clips("cascade", 40).await;
    let score = |out: &str, words: &[&str]| {
        let source = fleet.address("videos");
        let mut command = fleet.plumbline(&["score", &source, "--out", out]);
        command.args([
            "--group-by",
            "path:1",
            "--budget",
            "agreement=90%",
            "--json",
        ]);
        command.args(words);
        Started::start(&mut command).wait_within(std::time::Duration::from_secs(300))
    };
    score("embedded", &[]).expect_code(3);
    let _first = fleet.worker("first", &[]);
    let _second = fleet.worker("second", &[]);
    let on_fleet = score("out", &["--queue"]).expect_code(3);
    // Waves of both profiles, each under its own name.
    let runs: std::collections::BTreeSet<&str> = on_fleet
        .stderr
        .lines()
        .filter_map(|line| line.strip_prefix("run ")?.split_once(':'))
        .map(|(run, _)| run)
        .collect();
    assert_eq!(runs.len(), 2, "{}", on_fleet.stderr);
    let (found, expected) = (
        fleet.place.published("out").stable_files(),
        fleet.place.published("embedded").stable_files(),
    );
    assert!(found.keys().eq(expected.keys()));
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{name} differs");
    }
    let rungs = plumbline_tests::published::values(&fleet.place.published("out").rows(), "rung");
    assert_eq!(rungs.len(), 2, "{rungs:?}");
}
