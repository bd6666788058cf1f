//! Queues on RabbitMQ (3.10 or later) over AMQP 0-9-1: confirmed, mandatory, persistent.

mod consumer;
mod failure;
mod lease;
mod names;
mod session;
mod topology;
mod wire;

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use lapin::options::QueueDeleteOptions;
use lapin::uri::AMQPUri;
use tokio::sync::Mutex;
use tokio::time::{sleep, timeout};

use self::consumer::AmqpConsumer;
use self::failure::Failure;
use self::lease::AmqpLease;
use self::names::{MAX_NAMESPACE_BYTES, Names, Target};
use self::session::Session;
use super::error::QueueError;
use super::{Broker, Consumer, Lease, Message, Queue};
use crate::backoff::Backoff;
use crate::id::RunId;

/// How long one call may take before its connection is given up: longer than a busy broker pauses.
const PATIENCE: Duration = Duration::from_secs(30);

/// How often broker and client assure each other that they are there, unless the address says
/// otherwise (`?heartbeat=`): half of what it takes to notice a machine that vanished.
const HEARTBEAT_S: u16 = 20;

/// How a broker is spoken to.
#[derive(Debug, Clone)]
pub struct AmqpOptions {
    /// What the names of all exchanges and queues begin with: fleets that share a broker differ in it.
    /// 1 to 64 of `a`–`z`, `0`–`9`, `-`, `_`, `.`.
    pub namespace: String,
    /// Waits between attempts to reach the broker.
    pub backoff: Backoff,
    /// The waits before a retry that the broker offers, ascending; a wait is rounded up to the next of
    /// them. All programs of a namespace must agree on them.
    pub waits: Vec<Duration>,
}

impl Default for AmqpOptions {
    fn default() -> Self {
        Self {
            namespace: "plumbline".to_owned(),
            // About six minutes in all: a broker that restarts or fails over is back by then.
            backoff: Backoff {
                first: Duration::from_millis(200),
                longest: Duration::from_secs(15),
                attempts: 30,
            },
            waits: [1, 4, 16, 64, 256].map(Duration::from_secs).to_vec(),
        }
    }
}

impl AmqpOptions {
    /// The offered wait that is at least `after`, or the longest.
    fn wait_for(&self, after: Duration) -> Duration {
        let offered = self.waits.iter().find(|wait| **wait >= after);
        offered.or(self.waits.last()).copied().unwrap_or_default()
    }
}

/// A RabbitMQ broker. Clones share one connection for publishing.
#[derive(Debug, Clone)]
pub struct AmqpBroker {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    uri: AMQPUri,
    /// The address without credentials.
    address: String,
    names: Names,
    options: AmqpOptions,
    session: Mutex<Option<Arc<Session>>>,
    /// Connections that did not come about, so far.
    not_opened: AtomicU64,
}

impl AmqpBroker {
    /// Connects to `url` (`amqp://user:password@host:port/vhost`, or `amqps://`) and declares what is
    /// always there.
    ///
    /// # Errors
    /// [`QueueError`]; `Address` where the address, namespace or waits are not usable.
    pub async fn connect(url: &str, options: AmqpOptions) -> Result<Self, QueueError> {
        let address = |why: String| QueueError::Address { source: why.into() };
        let mut uri: AMQPUri = url.parse().map_err(address)?;
        uri.query.heartbeat.get_or_insert(HEARTBEAT_S);
        let names = Names::new(&options.namespace).ok_or_else(|| {
            address(format!(
                "the namespace {:?} must be 1 to {MAX_NAMESPACE_BYTES} of a-z, 0-9, '-', '_', '.'",
                options.namespace
            ))
        })?;
        if options.waits.is_empty() || !options.waits.is_sorted() {
            return Err(address("the waits must ascend and not be none".to_owned()));
        }
        let broker = Self {
            shared: Arc::new(Shared {
                address: format!(
                    "{}://{}:{}/{}",
                    uri.scheme, uri.authority.host, uri.authority.port, uri.vhost
                ),
                uri,
                names,
                options,
                session: Mutex::default(),
                not_opened: AtomicU64::new(0),
            }),
        };
        broker.retried("", |_connected| async { Ok(()) }).await?;
        Ok(broker)
    }

    fn names(&self) -> &Names {
        &self.shared.names
    }

    fn options(&self) -> &AmqpOptions {
        &self.shared.options
    }

    fn error(&self, failure: Failure, queue: &str, attempts: u32) -> QueueError {
        failure.of(queue.to_owned(), self.shared.address.clone(), attempts)
    }

    /// The connection in use, or a new one; others wait meanwhile rather than open their own, and share its
    /// failure: else each of hundreds would wait for the silence of a broker, one after the other.
    async fn session(&self) -> Result<Arc<Session>, Failure> {
        let not_opened = &self.shared.not_opened;
        let before = not_opened.load(Ordering::SeqCst);
        let mut current = self.shared.session.lock().await;
        if let Some(session) = current.as_ref().filter(|session| session.is_alive()) {
            return Ok(Arc::clone(session));
        }
        *current = None;
        if not_opened.load(Ordering::SeqCst) != before {
            return Err(Failure::Passing("no connection came about".into()));
        }
        let opening = Session::open(&self.shared.uri, self.names(), &self.options().waits);
        let opened = patiently(opening).await;
        let session = Arc::new(opened.inspect_err(|_failure| {
            not_opened.fetch_add(1, Ordering::SeqCst);
        })?);
        *current = Some(Arc::clone(&session));
        Ok(session)
    }

    /// Throws a connection away that does not do, unless that has happened already.
    async fn discard(&self, session: &Arc<Session>) {
        let mut current = self.shared.session.lock().await;
        if current
            .as_ref()
            .is_some_and(|current| Arc::ptr_eq(current, session))
        {
            *current = None;
        }
    }

    /// Tries `attempt` on a live connection until it succeeds, fails for good, or has been tried often
    /// enough; each attempt is bounded in time.
    async fn retried<T, F>(
        &self,
        queue: &str,
        attempt: impl Fn(Arc<Session>) -> F,
    ) -> Result<T, QueueError>
    where
        F: Future<Output = Result<T, Failure>>,
    {
        let mut attempts = 1;
        loop {
            let failure = match self.session().await {
                Ok(session) => match patiently(attempt(Arc::clone(&session))).await {
                    Ok(answer) => return Ok(answer),
                    Err(failure) => {
                        if matches!(failure, Failure::Passing(_)) {
                            self.discard(&session).await;
                        }
                        failure
                    }
                },
                Err(failure) => failure,
            };
            match (failure, self.options().backoff.after_with_jitter(attempts)) {
                (Failure::Passing(source), Some(wait)) => {
                    tracing::info!(broker = self.shared.address, attempts, %source, "trying again");
                    sleep(wait).await;
                    attempts += 1;
                }
                (failure, _) => return Err(self.error(failure, queue, attempts)),
            }
        }
    }

    /// Messages that wait, and consumers.
    async fn state(&self, queue: &Queue) -> Result<(u32, u32), QueueError> {
        let name = &self.names().queue(queue);
        let state = async |session: Arc<Session>| session.state(name).await;
        self.retried(&queue.to_string(), state).await
    }

    /// Publishes to a target, confirmed.
    async fn put(
        &self,
        target: &Target,
        message: Message,
        reason: Option<String>,
    ) -> Result<(), QueueError> {
        let (message, reason) = (&message, reason.as_deref());
        self.retried(&target.routing_key, |session| async move {
            session.publish(target, message, reason).await
        })
        .await
    }
}

#[async_trait]
impl Broker for AmqpBroker {
    async fn declare(&self, queue: &Queue) -> Result<(), QueueError> {
        let (names, waits) = (self.names(), &self.options().waits);
        let name = &names.queue(queue);
        self.retried(&queue.to_string(), |session| async move {
            session
                .declared_safely(name, async |channel| match queue {
                    Queue::Results(_) => topology::declare_work_queue(&channel, names, queue).await,
                    // There since the connection, unless somebody took it away.
                    Queue::Jobs(_) | Queue::Dead => topology::declare(&channel, names, waits).await,
                })
                .await
        })
        .await
    }

    async fn publish(&self, queue: &Queue, message: Message) -> Result<(), QueueError> {
        message.check_size(&queue.to_string())?;
        self.put(&self.names().to_queue(queue), message, None).await
    }

    async fn consume(&self, queue: &Queue, slots: u16) -> Result<Box<dyn Consumer>, QueueError> {
        // 0 would mean without limit.
        let consumer = AmqpConsumer::start(self.clone(), queue.clone(), slots.max(1)).await?;
        Ok(Box::new(consumer))
    }

    async fn ready(&self, queue: &Queue) -> Result<u64, QueueError> {
        Ok(self.state(queue).await?.0.into())
    }

    async fn consumers(&self, queue: &Queue) -> Result<u64, QueueError> {
        Ok(self.state(queue).await?.1.into())
    }

    async fn delete(&self, run: &RunId) -> Result<(), QueueError> {
        let name = &self.names().queue(&Queue::Results(run.clone()));
        self.retried(name, |session| async move {
            let channel = session.channel().await?;
            let options = QueueDeleteOptions::default();
            channel.queue_delete(name.as_str().into(), options).await?;
            Ok(())
        })
        .await
    }

    async fn lease(&self, run: &RunId) -> Result<Option<Box<dyn Lease>>, QueueError> {
        let name = self.names().lease(run);
        let taken = self
            .retried(&name, |_session| async {
                match AmqpLease::take(&self.shared.uri, &name).await {
                    Ok(lease) => Ok(Some(Box::new(lease) as Box<dyn Lease>)),
                    Err(Failure::Locked) => Ok(None),
                    Err(failure) => Err(failure),
                }
            })
            .await?;
        Ok(taken)
    }
}

/// Bounds a call in time.
async fn patiently<T>(call: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    timeout(PATIENCE, call).await.unwrap_or_else(|_elapsed| {
        Err(Failure::Passing(
            format!("no answer within {} s", PATIENCE.as_secs()).into(),
        ))
    })
}
