//! A fleet of its own for each test: a namespace of the broker, a prefix of the bucket, a directory.

use std::path::Path;
use std::process::Command;

use bytes::Bytes;
use plumbline_common::store::{ObjectKey, ObjectStore, S3Options, S3Store};
use plumbline_tests::binary::{plumbline, worker};
use plumbline_tests::clips;
use plumbline_tests::fleet::Daemon;
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_tests::servers::server;

pub(crate) struct Fleet {
    pub(crate) place: Place,
    name: String,
}

impl Fleet {
    pub(crate) fn new(test: &str) -> Self {
        let since_epoch = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap();
        Self {
            place: Place::new(),
            name: format!("{test}-{}", since_epoch.as_nanos()),
        }
    }

    /// The same with `count` clips in `videos` and in the bucket, in two groups, and two that have no score.
    pub(crate) async fn with_clips(test: &str, count: u64) -> Self {
        let fleet = Self::new(test);
        for seed in 0..count {
            let group = ["pick", "place"][(seed % 2) as usize];
            let clip = fleet.place.video(format!("{group}/clip-{seed:02}.mp4"));
            clips::write_moving(&clip, seed);
        }
        clips::write_short(&fleet.place.video("pick/short.mp4"), 0, 3);
        std::fs::write(fleet.place.video("place/text.mp4"), b"just some text\n").unwrap();
        std::fs::write(fleet.place.video("notes.txt"), b"not a video\n").unwrap();
        fleet.upload().await;
        fleet
    }

    /// Puts `videos` into the bucket.
    pub(crate) async fn upload(&self) {
        let store = self.store("videos").await;
        let root = self.place.path("videos");
        let mut directories = vec![root.clone()];
        while let Some(directory) = directories.pop() {
            for entry in std::fs::read_dir(directory).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    directories.push(path);
                    continue;
                }
                let key = path.strip_prefix(&root).unwrap().to_str().unwrap();
                let key = ObjectKey::new(key).unwrap();
                let content = Bytes::from(std::fs::read(&path).unwrap());
                store.put(&key, content).await.unwrap();
            }
        }
    }

    /// What lies below a prefix of this test.
    pub(crate) async fn store(&self, below: &str) -> S3Store {
        let options = S3Options {
            endpoint: Some(server("PLUMBLINE_TEST_S3_ENDPOINT")),
            ..S3Options::default()
        };
        let prefix = format!("{}/{below}", self.name);
        S3Store::connect(&server("PLUMBLINE_TEST_S3_BUCKET"), &prefix, &options)
            .await
            .unwrap()
    }

    /// Its address.
    pub(crate) fn address(&self, below: &str) -> String {
        let bucket = server("PLUMBLINE_TEST_S3_BUCKET");
        format!("s3://{bucket}/{}/{below}", self.name)
    }

    /// A command in this fleet's environment, as a user would set it.
    pub(crate) fn command(&self, program: &Path) -> Command {
        let mut command = self.place.command(program);
        command
            .env("AWS_ENDPOINT_URL", server("PLUMBLINE_TEST_S3_ENDPOINT"))
            .env("PLUMBLINE_QUEUE__URL", server("PLUMBLINE_TEST_AMQP_URL"))
            .env("PLUMBLINE_QUEUE__NAMESPACE", &self.name);
        command
    }

    /// `plumbline` with words after it.
    pub(crate) fn plumbline(&self, words: &[&str]) -> Command {
        let mut command = self.command(plumbline());
        command.args(words);
        command
    }

    /// The same, to its end.
    pub(crate) fn run(&self, words: &[&str]) -> Ended {
        Started::start(&mut self.plumbline(words)).wait()
    }

    /// `plumbline score` of the bucket's clips at `draft`.
    pub(crate) fn score(&self, out: &str, words: &[&str]) -> Command {
        let source = self.address("videos");
        let mut command = self.plumbline(&["score", &source, "--out", out]);
        command.args(["--profile", "draft", "--group-by", "path:1"]);
        command.args(words);
        command
    }

    /// A worker with one slot.
    pub(crate) fn worker(&self, name: &str, words: &[&str]) -> Daemon {
        self.worker_of(self.command(worker()), name, words)
    }

    /// The same of a command that has more set.
    pub(crate) fn worker_of(&self, mut command: Command, name: &str, words: &[&str]) -> Daemon {
        let scratch = self.place.path(&format!("scratch-{name}"));
        command.args(["--name", name, "--slots", "1", "--grace", "5"]);
        command.arg("--scratch").arg(scratch).args(words);
        Daemon::start(command, &self.place.path(&format!("{name}.log")))
    }
}
