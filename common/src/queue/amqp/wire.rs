//! A message as AMQP carries it: the body as it is, the rest in headers. Ids are headers, too, since
//! AMQP's own field for them ends at 255 bytes and a video's name does not.

use lapin::BasicProperties;
use lapin::message::Delivery;
use lapin::types::{AMQPValue, FieldTable, LongString, ShortString};

use super::names::Names;
use crate::queue::{DeadLetter, Message};

const ID: &str = "plumbline-id";
const ATTEMPT: &str = "plumbline-attempt";
/// The W3C's name, by which other programs' traces find it too.
const TRACEPARENT: &str = "traceparent";
const REASON: &str = "plumbline-reason";

/// The broker's count of deliveries before this one.
const DELIVERY_COUNT: &str = "x-delivery-count";

/// The broker's list of why and whence a message was dead-lettered, the latest first.
const DEATHS: &str = "x-death";

/// AMQP's number for messages that survive a restart.
const PERSISTENT: u8 = 2;

/// Longest reason, in bytes: headers must fit one frame.
const MAX_REASON_BYTES: usize = 4096;

pub(super) fn properties(message: &Message, reason: Option<&str>) -> BasicProperties {
    let mut headers = FieldTable::default();
    headers.insert(ID.into(), text(&message.id));
    headers.insert(
        ATTEMPT.into(),
        AMQPValue::LongLongInt(message.attempt.into()),
    );
    if let Some(trace) = &message.traceparent {
        headers.insert(TRACEPARENT.into(), text(trace));
    }
    if let Some(reason) = reason {
        let end = reason.floor_char_boundary(MAX_REASON_BYTES);
        headers.insert(REASON.into(), text(&reason[..end]));
    }
    BasicProperties::default()
        .with_delivery_mode(PERSISTENT)
        .with_headers(headers)
}

/// The message, how often it was delivered before, and why it is dead if it is. What another program
/// sent without our headers has an empty id and is at its first attempt; its body will not decode.
pub(super) fn received(delivery: &mut Delivery, names: &Names) -> (Message, u32, DeadLetter) {
    let headers = delivery.properties.headers().clone().unwrap_or_default();
    let message = Message {
        id: text_of(&headers, ID).unwrap_or_default(),
        body: std::mem::take(&mut delivery.data).into(),
        attempt: count_of(&headers, ATTEMPT).unwrap_or(1),
        traceparent: text_of(&headers, TRACEPARENT),
    };
    let dead = DeadLetter {
        queue: names.parse(delivery.routing_key.as_str()),
        reason: text_of(&headers, REASON)
            .or_else(|| latest_death(&headers))
            .unwrap_or_else(|| "unknown".to_owned()),
    };
    (
        message,
        count_of(&headers, DELIVERY_COUNT).unwrap_or(0),
        dead,
    )
}

fn latest_death(headers: &FieldTable) -> Option<String> {
    let deaths = headers.inner().get(DEATHS)?.as_array()?;
    let latest = deaths.as_slice().first()?.as_field_table()?;
    text_of(latest, "reason")
}

fn text(text: &str) -> AMQPValue {
    AMQPValue::LongString(LongString::from(text))
}

fn text_of(table: &FieldTable, name: &str) -> Option<String> {
    match table.inner().get(name)? {
        AMQPValue::LongString(text) => Some(text.to_string()),
        AMQPValue::ShortString(text) => Some(ShortString::to_string(text)),
        _ => None,
    }
}

/// Brokers send counts as whichever integer is at hand.
fn count_of(table: &FieldTable, name: &str) -> Option<u32> {
    let count: i64 = match *table.inner().get(name)? {
        AMQPValue::ShortShortInt(n) => n.into(),
        AMQPValue::ShortShortUInt(n) => n.into(),
        AMQPValue::ShortInt(n) => n.into(),
        AMQPValue::ShortUInt(n) => n.into(),
        AMQPValue::LongInt(n) => n.into(),
        AMQPValue::LongUInt(n) => n.into(),
        AMQPValue::LongLongInt(n) => n,
        _ => return None,
    };
    u32::try_from(count).ok()
}
