//! A run's lease: a queue that belongs to one connection and goes with it.

use async_trait::async_trait;
use futures_util::StreamExt;
use lapin::options::{BasicConsumeOptions, QueueDeclareOptions};
use lapin::types::FieldTable;
use lapin::uri::AMQPUri;
use lapin::{Channel, Connection};

use super::failure::Failure;
use super::session::{REPLY_SUCCESS, connect};
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
    /// Takes it; [`Failure::Locked`] while another connection holds it.
    pub(super) async fn take(uri: &AMQPUri, queue: &str) -> Result<Self, Failure> {
        let connection = connect(uri).await?;
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
        // A connection that cannot be closed is gone already.
        let _gone = self
            .connection
            .close(REPLY_SUCCESS, "released".into())
            .await;
    }
}
