//! What goes wrong, how often, and how it is done.

use std::time::{Duration, SystemTime};

use plumbline_common::id::{RunId, VideoId};
use plumbline_common::message::{self, FleetJob, Location, ObjectLocation};
use plumbline_common::queue::{
    AmqpBroker, Broker, Delivery, JobKind, Message, Queue, QueueError, Settlement,
};
use plumbline_common::store::{ObjectKey, ObjectStore};
use plumbline_tests::clips;
use plumbline_tests::servers::server;
use tokio::time::timeout;

use crate::setup::{POISON, put, store};

pub(crate) const JOBS: Queue = Queue::Jobs(JobKind::Fused);

/// How long the campaign waits for a message to tamper with.
const PATIENCE: Duration = Duration::from_secs(3);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    KillWorker,
    KillChild,
    KillCoordinator,
    KillBroker,
    KillStore,
    CloseAmqp,
    ResetAmqp,
    HalfOpenAmqp,
    DelayAmqp,
    ThrottleAmqp,
    CloseS3,
    ResetS3,
    HalfOpenS3,
    DelayS3,
    DuplicateJob,
    DropJob,
    DuplicateResult,
    Poison(Poison),
}

/// Messages that no honest program sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Poison {
    Garbage,
    FutureVersion,
    MissingObject,
    ChangedObject,
    DecodeBomb,
    GarbageResult,
}

impl Fault {
    /// A hundred faults: each kind as often as it is worth.
    const DECK: [(Self, usize); 23] = [
        (Self::KillWorker, 12),
        (Self::KillChild, 12),
        (Self::KillCoordinator, 8),
        (Self::KillBroker, 2),
        (Self::KillStore, 4),
        (Self::CloseAmqp, 6),
        (Self::ResetAmqp, 7),
        (Self::HalfOpenAmqp, 4),
        (Self::DelayAmqp, 6),
        (Self::ThrottleAmqp, 4),
        (Self::CloseS3, 4),
        (Self::ResetS3, 4),
        (Self::HalfOpenS3, 1),
        (Self::DelayS3, 4),
        (Self::DuplicateJob, 6),
        (Self::DropJob, 3),
        (Self::DuplicateResult, 5),
        (Self::Poison(Poison::Garbage), 2),
        (Self::Poison(Poison::FutureVersion), 2),
        (Self::Poison(Poison::MissingObject), 1),
        (Self::Poison(Poison::ChangedObject), 1),
        (Self::Poison(Poison::DecodeBomb), 1),
        (Self::Poison(Poison::GarbageResult), 1),
    ];

    pub(crate) fn deck() -> Vec<Self> {
        let cards = Self::DECK.iter();
        cards
            .flat_map(|(fault, count)| std::iter::repeat_n(*fault, *count))
            .collect()
    }

    /// Whether the broker must answer for it.
    pub(crate) fn needs_broker(self) -> bool {
        !matches!(
            self,
            Self::KillWorker
                | Self::KillChild
                | Self::KillCoordinator
                | Self::KillStore
                | Self::CloseS3
                | Self::ResetS3
                | Self::HalfOpenS3
                | Self::DelayS3
        )
    }
}

/// Tampers with messages at the broker itself.
#[derive(Debug)]
pub(crate) struct Tamperer {
    broker: AmqpBroker,
    /// A job of the current corpus, to make others of.
    template: Option<FleetJob>,
    poisons: u64,
    /// Ids of the messages that must end as dead letters.
    pub(crate) deadly: Vec<String>,
    /// Of those that must, unless their run was over before anyone looked at them.
    pub(crate) deadly_in_time: Vec<String>,
}

impl Tamperer {
    pub(crate) async fn connect() -> Self {
        let url = server("PLUMBLINE_TEST_AMQP_URL");
        Self {
            broker: AmqpBroker::connect(&url, Default::default()).await.unwrap(),
            template: None,
            poisons: 0,
            deadly: Vec::new(),
            deadly_in_time: Vec::new(),
        }
    }

    pub(crate) fn broker(&self) -> &AmqpBroker {
        &self.broker
    }

    /// Takes a message in hand; `None` where none comes, or the queue is gone.
    async fn snatch(&self, queue: &Queue) -> Option<(Delivery, Box<dyn std::any::Any>)> {
        let mut consumer = self.broker.consume(queue, 1).await.ok()?;
        let delivery = timeout(PATIENCE, consumer.next()).await.ok()?.ok()?;
        // The consumer must outlive the settlement.
        Some((delivery, Box::new(consumer)))
    }

    /// One message becomes two; its id, or `None` where none was to be had.
    pub(crate) async fn duplicate(&mut self, queue: &Queue) -> Option<String> {
        let (delivery, _consumer) = self.snatch(queue).await?;
        let message = delivery.message.clone();
        for _ in 0..2 {
            self.publish(queue, message.clone()).await?;
        }
        // Lost is fine: then there are three.
        let _lost = delivery.settle(Settlement::Done).await;
        Some(message.id)
    }

    /// A receiver takes a job and dies with it.
    pub(crate) async fn drop_job(&mut self) -> Option<String> {
        let (delivery, _consumer) = self.snatch(&JOBS).await?;
        Some(delivery.message.id)
    }

    /// Learns what a job of `run` looks like.
    async fn learn(&mut self) -> Option<FleetJob> {
        if self.template.is_none() {
            let (delivery, _consumer) = self.snatch(&JOBS).await?;
            self.template = message::decode(&delivery.message.body).ok();
        }
        self.template.clone()
    }

    async fn publish(&self, queue: &Queue, message: Message) -> Option<()> {
        match self.broker.publish(queue, message).await {
            Ok(()) => Some(()),
            Err(QueueError::Missing { .. }) => None,
            Err(error) => panic!("{error}"),
        }
    }

    /// Sends a message that no honest program sends; `None` where that was not to be done now.
    pub(crate) async fn poison(&mut self, run: &RunId, poison: Poison) -> Option<String> {
        self.poisons += 1;
        let name = format!("poison/{}-{poison:?}", self.poisons);
        let garbage: Vec<u8> = name.bytes().map(|byte| byte ^ 0xa5).collect();
        match poison {
            Poison::Garbage => {
                self.publish(&JOBS, Message::new(&name, garbage)).await?;
                self.deadly.push(name.clone());
            }
            Poison::GarbageResult => {
                let results = Queue::Results(run.clone());
                self.publish(&results, Message::new(&name, garbage)).await?;
                self.deadly_in_time.push(name.clone());
            }
            Poison::FutureVersion => {
                let job = self.poison_job(run, &name, "any.mp4").await?;
                let mut body = message::encode(&job).unwrap();
                body[0] = message::WIRE_VERSION + 1;
                self.publish(&JOBS, Message::new(&name, body)).await?;
                // Its run can be told from it, and nobody waits for its row when that is over.
                self.deadly_in_time.push(name.clone());
            }
            Poison::MissingObject => {
                let job = self.poison_job(run, &name, "never-there.mp4").await?;
                self.publish_job(&job).await?;
            }
            Poison::ChangedObject => {
                let key = format!("changed-{}.mp4", self.poisons);
                let job = self.changed_object(run, &name, &key).await?;
                self.publish_job(&job).await?;
            }
            Poison::DecodeBomb => {
                let store = store(POISON).await;
                put(&store, "bomb.gif", clips::huge_gif(65535)).await;
                let mut job = self.poison_job(run, &name, "bomb.gif").await?;
                let key = ObjectKey::new("bomb.gif").unwrap();
                describe(&mut job, &store.head(&key).await.ok()?);
                self.publish_job(&job).await?;
            }
        }
        Some(name)
    }

    async fn publish_job(&self, job: &FleetJob) -> Option<()> {
        let message = Message::new(job.message_id(), message::encode(job).unwrap());
        self.publish(&JOBS, message).await
    }

    /// A job of a video that is not in the corpus, of an object outside of it.
    async fn poison_job(&mut self, run: &RunId, video: &str, key: &str) -> Option<FleetJob> {
        let mut job = self.learn().await?;
        job.run = run.clone();
        job.job.video = VideoId::new(video).unwrap();
        job.job.location = Location::Object(ObjectLocation {
            bucket: server("PLUMBLINE_TEST_S3_BUCKET"),
            key: format!("{POISON}/{key}"),
            etag: None,
            modified_s: None,
        });
        Some(job)
    }

    /// A job of an object that is another by the time anyone reads it.
    async fn changed_object(&mut self, run: &RunId, video: &str, key: &str) -> Option<FleetJob> {
        let mut job = self.poison_job(run, video, key).await?;
        let store = store(POISON).await;
        put(&store, key, "what was listed").await;
        let key = ObjectKey::new(key).unwrap();
        describe(&mut job, &store.head(&key).await.ok()?);
        put(&store, key.as_str(), "something else, and longer").await;
        Some(job)
    }
}

fn describe(job: &mut FleetJob, meta: &plumbline_common::store::ObjectMeta) {
    job.job.bytes = meta.bytes;
    let modified_s = meta.modified_s.unwrap_or_default();
    job.job.modified_ns = i128::from(modified_s) * 1_000_000_000;
    if let Location::Object(object) = &mut job.job.location {
        object.etag.clone_from(&meta.etag);
        object.modified_s = meta.modified_s;
    }
}

/// A name that no earlier campaign on the same servers has.
pub(crate) fn unique() -> String {
    let since_epoch = SystemTime::UNIX_EPOCH.elapsed().unwrap();
    format!("{}-{}", std::process::id(), since_epoch.as_millis())
}
