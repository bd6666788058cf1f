//! What every broker promises, asked of each in the same words.

use std::collections::{BTreeMap, BTreeSet};
use std::task::Poll;
use std::time::{Duration, Instant};

use plumbline_common::id::RunId;
use plumbline_common::message::MAX_MESSAGE_BYTES;
use plumbline_common::queue::{
    Broker, Consumer, Delivery, JobKind, MAX_DELIVERIES, Message, Queue, QueueError, Settlement,
    publish_all,
};
use tokio::time::timeout;

use super::DEADLINE;

/// Long enough that what is on its way has arrived; only ever waited for where nothing should come.
const QUIET: Duration = Duration::from_millis(300);

pub(crate) const JOBS: Queue = Queue::Jobs(JobKind::Fused);

pub(crate) fn results(run: &str) -> Queue {
    Queue::Results(RunId::new(run).unwrap())
}

pub(crate) fn numbered(n: usize) -> impl Iterator<Item = Message> + Send {
    (0..n).map(|k| Message::new(format!("video-{k}"), format!("body {k}")))
}

pub(crate) async fn next(consumer: &mut Box<dyn Consumer>) -> Delivery {
    timeout(DEADLINE, consumer.next())
        .await
        .expect("a message within the deadline")
        .unwrap()
}

async fn nothing_comes(consumer: &mut Box<dyn Consumer>) {
    assert!(
        timeout(QUIET, consumer.next()).await.is_err(),
        "a message came"
    );
}

/// Asks for all of it, one after the other.
pub(crate) async fn keeps_the_contract(broker: &dyn Broker) {
    every_message_arrives_as_it_was(broker).await;
    no_more_than_slots_are_in_work(broker).await;
    what_a_lost_consumer_held_comes_again(broker).await;
    a_retry_comes_back_later_and_counted(broker).await;
    a_rejection_is_kept_with_its_reason(broker).await;
    a_message_that_ends_every_receiver_is_put_away(broker).await;
    consumers_are_counted(broker).await;
    a_stopped_consumer_gets_no_more_and_settles_what_it_has(broker).await;
    a_run_has_a_results_queue_while_it_lasts(broker).await;
    a_retry_whose_queue_is_gone_is_not_lost(broker).await;
    a_missing_queue_is_told_to_the_right_publisher(broker).await;
    messages_have_a_largest_size(broker).await;
    a_cancelled_wait_loses_nothing(broker).await;
    a_subscription_that_is_given_up_takes_nothing(broker).await;
    a_lease_has_one_holder(broker).await;
}

async fn every_message_arrives_as_it_was(broker: &dyn Broker) {
    const N: usize = 500;
    let mut consumer = broker.consume(&JOBS, 50).await.unwrap();
    let odd = Message::new("ünï\n\"".to_owned() + &"x".repeat(4000), Vec::new());
    let messages: Vec<_> = numbered(N).chain([odd]).collect();
    let mut expected: BTreeMap<_, _> = messages
        .iter()
        .map(|message| (message.id.clone(), message.clone()))
        .collect();
    // Received while it is published: a bounded queue would not hold all.
    let publishing = publish_all(broker, &JOBS, messages, 100);
    let receiving = async {
        while !expected.is_empty() {
            let delivery = next(&mut consumer).await;
            assert_eq!((delivery.redeliveries, &delivery.dead), (0, &None));
            assert_eq!(
                expected.remove(&delivery.message.id),
                Some(delivery.message.clone())
            );
            delivery.settle(Settlement::Done).await.unwrap();
        }
    };
    let (published, ()) = tokio::join!(publishing, receiving);
    assert_eq!(published.unwrap(), N as u64 + 1);
    nothing_comes(&mut consumer).await;
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 0);
}

async fn no_more_than_slots_are_in_work(broker: &dyn Broker) {
    const SLOTS: usize = 3;
    let mut consumer = broker.consume(&JOBS, SLOTS as u16).await.unwrap();
    publish_all(broker, &JOBS, numbered(5), 5).await.unwrap();
    let mut held = Vec::new();
    for _ in 0..SLOTS {
        held.push(next(&mut consumer).await);
    }
    nothing_comes(&mut consumer).await;
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 2);
    for _ in 0..2 {
        held.remove(0).settle(Settlement::Done).await.unwrap();
        held.push(next(&mut consumer).await);
    }
    for delivery in held {
        delivery.settle(Settlement::Done).await.unwrap();
    }
    nothing_comes(&mut consumer).await;
}

/// A consumer that was dropped goes in its own time, and what comes to it meanwhile comes again.
async fn nobody_listens(broker: &dyn Broker) {
    let gone = async {
        while broker.consumers(&JOBS).await.unwrap() > 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), gone)
        .await
        .unwrap();
}

async fn a_stopped_consumer_gets_no_more_and_settles_what_it_has(broker: &dyn Broker) {
    nobody_listens(broker).await;
    let mut stopped = broker.consume(&JOBS, 2).await.unwrap();
    assert!(stopped.pulse().is_alive());
    publish_all(broker, &JOBS, numbered(2), 2).await.unwrap();
    let held = [next(&mut stopped).await, next(&mut stopped).await];
    stopped.stop().await;
    assert!(!stopped.pulse().is_alive());
    for delivery in held {
        delivery.settle(Settlement::Done).await.unwrap();
    }
    publish_all(broker, &JOBS, numbered(2), 2).await.unwrap();
    let mut other = broker.consume(&JOBS, 2).await.unwrap();
    for _ in 0..2 {
        let delivery = next(&mut other).await;
        assert_eq!(delivery.redeliveries, 0);
        delivery.settle(Settlement::Done).await.unwrap();
    }
}

async fn what_a_lost_consumer_held_comes_again(broker: &dyn Broker) {
    nobody_listens(broker).await;
    publish_all(broker, &JOBS, numbered(2), 2).await.unwrap();
    let mut first = broker.consume(&JOBS, 2).await.unwrap();
    let (a, b) = (next(&mut first).await, next(&mut first).await);
    drop(b);
    drop(first);
    let mut second = broker.consume(&JOBS, 2).await.unwrap();
    let mut again = BTreeSet::new();
    for _ in 0..2 {
        let delivery = next(&mut second).await;
        assert_eq!(delivery.redeliveries, 1);
        assert_eq!(delivery.message.attempt, 1);
        again.insert(delivery.message.id.clone());
        delivery.settle(Settlement::Done).await.unwrap();
    }
    assert_eq!(again, ["video-0", "video-1"].map(str::to_owned).into());
    // What the lost consumer says of it comes too late, and says so.
    let too_late = a.settle(Settlement::Done).await;
    assert!(
        matches!(too_late, Err(QueueError::Lost { .. })),
        "{too_late:?}"
    );
    nothing_comes(&mut second).await;
}

async fn a_retry_comes_back_later_and_counted(broker: &dyn Broker) {
    const WAIT: Duration = Duration::from_millis(300);
    let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
    let message = Message::new("again", "body");
    broker.publish(&JOBS, message.clone()).await.unwrap();
    for attempt in 1..=3 {
        let delivery = next(&mut consumer).await;
        assert_eq!(delivery.redeliveries, 0, "a retry is no crash");
        assert_eq!(
            delivery.message,
            Message {
                attempt,
                ..message.clone()
            }
        );
        let settled = Instant::now();
        if attempt == 3 {
            delivery.settle(Settlement::Done).await.unwrap();
            break;
        }
        delivery
            .settle(Settlement::Retry { after: WAIT })
            .await
            .unwrap();
        // The slot is free meanwhile.
        let other = Message::new("other", "");
        broker.publish(&JOBS, other).await.unwrap();
        let between = next(&mut consumer).await;
        assert_eq!(between.message.id, "other");
        between.settle(Settlement::Done).await.unwrap();
        let waited = timeout(WAIT.saturating_sub(settled.elapsed()) / 2, consumer.next()).await;
        assert!(waited.is_err(), "the retry came at once");
    }
    nothing_comes(&mut consumer).await;
}

async fn a_rejection_is_kept_with_its_reason(broker: &dyn Broker) {
    let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
    let message = Message::new("poison", vec![0xc1, 0xff]);
    broker.publish(&JOBS, message.clone()).await.unwrap();
    let reason = "the message does not decode: é".to_owned() + &"…".repeat(100);
    let rejected = Settlement::Reject {
        reason: reason.clone(),
    };
    next(&mut consumer).await.settle(rejected).await.unwrap();
    nothing_comes(&mut consumer).await;

    let mut dead = broker.consume(&Queue::Dead, 1).await.unwrap();
    let letter = next(&mut dead).await;
    assert_eq!(letter.message, message);
    let why = letter.dead.clone().unwrap();
    assert_eq!((why.queue, why.reason), (Some(JOBS), reason));
    letter.settle(Settlement::Done).await.unwrap();
    nothing_comes(&mut dead).await;
}

async fn a_message_that_ends_every_receiver_is_put_away(broker: &dyn Broker) {
    // Consumers of earlier parts go in their own time, and may take a message with them.
    let started = Instant::now();
    while broker.consumers(&JOBS).await.unwrap() != 0 {
        assert!(started.elapsed() < DEADLINE, "somebody still receives");
    }
    broker
        .publish(&JOBS, Message::new("killer", "x"))
        .await
        .unwrap();
    for redeliveries in 0..MAX_DELIVERIES {
        let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
        let delivery = next(&mut consumer).await;
        assert_eq!(delivery.message.id, "killer");
        assert_eq!(delivery.redeliveries, redeliveries);
    }
    let mut dead = broker.consume(&Queue::Dead, 1).await.unwrap();
    let letter = next(&mut dead).await;
    let why = letter.dead.clone().unwrap();
    assert_eq!(letter.message.id, "killer");
    assert_eq!(
        (why.queue, why.reason.as_str()),
        (Some(JOBS), "delivery_limit")
    );
    letter.settle(Settlement::Done).await.unwrap();
    assert_eq!(broker.ready(&JOBS).await.unwrap(), 0);
}

async fn consumers_are_counted(broker: &dyn Broker) {
    let queue = results("counted");
    assert!(matches!(
        broker.consumers(&queue).await,
        Err(QueueError::Missing { .. })
    ));
    broker.declare(&queue).await.unwrap();
    let started = Instant::now();
    let until = async |wanted: u64| {
        while broker.consumers(&queue).await.unwrap() != wanted {
            assert!(started.elapsed() < DEADLINE, "never {wanted} consumers");
        }
    };
    until(0).await;
    let one = broker.consume(&queue, 1).await.unwrap();
    let other = broker.consume(&queue, 1).await.unwrap();
    until(2).await;
    drop(one);
    until(1).await;
    drop(other);
    until(0).await;
    broker
        .delete(&RunId::new("counted").unwrap())
        .await
        .unwrap();
}

async fn a_run_has_a_results_queue_while_it_lasts(broker: &dyn Broker) {
    let run = RunId::new("lasts").unwrap();
    let queue = Queue::Results(run.clone());
    let is_missing = async || {
        let published = broker.publish(&queue, Message::new("r", "")).await;
        assert!(
            matches!(published, Err(QueueError::Missing { .. })),
            "{published:?}"
        );
        let consumed = broker.consume(&queue, 1).await;
        assert!(
            matches!(consumed, Err(QueueError::Missing { .. })),
            "{consumed:?}"
        );
        let counted = broker.ready(&queue).await;
        assert!(
            matches!(counted, Err(QueueError::Missing { .. })),
            "{counted:?}"
        );
    };
    is_missing().await;
    broker.declare(&queue).await.unwrap();
    broker.publish(&queue, Message::new("r", "")).await.unwrap();
    // A restarted coordinator declares again, and finds what is there.
    broker.declare(&queue).await.unwrap();
    let mut consumer = broker.consume(&queue, 1).await.unwrap();
    assert_eq!(next(&mut consumer).await.message.id, "r");
    drop(consumer);
    broker.delete(&run).await.unwrap();
    broker.delete(&run).await.unwrap();
    is_missing().await;
}

async fn a_retry_whose_queue_is_gone_is_not_lost(broker: &dyn Broker) {
    let run = RunId::new("gone").unwrap();
    let queue = Queue::Results(run.clone());
    broker.declare(&queue).await.unwrap();
    broker
        .publish(&queue, Message::new("homeless", ""))
        .await
        .unwrap();
    let mut consumer = broker.consume(&queue, 1).await.unwrap();
    let after = Duration::from_millis(300);
    let delivery = next(&mut consumer).await;
    delivery.settle(Settlement::Retry { after }).await.unwrap();
    drop(consumer);
    broker.delete(&run).await.unwrap();
    let mut dead = broker.consume(&Queue::Dead, 1).await.unwrap();
    let letter = next(&mut dead).await;
    assert_eq!(
        (letter.message.id.as_str(), letter.message.attempt),
        ("homeless", 2)
    );
    assert_eq!(letter.dead.clone().unwrap().queue, Some(queue));
    letter.settle(Settlement::Done).await.unwrap();
}

async fn a_missing_queue_is_told_to_the_right_publisher(broker: &dyn Broker) {
    const N: usize = 100;
    let missing = results("never");
    let there = publish_all(broker, &JOBS, numbered(N), N);
    let not_there = futures_util::future::join_all(
        numbered(N).map(|message| broker.publish(&missing, message)),
    );
    let (published, refused) = tokio::join!(there, not_there);
    assert_eq!(published.unwrap(), N as u64);
    for refused in refused {
        assert!(
            matches!(refused, Err(QueueError::Missing { .. })),
            "{refused:?}"
        );
    }
    let mut consumer = broker.consume(&JOBS, N as u16).await.unwrap();
    for _ in 0..N {
        next(&mut consumer)
            .await
            .settle(Settlement::Done)
            .await
            .unwrap();
    }
}

async fn messages_have_a_largest_size(broker: &dyn Broker) {
    let body = vec![7; MAX_MESSAGE_BYTES + 1];
    let refused = broker
        .publish(&JOBS, Message::new("big", body.clone()))
        .await;
    assert!(
        matches!(refused, Err(QueueError::TooLarge { .. })),
        "{refused:?}"
    );
    let largest = Message::new("big", body[1..].to_vec());
    broker.publish(&JOBS, largest.clone()).await.unwrap();
    let mut consumer = broker.consume(&JOBS, 1).await.unwrap();
    let delivery = next(&mut consumer).await;
    assert!(
        delivery.message == largest,
        "the largest message came back another"
    );
    delivery.settle(Settlement::Done).await.unwrap();
}

async fn a_cancelled_wait_loses_nothing(broker: &dyn Broker) {
    const N: usize = 50;
    let mut consumer = broker.consume(&JOBS, 2).await.unwrap();
    let receiving = async {
        let mut received = BTreeSet::new();
        while received.len() < N {
            let hasty = timeout(Duration::from_micros(300), consumer.next()).await;
            if let Ok(delivery) = hasty {
                let delivery = delivery.unwrap();
                assert!(received.insert(delivery.message.id.clone()));
                delivery.settle(Settlement::Done).await.unwrap();
            }
        }
    };
    let publishing = publish_all(broker, &JOBS, numbered(N), 1);
    let (published, received) = tokio::join!(publishing, timeout(DEADLINE, receiving));
    assert_eq!(published.unwrap(), N as u64);
    received.expect("everything within the deadline");
}

async fn a_lease_has_one_holder(broker: &dyn Broker) {
    let run = RunId::new("one").unwrap();
    let mut held = broker.lease(&run).await.unwrap().expect("a free lease");
    assert!(broker.lease(&run).await.unwrap().is_none());
    assert!(
        broker
            .lease(&RunId::new("other").unwrap())
            .await
            .unwrap()
            .is_some()
    );
    assert!(timeout(QUIET, held.lost()).await.is_err(), "the lease went");
    held.release().await;
    let again = broker.lease(&run).await.unwrap().expect("a released lease");
    drop(again);
    // A holder that only went is noticed a little later.
    let taken = async {
        while broker.lease(&run).await.unwrap().is_none() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(DEADLINE, taken)
        .await
        .expect("a lease whose holder is gone");
}

async fn a_subscription_that_is_given_up_takes_nothing(broker: &dyn Broker) {
    const N: usize = 20;
    // At each of its waits, one after the other.
    let mut polls = 1;
    while polled(polls, broker.consume(&JOBS, 1)).await.is_none() {
        polls += 1;
    }
    // In the middle of each.
    for wait_ms in 0..10 {
        let wait = Duration::from_millis(wait_ms);
        let _given_up = timeout(wait, broker.consume(&JOBS, 1)).await;
    }
    let mut consumer = broker.consume(&JOBS, 2).await.unwrap();
    publish_all(broker, &JOBS, numbered(N), N).await.unwrap();
    for _ in 0..N {
        let delivery = next(&mut consumer).await;
        delivery.settle(Settlement::Done).await.unwrap();
    }
    let started = Instant::now();
    while broker.consumers(&JOBS).await.unwrap() != 1 {
        assert!(started.elapsed() < DEADLINE, "there are others");
    }
}

/// Polls `future` so often and gives it up then; what it gave, if it came to that.
async fn polled<F: Future>(polls: usize, future: F) -> Option<F::Output> {
    let mut future = std::pin::pin!(future);
    let mut left = polls;
    std::future::poll_fn(|context| {
        left -= 1;
        match future.as_mut().poll(context) {
            Poll::Pending if left > 0 => Poll::Pending,
            Poll::Pending => Poll::Ready(None),
            Poll::Ready(output) => Poll::Ready(Some(output)),
        }
    })
    .await
}
