//! A run's lease: a queue that belongs to one connection and goes with it.

use async_trait::async_trait;
use futures_util::StreamExt;
use lapin::options::{BasicConsumeOptions, QueueDeclareOptions};
use lapin::types::FieldTable;
use lapin::uri::AMQPUri;
use lapin::{Channel, Connection};
use tokio::time::timeout;

use super::PATIENCE;
use super::failure::Failure;
use super::session::{REPLY_SUCCESS, connect, to_its_end};
use crate::queue::Lease;

#[derive(Debug)]
pub(super) struct AmqpLease {
    /// Of its own: publishing may throw its connection away, and the lease must not go with it.
    connection: Connection,
    _channel: Channel,
    /// Never delivers; ends with the connection.
    stream: lapin::Consumer,
}

impl AmqpLease {
    /// Takes it; [`Failure::Locked`] while another connection holds it. Given up, it does not stay with a
    /// connection that nobody knows.
    pub(super) async fn take(uri: &AMQPUri, queue: &str) -> Result<Self, Failure> {
        to_its_end(Self::taken(uri.clone(), queue.to_owned())).await
    }

    async fn taken(uri: AMQPUri, queue: String) -> Result<Self, Failure> {
        let queue = queue.as_str();
        let connection = connect(&uri).await?;
        let channel = connection.create_channel().await?;
        channel
            .queue_declare(
                queue.into(),
                QueueDeclareOptions::exclusive(),
                FieldTable::default(),
            )
            .await?;
        let stream = channel
            .basic_consume(
                queue.into(),
                "".into(),
                BasicConsumeOptions::default(),
                FieldTable::default(),
            )
            .await?;
        Ok(Self {
            connection,
            _channel: channel,
            stream,
        })
    }
}

#[async_trait]
impl Lease for AmqpLease {
    async fn lost(&mut self) {
        while let Some(Ok(_)) = self.stream.next().await {}
    }

    async fn release(self: Box<Self>) {
        let closing = self.connection.close(REPLY_SUCCESS, "released".into());
        // A connection that cannot be closed is gone already. There are no heartbeats while it closes: one
        // that has fallen silent would never be.
        let _gone = timeout(PATIENCE, closing).await;
    }
}
