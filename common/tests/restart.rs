//! A broker that is killed in the middle of everything. Needs the broker for itself: apart from the other
//! tests, which would see their connections go.

#[cfg(test)]
mod support;

use std::collections::BTreeMap;
use std::time::Duration;

use plumbline_common::id::RunId;
use plumbline_common::queue::{AmqpBroker, Broker, QueueError, Settlement, publish_all};
use support::queue_contract::{JOBS, next, numbered};
use support::{DEADLINE, amqp_options, broker_script, server};
use tokio::time::timeout;

/// RabbitMQ takes every job of a channel back when one is not settled in time; it looks once a minute, unless
/// told otherwise here.
#[tokio::test(flavor = "multi_thread")]
async fn a_settlement_that_the_broker_did_not_wait_for_is_lost_and_the_consumer_goes_on() {
    let set = |timeout_ms: &str, look_every_ms: &str| {
        let program = format!(
            "application:set_env(rabbit, consumer_timeout, {timeout_ms}), \
             application:set_env(rabbit, channel_tick_interval, {look_every_ms})."
        );
        broker_script(&["ctl", "-q", "eval", &program]);
    };
    set("1000", "200");
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let broker = AmqpBroker::connect(&url, amqp_options("patience")).await;
    let broker = broker.unwrap();
    let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
    let pulse = consumer.pulse();
    publish_all(&broker, &JOBS, numbered(1), 1).await.unwrap();
    let slow = next(&mut consumer).await;
    let waiting = std::time::Instant::now();
    while pulse.is_alive() {
        assert!(waiting.elapsed() < DEADLINE, "the broker waits");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    set("1800000", "60000");
    let again = next(&mut consumer).await;
    assert_eq!(again.message.id, slow.message.id);
    assert_eq!(again.redeliveries, 1);
    assert!(pulse.is_alive());
    let too_late = slow.settle(Settlement::Done).await;
    assert!(
        matches!(too_late, Err(QueueError::Lost { .. })),
        "{too_late:?}"
    );
    again.settle(Settlement::Done).await.unwrap();
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 0);
}

/// Whoever has other things to do stops waiting for a message now and then, and comes again.
#[tokio::test(flavor = "multi_thread")]
async fn a_consumer_subscribes_anew_however_briefly_it_is_waited_for() {
    const MESSAGES: usize = 50;
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let options = amqp_options("brief");
    let broker = AmqpBroker::connect(&url, options.clone()).await.unwrap();
    let mut consumer = broker.consume(&JOBS, 2).await.unwrap();
    for brief_ms in [1, 2, 3, 5, 8, 13, 21] {
        broker_script(&["ctl", "-q", "close_all_connections", "as told"]);
        // Of its own, since a connection that another opens serves a consumer, too.
        let other = AmqpBroker::connect(&url, options.clone()).await.unwrap();
        publish_all(&other, &JOBS, numbered(MESSAGES), MESSAGES)
            .await
            .unwrap();
        let started = std::time::Instant::now();
        let mut received = 0;
        while received < MESSAGES {
            let brief = Duration::from_millis(brief_ms);
            if let Ok(delivery) = timeout(brief, consumer.next()).await {
                delivery.unwrap().settle(Settlement::Done).await.unwrap();
                received += 1;
            }
            assert!(
                started.elapsed() < DEADLINE,
                "{received} of {MESSAGES}, {brief:?} each; consumers: {:?}",
                other.consumers(&JOBS).await
            );
        }
        while other.consumers(&JOBS).await.unwrap() != 1 {
            assert!(started.elapsed() < DEADLINE, "there are others");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_broker_loses_nothing_and_slots_stay_bounded() {
    const MESSAGES: usize = 3000;
    const SLOTS: u16 = 8;
    let options = amqp_options("restart");
    let queue = format!("{}.{JOBS}", options.namespace);
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let broker = AmqpBroker::connect(&url, options).await.unwrap();
    let mut lease = broker
        .lease(&RunId::new("run").unwrap())
        .await
        .unwrap()
        .unwrap();

    let publisher = broker.clone();
    let publishing =
        tokio::spawn(async move { publish_all(&publisher, &JOBS, numbered(MESSAGES), 4).await });
    let mut consumer = broker.consume(&JOBS, SLOTS).await.unwrap();
    let mut times_received = BTreeMap::<String, u32>::new();
    let in_hand = loop {
        let delivery = next(&mut consumer).await;
        *times_received
            .entry(delivery.message.id.clone())
            .or_default() += 1;
        if times_received.len() == MESSAGES / 10 {
            break delivery;
        }
        delivery.settle(Settlement::Done).await.unwrap();
    };

    assert!(
        !publishing.is_finished(),
        "publishing must go on into the outage"
    );
    let restart = tokio::task::spawn_blocking(|| {
        broker_script(&["kill"]);
        broker_script(&["start"]);
    });
    timeout(DEADLINE, lease.lost())
        .await
        .expect("the loss of the lease");
    restart.await.unwrap();

    // What was in hand is back at the broker: settling it says so.
    let too_late = in_hand.settle(Settlement::Done).await;
    assert!(
        matches!(too_late, Err(QueueError::Lost { .. })),
        "{too_late:?}"
    );

    // As many as there are slots, and the broker says the same of the same consumer.
    let mut held = Vec::new();
    for _ in 0..SLOTS {
        held.push(next(&mut consumer).await);
    }
    assert!(
        timeout(Duration::from_secs(1), consumer.next())
            .await
            .is_err()
    );
    // Its count follows within seconds.
    let unsettled = || {
        let counts = broker_script(&[
            "ctl",
            "-q",
            "list_queues",
            "name",
            "messages_unacknowledged",
        ]);
        let count = counts.lines().find_map(|line| line.strip_prefix(&queue));
        count.unwrap().trim().parse::<u16>().unwrap()
    };
    let counted = std::time::Instant::now();
    while unsettled() != SLOTS {
        assert!(unsettled() <= SLOTS && counted.elapsed() < DEADLINE);
    }

    for delivery in held {
        *times_received
            .entry(delivery.message.id.clone())
            .or_default() += 1;
        delivery.settle(Settlement::Done).await.unwrap();
    }
    while times_received.len() < MESSAGES {
        let delivery = next(&mut consumer).await;
        *times_received
            .entry(delivery.message.id.clone())
            .or_default() += 1;
        delivery.settle(Settlement::Done).await.unwrap();
    }
    assert_eq!(publishing.await.unwrap().unwrap(), MESSAGES as u64);
    let again = times_received.values().filter(|times| **times > 1).count();
    println!("{again} of {MESSAGES} messages came more than once");
    assert!(
        broker
            .lease(&RunId::new("run").unwrap())
            .await
            .unwrap()
            .is_some()
    );
}
