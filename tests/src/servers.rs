//! The real servers of the fleet's tests, which can be killed and started again: `deploy/servers.sh` has
//! started them and says in the environment where they are.

use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;

/// What the environment says of a server. There is no skipping: a test that did not run is no proof.
///
/// # Panics
/// Where it says nothing.
pub fn server(variable: &str) -> String {
    std::env::var(variable).unwrap_or_else(|_| {
        panic!("{variable} is not set: this test needs real servers; run deploy/test.sh fleet, or deploy/servers.sh COMMAND")
    })
}

/// A server with a script in `deploy` that starts and kills it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Server {
    /// RabbitMQ.
    Broker,
    /// The S3-compatible store.
    Store,
}

impl Server {
    fn script(self) -> Command {
        let (script, place) = match self {
            Self::Broker => ("broker.sh", "PLUMBLINE_TEST_BROKER_DIR"),
            Self::Store => ("store.sh", "PLUMBLINE_TEST_STORE_DIR"),
        };
        let deploy = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../deploy");
        let mut command = Command::new(deploy.join(script));
        command.arg(server(place));
        command
    }

    fn run(self, words: &[&str]) -> Result<Vec<u8>, String> {
        let output = self.script().args(words).output().expect("the script runs");
        if output.status.success() {
            return Ok(output.stdout);
        }
        Err(format!(
            "{self:?} {words:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        ))
    }

    /// Ends it as a power cut would.
    pub fn kill(self) {
        self.run(&["kill"])
            .unwrap_or_else(|error| panic!("{error}"));
    }

    /// Starts it again on the same port and data, and waits until it answers.
    pub fn start(self) {
        self.run(&["start"])
            .unwrap_or_else(|error| panic!("{error}"));
    }
}

/// What RabbitMQ itself says, by `rabbitmqctl`; an error while it is away.
///
/// # Errors
/// What it said instead.
pub fn broker_says(words: &[&str]) -> Result<Vec<Value>, String> {
    let out = Server::Broker.run(&[&["ctl", "-q", "--formatter", "json"], words].concat())?;
    match serde_json::from_slice(&out) {
        Ok(Value::Array(rows)) => Ok(rows),
        _ => Err(format!("{words:?}: {}", String::from_utf8_lossy(&out))),
    }
}

/// Messages of one queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueueState {
    /// Its name.
    pub name: String,
    /// Waiting.
    pub ready: u64,
    /// Handed out and not settled.
    pub unacked: u64,
}

/// Every queue of the broker.
///
/// # Errors
/// What the broker said instead.
pub fn queues() -> Result<Vec<QueueState>, String> {
    let rows = broker_says(&[
        "list_queues",
        "name",
        "messages_ready",
        "messages_unacknowledged",
    ])?;
    Ok(rows
        .iter()
        .map(|row| QueueState {
            name: row["name"].as_str().unwrap_or_default().to_owned(),
            ready: row["messages_ready"].as_u64().unwrap_or(0),
            unacked: row["messages_unacknowledged"].as_u64().unwrap_or(0),
        })
        .collect())
}

/// A consumer of jobs as the broker sees it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobConsumer {
    /// How many unsettled messages it may hold; 0 is no bound.
    pub prefetch: u64,
    /// How many its channel holds.
    pub unacked: u64,
}

/// The consumers of the queues whose names begin with `prefix`. Two questions, so that a consumer that
/// came or went between them is left out.
///
/// # Errors
/// What the broker said instead.
pub fn consumers(prefix: &str) -> Result<Vec<JobConsumer>, String> {
    let consumers = broker_says(&["list_consumers"])?;
    let channels = broker_says(&["list_channels", "pid", "messages_unacknowledged"])?;
    let of_jobs = consumers.iter().filter(|consumer| {
        let queue = consumer["queue_name"].as_str();
        queue.is_some_and(|queue| queue.starts_with(prefix))
    });
    Ok(of_jobs
        .filter_map(|consumer| {
            let same = |channel: &&Value| channel["pid"] == consumer["channel_pid"];
            let channel = channels.iter().find(same)?;
            Some(JobConsumer {
                prefetch: consumer["prefetch_count"].as_u64()?,
                unacked: channel["messages_unacknowledged"].as_u64()?,
            })
        })
        .collect())
}
