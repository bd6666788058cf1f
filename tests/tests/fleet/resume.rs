//! A coordinator that is killed and started again, and a second one for the same run.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use plumbline_tests::process::wait_until;
use plumbline_tests::run::Started;
use rustix::process::Signal;

use crate::setup::Fleet;

/// A port that was free a moment ago.
fn free_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap()
}

/// What is exposed there; nothing while nobody listens.
fn metrics(address: SocketAddr) -> String {
    let ask = || -> std::io::Result<String> {
        let mut stream = TcpStream::connect(address)?;
        stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer)
    };
    ask().unwrap_or_default()
}

const PATIENCE: Duration = Duration::from_secs(90);

#[tokio::test]
async fn a_killed_coordinator_is_taken_over_and_nothing_is_measured_again() {
    let fleet = Fleet::with_clips("resume", 16).await;
    Started::start(&mut fleet.score("embedded", &[]))
        .wait()
        .expect_code(3);

    let listen = free_address();
    let words = ["--queue", "--listen", &listen.to_string()];
    let mut first = Started::start(&mut fleet.score("out", &words));
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
    let shown = |line: &str| metrics(listen).lines().any(|shown| shown == line);
    wait_until("the jobs that wait are shown", PATIENCE, || {
        shown("plumbline_queue_ready{queue=\"jobs\"} 18")
    });
    assert!(shown("plumbline_run_videos 18") && shown("plumbline_queue_workers 0"));
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
