//! The real servers of the tests, and what the test programs share.

#![allow(dead_code, reason = "each test program uses its own part")]

pub(crate) mod faulty_proxy;
pub(crate) mod queue_contract;
pub(crate) mod store_contract;

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use plumbline_common::backoff::Backoff;
use plumbline_common::queue::{AmqpBroker, AmqpOptions};
use plumbline_common::store::{S3Options, S3Store};

/// Longest that anything may take which a test waits for; a broker's restart is the longest of them.
pub(crate) const DEADLINE: Duration = Duration::from_secs(120);

/// What the environment says of a server. There is no skipping: a test that did not run is no proof.
pub(crate) fn server(variable: &str) -> String {
    std::env::var(variable).unwrap_or_else(|_| {
        panic!("{variable} is not set: this test needs real servers; run deploy/test.sh fleet, or deploy/servers.sh COMMAND")
    })
}

/// Runs `deploy/broker.sh` on the tests' own broker.
pub(crate) fn broker_script(words: &[&str]) -> String {
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../deploy/broker.sh");
    let output = Command::new(script)
        .arg(server("PLUMBLINE_TEST_BROKER_DIR"))
        .args(words)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{words:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// A name that no other test and no earlier run has.
pub(crate) fn unique(test: &str) -> String {
    let since_epoch = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap();
    format!("{test}-{}-{}", std::process::id(), since_epoch.as_nanos())
}

pub(crate) fn amqp_options(test: &str) -> AmqpOptions {
    AmqpOptions {
        namespace: unique(test),
        waits: vec![Duration::from_millis(300), Duration::from_millis(1500)],
        ..AmqpOptions::default()
    }
}

pub(crate) async fn amqp(test: &str) -> AmqpBroker {
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    AmqpBroker::connect(&url, amqp_options(test)).await.unwrap()
}

pub(crate) fn s3_options() -> S3Options {
    S3Options {
        endpoint: Some(server("PLUMBLINE_TEST_S3_ENDPOINT")),
        // Passing failures are made on purpose here: no need to be polite about them.
        backoff: Backoff {
            first: Duration::from_millis(10),
            longest: Duration::from_millis(50),
            attempts: 5,
        },
        part_bytes: 5 << 20,
        ..S3Options::default()
    }
}

/// An empty store: a prefix of its own in the test bucket.
pub(crate) async fn s3(test: &str, options: &S3Options) -> S3Store {
    let bucket = server("PLUMBLINE_TEST_S3_BUCKET");
    S3Store::connect(&bucket, &unique(test), options)
        .await
        .unwrap()
}
