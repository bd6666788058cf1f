//! Jobs into the queue: many confirmations under way at once, and a bounded number without an answer.

use std::sync::Arc;

use futures_util::{StreamExt, TryStreamExt, stream};
use plumbline_common::id::RunId;
use plumbline_common::message::{self, FleetJob};
use plumbline_common::queue::{Broker, JobKind, Message, Queue};
use plumbline_worker::profile::Profile;
use tokio::sync::Semaphore;

use super::standings::{Standing, Standings};
use crate::corpus::Entry;
use crate::measuring::job;
use crate::run::RunError;

/// Publications whose confirmation is awaited at once: more bring no more.
const UNCONFIRMED: usize = 256;

/// Publishes the jobs of one run.
#[derive(Debug)]
pub(super) struct Publisher {
    broker: Arc<dyn Broker>,
    run: RunId,
    entries: Arc<Vec<Entry>>,
    profile: Profile,
    standings: Arc<Standings>,
    window: Arc<Semaphore>,
}

impl Publisher {
    pub(super) fn new(
        broker: Arc<dyn Broker>,
        run: RunId,
        entries: Arc<Vec<Entry>>,
        profile: Profile,
        standings: Arc<Standings>,
        window: usize,
    ) -> Self {
        Self {
            broker,
            run,
            entries,
            profile,
            standings,
            window: Arc::new(Semaphore::new(window.max(1))),
        }
    }

    /// A published job is answered.
    pub(super) fn one_less(&self) {
        self.window.add_permits(1);
    }

    /// Publishes those that are still waiting when there is room for them.
    pub(super) async fn publish(self: Arc<Self>, waiting: Vec<usize>) -> Result<(), RunError> {
        stream::iter(waiting)
            .filter_map(|index| {
                let this = Arc::clone(&self);
                async move { this.claim(index).await }
            })
            .map(|index| Arc::clone(&self).put(index))
            .buffer_unordered(UNCONFIRMED)
            .try_collect::<()>()
            .await
    }

    /// Publishes those that are published, and not answered, once more; they have their room.
    pub(super) async fn publish_again(
        self: Arc<Self>,
        published: Vec<usize>,
    ) -> Result<(), RunError> {
        let lost = published
            .into_iter()
            .filter(|&index| self.standings.get(index) == Standing::Published);
        stream::iter(lost)
            .map(|index| {
                self.standings.count_publication(index);
                Arc::clone(&self).put(index)
            })
            .buffer_unordered(UNCONFIRMED)
            .try_collect::<()>()
            .await
    }

    /// Waits for room; `None` where the video was answered meanwhile.
    async fn claim(&self, index: usize) -> Option<usize> {
        // The window is never closed.
        let room = self.window.acquire().await.ok()?;
        self.standings.claim(index).then(|| {
            room.forget();
            index
        })
    }

    async fn put(self: Arc<Self>, index: usize) -> Result<(), RunError> {
        let entry = self.entries.get(index);
        let job = entry.map(|entry| job(entry, &self.profile)).transpose();
        // What cannot be looked at is not asked.
        let Some(job) = job.map_err(RunError::Profile)?.flatten() else {
            return Ok(());
        };
        let job = FleetJob {
            run: self.run.clone(),
            job,
        };
        let body = message::encode(&job).map_err(RunError::Message)?;
        let mut message = Message::new(job.message_id(), body);
        message.traceparent = Some(traceparent(&message.id));
        self.broker
            .publish(&Queue::Jobs(JobKind::Fused), message)
            .await?;
        Ok(())
    }
}

/// A trace of its own for every job, the same on every copy.
fn traceparent(id: &str) -> String {
    let digest = blake3::hash(id.as_bytes()).to_hex();
    let (trace, rest) = digest.split_at(32);
    let (span, _) = rest.split_at(16);
    format!("00-{trace}-{span}-01")
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_trace_parent_has_the_standard_form() {
        let text = super::traceparent("run/video");
        let parts: Vec<_> = text.split('-').map(str::len).collect();
        assert_eq!(parts, [2, 32, 16, 2], "{text}");
        assert_ne!(text, super::traceparent("run/other"));
    }
}
