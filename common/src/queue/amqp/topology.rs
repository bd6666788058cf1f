//! Exchanges and queues, declared anew by every connection: a declaration of what is there is cheap, and
//! a broker that lost everything is set up again.
//!
//! ```text
//! publish ─► plumbline (direct) ─► jobs.* / results.RUN ── more than 20 deliveries ──► dead (fanout) ─► dead
//!                                        ▲                                               ▲
//! retry ───► wait.Nms (fanout) ─► wait.Nms ── N ms ──► back (direct) ── queue is gone ───┘
//! ```
//!
//! All queues are quorum queues: they survive a broker's death, and count deliveries. One queue per
//! wait, rather than one for all with a time per message, since a queue only expires what is in front.
//! Dead-lettering is at-least-once, which the broker offers with `reject-publish` only.

use std::time::Duration;

use lapin::options::{ExchangeDeclareOptions, QueueBindOptions, QueueDeclareOptions};
use lapin::types::{AMQPValue, FieldTable};
use lapin::{Channel, ExchangeKind};

use super::names::Names;
use crate::queue::{JobKind, MAX_DELIVERIES, Queue};

/// Declares what is always there.
pub(super) async fn declare(
    channel: &Channel,
    names: &Names,
    waits: &[Duration],
) -> lapin::Result<()> {
    let dead = names.dead_exchange();
    exchange(channel, &dead, ExchangeKind::Fanout, FieldTable::default()).await?;
    queue(channel, &dead, quorum()).await?;
    bind(channel, &dead, &dead, "").await?;

    let work = names.work_exchange();
    exchange(channel, &work, ExchangeKind::Direct, FieldTable::default()).await?;
    let mut unroutable_is_dead = FieldTable::default();
    unroutable_is_dead.insert("alternate-exchange".into(), text(&dead));
    let back = names.back_exchange();
    exchange(channel, &back, ExchangeKind::Direct, unroutable_is_dead).await?;

    for wait in waits {
        let name = names.wait(*wait);
        exchange(channel, &name, ExchangeKind::Fanout, FieldTable::default()).await?;
        let mut arguments = dead_lettered_to(&back);
        let wait_ms = i64::try_from(wait.as_millis()).unwrap_or(i64::MAX);
        arguments.insert("x-message-ttl".into(), AMQPValue::LongLongInt(wait_ms));
        queue(channel, &name, arguments).await?;
        bind(channel, &name, &name, "").await?;
    }
    for kind in JobKind::ALL {
        declare_work_queue(channel, names, &Queue::Jobs(kind)).await?;
    }
    Ok(())
}

/// Declares a queue of jobs or results.
pub(super) async fn declare_work_queue(
    channel: &Channel,
    names: &Names,
    work: &Queue,
) -> lapin::Result<()> {
    let name = names.queue(work);
    let mut arguments = dead_lettered_to(&names.dead_exchange());
    // The broker counts what comes after the first delivery.
    arguments.insert(
        "x-delivery-limit".into(),
        AMQPValue::LongInt(MAX_DELIVERIES as i32 - 1),
    );
    queue(channel, &name, arguments).await?;
    bind(channel, &name, &names.work_exchange(), &name).await?;
    bind(channel, &name, &names.back_exchange(), &name).await
}

fn quorum() -> FieldTable {
    let mut arguments = FieldTable::default();
    arguments.insert("x-queue-type".into(), text("quorum"));
    arguments
}

fn dead_lettered_to(exchange: &str) -> FieldTable {
    let mut arguments = quorum();
    arguments.insert("x-dead-letter-exchange".into(), text(exchange));
    arguments.insert("x-dead-letter-strategy".into(), text("at-least-once"));
    arguments.insert("x-overflow".into(), text("reject-publish"));
    arguments
}

async fn exchange(
    channel: &Channel,
    name: &str,
    kind: ExchangeKind,
    arguments: FieldTable,
) -> lapin::Result<()> {
    let options = ExchangeDeclareOptions {
        durable: true,
        ..ExchangeDeclareOptions::default()
    };
    channel
        .exchange_declare(name.into(), kind, options, arguments)
        .await
}

async fn queue(channel: &Channel, name: &str, arguments: FieldTable) -> lapin::Result<()> {
    let options = QueueDeclareOptions::durable();
    channel
        .queue_declare(name.into(), options, arguments)
        .await?;
    Ok(())
}

async fn bind(channel: &Channel, queue: &str, exchange: &str, key: &str) -> lapin::Result<()> {
    channel
        .queue_bind(
            queue.into(),
            exchange.into(),
            key.into(),
            QueueBindOptions::default(),
            FieldTable::default(),
        )
        .await
}

fn text(text: &str) -> AMQPValue {
    AMQPValue::LongString(text.into())
}
