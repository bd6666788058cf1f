//! Short clips, jobs, and a worker to do them, for tests of the fleet.

#![allow(dead_code, reason = "each test program uses its own part")]

pub(crate) mod gate;

use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use plumbline_common::backoff::Backoff;
use plumbline_common::file_time::modified_ns;
use plumbline_common::id::{RunId, VideoId};
use plumbline_common::message::{self, FleetJob, FleetResult, Job, Location, ObjectLocation};
use plumbline_common::queue::{Broker, Consumer, Delivery, Message, Queue, Settlement};
use plumbline_common::store::{DirStore, S3Options};
use plumbline_vision::image::Rgb8;
use plumbline_worker::child::{ComputeLimits, ComputeSlot};
use plumbline_worker::encode::Mp4Writer;
use plumbline_worker::fetch::Fetcher;
use plumbline_worker::fleet::{Compute, JOBS, Metrics, ServeError, Stop, WorkerOptions, serve};
use plumbline_worker::profile::{Profile, Rung};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Longest that anything may take which a test waits for.
pub(crate) const DEADLINE: Duration = Duration::from_secs(120);

/// The bucket that [`fetcher`] reads from a directory.
pub(crate) const BUCKET: &str = "bucket";

/// The binary under test, which is its own compute child.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_plumbline-worker");

/// A clip of a textured square that moves before a textured ground.
pub(crate) fn clip(path: &Path) {
    const SIDE: usize = 96;
    let mut writer = Mp4Writer::create(path, SIDE as u32, SIDE as u32, 10.0).unwrap();
    for frame in 0..8 {
        let shade = |x: usize, y: usize| {
            let inside = (20 + 4 * frame..60 + 4 * frame).contains(&x) && (30..70).contains(&y);
            let (x, scale) = if inside { (x - 4 * frame, 5) } else { (x, 9) };
            ((x * x / scale + y * y / 7 + x * y / scale) % 200) as u8 + 28
        };
        let data = (0..SIDE * SIDE)
            .flat_map(|at| [shade(at % SIDE, at / SIDE); 3])
            .collect();
        writer
            .push(&Rgb8 {
                width: SIDE,
                height: SIDE,
                data,
            })
            .unwrap();
    }
    writer.finish().unwrap();
}

pub(crate) fn profile() -> Profile {
    Profile::new(Rung::Draft)
}

pub(crate) fn video(name: &str) -> VideoId {
    VideoId::new(name).unwrap()
}

/// The job of a file, as it is now.
pub(crate) fn file_job(name: &str, path: &Path) -> Job {
    let metadata = std::fs::metadata(path).unwrap();
    Job {
        video: video(name),
        location: Location::File(path.as_os_str().as_bytes().to_vec()),
        bytes: metadata.len(),
        modified_ns: modified_ns(&metadata).unwrap(),
        profile: profile().canonical().unwrap(),
    }
}

/// The job of the same bytes as an object.
pub(crate) fn as_object(job: &Job, key: &str) -> Job {
    Job {
        location: Location::Object(ObjectLocation {
            bucket: BUCKET.to_owned(),
            key: key.to_owned(),
            etag: None,
            modified_s: None,
        }),
        ..job.clone()
    }
}

/// Reads [`BUCKET`] from `root`.
pub(crate) async fn fetcher(root: &Path, scratch: &Path) -> Fetcher {
    let fetcher = Fetcher::new(S3Options::default(), scratch);
    fetcher
        .put_store(BUCKET, Arc::new(DirStore::new(root)))
        .await;
    fetcher
}

pub(crate) fn slot(fetcher: &Fetcher) -> ComputeSlot {
    ComputeSlot::new(PROGRAM.into(), ComputeLimits::default(), fetcher.clone())
}

pub(crate) fn options(fetcher: Fetcher) -> WorkerOptions {
    WorkerOptions {
        name: "tester".to_owned(),
        slots: 2,
        grace: DEADLINE,
        files: None,
        compute: Compute::Children {
            program: PathBuf::from(PROGRAM),
            limits: ComputeLimits::default(),
        },
        fetcher,
        fetch_retries: Backoff {
            first: Duration::from_millis(10),
            longest: Duration::from_millis(20),
            attempts: 3,
        },
    }
}

pub(crate) fn no_op(job_time: Duration) -> Compute {
    Compute::Nobody { job_time }
}

/// A run whose results are waited for.
pub(crate) struct Run {
    pub(crate) broker: Arc<dyn Broker>,
    pub(crate) id: RunId,
}

impl Run {
    pub(crate) async fn new(broker: Arc<dyn Broker>) -> Self {
        let id = RunId::new("run").unwrap();
        broker.declare(&Queue::Results(id.clone())).await.unwrap();
        Self { broker, id }
    }

    pub(crate) fn message(&self, job: Job) -> Message {
        let job = FleetJob {
            run: self.id.clone(),
            job,
        };
        Message::new(job.message_id(), message::encode(&job).unwrap())
    }

    pub(crate) async fn ask(&self, job: Job) {
        self.broker.publish(&JOBS, self.message(job)).await.unwrap();
    }

    /// The next result, with its message.
    pub(crate) async fn answer(&self) -> (FleetResult, Message) {
        let queue = Queue::Results(self.id.clone());
        let (delivery, _consumer) = receive(&*self.broker, &queue).await;
        let message = delivery.message.clone();
        let result: FleetResult = message::decode(&message.body).unwrap();
        assert_eq!(result.message_id(), message.id);
        delivery.settle(Settlement::Done).await.unwrap();
        (result, message)
    }

    /// The next result's row: status and reason.
    pub(crate) async fn row(&self) -> (String, String) {
        let (result, _) = self.answer().await;
        let measured = result.outcome.measurement;
        let reason = measured.status_reason.unwrap_or_default();
        (measured.status.as_str().to_owned(), reason)
    }

    /// The reason of the next dead letter, and the id of its message.
    pub(crate) async fn dead_letter(&self) -> (String, String) {
        let (delivery, _consumer) = receive(&*self.broker, &Queue::Dead).await;
        let dead = delivery.dead.clone().unwrap();
        let id = delivery.message.id.clone();
        delivery.settle(Settlement::Done).await.unwrap();
        (dead.reason, id)
    }

    pub(crate) async fn waiting(&self, queue: &Queue) -> u64 {
        self.broker.ready(queue).await.unwrap()
    }
}

/// One message, and the consumer without which it would go back.
pub(crate) async fn receive(broker: &dyn Broker, queue: &Queue) -> (Delivery, Box<dyn Consumer>) {
    let mut consumer = broker.consume(queue, 1).await.unwrap();
    let delivery = timeout(DEADLINE, consumer.next()).await;
    let delivery = delivery.unwrap_or_else(|_| panic!("nothing came from {queue}"));
    (delivery.unwrap(), consumer)
}

/// A worker at work.
pub(crate) struct Working {
    pub(crate) stop: watch::Sender<Stop>,
    pub(crate) metrics: Metrics,
    task: JoinHandle<Result<(), ServeError>>,
}

impl Working {
    pub(crate) fn start(broker: &Arc<dyn Broker>, options: WorkerOptions) -> Self {
        let (stop, told) = watch::channel(Stop::No);
        let metrics = Metrics::default();
        let (ready, _) = watch::channel(None);
        let serving = serve(Arc::clone(broker), options, metrics.clone(), told, ready);
        Self {
            stop,
            metrics,
            task: tokio::spawn(serving),
        }
    }

    /// Told to stop, it ends.
    pub(crate) async fn stopped(self, how: Stop) -> Metrics {
        self.stop.send_replace(how);
        timeout(DEADLINE, self.task)
            .await
            .unwrap()
            .unwrap()
            .unwrap();
        self.metrics
    }
}

impl Working {
    /// It ends by itself; why.
    pub(crate) async fn failed(self) -> String {
        let ended = timeout(DEADLINE, self.task).await.unwrap().unwrap();
        ended.unwrap_err().to_string()
    }
}

/// What the metrics say, as a scraper reads it.
pub(crate) fn exposed(metrics: &Metrics) -> String {
    let mut registry = prometheus_client::registry::Registry::default();
    metrics.register(&mut registry);
    let mut text = String::new();
    prometheus_client::encoding::text::encode(&mut text, &registry).unwrap();
    text
}
