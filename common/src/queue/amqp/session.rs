//! One connection with its topology declared and its publishing channels. When it breaks it is thrown
//! away and another made: the client's own recovery restores neither every property nor every promise.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use lapin::options::{BasicPublishOptions, ConfirmSelectOptions, QueueDeclareOptions};
use lapin::types::FieldTable;
use lapin::uri::AMQPUri;
use lapin::{Channel, Confirmation, Connection, ConnectionProperties};
use tokio::sync::Mutex;
use tokio::time::sleep;

use super::failure::Failure;
use super::names::{Names, Target};
use super::{topology, wire};
use crate::queue::{JobKind, Message, Queue};

/// AMQP's reply code for an orderly end.
pub(super) const REPLY_SUCCESS: u16 = 200;

/// How long a new queue is left alone. RabbitMQ (3.10.8), killed within about a second of a declaration that
/// it has confirmed, may come back with that queue empty and without a leader. Probably its name was not on
/// the disk yet; after this time it was never seen.
const NEW_QUEUE_SETTLES: Duration = Duration::from_millis(1500);

#[derive(Debug)]
pub(super) struct Session {
    connection: Connection,
    /// One per target. The client may tell a returned message to another publish of the same channel;
    /// here all of those go to the same queue, and where that is gone none of them arrived.
    publishing: Mutex<HashMap<Target, Arc<Channel>>>,
}

impl Session {
    /// Connects and declares what is always there.
    pub(super) async fn open(
        uri: &AMQPUri,
        names: &Names,
        waits: &[Duration],
    ) -> Result<Self, Failure> {
        let session = Self {
            connection: connect(uri).await?,
            publishing: Mutex::default(),
        };
        let last = names.queue(&Queue::Jobs(JobKind::Fused));
        session
            .declared_safely(&last, async |channel| {
                topology::declare(&channel, names, waits).await
            })
            .await?;
        Ok(session)
    }

    /// Declares something whose last queue is called `last`, and where that is new waits until a power cut
    /// cannot take it back.
    pub(super) async fn declared_safely(
        &self,
        last: &str,
        declare: impl AsyncFnOnce(Channel) -> lapin::Result<()>,
    ) -> Result<(), Failure> {
        let is_new = match self.state(last).await {
            Ok(_messages) => false,
            Err(Failure::Missing) => true,
            Err(failure) => return Err(failure),
        };
        declare(self.channel().await?).await?;
        if is_new {
            sleep(NEW_QUEUE_SETTLES).await;
        }
        Ok(())
    }

    /// Messages that wait in a queue, and its consumers.
    pub(super) async fn state(&self, queue: &str) -> Result<(u32, u32), Failure> {
        let passive = QueueDeclareOptions::default().passive();
        let channel = self.channel().await?;
        let declared = channel
            .queue_declare(queue.into(), passive, FieldTable::default())
            .await?;
        Ok((declared.message_count(), declared.consumer_count()))
    }

    pub(super) fn is_alive(&self) -> bool {
        self.connection.status().connected()
    }

    /// A channel of its own, for something that may end with its channel.
    pub(super) async fn channel(&self) -> Result<Channel, Failure> {
        Ok(self.connection.create_channel().await?)
    }

    /// Publishes and waits until the broker has the message safe.
    pub(super) async fn publish(
        &self,
        target: &Target,
        message: &Message,
        reason: Option<&str>,
    ) -> Result<(), Failure> {
        let channel = self.publishing_channel(target).await?;
        let mandatory = BasicPublishOptions {
            mandatory: true,
            ..BasicPublishOptions::default()
        };
        let confirmation = channel
            .basic_publish(
                target.exchange.as_str().into(),
                target.routing_key.as_str().into(),
                mandatory,
                &message.body,
                wire::properties(message, reason),
            )
            .await?
            .await?;
        match confirmation {
            Confirmation::Ack(None) => Ok(()),
            // An unroutable message is acknowledged, too. Runs come and go: their channels must not stay.
            Confirmation::Ack(Some(_)) | Confirmation::Nack(Some(_)) => {
                self.publishing.lock().await.remove(target);
                Err(Failure::Missing)
            }
            Confirmation::Nack(None) => Err(Failure::Passing("the queue is full".into())),
            Confirmation::NotRequested => {
                Err(Failure::Passing("the channel confirms nothing".into()))
            }
        }
    }

    async fn publishing_channel(&self, target: &Target) -> Result<Arc<Channel>, Failure> {
        let mut publishing = self.publishing.lock().await;
        if let Some(channel) = publishing.get(target)
            && channel.status().connected()
        {
            return Ok(Arc::clone(channel));
        }
        let channel = self.connection.create_channel().await?;
        channel
            .confirm_select(ConfirmSelectOptions::default())
            .await?;
        let channel = Arc::new(channel);
        publishing.insert(target.clone(), Arc::clone(&channel));
        Ok(channel)
    }
}

/// A bare connection, without recovery by the client.
pub(super) async fn connect(uri: &AMQPUri) -> Result<Connection, Failure> {
    let properties = ConnectionProperties::default().with_connection_name("plumbline".into());
    Ok(Connection::connect_uri(uri.clone(), properties).await?)
}

/// Does a call to its end, also where nobody waits for it any more. The client forgets a subscription whose
/// future is dropped before the broker has confirmed it, and keeps its channel open; the broker would then
/// hand it messages that nobody ever reads.
pub(super) async fn to_its_end<T: Send + 'static>(
    call: impl Future<Output = Result<T, Failure>> + Send + 'static,
) -> Result<T, Failure> {
    match tokio::spawn(call).await {
        Ok(done) => done,
        Err(broken) => Err(Failure::Passing(broken.into())),
    }
}
