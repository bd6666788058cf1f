//! The corpus, the programs, and what stands between them and their servers.

use std::path::{Path, PathBuf};
use std::process::Command;

use bytes::Bytes;
use plumbline_common::store::{ObjectKey, ObjectStore, S3Options, S3Store};
use plumbline_tests::binary::{plumbline, worker};
use plumbline_tests::clips;
use plumbline_tests::fleet::Daemon;
use plumbline_tests::proxy::Proxy;
use plumbline_tests::run::Place;
use plumbline_tests::s3_faults::S3Faults;
use plumbline_tests::servers::server;

/// Slots of every worker.
pub(crate) const SLOTS: u16 = 2;

/// Scenes that are rendered, and objects made of each.
const SCENES: u64 = 40;
const COPIES: u64 = 13;

/// Of each clip: few, since it is not the measuring that is tried here.
const FRAMES: usize = 5;

/// Jobs that wait at once: few, so that what is sent among them is met in the middle of a run.
const WINDOW: &str = "60";

/// A connection that says nothing for about twice as long is given up: short, so that half-open ones cost
/// seconds here.
const HEARTBEAT_S: u32 = 3;

/// Where the corpus lies, and objects that only poison names.
pub(crate) const CORPUS: &str = "corpus";
pub(crate) const POISON: &str = "poison";

/// The store itself, past everything that misbehaves.
pub(crate) async fn store(prefix: &str) -> S3Store {
    let options = S3Options {
        endpoint: Some(server("PLUMBLINE_TEST_S3_ENDPOINT")),
        ..S3Options::default()
    };
    let bucket = server("PLUMBLINE_TEST_S3_BUCKET");
    S3Store::connect(&bucket, prefix, &options).await.unwrap()
}

pub(crate) async fn put(store: &S3Store, key: &str, content: impl Into<Bytes>) {
    let key = ObjectKey::new(key).unwrap();
    store.put(&key, content.into()).await.unwrap();
}

/// Puts the corpus below `prefix`: many small objects of distinct bytes, a few of them bad.
/// Gives their names.
pub(crate) async fn put_corpus(place: &Place, prefix: &str) -> Vec<String> {
    let store = store(prefix).await;
    let mut videos = Vec::new();
    for scene in 0..SCENES {
        let clip = place.path("clip.mp4");
        clips::write_short(&clip, scene, FRAMES);
        let clip = std::fs::read(clip).unwrap();
        for copy in 0..COPIES {
            let name = format!("scene-{scene:02}/{copy:02}.mp4");
            let mut content = clip.clone();
            // A box that players skip (ISO/IEC 14496-12, 8.1.2), so that no two objects are the same.
            content.extend(16_u32.to_be_bytes());
            content.extend(b"free");
            content.extend((scene * COPIES + copy).to_be_bytes());
            put(&store, &name, content).await;
            videos.push(name);
        }
    }
    let short = place.path("short.mp4");
    clips::write_short(&short, 0, 3);
    let bad = [
        ("bad/bomb.gif", clips::huge_gif(8192)),
        ("bad/text.mp4", b"just some text\n".to_vec()),
        ("bad/short.mp4", std::fs::read(short).unwrap()),
        ("bad/empty.mp4", Vec::new()),
    ];
    for (name, content) in bad {
        put(&store, name, content).await;
        videos.push(name.to_owned());
    }
    videos
}

/// One program's ways to its servers.
#[derive(Debug)]
pub(crate) struct Ways {
    pub(crate) amqp: Proxy,
    pub(crate) s3: Proxy,
}

impl Ways {
    pub(crate) async fn new(s3_faults: &S3Faults) -> Self {
        let url = server("PLUMBLINE_TEST_AMQP_URL");
        let endpoint = s3_faults.endpoint();
        Self {
            amqp: Proxy::before(authority(&url)).await,
            s3: Proxy::before(authority(&endpoint)).await,
        }
    }

    /// The broker's address through here.
    pub(crate) fn amqp_url(&self) -> String {
        let url = server("PLUMBLINE_TEST_AMQP_URL");
        let through = url.replace(authority(&url), &self.amqp.address());
        format!("{through}?heartbeat={HEARTBEAT_S}")
    }
}

/// `host:port` of a URL.
fn authority(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    let rest = rest.rsplit_once('@').map_or(rest, |(_, rest)| rest);
    rest.split('/').next().unwrap_or(rest)
}

/// A command that finds the store at `endpoint` and can be recognised, with its children, by `marker`.
fn command(place: &Place, program: &Path, endpoint: &str, marker: &str) -> Command {
    let mut command = place.command(program);
    let (name, value) = marker.split_once('=').unwrap();
    command.env("AWS_ENDPOINT_URL", endpoint).env(name, value);
    command
}

/// A worker's command; its scratch directory and log are below the place.
pub(crate) fn worker_command(
    place: &Place,
    name: &str,
    ways: &Ways,
    marker: &str,
    more: &[&str],
) -> Command {
    let scratch = place.path(&format!("scratch-{name}"));
    std::fs::create_dir_all(&scratch).unwrap();
    let endpoint = format!("http://{}", ways.s3.address());
    let mut command = command(place, worker(), &endpoint, marker);
    command
        .args(["--queue", &ways.amqp_url(), "--name", name])
        .args(["--slots", &SLOTS.to_string(), "--grace", "20"])
        .args(["--listen", "127.0.0.1:0", "--scratch"])
        .arg(scratch)
        .args(more);
    command
}

pub(crate) fn start_worker(place: &Place, name: &str, ways: &Ways, marker: &str) -> Daemon {
    let command = worker_command(place, name, ways, marker, &[]);
    Daemon::start(command, &log(place, name))
}

pub(crate) fn log(place: &Place, name: &str) -> PathBuf {
    place.path(&format!("{name}.log"))
}

/// `plumbline score` of the corpus on the fleet.
pub(crate) fn score_command(
    place: &Place,
    prefix: &str,
    out: &str,
    run: &str,
    ways: &Ways,
    marker: &str,
) -> Command {
    let endpoint = format!("http://{}", ways.s3.address());
    let mut command = command(place, plumbline(), &endpoint, marker);
    command
        .args(["score", &format!("{}/", address(prefix)), "--out", out])
        .args(["--profile", "draft", "--run", run])
        .args(["--window", WINDOW])
        .args(["--queue", &ways.amqp_url()]);
    command
}

/// The same without a fleet and without faults.
pub(crate) fn embedded_command(place: &Place, prefix: &str, out: &str) -> Command {
    let endpoint = server("PLUMBLINE_TEST_S3_ENDPOINT");
    let mut command = command(place, plumbline(), &endpoint, "PLUMBLINE_EMBEDDED=1");
    command.args([
        "score",
        &format!("{}/", address(prefix)),
        "--out",
        out,
        "--profile",
        "draft",
    ]);
    command
}

/// `s3://…` of a place in the test bucket.
pub(crate) fn address(prefix: &str) -> String {
    format!("s3://{}/{prefix}", server("PLUMBLINE_TEST_S3_BUCKET"))
}
