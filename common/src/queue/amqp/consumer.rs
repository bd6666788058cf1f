//! Receiving from a RabbitMQ queue, through broken connections and restarted brokers.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use futures_util::StreamExt;
use lapin::options::{BasicAckOptions, BasicCancelOptions, BasicConsumeOptions, BasicQosOptions};
use lapin::types::FieldTable;
use lapin::{Acker, Channel, ChannelStatus};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use super::failure::Failure;
use super::session::{Session, to_its_end};
use super::wire;
use super::{AmqpBroker, PATIENCE};
use crate::observe::Pulse;
use crate::queue::{Consumer, Delivery, Message, Queue, QueueError, Settle, Settlement};

#[derive(Debug)]
pub(super) struct AmqpConsumer {
    broker: AmqpBroker,
    queue: Queue,
    slots: u16,
    open: Option<Open>,
    /// The next subscription, on its way on a task of its own: whoever waits for a message may stop waiting
    /// at any time, as often as it likes, and a subscription takes what time it takes.
    subscribing: JoinSet<Result<Open, QueueError>>,
    status: Status,
    /// Failures since the last delivery.
    failures: u32,
}

/// A subscription on a channel of its own; both end when it is dropped, and what is unsettled returns.
#[derive(Debug)]
struct Open {
    stream: lapin::Consumer,
    channel: Channel,
}

/// How the channel in use does, for whoever asks; it does not keep the channel.
type Status = Arc<Mutex<Option<ChannelStatus>>>;

/// As a tag of the broker's own choosing.
const ANY_TAG: &str = "";

impl AmqpConsumer {
    /// Subscribes.
    pub(super) async fn start(
        broker: AmqpBroker,
        queue: Queue,
        slots: u16,
    ) -> Result<Self, QueueError> {
        let mut consumer = Self {
            broker,
            queue,
            slots,
            open: None,
            subscribing: JoinSet::new(),
            status: Status::default(),
            failures: 0,
        };
        consumer.opened().await?;
        Ok(consumer)
    }

    fn set_status(&self, status: Option<ChannelStatus>) {
        *self.status.lock().unwrap_or_else(PoisonError::into_inner) = status;
    }

    /// The subscription, or the next one where there is none. May be cancelled without loss.
    async fn opened(&mut self) -> Result<&mut Open, QueueError> {
        let open = match self.open.take() {
            Some(open) => open,
            None => self.subscribed().await?,
        };
        Ok(self.open.insert(open))
    }

    /// The subscription that is on its way, or that is begun now.
    async fn subscribed(&mut self) -> Result<Open, QueueError> {
        if self.subscribing.is_empty() {
            self.subscribe_after(Duration::ZERO);
        }
        let open = match self.subscribing.join_next().await {
            Some(Ok(subscribed)) => subscribed?,
            // None: never, since one was begun.
            broken @ (Some(Err(_)) | None) => {
                let failure =
                    Failure::Passing(format!("subscribing broke down: {broken:?}").into());
                return Err(self.broker.error(failure, &self.queue.to_string(), 1));
            }
        };
        self.set_status(Some(open.channel.status().clone()));
        Ok(open)
    }

    /// Begins a subscription after so long.
    fn subscribe_after(&mut self, wait: Duration) {
        let (broker, queue, slots) = (self.broker.clone(), self.queue.clone(), self.slots);
        self.subscribing.spawn(async move {
            sleep(wait).await;
            let name = broker.names().queue(&queue);
            broker
                .retried(&queue.to_string(), |session| {
                    to_its_end(subscribe(session, name.clone(), slots))
                })
                .await
        });
    }
}

async fn subscribe(session: Arc<Session>, queue: String, slots: u16) -> Result<Open, Failure> {
    let channel = session.channel().await?;
    // On every channel anew, and before the subscription: else the broker hands out all it has.
    channel.basic_qos(slots, BasicQosOptions::default()).await?;
    let stream = channel
        .basic_consume(
            queue.into(),
            ANY_TAG.into(),
            BasicConsumeOptions::default(),
            FieldTable::default(),
        )
        .await?;
    Ok(Open { stream, channel })
}

#[async_trait]
impl Consumer for AmqpConsumer {
    async fn next(&mut self) -> Result<Delivery, QueueError> {
        loop {
            let failure = match self.opened().await?.stream.next().await {
                // Buffered from a channel that is closed: it comes again, so no work is begun on it.
                Some(Ok(delivery)) if !delivery.acker.usable() => continue,
                Some(Ok(mut delivery)) => {
                    self.failures = 0;
                    let (message, redeliveries, dead) =
                        wire::received(&mut delivery, self.broker.names());
                    return Ok(Delivery {
                        message,
                        redeliveries,
                        dead: (self.queue == Queue::Dead).then_some(dead),
                        handle: Box::new(AmqpHandle {
                            broker: self.broker.clone(),
                            queue: self.queue.clone(),
                            acker: delivery.acker,
                        }),
                    });
                }
                // On an open subscription this is no mismatch of properties: a delivery was not settled in
                // time, and the broker took all of them back.
                Some(Err(error)) => match Failure::from(error) {
                    Failure::Mismatch(source) => {
                        tracing::error!(
                            queue = %self.queue, %source,
                            "the broker waited too long for a settlement: raise its consumer_timeout above the deadline of a job"
                        );
                        Failure::Passing(source)
                    }
                    failure => failure,
                },
                None => Failure::Passing("the broker cancelled the subscription".into()),
            };
            self.open = None;
            self.failures += 1;
            match (
                failure,
                self.broker
                    .options()
                    .backoff
                    .after_with_jitter(self.failures),
            ) {
                (Failure::Passing(source), Some(wait)) => {
                    tracing::info!(queue = %self.queue, %source, "subscribing anew");
                    self.subscribe_after(wait);
                }
                (failure, _) => {
                    return Err(self
                        .broker
                        .error(failure, &self.queue.to_string(), self.failures));
                }
            }
        }
    }

    async fn stop(&mut self) {
        self.set_status(None);
        self.subscribing = JoinSet::new();
        let Some(open) = &self.open else {
            return;
        };
        let options = BasicCancelOptions::default();
        let cancelling = open.channel.basic_cancel(open.stream.tag(), options);
        // Where the broker does not answer, no messages come either.
        let _cancelled = timeout(PATIENCE, cancelling).await;
    }

    fn pulse(&self) -> Pulse {
        let status = Arc::clone(&self.status);
        Pulse::new(move || {
            let status = status.lock().unwrap_or_else(PoisonError::into_inner);
            status.as_ref().is_some_and(ChannelStatus::connected)
        })
    }
}

#[derive(Debug)]
struct AmqpHandle {
    broker: AmqpBroker,
    queue: Queue,
    acker: Acker,
}

#[async_trait]
impl Settle for AmqpHandle {
    async fn settle(
        self: Box<Self>,
        message: Message,
        settlement: Settlement,
    ) -> Result<(), QueueError> {
        let id = message.id.clone();
        let names = self.broker.names();
        match settlement {
            Settlement::Done => {}
            Settlement::Retry { after } => {
                let target =
                    names.to_queue_after(&self.queue, self.broker.options().wait_for(after));
                self.broker.put(&target, message.for_retry(), None).await?;
            }
            Settlement::Reject { reason } => {
                let target = names.to_dead(&self.queue);
                self.broker.put(&target, message, Some(reason)).await?;
            }
        }
        let acked = timeout(PATIENCE, self.acker.ack(BasicAckOptions::default())).await;
        match acked {
            Ok(Ok(true)) => Ok(()),
            // False: the channel was closed, and the broker has taken the message back.
            Ok(Ok(false) | Err(_)) | Err(_) => Err(QueueError::Lost {
                queue: self.queue.to_string(),
                message: id,
            }),
        }
    }
}
