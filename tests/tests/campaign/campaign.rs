//! Runs of one corpus, over and over, while what they need breaks in a seeded order.
//!
//! `PLUMBLINE_CAMPAIGN_FAULTS` (200) is how many faults to inject at least, beside those of the S3 requests;
//! `PLUMBLINE_CAMPAIGN_MINUTES` (60) when no further run begins, which fails where faults are missing;
//! `PLUMBLINE_CAMPAIGN_SEED` another order; `PLUMBLINE_CAMPAIGN_LOG` a file for the line per fault.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use plumbline_common::id::RunId;
use plumbline_common::queue::Queue;
use plumbline_tests::fleet::Daemon;
use plumbline_tests::process::{Process, wait_until};
use plumbline_tests::proxy::{Break, Pace};
use plumbline_tests::run::{Place, Started};
use plumbline_tests::s3_faults::S3Faults;
use plumbline_tests::servers::{Server, server};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use tokio::runtime::Runtime;

use crate::check::{self, Prefetches};
use crate::fault::{Fault, JOBS, Tamperer, unique};
use crate::hang::{self, Progress};
use crate::journal::Journal;
use crate::setup::{
    CORPUS, Ways, address, embedded_command, log, put_corpus, score_command, start_worker,
};

const WORKERS: usize = 3;

/// Of 1,000 requests to the store, how many meet a fault.
const S3_FAULTS_PER_MILLE: u32 = 30;

/// Waits between faults, milliseconds.
const GAP_MS: (u64, u64) = (150, 1100);

/// Between two kills of compute processes: far above what a clip takes, since a clip whose process dies
/// twice is rightly given up.
const CHILD_KILL_GAP: Duration = Duration::from_millis(1500);

/// Faults within one run, after which it is left to finish.
const FAULTS_PER_RUN: u64 = 60;

/// A fleet that answers nothing for so long hangs: a broker that starts again on a busy machine, with the
/// waits of those who look for it, or a store's attempt that meets silence, take a minute or so.
const SILENCE: Duration = Duration::from_secs(180);

/// A run of a few tens of seconds that is not done by then goes round in circles.
const RUN_DEADLINE: Duration = Duration::from_secs(1200);

/// A queue that the broker is killed over within a second of its declaration may be unusable afterwards
/// (the broker's own defect, see the design of the queues).
const YOUNG_QUEUE: Duration = Duration::from_secs(4);

/// For what needs a heartbeat or two, a restart, a retry's wait.
const PATIENCE: Duration = Duration::from_secs(120);

fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

#[test]
fn nothing_is_lost_and_nothing_comes_twice_under_faults() {
    let wanted = setting("PLUMBLINE_CAMPAIGN_FAULTS", 200);
    let seed = setting("PLUMBLINE_CAMPAIGN_SEED", 20_261_125);
    let most_s = 60.0 * setting("PLUMBLINE_CAMPAIGN_MINUTES", 60) as f64;
    let mut campaign = Campaign::begin(seed);
    let mut runs = 0;
    while campaign.journal.faults() < wanted && campaign.journal.elapsed_s() < most_s {
        runs += 1;
        campaign.run(runs, wanted);
        eprintln!(
            "run {runs} is whole and the same: {} faults after {:.0} s",
            campaign.journal.faults(),
            campaign.journal.elapsed_s()
        );
    }
    let faults = campaign.journal.faults();
    campaign.end(runs);
    assert!(
        faults >= wanted,
        "only {faults} of {wanted} faults in {most_s} s, though all went well"
    );
}

struct Campaign {
    runtime: Runtime,
    place: Place,
    marker: String,
    /// What the names of its runs begin with, since other campaigns may have used the same broker.
    name: String,
    /// What the coordinator adds to these names, the same for all runs over the same videos.
    digest: String,
    prefix: String,
    videos: Vec<String>,
    reference: BTreeMap<String, Vec<u8>>,
    reference_code: i32,
    s3_faults: S3Faults,
    ways: Vec<Ways>,
    workers: Vec<Daemon>,
    coordinator_ways: Ways,
    tamperer: Tamperer,
    generator: Pcg64,
    deck: Vec<Fault>,
    broker_restart: Option<JoinHandle<()>>,
    /// Compute processes whose worker was killed under them.
    orphans: Vec<Process>,
    child_killed_at: Instant,
    prefetches: Prefetches,
    progress: Progress,
    journal: Journal,
}

impl Campaign {
    fn begin(seed: u64) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .unwrap();
        let place = Place::new();
        let name = unique();
        let prefix = format!("{name}/{CORPUS}");
        let marker = format!("CAMPAIGN_MARKER={name}");
        let videos = runtime.block_on(put_corpus(&place, &prefix));
        assert!(videos.len() >= 500, "{}", videos.len());
        let embedded = Started::start(&mut embedded_command(&place, &prefix, "reference"));
        let embedded = embedded.wait_within(RUN_DEADLINE);
        let reference_code = embedded.status.code().unwrap();
        assert!([0, 3].contains(&reference_code), "{}", embedded.stderr);
        let reference = place.published("reference");
        reference.expect_rows(&videos);

        let (s3_faults, ways, coordinator_ways, tamperer) = runtime.block_on(async {
            let endpoint = server("PLUMBLINE_TEST_S3_ENDPOINT");
            let s3_faults = S3Faults::before(&endpoint, seed, S3_FAULTS_PER_MILLE).await;
            let mut ways = Vec::new();
            for _ in 0..WORKERS {
                ways.push(Ways::new(&s3_faults).await);
            }
            let coordinator_ways = Ways::new(&s3_faults).await;
            (s3_faults, ways, coordinator_ways, Tamperer::connect().await)
        });
        let workers = ways
            .iter()
            .enumerate()
            .map(|(index, ways)| start_worker(&place, &format!("worker-{index}"), ways, &marker));
        let log = std::env::var_os("PLUMBLINE_CAMPAIGN_LOG").map(PathBuf::from);
        Self {
            workers: workers.collect(),
            reference: reference.stable_files(),
            reference_code,
            journal: Journal::create(log.unwrap_or_else(|| place.path("faults.log"))),
            generator: Pcg64::seed_from_u64(seed),
            deck: Vec::new(),
            broker_restart: None,
            orphans: Vec::new(),
            child_killed_at: Instant::now(),
            prefetches: Prefetches::watch(),
            progress: Progress::new(),
            runtime,
            place,
            marker,
            name,
            digest: String::new(),
            prefix,
            videos,
            s3_faults,
            ways,
            coordinator_ways,
            tamperer,
        }
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.generator.next_u64() % bound
    }

    /// The next fault; all hundred of a deck come before the next deck does.
    fn draw(&mut self) -> Fault {
        if self.deck.is_empty() {
            self.deck = Fault::deck();
        }
        let at = self.below(self.deck.len() as u64) as usize;
        self.deck.swap_remove(at)
    }

    /// One run from its first start to its published bytes.
    fn run(&mut self, number: u64, wanted: u64) {
        let name = format!("{}-{number}", self.name);
        // Results go to a directory and to the store by turns.
        let in_store = number.is_multiple_of(2);
        let out = match in_store {
            true => address(&format!("{}/out-{number}", self.name)),
            false => format!("out-{number}"),
        };
        let started = Instant::now();
        let mut coordinator = self.start_coordinator(&name, &out, number);
        let run = self.run_id(&name, &out, &mut coordinator);
        let faults_before = self.journal.faults();
        let mut next_fault = Instant::now() + Duration::from_millis(self.below(1500));
        let code = loop {
            if let Some(code) = self.keep_running(&mut coordinator) {
                break code;
            }
            self.fail_if_it_hangs(&format!("run {number}"), started, &coordinator);
            let in_run = self.journal.faults() - faults_before;
            if in_run < FAULTS_PER_RUN
                && self.journal.faults() < wanted
                && Instant::now() >= next_fault
            {
                let fault = self.draw();
                match self.inject(fault, &run, &mut coordinator, started) {
                    Ok(detail) => self.journal.fault(&format!("{fault:?}"), &detail),
                    // Not to be done now: later.
                    Err(why) => {
                        self.journal.not_now(&format!("{fault:?}"), why);
                        self.deck.push(fault);
                    }
                }
                let gap_ms = GAP_MS.0 + self.below(GAP_MS.1 - GAP_MS.0);
                next_fault = Instant::now() + Duration::from_millis(gap_ms);
            }
            sleep(Duration::from_millis(10));
        };
        self.wait_for_broker();
        let code = self.retry_dead(&run, &name, code, &out, number);
        assert_eq!(code, self.reference_code, "{}", coordinator.last_words(30));
        self.check_published(in_store, &out, number);
        self.check_left_behind(&run);
        self.journal.note(
            "run",
            &format!(
                "{run} is whole after {:.0} s",
                started.elapsed().as_secs_f64()
            ),
        );
    }

    /// What the coordinator calls the run: its name and a digest of what it measures, which the first run
    /// notes in its directory.
    fn run_id(&mut self, name: &str, out: &str, coordinator: &mut Daemon) -> RunId {
        if self.digest.is_empty() {
            let noted = self.place.path(out).join(".plumbline/run");
            wait_until("the run's name", PATIENCE, || {
                let ended = coordinator.ended();
                assert!(
                    ended.is_none() || noted.exists(),
                    "{ended:?}: {}",
                    coordinator.last_words(30)
                );
                let run = std::fs::read_to_string(&noted).unwrap_or_default();
                let digest = run.trim_end().strip_prefix(&format!("{name}-"));
                digest
                    .map(|digest| self.digest = digest.to_owned())
                    .is_some()
            });
        }
        RunId::new(format!("{name}-{}", self.digest)).unwrap()
    }

    fn start_coordinator(&self, name: &str, out: &str, number: u64) -> Daemon {
        let command = score_command(
            &self.place,
            &self.prefix,
            out,
            name,
            &self.coordinator_ways,
            &self.marker,
        );
        Daemon::start(command, &log(&self.place, &format!("coordinator-{number}")))
    }

    /// Starts again what has ended; gives the coordinator's exit code once it has finished.
    fn keep_running(&mut self, coordinator: &mut Daemon) -> Option<i32> {
        for worker in &mut self.workers {
            if let Some(status) = worker.ended() {
                // Giving up after its last attempt is a worker's right; nothing else ends it.
                assert_eq!(
                    status.code(),
                    Some(1),
                    "{status}\n{}",
                    worker.last_words(30)
                );
                self.journal.note("a worker gave up", &status.to_string());
                worker.restart();
            }
        }
        let status = coordinator.ended()?;
        match status.code() {
            Some(code @ (0 | 3)) => Some(code),
            // Stopped before the end, or refused while the broker still holds the lease of a dead one.
            Some(1 | 2) => {
                let words = coordinator.last_words(30);
                let last = words.lines().last().unwrap_or_default();
                self.journal.note("the coordinator stopped", last);
                sleep(Duration::from_millis(500));
                coordinator.restart();
                None
            }
            _ => panic!("{status}\n{}", coordinator.last_words(30)),
        }
    }

    /// Does it; what was hit, or why it cannot be done now.
    fn inject(
        &mut self,
        fault: Fault,
        run: &RunId,
        coordinator: &mut Daemon,
        started: Instant,
    ) -> Result<String, &'static str> {
        const NO_MESSAGE: &str = "no message to tamper with";
        const NO_CONNECTION: &str = "no connection is open";
        if fault.needs_broker() && self.broker_is_away() {
            return Err("the broker is away");
        }
        let victim = self.below(WORKERS as u64) as usize;
        // Ways of all workers, and the coordinator's.
        let way = self.below(WORKERS as u64 + 1) as usize;
        match fault {
            Fault::KillWorker => {
                let worker = &mut self.workers[victim];
                let children = worker.children();
                let detail = format!("worker-{victim} with {} children", children.len());
                worker.kill();
                self.orphans.extend(children);
                worker.restart();
                Ok(detail)
            }
            Fault::KillChild => {
                if self.child_killed_at.elapsed() < CHILD_KILL_GAP {
                    return Err("another was killed a moment ago");
                }
                let children = self.workers[victim].children();
                let child = children.first().ok_or("the worker has none")?;
                child.kill();
                self.child_killed_at = Instant::now();
                Ok(format!("of worker-{victim}, process {}", child.pid))
            }
            Fault::KillCoordinator => {
                coordinator.kill();
                coordinator.restart();
                Ok(run.to_string())
            }
            Fault::KillBroker => {
                if started.elapsed() < YOUNG_QUEUE {
                    return Err("the results queue is too young");
                }
                let away = Duration::from_millis(self.below(1500));
                Server::Broker.kill();
                self.broker_restart = Some(std::thread::spawn(move || {
                    sleep(away);
                    Server::Broker.start();
                }));
                Ok("started again at once".to_owned())
            }
            Fault::KillStore => {
                Server::Store.kill();
                sleep(Duration::from_millis(self.below(1500)));
                Server::Store.start();
                Ok("started again".to_owned())
            }
            Fault::CloseAmqp => self.break_amqp(way, Break::Close).ok_or(NO_CONNECTION),
            Fault::ResetAmqp => self.break_amqp(way, Break::Reset).ok_or(NO_CONNECTION),
            Fault::HalfOpenAmqp => self.break_amqp(way, Break::HalfOpen).ok_or(NO_CONNECTION),
            Fault::DelayAmqp => {
                let wait = Duration::from_millis(20 + self.below(200));
                Ok(self.slow_down(way, Pace::Delayed(wait), |ways| &ways.amqp))
            }
            Fault::ThrottleAmqp => {
                Ok(self.slow_down(way, Pace::Throttled(20_000), |ways| &ways.amqp))
            }
            Fault::CloseS3 => self.break_s3(way, Break::Close).ok_or(NO_CONNECTION),
            Fault::ResetS3 => self.break_s3(way, Break::Reset).ok_or(NO_CONNECTION),
            Fault::HalfOpenS3 => self.break_s3(way, Break::HalfOpen).ok_or(NO_CONNECTION),
            Fault::DelayS3 => {
                let wait = Duration::from_millis(20 + self.below(200));
                Ok(self.slow_down(way, Pace::Delayed(wait), |ways| &ways.s3))
            }
            Fault::DuplicateJob => {
                let duplicated = self.runtime.block_on(self.tamperer.duplicate(&JOBS));
                duplicated.ok_or(NO_MESSAGE)
            }
            Fault::DropJob => {
                let dropped = self.runtime.block_on(self.tamperer.drop_job());
                dropped.ok_or(NO_MESSAGE)
            }
            Fault::DuplicateResult => {
                let results = Queue::Results(run.clone());
                let duplicated = self.runtime.block_on(self.tamperer.duplicate(&results));
                duplicated.ok_or(NO_MESSAGE)
            }
            Fault::Poison(poison) => {
                let poisoned = self.runtime.block_on(self.tamperer.poison(run, poison));
                poisoned.ok_or("nothing to make it of, or the run is over")
            }
        }
    }

    fn ways(&self, way: usize) -> (String, &Ways) {
        match self.ways.get(way) {
            Some(ways) => (format!("worker-{way}"), ways),
            None => ("coordinator".to_owned(), &self.coordinator_ways),
        }
    }

    fn break_amqp(&self, way: usize, how: Break) -> Option<String> {
        let (whose, ways) = self.ways(way);
        let broken = ways.amqp.break_all(how);
        (broken > 0).then(|| format!("{broken} connections of {whose}"))
    }

    /// Of the store's, which are short: one must be open, or comes soon.
    fn break_s3(&self, way: usize, how: Break) -> Option<String> {
        let (whose, ways) = self.ways(way);
        let tried = Instant::now();
        while tried.elapsed() < Duration::from_millis(500) {
            let broken = ways.s3.break_all(how);
            if broken > 0 {
                return Some(format!("{broken} connections of {whose}"));
            }
            sleep(Duration::from_millis(2));
        }
        None
    }

    fn slow_down(
        &mut self,
        way: usize,
        pace: Pace,
        which: impl Fn(&Ways) -> &plumbline_tests::proxy::Proxy,
    ) -> String {
        let lasts = Duration::from_millis(300 + self.below(1200));
        let (whose, ways) = self.ways(way);
        which(ways).set_pace(pace);
        sleep(lasts);
        which(ways).set_pace(Pace::Free);
        format!("{pace:?} for {lasts:?}, {whose}")
    }

    fn broker_is_away(&mut self) -> bool {
        match self.broker_restart.take_if(|restart| restart.is_finished()) {
            Some(done) => done.join().unwrap(),
            None => return self.broker_restart.is_some(),
        }
        false
    }

    fn wait_for_broker(&mut self) {
        if let Some(restart) = self.broker_restart.take() {
            restart.join().unwrap();
        }
    }

    /// Jobs that were given up since faults hit them too often are rightly dead; they are put back and
    /// collected as a user would, and that is told.
    fn retry_dead(&mut self, run: &RunId, name: &str, code: i32, out: &str, number: u64) -> i32 {
        let dead = self
            .runtime
            .block_on(check::given_up(self.tamperer.broker(), run));
        if dead.is_empty() {
            return code;
        }
        for (id, reason) in &dead {
            self.journal.note("given up", &format!("{id}: {reason}"));
        }
        let mut retry = self.place.command(plumbline_tests::binary::plumbline());
        let url = server("PLUMBLINE_TEST_AMQP_URL");
        retry.args(["fleet", "retry", "--queue", &url, run.as_str()]);
        Started::start(&mut retry).wait().expect_code(0);
        let mut coordinator = self.start_coordinator(name, out, number);
        let again = Instant::now();
        loop {
            if let Some(code) = self.keep_running(&mut coordinator) {
                return code;
            }
            self.fail_if_it_hangs("a retry", again, &coordinator);
            sleep(Duration::from_millis(20));
        }
    }

    fn check_published(&mut self, in_store: bool, out: &str, number: u64) {
        let directory = format!("out-{number}");
        if in_store {
            let prefix = out.strip_prefix(&address("")).unwrap();
            self.runtime
                .block_on(check::download(prefix, &self.place.path(&directory)));
        }
        let published = self.place.published(&directory);
        published.expect_rows(&self.videos);
        check::same_bytes(&published.stable_files(), &self.reference, out);
    }

    /// Nothing of the run is anywhere but in its results.
    fn check_left_behind(&mut self, run: &RunId) {
        check::wait_until_idle(run, PATIENCE);
        let orphans = std::mem::take(&mut self.orphans);
        wait_until("orphaned compute processes end", PATIENCE, || {
            orphans.iter().all(|orphan| !orphan.is_alive())
        });
    }

    /// Fails where nobody answers any more, or without end, and says in what state everything is: the
    /// first lines of that are all that some logs keep.
    fn fail_if_it_hangs(&mut self, what: &str, started: Instant, coordinator: &Daemon) {
        let logs = (0..WORKERS).map(|index| log(&self.place, &format!("worker-{index}")));
        let quiet = self.progress.quiet(logs, started);
        if quiet < SILENCE && started.elapsed() < RUN_DEADLINE {
            return;
        }
        let workers: Vec<String> = self.workers.iter().map(|w| w.last_words(5)).collect();
        panic!(
            "{what} hangs: no answer for {:.0} s, begun {:.0} s ago\n{}\n{}{}\n{}",
            quiet.as_secs_f64(),
            started.elapsed().as_secs_f64(),
            coordinator.last_words(8),
            hang::broker_state(),
            workers.join("\n"),
            self.journal.summary(),
        );
    }

    fn end(mut self, runs: u64) {
        for worker in &mut self.workers {
            let status = worker.terminate(PATIENCE);
            let code = status.and_then(|status| status.code());
            assert_eq!(code, Some(0), "drained\n{}", worker.last_words(30));
        }
        let marker = &self.marker;
        wait_until("no process is left", PATIENCE, || {
            plumbline_tests::process::marked(marker).is_empty()
        });
        let dead = self
            .runtime
            .block_on(check::drain_dead(self.tamperer.broker(), &self.name));
        for id in &self.tamperer.deadly {
            assert!(dead.contains_key(id), "{id} is no dead letter");
        }
        let in_time = &self.tamperer.deadly_in_time;
        for (id, reason) in &dead {
            let is_poison = self.tamperer.deadly.contains(id) || in_time.contains(id);
            assert!(is_poison, "unexpected dead letter {id}: {reason}");
        }
        assert!(in_time.len() < 4 || in_time.iter().any(|id| dead.contains_key(id)));
        let seen = self.prefetches.stop();
        let s3: u64 = self
            .s3_faults
            .injected()
            .iter()
            .map(|(_, count)| count)
            .sum();
        eprintln!(
            "{}S3 requests that met a fault, beside these: {s3} ({:?})\n{runs} runs of {} videos: 0 lost, 0 twice, the bytes of an undisturbed run; {} dead letters, all poison\n{seen}",
            self.journal.summary(),
            self.s3_faults.injected(),
            self.videos.len(),
            dead.len(),
        );
    }
}
