//! A coordinator that is killed and started again, and a second one for the same run.

use std::time::Duration;

use plumbline_tests::process::wait_until;
use plumbline_tests::run::Started;
use rustix::process::Signal;

use crate::setup::Fleet;

const PATIENCE: Duration = Duration::from_secs(90);

#[tokio::test]
async fn a_killed_coordinator_is_taken_over_and_nothing_is_measured_again() {
    let fleet = Fleet::with_clips("resume", 16).await;
    Started::start(&mut fleet.score("embedded", &[]))
        .wait()
        .expect_code(3);

    let mut first = Started::start(&mut fleet.score("out", &["--queue"]));
    let journal = fleet.place.published("out").journal();
    let rows_are_kept = || journal.metadata().is_ok_and(|file| file.len() > 0);
    // Before any worker is there: nothing can be done yet, and another coordinator is refused, wherever
    // its OUT is.
    wait_until("the first coordinator is at work", PATIENCE, || {
        journal.exists()
    });
    wait_until("another is refused", PATIENCE, || {
        let refused =
            Started::start(&mut fleet.score("other", &["--queue", "--window", "1"])).wait();
        refused.status.code() == Some(2) && refused.stderr.contains("another coordinator")
    });
    let _worker = fleet.worker("worker", &[]);
    wait_until("rows are kept", PATIENCE, rows_are_kept);
    assert!(first.is_running());
    first.signal(Signal::KILL);
    first.wait().expect_signal(Signal::KILL);
    assert!(!fleet.place.published("out").is_finished());

    let again = Started::start(&mut fleet.score("out", &["--queue"])).wait();
    let again = again.expect_code(3);
    assert!(
        again.stderr.contains("were measured by an earlier run"),
        "{}",
        again.stderr
    );
    let (out, embedded) = (
        fleet.place.published("out").stable_files(),
        fleet.place.published("embedded").stable_files(),
    );
    for (name, bytes) in &embedded {
        assert!(out[name] == *bytes, "{name} differs");
    }
}
