//! The built worker against a real broker and a real object store; run by deploy/test.sh fleet.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::expect_used,
    reason = "what does not work fails the test"
)]

#[cfg(test)]
mod support;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use plumbline_common::id::VideoId;
use plumbline_common::message::{Job, Location, ObjectLocation};
use plumbline_common::queue::{AmqpBroker, AmqpOptions, Broker, Queue};
use plumbline_common::store::{ObjectKey, ObjectMeta, ObjectStore, S3Options, S3Store};
use plumbline_common::trace::TraceContext;
use plumbline_worker::fetch::Fetcher;
use plumbline_worker::fleet::JOBS;
use support::gate::Gate;
use support::{DEADLINE, PROGRAM, Run, clip, file_job, profile, slot};
use tempfile::TempDir;

/// What the environment says of a server. There is no skipping: a test that did not run is no proof.
fn server(variable: &str) -> String {
    std::env::var(variable).unwrap_or_else(|_| {
        panic!("{variable} is not set: this test needs real servers; run deploy/test.sh fleet, or deploy/servers.sh COMMAND")
    })
}

/// A name that no other test and no earlier run has.
fn unique(test: &str) -> String {
    let since_epoch = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap();
    format!("{test}-{}-{}", std::process::id(), since_epoch.as_nanos())
}

struct Place {
    dir: TempDir,
    namespace: String,
    run: Run,
}

impl Place {
    async fn new(test: &str) -> Self {
        let namespace = unique(test);
        let options = AmqpOptions {
            namespace: namespace.clone(),
            ..AmqpOptions::default()
        };
        let broker = AmqpBroker::connect(&server("PLUMBLINE_TEST_AMQP_URL"), options).await;
        let broker: Arc<dyn Broker> = Arc::new(broker.unwrap());
        Self {
            dir: tempfile::tempdir().unwrap(),
            namespace,
            run: Run::new(broker).await,
        }
    }

    fn worker(&self, words: &[&str]) -> WorkerProcess {
        WorkerProcess::start(self, &server("PLUMBLINE_TEST_AMQP_URL"), words, &[])
    }

    /// A job that a no-op worker takes; nothing is there.
    fn any_job(&self, name: &str) -> Job {
        Job {
            video: VideoId::new(name).unwrap(),
            location: Location::Object(ObjectLocation {
                bucket: "b".to_owned(),
                key: name.to_owned(),
                etag: None,
                modified_s: None,
            }),
            bytes: 1,
            modified_ns: 0,
            profile: profile().canonical().unwrap(),
        }
    }
}

/// A running `plumbline-worker`, killed with the test.
struct WorkerProcess {
    child: Child,
    listen: SocketAddr,
    log: mpsc::Receiver<String>,
}

impl WorkerProcess {
    fn start(place: &Place, url: &str, words: &[&str], environment: &[(&str, &str)]) -> Self {
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let listen = free.local_addr().unwrap();
        drop(free);
        let mut child = Command::new(PROGRAM)
            .args(["--log-format", "json", "--name", "tester"])
            .args(["--listen", &listen.to_string()])
            .arg("--scratch")
            .arg(place.dir.path().join("scratch"))
            .args(words)
            .current_dir(place.dir.path())
            .env("PLUMBLINE_QUEUE__URL", url)
            .env("PLUMBLINE_QUEUE__NAMESPACE", &place.namespace)
            .env(
                "PLUMBLINE_STORE__ENDPOINT",
                server("PLUMBLINE_TEST_S3_ENDPOINT"),
            )
            .envs(environment.iter().copied())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (lines, log) = mpsc::channel();
        let stderr = child.stderr.take().unwrap();
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                println!("{line}");
                let _test_is_over = lines.send(line);
            }
        });
        Self { child, listen, log }
    }

    /// Status and body; `None` while nobody listens.
    fn get(&self, path: &str) -> Option<(u16, String)> {
        let mut stream = TcpStream::connect(self.listen).ok()?;
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let status = answer.split(' ').nth(1)?.parse().ok()?;
        let (_head, body) = answer.split_once("\r\n\r\n")?;
        Some((status, body.to_owned()))
    }

    fn wait_for(&self, path: &str, status: u16) {
        self.wait(|| self.get(path).is_some_and(|answer| answer.0 == status));
    }

    fn wait_for_metric(&self, line: &str) {
        self.wait(|| {
            self.get("/metrics")
                .is_some_and(|(_, metrics)| metrics.contains(line))
        });
    }

    #[track_caller]
    fn wait(&self, mut condition: impl FnMut() -> bool) {
        let started = Instant::now();
        while !condition() {
            assert!(started.elapsed() < DEADLINE, "it never comes about");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(self.child.id() as i32).unwrap();
        rustix::process::kill_process(pid, signal).unwrap();
    }

    /// Told to stop, its exit code.
    fn terminated(mut self) -> Option<i32> {
        self.signal(rustix::process::Signal::TERM);
        self.wait_for_end()
    }

    fn wait_for_end(&mut self) -> Option<i32> {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(started.elapsed() < DEADLINE, "it does not end");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The log so far, line by line.
    fn logged(&self) -> Vec<serde_json::Value> {
        let lines = self.log.try_iter();
        lines
            .map(|line| serde_json::from_str(&line).expect("a line of JSON"))
            .collect()
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        let _gone = self.child.kill();
        let _gone = self.child.wait();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn objects_of_a_bucket_become_the_rows_of_files() {
    let place = Place::new("objects").await;
    let s3 = S3Options {
        endpoint: Some(server("PLUMBLINE_TEST_S3_ENDPOINT")),
        ..S3Options::default()
    };
    let bucket = server("PLUMBLINE_TEST_S3_BUCKET");
    let store = S3Store::connect(&bucket, "", &s3).await.unwrap();
    let path = place.dir.path().join("a.mp4");
    clip(&path);
    let key = ObjectKey::new(format!("{}/a.mp4", place.namespace)).unwrap();
    store.put_file(&key, &path).await.unwrap();
    let ObjectMeta {
        etag, modified_s, ..
    } = store.head(&key).await.unwrap();
    let file = file_job("a", &path);
    let object = Job {
        location: Location::Object(ObjectLocation {
            bucket,
            key: key.to_string(),
            etag,
            modified_s,
        }),
        ..file.clone()
    };
    let fetcher = Fetcher::new(s3, place.dir.path().join("embedded-scratch"));
    let mut slot = slot(&fetcher);
    let of_file = slot.measure(&file).await.unwrap().outcome;
    let embedded = slot.measure(&object).await.unwrap().outcome;
    assert_eq!(embedded.measurement, of_file.measurement);

    let worker = place.worker(&["--slots", "1"]);
    worker.wait_for("/readyz", 200);
    assert_eq!(worker.get("/healthz").unwrap().0, 200);
    assert_eq!(worker.get("/elsewhere").unwrap().0, 404);
    let trace = TraceContext::root();
    let mut message = place.run.message(object.clone());
    message.traceparent = Some(trace.to_string());
    place.run.broker.publish(&JOBS, message).await.unwrap();
    let (result, answer) = place.run.answer().await;
    assert_eq!(result.outcome.measurement, of_file.measurement);
    assert_eq!(result.outcome.thumbnails, of_file.thumbnails);
    let passed_on = TraceContext::parse(&answer.traceparent.unwrap()).unwrap();
    assert_eq!(passed_on.trace_id(), trace.trace_id());
    worker.wait_for_metric("plumbline_worker_jobs_total{outcome=\"scored\"} 1");
    let metrics = worker.get("/metrics").unwrap().1;
    assert!(metrics.contains("plumbline_worker_slots 1"), "{metrics}");
    assert!(metrics.ends_with("# EOF\n"), "{metrics}");
    let answered = worker
        .logged()
        .into_iter()
        .find(|line| line["message"] == "answered")
        .expect("a line about the job");
    assert_eq!(answered["span"]["trace_id"], trace.trace_id());
    assert_eq!(answered["span"]["span_id"], passed_on.span_id());
    assert_eq!(answered["span"]["parent_span_id"], trace.span_id());

    // Another version now: not scored silently.
    fs::write(&path, [1; 10]).unwrap();
    store.put_file(&key, &path).await.unwrap();
    place.run.ask(object).await;
    let (status, reason) = place.run.row().await;
    assert_eq!(status, "failed");
    let address = format!("s3://{}/{key}: changed", server("PLUMBLINE_TEST_S3_BUCKET"));
    assert!(reason.starts_with(&address), "{reason}");
    assert_eq!(worker.terminated(), Some(0));
    assert_eq!(place.run.waiting(&Queue::Dead).await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_workers_job_goes_to_another_and_a_drained_one_gives_its_job_back() {
    let place = Place::new("killed").await;
    let stuck = ["--no-op", "--no-op-ms", "3600000", "--slots", "1"];
    let killed = place.worker(&stuck);
    place.run.ask(place.any_job("a")).await;
    killed.wait_for_metric("plumbline_worker_jobs_in_work 1");
    drop(killed);

    let drained = place.worker(&[&stuck[..], &["--grace", "0"]].concat());
    drained.wait_for_metric("plumbline_worker_jobs_in_work 1");
    assert_eq!(drained.terminated(), Some(0));

    let finishing = place.worker(&["--no-op", "--no-op-ms", "100"]);
    let (result, _) = place.run.answer().await;
    assert_eq!(result.outcome.measurement.status.as_str(), "static");
    assert_eq!(result.attempts, 2, "the retry of the drained worker");
    assert_eq!(finishing.terminated(), Some(0));
    for queue in [JOBS, Queue::Dead, Queue::Results(place.run.id.clone())] {
        assert_eq!(place.run.waiting(&queue).await, 0, "{queue}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_signals_end_a_worker_at_once_and_a_drain_is_seen() {
    let place = Place::new("signals").await;
    let mut worker = place.worker(&["--no-op", "--no-op-ms", "3600000"]);
    place.run.ask(place.any_job("a")).await;
    worker.wait_for_metric("plumbline_worker_jobs_in_work 1");
    worker.wait_for("/readyz", 200);
    worker.signal(rustix::process::Signal::INT);
    worker.wait_for("/readyz", 503);
    assert_eq!(worker.get("/healthz").unwrap().0, 200);
    worker.signal(rustix::process::Signal::TERM);
    assert_eq!(worker.wait_for_end(), Some(130));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_connection_is_seen_and_mended_and_costs_no_second_answer() {
    let place = Place::new("lost").await;
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let host = host_of(&url);
    let gate = Gate::before(host).await;
    let url = url.replace(host, &gate.address());
    let words = ["--no-op", "--no-op-ms", "2000", "--slots", "1"];
    let worker = WorkerProcess::start(&place, &url, &words, &[]);
    worker.wait_for("/readyz", 200);
    place.run.ask(place.any_job("a")).await;
    worker.wait_for_metric("plumbline_worker_jobs_in_work 1");
    gate.shut();
    worker.wait_for("/readyz", 503);
    // The job is finished while there is nobody to tell.
    tokio::time::sleep(Duration::from_secs(2)).await;
    gate.open();
    worker.wait_for("/readyz", 200);
    let (result, _) = place.run.answer().await;
    assert_eq!(result.attempts, 1);
    worker.wait_for_metric("plumbline_worker_jobs_total{outcome=\"repeated\"} 1");
    place.run.ask(place.any_job("b")).await;
    assert_eq!(place.run.answer().await.0.outcome.video.as_str(), "b");
    assert_eq!(worker.terminated(), Some(0));
    for queue in [JOBS, Queue::Dead, Queue::Results(place.run.id.clone())] {
        assert_eq!(place.run.waiting(&queue).await, 0, "{queue}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_queue_of_jobs_is_made_again() {
    let place = Place::new("deleted").await;
    let worker = place.worker(&["--no-op"]);
    worker.wait_for("/readyz", 200);
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let connection = lapin::Connection::connect(&url, lapin::ConnectionProperties::default());
    let channel = connection.await.unwrap().create_channel().await.unwrap();
    let queue = format!("{}.{JOBS}", place.namespace);
    let options = lapin::options::QueueDeleteOptions::default();
    channel.queue_delete(queue.into(), options).await.unwrap();
    worker.wait(|| {
        let lines = worker.logged();
        lines
            .iter()
            .any(|line| line.to_string().contains("made again"))
    });
    worker.wait_for("/readyz", 200);
    place.run.ask(place.any_job("a")).await;
    assert_eq!(place.run.row().await.0, "static");
    assert_eq!(worker.terminated(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn tls_is_spoken_with_whom_the_machine_trusts_and_with_nobody_else() {
    let place = Place::new("tls").await;
    let url = server("PLUMBLINE_TEST_AMQP_URL");
    let (tls, authority_pem) = Gate::before(host_of(&url)).await.with_tls();
    let authority = place.dir.path().join("authority.pem");
    fs::write(&authority, authority_pem).unwrap();
    let url = url.replace("amqp://", "amqps://").replace(
        host_of(&url),
        &tls.address().replace("127.0.0.1", "localhost"),
    );

    let stranger = WorkerProcess::start(&place, &url, &["--no-op"], &[]);
    let refused = || {
        let lines = stranger.logged();
        lines
            .iter()
            .any(|line| line.to_string().contains("certificate"))
    };
    stranger.wait(refused);
    assert_eq!(stranger.get("/readyz").unwrap().0, 503);
    drop(stranger);

    let trusting = [("SSL_CERT_FILE", authority.to_str().unwrap())];
    let worker = WorkerProcess::start(&place, &url, &["--no-op"], &trusting);
    worker.wait_for("/readyz", 200);
    place.run.ask(place.any_job("a")).await;
    assert_eq!(place.run.row().await.0, "static");
    assert_eq!(worker.terminated(), Some(0));
}

#[test]
fn what_is_wrong_is_told_in_one_line_with_its_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let told = |words: &[&str]| {
        let output = Command::new(PROGRAM)
            .args(words)
            .current_dir(dir.path())
            .env_remove("PLUMBLINE_QUEUE__URL")
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), said)
    };
    let queue = "--queue=amqp://guest:geheim@127.0.0.1:1";
    for (words, code, word) in [
        (&["--log", "error"][..], 2, "PLUMBLINE_QUEUE__URL"),
        (&[queue, "--files", "nowhere"], 2, "no such directory"),
        (&[queue, "--deadline", "0"], 2, "above 0"),
        (&["--queue", "http://x"], 1, "write amqp://"),
        (&[queue, "--slots", "0"], 2, "--slots"),
    ] {
        let (found, said) = told(words);
        assert_eq!(found, Some(code), "{said}");
        assert!(said.contains(word), "{words:?}: {said}");
        assert!(!said.contains("geheim"), "{said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_beyond_the_brokers_patience_is_warned_of() {
    let place = Place::new("patience").await;
    for (deadline_s, warned) in [("599", false), ("601", true)] {
        let worker = place.worker(&["--deadline", deadline_s]);
        worker.wait_for("/readyz", 200);
        let lines = worker.logged();
        let told = lines
            .iter()
            .any(|line| line.to_string().contains("consumer_timeout"));
        assert_eq!(told, warned, "{lines:?}");
        assert_eq!(worker.terminated(), Some(0));
    }
}

/// Host and port of `amqp://user:password@HOST:PORT/vhost`.
fn host_of(url: &str) -> &str {
    let (_, rest) = url.rsplit_once('@').unwrap();
    rest.split('/').next().unwrap()
}
