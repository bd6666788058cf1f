//! What a coordinator counts of its run, under `plumbline_run_`, and what it sees of the fleet's queues.

use std::sync::Arc;
use std::time::Duration;

use plumbline_common::queue::{Broker, JobKind, Queue, QueueError};
use plumbline_common::row::Status;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

/// How often queues are looked at: as often as they are usually scraped.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// One label and its value.
type Label = [(&'static str, &'static str); 1];

const JOBS: Queue = Queue::Jobs(JobKind::Fused);

/// The queues whose lengths are shown, by the names they are shown under.
const WATCHED: [(&str, Queue); 2] = [("jobs", JOBS), ("dead", Queue::Dead)];

/// The figures; clones count into the same.
#[derive(Debug, Clone, Default)]
pub struct Metrics {
    videos: Gauge,
    kept: Gauge,
    answers: Family<Label, Counter>,
    ready: Family<Label, Gauge>,
    workers: Gauge,
}

impl Metrics {
    /// Shows them in `registry`; those of queues where there are any. Every count is there from the start, so
    /// that its first increase is one.
    pub fn register(&self, registry: &mut Registry, on_fleet: bool) {
        for status in Status::ALL {
            drop(self.answers.get_or_create(&[("status", status.as_str())]));
        }
        let run = registry.sub_registry_with_prefix("plumbline_run");
        run.register("videos", "Videos of the corpus", self.videos.clone());
        let about = "Videos measured, by this and earlier runs into the same OUT";
        run.register("videos_measured", about, self.kept.clone());
        let about = "Answers taken, by status of the row";
        run.register("answers", about, self.answers.clone());
        if on_fleet {
            for (name, _) in WATCHED {
                drop(self.ready.get_or_create(&[("queue", name)]));
            }
            let queue = registry.sub_registry_with_prefix("plumbline_queue");
            let about = "Messages that wait for a receiver, by queue";
            queue.register("ready", about, self.ready.clone());
            let about = "Workers that receive jobs, a consumer each";
            queue.register("workers", about, self.workers.clone());
        }
    }

    pub(crate) fn corpus(&self, videos: usize, kept: usize) {
        self.videos.set(as_gauge(videos as u64));
        self.kept.set(as_gauge(kept as u64));
    }

    pub(crate) fn answer(&self, status: Status, kept: usize) {
        let label = [("status", status.as_str())];
        self.answers.get_or_create(&label).inc();
        self.kept.set(as_gauge(kept as u64));
    }

    /// Looks at the queues until dropped. A broker that does not answer leaves the figures as they are.
    pub async fn watch_queues(self, broker: Arc<dyn Broker>) {
        let mut looks = tokio::time::interval(LOOK_EVERY);
        loop {
            looks.tick().await;
            if let Err(error) = self.look(broker.as_ref()).await {
                tracing::info!(%error, "the queues were not looked at");
            }
        }
    }

    async fn look(&self, broker: &dyn Broker) -> Result<(), QueueError> {
        for (name, queue) in &WATCHED {
            let ready = broker.ready(queue).await?;
            let label = [("queue", *name)];
            self.ready.get_or_create(&label).set(as_gauge(ready));
        }
        self.workers.set(as_gauge(broker.consumers(&JOBS).await?));
        Ok(())
    }
}

fn as_gauge(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::queue::{LocalBroker, LocalOptions, Message};
    use prometheus_client::encoding::text;

    fn shown(metrics: &Metrics) -> String {
        let mut registry = Registry::default();
        metrics.register(&mut registry, true);
        let mut text = String::new();
        text::encode(&mut text, &registry).unwrap();
        text
    }

    #[tokio::test]
    async fn a_run_and_its_queues_are_shown() {
        let broker = LocalBroker::new(LocalOptions::default());
        let jobs = Queue::Jobs(JobKind::Fused);
        broker.publish(&jobs, Message::new("a", "x")).await.unwrap();
        let metrics = Metrics::default();
        metrics.corpus(5, 1);
        metrics.answer(Status::Scored, 2);
        metrics.answer(Status::Failed, 3);
        metrics.look(&broker).await.unwrap();
        let text = shown(&metrics);
        for line in [
            "plumbline_run_videos 5",
            "plumbline_run_videos_measured 3",
            "plumbline_run_answers_total{status=\"scored\"} 1",
            "plumbline_run_answers_total{status=\"failed\"} 1",
            "plumbline_queue_ready{queue=\"jobs\"} 1",
            "plumbline_queue_ready{queue=\"dead\"} 0",
            "plumbline_queue_workers 0",
        ] {
            assert!(text.lines().any(|shown| shown == line), "{line}:\n{text}");
        }
    }
}
