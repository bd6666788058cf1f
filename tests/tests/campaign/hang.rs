//! Whether a run still moves, and in what state its broker is where it does not.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use plumbline_tests::servers::broker_says;

/// When a worker last answered a job, by what the workers write.
#[derive(Debug)]
pub(crate) struct Progress {
    /// Answers when the logs were last read.
    answers: usize,
    since: Instant,
    looked: Instant,
}

impl Progress {
    /// Between two looks at the logs.
    const EVERY: Duration = Duration::from_secs(2);

    pub(crate) fn new() -> Self {
        Self {
            answers: 0,
            since: Instant::now(),
            looked: Instant::now(),
        }
    }

    /// For how long there is no new answer in the workers' `logs`, since `started` at most.
    pub(crate) fn quiet(
        &mut self,
        logs: impl Iterator<Item = PathBuf>,
        started: Instant,
    ) -> Duration {
        if self.looked.elapsed() >= Self::EVERY {
            self.looked = Instant::now();
            let texts = logs.map(|log| std::fs::read_to_string(log).unwrap_or_default());
            let answers = texts.map(|text| text.matches(": answered ").count()).sum();
            if answers != self.answers {
                (self.answers, self.since) = (answers, self.looked);
            }
        }
        self.since.max(started).elapsed()
    }
}

/// Queues and channels as the broker sees them, a line for each, or why it does not tell.
pub(crate) fn broker_state() -> String {
    let queues = [
        "list_queues",
        "name",
        "state",
        "messages_ready",
        "messages_unacknowledged",
        "consumers",
    ];
    let channels = [
        "list_channels",
        "pid",
        "prefetch_count",
        "consumer_count",
        "messages_unacknowledged",
    ];
    let consumers = ["list_consumers", "queue_name", "channel_pid"];
    let tables = [&queues[..], &channels, &consumers].map(|words| match broker_says(words) {
        Ok(rows) => rows.iter().map(|row| format!("  {row}\n")).collect(),
        Err(error) => format!("  {error}\n"),
    });
    let [queues, channels, consumers] = tables;
    format!("queues:\n{queues}channels:\n{channels}consumers:\n{consumers}")
}
