//! Runs over a broker in this process, with workers that do what no worker should.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

use bytes::Bytes;
use plumbline_common::id::VideoId;
use plumbline_common::message::{FleetJob, Location};
use plumbline_common::queue::{LocalBroker, LocalOptions, Message};
use plumbline_worker::profile::Rung;
use tokio::task::JoinHandle;

use super::*;

const JOBS: Queue = Queue::Jobs(JobKind::Fused);

fn entries(count: usize) -> Arc<Vec<Entry>> {
    let entry = |n: usize| Entry {
        video: VideoId::new(format!("{n:04}.mp4")).unwrap(),
        location: Location::File(format!("/v/{n:04}.mp4").into_bytes()),
        bytes: Some(1),
        modified_ns: Some(1),
        problem: None,
        group: None,
        carried: serde_json::Map::new(),
    };
    Arc::new((0..count).map(entry).collect())
}

fn run_id() -> RunId {
    RunId::new("run").unwrap()
}

fn broker() -> Arc<dyn Broker> {
    Arc::new(LocalBroker::new(LocalOptions::default()))
}

async fn start_with(
    broker: &Arc<dyn Broker>,
    entries: &Arc<Vec<Entry>>,
    window: usize,
    republish_after: Duration,
) -> Result<FleetRun, RunError> {
    let options = FleetOptions {
        broker: Arc::clone(broker),
        name: None,
        window,
        republish_after,
    };
    let questions = Questions {
        entries: Arc::clone(entries),
        missing: (0..entries.len()).collect(),
        profile: Profile::new(Rung::Draft),
        resume: true,
    };
    FleetRun::start(&options, run_id(), questions).await
}

async fn start(broker: &Arc<dyn Broker>, entries: &Arc<Vec<Entry>>) -> FleetRun {
    let hour = Duration::from_secs(3600);
    start_with(broker, entries, 1000, hour).await.unwrap()
}

fn result(run: &RunId, video: &VideoId, status: Status, reason: &str) -> Message {
    let result = FleetResult {
        run: run.clone(),
        outcome: Outcome {
            video: video.clone(),
            measurement: Measurement::without_score(status, reason),
            cost: Cost::default(),
            thumbnails: None,
        },
        attempts: 1,
        worker: "w".to_owned(),
    };
    Message::new(result.message_id(), message::encode(&result).unwrap())
}

/// Answers every job with what `answer` makes of it and of how often it was seen.
fn worker(
    broker: &Arc<dyn Broker>,
    answer: impl Fn(&VideoId, usize) -> Vec<Message> + Send + 'static,
) -> JoinHandle<()> {
    let broker = Arc::clone(broker);
    tokio::spawn(async move {
        let mut seen: BTreeMap<VideoId, usize> = BTreeMap::new();
        let mut consumer = broker.consume(&JOBS, 8).await.unwrap();
        while let Ok(delivery) = consumer.next().await {
            let job: FleetJob = message::decode(&delivery.message.body).unwrap();
            let times = seen.entry(job.job.video.clone()).or_default();
            *times += 1;
            for message in answer(&job.job.video, *times) {
                let results = Queue::Results(job.run.clone());
                match broker.publish(&results, message).await {
                    Ok(()) | Err(QueueError::Missing { .. }) => {}
                    Err(error) => panic!("{error}"),
                }
            }
            delivery.settle(Settlement::Done).await.unwrap();
        }
    })
}

/// Collects to the end: the last answer per video, and how many there were.
async fn collect(run: &mut FleetRun) -> (BTreeMap<String, Status>, usize) {
    let mut rows = BTreeMap::new();
    let mut count = 0;
    while let Some(answer) = run.next().await.unwrap() {
        count += 1;
        let video = answer.outcome.video.to_string();
        rows.insert(video, answer.outcome.measurement.status);
        if count % 7 == 0 {
            run.kept().await.unwrap();
        }
    }
    run.kept().await.unwrap();
    (rows, count)
}

#[tokio::test]
async fn every_video_is_answered_once_whatever_comes() {
    let broker = broker();
    let entries = entries(50);
    let mut run = start(&broker, &entries).await;
    let worker = worker(&broker, |video, _| {
        let ours = |status| result(&run_id(), video, status, "");
        let mut messages = vec![ours(Status::Static)];
        match video.as_str() {
            "0003.mp4" => messages.extend([ours(Status::Static), ours(Status::Failed)]),
            "0004.mp4" => messages.insert(0, Message::new("x", Bytes::from_static(b"garbage"))),
            "0005.mp4" => {
                let other = VideoId::new("unknown.mp4").unwrap();
                messages.insert(0, result(&run_id(), &other, Status::Static, ""));
            }
            "0006.mp4" => {
                let other_run = RunId::new("other").unwrap();
                messages.insert(0, result(&other_run, video, Status::Collapsed, ""));
            }
            _ => {}
        }
        messages
    });
    let (rows, count) = collect(&mut run).await;
    assert_eq!((rows.len(), count), (50, 50));
    assert!(rows.values().all(|status| *status == Status::Static));
    Box::new(run).finished().await.unwrap();
    assert!(matches!(
        broker.ready(&Queue::Results(run_id())).await,
        Err(QueueError::Missing { .. })
    ));
    // Garbage, and what belongs to another run, is kept for a person.
    assert_eq!(broker.ready(&Queue::Dead).await.unwrap(), 2);
    let again = broker.lease(&run_id()).await.unwrap();
    assert!(again.is_some(), "the lease is free");
    worker.abort();
}

#[tokio::test]
async fn a_failed_row_gives_way_to_another_but_not_the_other_way_round() {
    let broker = broker();
    let entries = entries(3);
    let mut run = start(&broker, &entries).await;
    let results = Queue::Results(run_id());
    let put = async |index: usize, status: Status| {
        let message = result(&run_id(), &entries[index].video, status, "");
        broker.publish(&results, message).await.unwrap();
    };
    for (index, status) in [
        (0, Status::Failed),
        (0, Status::Failed),
        (0, Status::Static),
        (0, Status::Failed),
        (1, Status::Static),
        (1, Status::Failed),
        (2, Status::Failed),
    ] {
        put(index, status).await;
    }
    let (rows, count) = collect(&mut run).await;
    assert_eq!(count, 4, "failed, static, static, failed");
    let statuses: Vec<_> = rows.into_values().collect();
    assert_eq!(statuses, [Status::Static, Status::Static, Status::Failed]);
}

#[tokio::test]
async fn no_more_jobs_than_the_window_are_out() {
    let broker = broker();
    let entries = entries(40);
    let hour = Duration::from_secs(3600);
    let mut run = start_with(&broker, &entries, 5, hour).await.unwrap();
    let seen = Arc::new(Mutex::new(Vec::new()));
    for round in 0..8 {
        // Whatever may come has come.
        let waiting = wait_for(async || broker.ready(&JOBS).await.unwrap() >= 5);
        waiting.await;
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert_eq!(broker.ready(&JOBS).await.unwrap(), 5, "round {round}");
        let mut consumer = broker.consume(&JOBS, 5).await.unwrap();
        for _ in 0..5 {
            let delivery = consumer.next().await.unwrap();
            let job: FleetJob = message::decode(&delivery.message.body).unwrap();
            seen.lock().unwrap().push(job.job.video.clone());
            let message = result(&run_id(), &job.job.video, Status::Static, "");
            let results = Queue::Results(run_id());
            broker.publish(&results, message).await.unwrap();
            delivery.settle(Settlement::Done).await.unwrap();
            assert!(run.next().await.unwrap().is_some());
        }
    }
    assert!(run.next().await.unwrap().is_none());
    let distinct: BTreeSet<_> = seen.lock().unwrap().iter().cloned().collect();
    assert_eq!(distinct.len(), 40);
}

async fn wait_for(condition: impl AsyncFn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !condition().await {
        assert!(Instant::now() < deadline, "it never happened");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn a_coordinator_that_died_leaves_nothing_undone_and_little_twice() {
    let broker = broker();
    let entries = entries(30);
    let mut first = start(&broker, &entries).await;
    wait_for(async || broker.ready(&JOBS).await.unwrap() == 30).await;
    let worker = worker(&broker, |video, _| {
        vec![result(&run_id(), video, Status::Static, "")]
    });
    // Ten rows are durable; ten more are in its hands when it dies, the rest in the queue.
    for _ in 0..10 {
        first.next().await.unwrap();
    }
    first.kept().await.unwrap();
    for _ in 0..10 {
        first.next().await.unwrap();
    }
    wait_for(async || broker.ready(&JOBS).await.unwrap() == 0).await;
    drop(first);
    let mut second = start(&broker, &entries).await;
    let mut rows = BTreeSet::new();
    for _ in 0..20 {
        let answer = second.next().await.unwrap().unwrap();
        assert!(rows.insert(answer.outcome.video));
    }
    second.kept().await.unwrap();
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 0, "nothing asked again");
    // The ten that were settled are asked again here, since this coordinator was not told of them.
    while let Some(answer) = second.next().await.unwrap() {
        assert!(rows.insert(answer.outcome.video));
    }
    assert_eq!(rows.len(), 30);
    worker.abort();
}

#[tokio::test]
async fn a_second_coordinator_is_refused_while_the_first_lives() {
    let broker = broker();
    let entries = entries(1);
    let first = start(&broker, &entries).await;
    let hour = Duration::from_secs(3600);
    let refused = start_with(&broker, &entries, 10, hour).await.err().unwrap();
    assert!(matches!(refused, RunError::RunInUse { .. }), "{refused}");
    drop(first);
    start(&broker, &entries).await;
}

#[tokio::test]
async fn a_cancelled_run_ends_and_says_so() {
    let broker = broker();
    let mut run = start(&broker, &entries(3)).await;
    broker.delete(&run_id()).await.unwrap();
    let ended = run.next().await.unwrap_err();
    assert!(matches!(ended, RunError::Cancelled { .. }), "{ended}");
}

#[tokio::test(start_paused = true)]
async fn what_is_lost_is_published_again_and_in_the_end_becomes_a_row() {
    let broker = broker();
    let entries = entries(6);
    let after = Duration::from_secs(100);
    let mut run = start_with(&broker, &entries, 4, after).await.unwrap();
    let asked = Arc::new(Mutex::new(BTreeMap::<VideoId, usize>::new()));
    let counted = Arc::clone(&asked);
    let worker = worker(&broker, move |video, times| {
        counted.lock().unwrap().insert(video.clone(), times);
        match video.as_str() {
            "0001.mp4" if times < 3 => vec![],
            "0002.mp4" => vec![],
            _ => vec![result(&run_id(), video, Status::Static, "")],
        }
    });
    let (rows, _) = collect(&mut run).await;
    assert_eq!(rows.len(), 6);
    assert_eq!(rows["0001.mp4"], Status::Static);
    assert_eq!(rows["0002.mp4"], Status::Failed);
    let asked: Vec<usize> = asked.lock().unwrap().values().copied().collect();
    assert_eq!(asked, [1, 3, 3, 1, 1, 1]);
    worker.abort();
}

#[tokio::test(start_paused = true)]
async fn nothing_is_published_again_while_jobs_wait_in_the_queue() {
    let broker = broker();
    let entries = entries(6);
    let after = Duration::from_secs(100);
    let mut run = start_with(&broker, &entries, 10, after).await.unwrap();
    let much_later = tokio::time::timeout(after * 20, run.next()).await;
    assert!(much_later.is_err(), "no answer, no end");
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 6);
}

/// A broker that takes its time to tell how many messages wait.
#[derive(Debug)]
struct Slow(LocalBroker);

#[async_trait]
impl Broker for Slow {
    async fn ready(&self, queue: &Queue) -> Result<u64, QueueError> {
        tokio::time::sleep(Duration::from_secs(2)).await;
        self.0.ready(queue).await
    }

    async fn declare(&self, queue: &Queue) -> Result<(), QueueError> {
        self.0.declare(queue).await
    }

    async fn publish(&self, queue: &Queue, message: Message) -> Result<(), QueueError> {
        self.0.publish(queue, message).await
    }

    async fn consume(&self, queue: &Queue, slots: u16) -> Result<Box<dyn Consumer>, QueueError> {
        self.0.consume(queue, slots).await
    }

    async fn consumers(&self, queue: &Queue) -> Result<u64, QueueError> {
        self.0.consumers(queue).await
    }

    async fn delete(&self, run: &RunId) -> Result<(), QueueError> {
        self.0.delete(run).await
    }

    async fn lease(
        &self,
        run: &RunId,
    ) -> Result<Option<Box<dyn plumbline_common::queue::Lease>>, QueueError> {
        self.0.lease(run).await
    }
}

/// Whoever collects stops waiting for an answer twice a second, to make rows durable.
#[tokio::test(start_paused = true)]
async fn what_is_lost_is_published_again_however_briefly_an_answer_is_waited_for() {
    let broker: Arc<dyn Broker> = Arc::new(Slow(LocalBroker::new(LocalOptions::default())));
    let after = Duration::from_secs(100);
    let mut run = start_with(&broker, &entries(1), 4, after).await.unwrap();
    let worker = worker(&broker, move |video, times| match times {
        1 => vec![],
        _ => vec![result(&run_id(), video, Status::Static, "")],
    });
    let started = Instant::now();
    let brief = Duration::from_millis(500);
    let answer = loop {
        assert!(started.elapsed() < after * 10, "never published again");
        if let Ok(answer) = tokio::time::timeout(brief, run.next()).await {
            break answer.unwrap().unwrap();
        }
    };
    assert_eq!(answer.outcome.measurement.status, Status::Static);
    worker.abort();
}
