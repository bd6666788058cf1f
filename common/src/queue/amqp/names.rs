//! What things are called on the broker; the program's version does not matter, the namespace does.

use std::time::Duration;

use crate::id::RunId;
use crate::queue::Queue;

/// Longest namespace, in bytes: with the longest queue it stays within AMQP's 255.
pub(super) const MAX_NAMESPACE_BYTES: usize = 64;

/// Names within one namespace (`plumbline` by default).
#[derive(Debug, Clone)]
pub(super) struct Names {
    namespace: String,
}

/// Where a message is published to.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Target {
    pub(super) exchange: String,
    pub(super) routing_key: String,
}

impl Names {
    /// `None` unless the namespace is 1 to [`MAX_NAMESPACE_BYTES`] of `a`–`z`, `0`–`9`, `-`, `_`, `.`.
    pub(super) fn new(namespace: &str) -> Option<Self> {
        let allowed = |byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_' | b'.');
        let usable =
            (1..=MAX_NAMESPACE_BYTES).contains(&namespace.len()) && namespace.bytes().all(allowed);
        usable.then(|| Self {
            namespace: namespace.to_owned(),
        })
    }

    pub(super) fn queue(&self, queue: &Queue) -> String {
        format!("{}.{queue}", self.namespace)
    }

    /// The queue behind a name or routing key.
    pub(super) fn parse(&self, name: &str) -> Option<Queue> {
        let below = name.strip_prefix(&self.namespace)?.strip_prefix('.')?;
        Queue::from_name(below)
    }

    /// The direct exchange that jobs and results go through.
    pub(super) fn work_exchange(&self) -> String {
        self.namespace.clone()
    }

    /// The direct exchange by which messages come back from a wait. It differs from the first in what
    /// it does with a message whose queue is gone: the dead letter queue, not a refusal nobody hears.
    pub(super) fn back_exchange(&self) -> String {
        format!("{}.back", self.namespace)
    }

    /// The fanout exchange of dead letters, and the name of their queue.
    pub(super) fn dead_exchange(&self) -> String {
        self.queue(&Queue::Dead)
    }

    /// The fanout exchange and the queue of one wait.
    pub(super) fn wait(&self, wait: Duration) -> String {
        format!("{}.wait.{}ms", self.namespace, wait.as_millis())
    }

    pub(super) fn lease(&self, run: &RunId) -> String {
        format!("{}.lease.{run}", self.namespace)
    }

    /// Into a queue.
    pub(super) fn to_queue(&self, queue: &Queue) -> Target {
        Target {
            exchange: match queue {
                Queue::Dead => self.dead_exchange(),
                Queue::Jobs(_) | Queue::Results(_) => self.work_exchange(),
            },
            routing_key: self.queue(queue),
        }
    }

    /// Into a queue after a wait. The routing key stays with the message and brings it back.
    pub(super) fn to_queue_after(&self, queue: &Queue, wait: Duration) -> Target {
        Target {
            exchange: self.wait(wait),
            routing_key: self.queue(queue),
        }
    }

    /// Into the dead letters; the routing key tells whence.
    pub(super) fn to_dead(&self, queue: &Queue) -> Target {
        Target {
            exchange: self.dead_exchange(),
            routing_key: self.queue(queue),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::JobKind;

    #[test]
    fn names_lead_back_to_their_queues() {
        let names = Names::new("plumbline").unwrap();
        let run = RunId::new("night-1").unwrap();
        for queue in [
            Queue::Jobs(JobKind::Flow),
            Queue::Jobs(JobKind::Slam),
            Queue::Jobs(JobKind::Fused),
            Queue::Results(run),
            Queue::Dead,
        ] {
            assert_eq!(names.parse(&names.queue(&queue)), Some(queue));
        }
        for foreign in [
            "plumbline",
            "plumbline.jobs.other",
            "other.dead",
            "plumblinedead",
        ] {
            assert_eq!(names.parse(foreign), None, "{foreign}");
        }
    }

    #[test]
    fn the_longest_names_fit_amqp() {
        let names = Names::new(&"n".repeat(MAX_NAMESPACE_BYTES)).unwrap();
        let run = RunId::new("r".repeat(RunId::MAX_BYTES)).unwrap();
        assert!(names.queue(&Queue::Results(run.clone())).len() <= 255);
        assert!(names.lease(&run).len() <= 255);
        for bad in ["", "a b", "A", &"n".repeat(MAX_NAMESPACE_BYTES + 1)] {
            assert!(Names::new(bad).is_none(), "{bad}");
        }
    }
}
