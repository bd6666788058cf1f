//! A consumer holds no more than its slots, also on the connections that follow a restart of the broker.

use std::thread::sleep;
use std::time::{Duration, Instant};

use plumbline_tests::fleet::Daemon;
use plumbline_tests::process::wait_until;
use plumbline_tests::run::Place;
use plumbline_tests::s3_faults::S3Faults;
use plumbline_tests::servers::{JobConsumer, Server, consumers, server};

use crate::check::{JOB_QUEUES, within_slots};
use crate::fault::unique;
use crate::setup::{CORPUS, SLOTS, Ways, log, put_corpus, score_command, worker_command};

const WORKERS: usize = 2;

/// What a job takes: so long that there are jobs left after the broker's restart.
const JOB_MS: &str = "500";

/// The jobs take a minute; the broker's restart and a busy machine may take as long again, and more.
const PATIENCE: Duration = Duration::from_secs(300);

#[test]
fn slots_bound_what_a_worker_holds_before_and_after_a_restart_of_the_broker() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let place = Place::new();
    let name = unique();
    let prefix = format!("{name}/{CORPUS}");
    let marker = format!("CAMPAIGN_MARKER={name}");
    let (videos, ways) = runtime.block_on(async {
        let videos = put_corpus(&place, &prefix).await;
        let s3 = S3Faults::before(&server("PLUMBLINE_TEST_S3_ENDPOINT"), 0, 0).await;
        let mut ways = Vec::new();
        for _ in 0..=WORKERS {
            ways.push(Ways::new(&s3).await);
        }
        (videos, (s3, ways))
    });
    let (_s3, ways) = ways;
    let mut workers: Vec<Daemon> = (0..WORKERS)
        .map(|index| {
            let name = format!("worker-{index}");
            let more = ["--no-op", "--no-op-ms", JOB_MS];
            let command = worker_command(&place, &name, &ways[index], &marker, &more);
            Daemon::start(command, &log(&place, &name))
        })
        .collect();
    let run = format!("{name}-prefetch");
    let score = score_command(&place, &prefix, "out", &run, &ways[WORKERS], &marker);
    let mut coordinator = Daemon::start(score, &log(&place, "coordinator"));

    full_slots(&mut coordinator);
    // Old enough to survive: see the design of the queues.
    sleep(Duration::from_secs(4));
    Server::Broker.kill();
    Server::Broker.start();
    let after = full_slots(&mut coordinator);
    eprintln!("after the restart: {after:?}");

    let started = Instant::now();
    loop {
        match coordinator.ended().map(|status| status.code()) {
            // Every row is static.
            Some(Some(0)) => break,
            Some(Some(1 | 2)) => coordinator.restart(),
            Some(other) => panic!("{other:?}\n{}", coordinator.last_words(30)),
            None => {}
        }
        for consumer in consumers(JOB_QUEUES).unwrap_or_default() {
            within_slots(&consumer);
        }
        assert!(
            started.elapsed() < PATIENCE,
            "{}",
            coordinator.last_words(30)
        );
        sleep(Duration::from_millis(200));
    }
    place.published("out").expect_rows(&videos);
    for worker in &mut workers {
        let status = worker.terminate(PATIENCE);
        assert_eq!(
            status.and_then(|s| s.code()),
            Some(0),
            "{}",
            worker.last_words(30)
        );
    }
    wait_until("no process is left", PATIENCE, || {
        plumbline_tests::process::marked(&marker).is_empty()
    });
}

/// Waits until all slots of all workers are taken, never more; what the broker said then.
fn full_slots(coordinator: &mut Daemon) -> Vec<JobConsumer> {
    let started = Instant::now();
    loop {
        let now = consumers(JOB_QUEUES).unwrap_or_default();
        now.iter().for_each(within_slots);
        let held: u64 = now.iter().map(|consumer| consumer.unacked).sum();
        if held == WORKERS as u64 * u64::from(SLOTS) {
            return now;
        }
        assert!(
            coordinator.ended().is_none() && started.elapsed() < PATIENCE,
            "{now:?}\n{}",
            coordinator.last_words(30)
        );
    }
}
