//! A worker on queues of this process, with real compute children: every way that a job can end.

#![allow(clippy::unwrap_used, reason = "what does not work fails the test")]

#[cfg(test)]
mod support;

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::stream::BoxStream;
use plumbline_common::id::RunId;
use plumbline_common::message::{Job, WIRE_VERSION};
use plumbline_common::queue::{
    Broker, Consumer, Lease, LocalBroker, LocalOptions, Message, Queue, QueueError,
};
use plumbline_common::store::{DirStore, ObjectKey, ObjectMeta, ObjectStore, StoreError};
use plumbline_common::trace::TraceContext;
use plumbline_worker::child::ComputeLimits;
use plumbline_worker::fleet::{Compute, JOBS, MAX_REDELIVERIES, Stop, WorkerOptions};
use support::{
    BUCKET, PROGRAM, Run, Working, as_object, clip, exposed, fetcher, file_job, no_op, options,
    receive, slot,
};

struct Place {
    dir: tempfile::TempDir,
    broker: Arc<dyn Broker>,
    run: Run,
    options: WorkerOptions,
    /// The job of an object that is there.
    job: Job,
}

impl Place {
    async fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let objects = dir.path().join("objects");
        fs::create_dir(&objects).unwrap();
        clip(&objects.join("a.mp4"));
        let broker: Arc<dyn Broker> = Arc::new(LocalBroker::new(LocalOptions::default()));
        let fetcher = fetcher(&objects, &dir.path().join("scratch")).await;
        Self {
            run: Run::new(Arc::clone(&broker)).await,
            job: as_object(&file_job("a", &objects.join("a.mp4")), "a.mp4"),
            options: options(fetcher),
            broker,
            dir,
        }
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().canonicalize().unwrap().join(name)
    }

    async fn failing_store(&self, failures: u32, fails_by: FailsBy) {
        let store = Flaky {
            store: DirStore::new(self.path("objects")),
            failures_left: failures.into(),
            fails_by,
        };
        let fetcher = &self.options.fetcher;
        fetcher.put_store(BUCKET, Arc::new(store)).await;
    }

    fn start(&self) -> Working {
        Working::start(&self.broker, self.options.clone())
    }

    /// Nothing is left anywhere but in work.
    async fn assert_nothing_waits(&self) {
        for queue in [JOBS, Queue::Dead, Queue::Results(self.run.id.clone())] {
            assert_eq!(self.run.waiting(&queue).await, 0, "{queue}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_become_rows_with_their_trace_and_are_counted() {
    let place = Place::new().await;
    let expected = slot(&place.options.fetcher)
        .measure(&place.job)
        .await
        .unwrap();
    let working = place.start();
    let trace = TraceContext::root();
    let mut message = place.run.message(place.job.clone());
    message.traceparent = Some(trace.to_string());
    place.broker.publish(&JOBS, message).await.unwrap();
    let (result, answer) = place.run.answer().await;
    assert_eq!(result.outcome.measurement, expected.outcome.measurement);
    assert_eq!(result.outcome.measurement.status.as_str(), "scored");
    assert_eq!(result.outcome.thumbnails, expected.outcome.thumbnails);
    assert_eq!((result.attempts, result.worker.as_str()), (1, "tester"));
    assert!(result.outcome.cost.fetch_s > 0.0);
    let passed_on = TraceContext::parse(&answer.traceparent.unwrap()).unwrap();
    assert_eq!(passed_on.trace_id(), trace.trace_id());
    assert_ne!(passed_on.span_id(), trace.span_id());

    let metrics = exposed(&working.stopped(Stop::Drain).await);
    for line in [
        "plumbline_worker_jobs_total{outcome=\"scored\"} 1",
        "plumbline_worker_stage_seconds_count{stage=\"fetch\"} 1",
        "plumbline_worker_stage_seconds_count{stage=\"flow\"} 1",
        "plumbline_worker_stage_seconds_count{stage=\"publish\"} 1",
        &format!("plumbline_worker_fetched_bytes_total {}", place.job.bytes),
        "plumbline_worker_jobs_in_work 0",
        "plumbline_worker_slots 2",
        "plumbline_worker_children_lost_total 0",
    ] {
        assert!(metrics.contains(line), "{line}\n{metrics}");
    }
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_job_is_a_dead_letter_and_a_row_wherever_its_video_is_known() {
    let place = Place::new().await;
    let working = place.start();
    let publish = async |id: &str, body: Vec<u8>| {
        let message = Message::new(id, body);
        place.broker.publish(&JOBS, message).await.unwrap();
    };

    for garbage in [vec![], b"{\"video\": 1}".to_vec(), vec![WIRE_VERSION, 0xc1]] {
        publish("garbage", garbage).await;
        let (reason, id) = place.run.dead_letter().await;
        assert!(reason.starts_with("the job cannot be read"), "{reason}");
        assert_eq!(id, "garbage");
    }

    // A version to come, whose jobs are called the same; one of this version with an unknown location.
    let mut future = place.run.message(place.job.clone()).body.to_vec();
    future[0] = WIRE_VERSION + 1;
    let mut elsewhere = place.run.message(place.job.clone()).body.to_vec();
    let at = elsewhere
        .windows(6)
        .position(|name| name == b"object")
        .unwrap();
    elsewhere[at..at + 6].copy_from_slice(b"zenith");
    let other_profile = Job {
        profile: b"{\"measure_version\": 99}".to_vec(),
        ..place.job.clone()
    };
    let other_profile = place.run.message(other_profile).body.to_vec();
    for (body, word) in [
        (future, "upgrade"),
        (elsewhere, "zenith"),
        (other_profile, "one version"),
    ] {
        publish("known", body).await;
        let (status, reason) = place.run.row().await;
        assert_eq!(status, "failed");
        assert!(reason.contains(word), "{reason}");
        assert_eq!(place.run.dead_letter().await, (reason, "known".to_owned()));
    }
    let metrics = exposed(&working.stopped(Stop::Drain).await);
    assert!(
        metrics.contains("jobs_total{outcome=\"unreadable\"} 3"),
        "{metrics}"
    );
    assert!(metrics.contains("dead_letters_total 6"), "{metrics}");
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_are_read_below_the_given_directory_only() {
    let mut place = Place::new().await;
    let inside = file_job("in", &place.path("objects/a.mp4"));
    let secret = place.path("secret.mp4");
    fs::copy(place.path("objects/a.mp4"), &secret).unwrap();
    let outside = file_job("out", &secret);

    let working = place.start();
    place.run.ask(inside.clone()).await;
    let (status, reason) = place.run.row().await;
    assert_eq!(status, "failed");
    assert!(reason.contains("start it with --files DIR"), "{reason}");
    assert_eq!(place.run.dead_letter().await.0, reason);
    working.stopped(Stop::Drain).await;

    place.options.files = Some(place.path("objects"));
    let working = place.start();
    place.run.ask(inside.clone()).await;
    assert_eq!(place.run.row().await.0, "scored");
    place.run.ask(outside).await;
    let (status, reason) = place.run.row().await;
    assert_eq!(status, "failed");
    assert!(reason.contains("lies outside"), "{reason}");
    assert_eq!(place.run.dead_letter().await.0, reason);
    // A video that was removed meanwhile is an ordinary row.
    fs::remove_file(place.path("objects/a.mp4")).unwrap();
    place.run.ask(inside).await;
    let (status, reason) = place.run.row().await;
    assert_eq!(status, "failed");
    assert!(reason.contains("check that the file exists"), "{reason}");
    working.stopped(Stop::Drain).await;
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_of_a_run_that_is_gone_are_dropped() {
    let place = Place::new().await;
    place.run.ask(place.job.clone()).await;
    let mut unreadable = place.run.message(place.job.clone());
    unreadable.body = {
        let mut body = unreadable.body.to_vec();
        body[0] = WIRE_VERSION + 1;
        body.into()
    };
    place.broker.publish(&JOBS, unreadable).await.unwrap();
    place.broker.delete(&place.run.id).await.unwrap();
    let working = place.start();
    wait_until(async || exposed(&working.metrics).contains("outcome=\"dropped\"} 2")).await;
    let metrics = exposed(&working.stopped(Stop::Drain).await);
    assert!(
        metrics.contains("stage_seconds_count{stage=\"fetch\"} 0\n"),
        "nothing is fetched for it: {metrics}"
    );
    assert_eq!(place.run.waiting(&JOBS).await, 0);
    assert_eq!(place.run.waiting(&Queue::Dead).await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_cancelled_while_its_job_is_in_work_costs_that_job_only() {
    let mut place = Place::new().await;
    place.options.compute = no_op(Duration::from_millis(300));
    let working = place.start();
    place.run.ask(place.job.clone()).await;
    wait_until(async || exposed(&working.metrics).contains("jobs_in_work 1")).await;
    place.broker.delete(&place.run.id).await.unwrap();
    wait_until(async || exposed(&working.metrics).contains("outcome=\"dropped\"} 1")).await;
    working.stopped(Stop::Drain).await;
    assert_eq!(place.run.waiting(&Queue::Dead).await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn objects_that_will_never_be_had_are_rows_and_no_dead_letters() {
    let place = Place::new().await;
    let working = place.start();
    let gone = as_object(&place.job, "gone.mp4");
    let changed = Job {
        bytes: place.job.bytes + 1,
        ..place.job.clone()
    };
    let huge = Job {
        bytes: u64::MAX,
        ..place.job.clone()
    };
    for (job, status, word) in [
        (gone, "failed", "there is no such object"),
        (changed, "failed", "changed after the list"),
        (huge, "over_limit", "raise max_bytes"),
    ] {
        place.run.ask(job).await;
        let (found, reason) = place.run.row().await;
        assert_eq!(found, status);
        assert!(reason.contains(word), "{reason}");
    }
    working.stopped(Stop::Drain).await;
    place.assert_nothing_waits().await;
}

/// Out of reach for the first requests.
#[derive(Debug)]
struct Flaky {
    store: DirStore,
    failures_left: AtomicU32,
    fails_by: FailsBy,
}

#[derive(Debug, Clone, Copy)]
enum FailsBy {
    Silence,
    Errors,
    Denial,
}

#[async_trait]
impl ObjectStore for Flaky {
    fn address(&self, key: &ObjectKey) -> String {
        self.store.address(key)
    }

    fn list(&self, prefix: &str) -> BoxStream<'static, Result<Vec<ObjectMeta>, StoreError>> {
        self.store.list(prefix)
    }

    async fn head(&self, key: &ObjectKey) -> Result<ObjectMeta, StoreError> {
        self.store.head(key).await
    }

    async fn get_range(
        &self,
        meta: &ObjectMeta,
        range: std::ops::Range<u64>,
    ) -> Result<Bytes, StoreError> {
        let left = |left: u32| left.checked_sub(1);
        let failing = self
            .failures_left
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, left);
        let object = self.store.address(&meta.key);
        match (failing, self.fails_by) {
            (Err(_none_left), _) => self.store.get_range(meta, range).await,
            (Ok(_), FailsBy::Silence) => std::future::pending().await,
            (Ok(_), FailsBy::Denial) => Err(StoreError::Denied {
                object,
                source: "request 4711".into(),
            }),
            (Ok(_), FailsBy::Errors) => Err(StoreError::Transient {
                object,
                attempts: 8,
                source: "connection reset".into(),
            }),
        }
    }

    async fn put(&self, key: &ObjectKey, content: Bytes) -> Result<(), StoreError> {
        self.store.put(key, content).await
    }

    async fn put_file(&self, key: &ObjectKey, file: &Path) -> Result<(), StoreError> {
        self.store.put_file(key, file).await
    }

    async fn delete(&self, key: &ObjectKey) -> Result<(), StoreError> {
        self.store.delete(key).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_out_of_reach_is_waited_for_and_given_up_in_the_end() {
    let place = Place::new().await;
    let flaky = async |failures, fails_by| place.failing_store(failures, fails_by).await;
    let working = place.start();
    // As many attempts as there are, and the last one succeeds.
    flaky(2, FailsBy::Errors).await;
    place.run.ask(place.job.clone()).await;
    let (result, _) = place.run.answer().await;
    assert_eq!(result.outcome.measurement.status.as_str(), "scored");
    assert_eq!(result.attempts, 3);
    assert_eq!(place.run.waiting(&Queue::Dead).await, 0);

    for (fails_by, said) in [
        (
            FailsBy::Errors,
            "s3://bucket/a.mp4: the store did not answer, however often it was asked; score it again later",
        ),
        (
            FailsBy::Denial,
            "s3://bucket/a.mp4: access denied; check the credentials and what they may read there",
        ),
    ] {
        flaky(3, fails_by).await;
        place.run.ask(place.job.clone()).await;
        assert_eq!(
            place.run.row().await,
            ("failed".to_owned(), said.to_owned())
        );
        assert_eq!(place.run.dead_letter().await.0, said);
    }
    let metrics = exposed(&working.stopped(Stop::Drain).await);
    assert!(metrics.contains("outcome=\"retried\"} 6"), "{metrics}");
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_store_does_not_hold_a_slot_for_ever() {
    let mut place = Place::new().await;
    place.options.compute = Compute::Children {
        program: PROGRAM.into(),
        limits: ComputeLimits {
            deadline_s: 0.2,
            ..ComputeLimits::default()
        },
    };
    place.failing_store(u32::MAX, FailsBy::Silence).await;
    let working = place.start();
    place.run.ask(place.job.clone()).await;
    let said = "s3://bucket/a.mp4: was not read within the time given to a video; score it again later, or raise --deadline";
    assert_eq!(
        place.run.row().await,
        ("failed".to_owned(), said.to_owned())
    );
    assert_eq!(place.run.dead_letter().await.0, said);
    working.stopped(Stop::Drain).await;
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_and_a_child_that_always_dies_are_a_row_and_a_dead_letter() {
    let children = |program: &str, deadline_s| Compute::Children {
        program: program.into(),
        limits: ComputeLimits {
            deadline_s,
            ..ComputeLimits::default()
        },
    };
    let mut place = Place::new().await;
    place.options.files = Some(place.path("objects"));
    let job = file_job("a", &place.path("objects/a.mp4"));
    for (compute, word, attempts, lost) in [
        (children(PROGRAM, 1e-3), "not measured within 0.001 s", 1, 1),
        (
            children("/bin/false", 600.0),
            "the compute process died 2 times",
            2,
            2,
        ),
    ] {
        place.options.compute = compute;
        let working = place.start();
        place.run.ask(job.clone()).await;
        let (result, _) = place.run.answer().await;
        let row = result.outcome.measurement;
        let reason = row.status_reason.unwrap();
        assert_eq!((row.status.as_str(), result.attempts), ("failed", attempts));
        assert!(reason.contains(word), "{reason}");
        assert_eq!(place.run.dead_letter().await.0, reason);
        let metrics = exposed(&working.stopped(Stop::Drain).await);
        assert!(
            metrics.contains(&format!("children_lost_total {lost}")),
            "{metrics}"
        );
        place.assert_nothing_waits().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_program_for_children_the_worker_ends_and_the_job_comes_again() {
    let mut place = Place::new().await;
    place.options.compute = Compute::Children {
        program: place.path("nothing-here"),
        limits: ComputeLimits::default(),
    };
    let working = place.start();
    place.run.ask(place.job.clone()).await;
    assert!(
        working
            .failed()
            .await
            .contains("cannot start the compute process")
    );
    assert_eq!(place.run.waiting(&JOBS).await, 1);
}

/// A broker that has outlasted every wait.
#[derive(Debug)]
struct Gone;

fn gone() -> QueueError {
    QueueError::Unreachable {
        broker: "amqp://somewhere".to_owned(),
        attempts: 30,
        source: "connection refused".into(),
    }
}

#[async_trait]
impl Broker for Gone {
    async fn declare(&self, _: &Queue) -> Result<(), QueueError> {
        Ok(())
    }

    async fn publish(&self, _: &Queue, _: Message) -> Result<(), QueueError> {
        Err(gone())
    }

    async fn consume(&self, _: &Queue, _: u16) -> Result<Box<dyn Consumer>, QueueError> {
        Err(gone())
    }

    async fn ready(&self, _: &Queue) -> Result<u64, QueueError> {
        Err(gone())
    }

    async fn consumers(&self, _: &Queue) -> Result<u64, QueueError> {
        Err(gone())
    }

    async fn delete(&self, _: &RunId) -> Result<(), QueueError> {
        Err(gone())
    }

    async fn lease(&self, _: &RunId) -> Result<Option<Box<dyn Lease>>, QueueError> {
        Err(gone())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_that_stays_away_ends_the_worker() {
    let place = Place::new().await;
    let broker: Arc<dyn Broker> = Arc::new(Gone);
    let working = Working::start(&broker, place.options.clone());
    assert!(
        working
            .failed()
            .await
            .contains("no answer after 30 attempts")
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_with_which_many_workers_died_is_not_tried_again() {
    let place = Place::new().await;
    place.run.ask(place.job.clone()).await;
    for died in 0..MAX_REDELIVERIES {
        let mut consumer = place.broker.consume(&JOBS, 1).await.unwrap();
        let delivery = consumer.next().await.unwrap();
        assert_eq!(delivery.redeliveries, died);
    }
    let working = place.start();
    let (status, reason) = place.run.row().await;
    assert_eq!(status, "failed");
    let told = format!("{MAX_REDELIVERIES} workers died with it");
    assert!(reason.starts_with(&told), "{reason}");
    assert_eq!(place.run.dead_letter().await.0, reason);
    let metrics = exposed(&working.stopped(Stop::Drain).await);
    let fetched = "stage_seconds_count{stage=\"fetch\"} ";
    assert!(metrics.contains(&format!("{fetched}0\n")), "{metrics}");
    place.assert_nothing_waits().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drained_worker_finishes_what_is_in_work_and_takes_no_more() {
    let mut place = Place::new().await;
    place.options.compute = no_op(Duration::from_millis(500));
    for name in ["a", "b", "c", "d", "e"] {
        place
            .run
            .ask(file_job(name, &place.path("objects/a.mp4")))
            .await;
    }
    place.options.files = Some(place.path("objects"));
    let working = place.start();
    wait_until(async || exposed(&working.metrics).contains("jobs_in_work 2")).await;
    working.stopped(Stop::Drain).await;
    assert_eq!(
        place
            .run
            .waiting(&Queue::Results(place.run.id.clone()))
            .await,
        2
    );
    assert_eq!(place.run.waiting(&JOBS).await, 3);
    let (next, _consumer) = receive(&*place.broker, &JOBS).await;
    assert_eq!((next.redeliveries, next.message.attempt), (0, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn after_the_grace_jobs_are_handed_back_without_counting_as_deaths() {
    let mut place = Place::new().await;
    place.options.compute = no_op(Duration::from_secs(3600));
    place.options.grace = Duration::from_millis(100);
    let working = place.start();
    place.run.ask(place.job.clone()).await;
    wait_until(async || exposed(&working.metrics).contains("jobs_in_work 1")).await;
    let metrics = exposed(&working.stopped(Stop::Drain).await);
    assert!(metrics.contains("outcome=\"handed_back\"} 1"), "{metrics}");
    let (again, _consumer) = receive(&*place.broker, &JOBS).await;
    assert_eq!((again.redeliveries, again.message.attempt), (0, 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn told_twice_a_worker_ends_at_once_and_its_jobs_come_again() {
    let mut place = Place::new().await;
    place.options.compute = no_op(Duration::from_secs(3600));
    let working = place.start();
    place.run.ask(place.job.clone()).await;
    wait_until(async || exposed(&working.metrics).contains("jobs_in_work 1")).await;
    working.stop.send_replace(Stop::Drain);
    working.stopped(Stop::Now).await;
    let (again, _consumer) = receive(&*place.broker, &JOBS).await;
    assert_eq!((again.redeliveries, again.message.attempt), (1, 1));
}

async fn wait_until(mut condition: impl AsyncFnMut() -> bool) {
    let started = std::time::Instant::now();
    while !condition().await {
        assert!(
            started.elapsed() < support::DEADLINE,
            "it never comes about"
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
