//! Queues: one contract for the process' own and for RabbitMQ, then what only a network can do.

#[cfg(test)]
mod support;

use std::time::Duration;

use plumbline_common::backoff::Backoff;
use plumbline_common::message::{self, Job};
use plumbline_common::queue::{
    AmqpBroker, AmqpOptions, Broker, LocalBroker, LocalOptions, Message, Queue, QueueError,
    publish_all,
};
use support::queue_contract::{JOBS, keeps_the_contract, next, numbered};
use support::{amqp, amqp_options, server};
use tokio::time::timeout;

#[tokio::test(flavor = "multi_thread")]
async fn the_local_broker_keeps_the_contract() {
    let broker = LocalBroker::new(LocalOptions {
        capacity: 120,
        ..LocalOptions::default()
    });
    keeps_the_contract(&broker).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rabbitmq_keeps_the_contract() {
    keeps_the_contract(&amqp("contract").await).await;
}

#[tokio::test]
async fn a_full_local_queue_makes_publishers_wait_and_dead_letters_are_bounded() {
    const CAPACITY: usize = 3;
    let broker = LocalBroker::new(LocalOptions {
        capacity: CAPACITY,
        dead_letters: 2,
    });
    publish_all(&broker, &JOBS, numbered(CAPACITY), 1)
        .await
        .unwrap();
    let mut one_more = std::pin::pin!(broker.publish(&JOBS, Message::new("more", "")));
    let quiet = Duration::from_millis(50);
    assert!(timeout(quiet, &mut one_more).await.is_err());
    // In work it still counts; settled it does not.
    let mut consumer = broker.consume(&JOBS, 9).await.unwrap();
    let delivery = next(&mut consumer).await;
    assert!(timeout(quiet, &mut one_more).await.is_err());
    let reject = |reason: &str| plumbline_common::queue::Settlement::Reject {
        reason: reason.to_owned(),
    };
    delivery.settle(reject("0")).await.unwrap();
    one_more.await.unwrap();
    for reason in ["1", "2"] {
        next(&mut consumer)
            .await
            .settle(reject(reason))
            .await
            .unwrap();
    }
    let mut dead = broker.consume(&Queue::Dead, 9).await.unwrap();
    for reason in ["1", "2"] {
        assert_eq!(next(&mut dead).await.dead.unwrap().reason, reason);
    }
}

#[tokio::test]
async fn a_deleted_local_queue_frees_those_who_wait_for_it() {
    let broker = LocalBroker::new(LocalOptions {
        capacity: 1,
        ..LocalOptions::default()
    });
    let run = plumbline_common::id::RunId::new("r").unwrap();
    let queue = Queue::Results(run.clone());
    broker.declare(&queue).await.unwrap();
    let mut consumer = broker.consume(&queue, 1).await.unwrap();
    let waits = tokio::spawn(async move { consumer.next().await });
    tokio::task::yield_now().await;
    broker.delete(&run).await.unwrap();
    let freed = timeout(support::DEADLINE, waits).await.unwrap().unwrap();
    assert!(
        matches!(freed, Err(QueueError::Missing { .. })),
        "{freed:?}"
    );
}

#[tokio::test]
async fn what_another_program_sent_arrives_and_does_not_decode() {
    let options = amqp_options("foreign");
    let exchange = options.namespace.clone();
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let broker = AmqpBroker::connect(&url, options).await.unwrap();
    let connection = lapin::Connection::connect(&url, lapin::ConnectionProperties::default());
    let channel = connection.await.unwrap().create_channel().await.unwrap();
    let published = channel.basic_publish(
        exchange.clone().into(),
        format!("{exchange}.jobs.fused").into(),
        lapin::options::BasicPublishOptions::default(),
        b"{\"video\": 1}",
        lapin::BasicProperties::default(),
    );
    published.await.unwrap().await.unwrap();
    let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
    let delivery = next(&mut consumer).await;
    assert_eq!(
        (delivery.message.id.as_str(), delivery.message.attempt),
        ("", 1)
    );
    let decoded = message::decode::<Job>(&delivery.message.body);
    assert!(
        matches!(decoded, Err(message::MessageError::Version { .. })),
        "{decoded:?}"
    );
}

#[tokio::test]
async fn a_queue_made_by_another_version_is_named() {
    let options = amqp_options("mismatch");
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let connection = lapin::Connection::connect(&url, lapin::ConnectionProperties::default());
    let connection = connection.await.unwrap();
    let channel = connection.create_channel().await.unwrap();
    let other = channel.queue_declare(
        format!("{}.dead", options.namespace).into(),
        lapin::options::QueueDeclareOptions::durable(),
        lapin::types::FieldTable::default(),
    );
    other.await.unwrap();
    let refused = AmqpBroker::connect(&url, options).await;
    assert!(
        matches!(refused, Err(QueueError::Mismatch { .. })),
        "{refused:?}"
    );
}

#[tokio::test]
async fn a_broker_out_of_reach_and_one_that_refuses_are_told_apart_without_the_password() {
    let options = || AmqpOptions {
        backoff: Backoff {
            first: Duration::from_millis(1),
            longest: Duration::from_millis(1),
            attempts: 3,
        },
        ..amqp_options("refused")
    };
    // A port that was free a moment ago.
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let nobody = format!("amqp://u:geheim@{free}/%2f");
    let error = AmqpBroker::connect(&nobody, options()).await.unwrap_err();
    assert!(
        matches!(error, QueueError::Unreachable { attempts: 3, .. }),
        "{error:?}"
    );
    assert!(error.to_string().contains(&free.to_string()) && !error.to_string().contains("geheim"));

    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let (_, host) = url.rsplit_once('@').unwrap();
    let wrong = format!("amqp://guest:geheim@{host}");
    let error = AmqpBroker::connect(&wrong, options()).await.unwrap_err();
    assert!(matches!(error, QueueError::Refused { .. }), "{error:?}");
    assert!(!error.to_string().contains("geheim"), "{error}");

    for (url, namespace) in [("http://x", "ok"), ("amqp://x", "Not ok")] {
        let options = AmqpOptions {
            namespace: namespace.to_owned(),
            ..options()
        };
        let error = AmqpBroker::connect(url, options).await.unwrap_err();
        assert!(matches!(error, QueueError::Address { .. }), "{error:?}");
    }
}
