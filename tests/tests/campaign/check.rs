//! What must be so, whatever happened before.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use futures_util::TryStreamExt;
use plumbline_common::id::RunId;
use plumbline_common::queue::{AmqpBroker, Broker, Queue, Settlement};
use plumbline_common::store::{ObjectStore, fetch};
use plumbline_tests::servers::{QueueState, consumers, queues};
use tokio::time::timeout;

use crate::setup::{SLOTS, store};

/// Every file but costs and the report that shows them is the same.
#[track_caller]
pub(crate) fn same_bytes(
    found: &BTreeMap<String, Vec<u8>>,
    reference: &BTreeMap<String, Vec<u8>>,
    out: &str,
) {
    assert!(
        found.keys().eq(reference.keys()),
        "{out}: {:?} {:?}",
        found.keys(),
        reference.keys()
    );
    assert!(reference.contains_key("scores.parquet"));
    for (name, bytes) in reference {
        if found[name] != *bytes {
            let lines = |bytes: &[u8]| -> Vec<String> {
                let text = String::from_utf8_lossy(bytes);
                text.lines().map(str::to_owned).collect()
            };
            let (found, expected) = (lines(&found[name]), lines(bytes));
            let differ = found.iter().zip(&expected).find(|(a, b)| a != b);
            panic!("{name} of {out} differs: {differ:#?}");
        }
    }
}

/// Copies what a run published below `prefix` of the bucket into a directory.
pub(crate) async fn download(prefix: &str, into: &Path) {
    const MAX_BYTES: u64 = 64 << 20;
    let store = store(prefix).await;
    let objects: Vec<_> = store.list("").try_concat().await.unwrap();
    let published = objects
        .iter()
        .filter(|object| !object.key.as_str().starts_with(".plumbline/"));
    for object in published {
        let path = into.join(object.key.as_str());
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let content = fetch(&store, object, MAX_BYTES).await.unwrap();
        std::fs::write(path, content).unwrap();
    }
}

/// What the names of the campaign's queues begin with.
const NAMESPACE: &str = "plumbline.";

/// No job waits or is in work, and the run's results queue is gone.
pub(crate) fn wait_until_idle(run: &RunId, patience: Duration) {
    let started = Instant::now();
    loop {
        let busy = queues().map(|queues| -> Vec<QueueState> {
            let left = queues.into_iter().filter(|queue| {
                // Other tests have namespaces of their own.
                let ours = queue.name.starts_with(NAMESPACE);
                let holds = queue.ready + queue.unacked > 0;
                let of_run = queue.name.ends_with(&format!("results.{run}"));
                of_run || (ours && holds && !queue.name.ends_with(".dead"))
            });
            left.collect()
        });
        match busy {
            Ok(busy) if busy.is_empty() => return,
            busy => assert!(started.elapsed() < patience, "left behind: {busy:?}"),
        }
        std::thread::sleep(Duration::from_millis(300));
    }
}

/// All dead letters of this campaign, by id, with their reasons; they are gone from the queue then.
pub(crate) async fn drain_dead(broker: &AmqpBroker, name: &str) -> BTreeMap<String, String> {
    dead(broker, true, |id| {
        id.starts_with("poison/") || id.starts_with(name)
    })
    .await
}

/// The dead letters of a run's own videos, which stay there.
pub(crate) async fn given_up(broker: &AmqpBroker, run: &RunId) -> BTreeMap<String, String> {
    let prefix = format!("{run}/");
    dead(broker, false, |id| id.starts_with(&prefix)).await
}

async fn dead(
    broker: &AmqpBroker,
    take: bool,
    is_ours: impl Fn(&str) -> bool,
) -> BTreeMap<String, String> {
    const AT_ONCE: u16 = 5000;
    const QUIET: Duration = Duration::from_secs(2);
    let mut letters = BTreeMap::new();
    let mut consumer = broker.consume(&Queue::Dead, AT_ONCE).await.unwrap();
    while let Ok(delivery) = timeout(QUIET, consumer.next()).await {
        let delivery = delivery.unwrap();
        let id = delivery.message.id.clone();
        if is_ours(&id) {
            let reason = delivery.dead.as_ref().map(|dead| dead.reason.clone());
            letters.insert(id, reason.unwrap_or_default());
            if take {
                delivery.settle(Settlement::Done).await.unwrap();
            }
        }
    }
    letters
}

/// Watches what the broker says of the consumers of jobs, all the time.
#[derive(Debug)]
pub(crate) struct Prefetches {
    stop: Arc<AtomicBool>,
    watching: JoinHandle<String>,
}

/// The question costs the broker and the machine a second: now and then is enough.
const INTERVAL: Duration = Duration::from_secs(6);

impl Prefetches {
    pub(crate) fn watch() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let watching = std::thread::spawn(move || {
            let (mut times, mut of, mut most) = (0, 0, 0);
            while !stopped.load(Ordering::Relaxed) {
                // While the broker is away there is nothing to see.
                for consumer in consumers(JOB_QUEUES).unwrap_or_default() {
                    of += 1;
                    most = most.max(consumer.unacked);
                    within_slots(&consumer);
                }
                times += 1;
                std::thread::sleep(INTERVAL);
            }
            format!(
                "the broker was asked {times} times and named {of} consumers of jobs: none held more than {most}, with {SLOTS} slots"
            )
        });
        Self { stop, watching }
    }

    /// What was seen; fails where anyone held too much.
    pub(crate) fn stop(self) -> String {
        self.stop.store(true, Ordering::Relaxed);
        self.watching.join().expect("slots are never exceeded")
    }
}

/// What the names of the queues of jobs begin with.
pub(crate) const JOB_QUEUES: &str = "plumbline.jobs.";

#[track_caller]
pub(crate) fn within_slots(consumer: &plumbline_tests::servers::JobConsumer) {
    let slots = u64::from(SLOTS);
    assert!((1..=slots).contains(&consumer.prefetch), "{consumer:?}");
    assert!(consumer.unacked <= slots, "{consumer:?}");
}
