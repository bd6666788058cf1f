//! Runs of the command in a directory of their own, with a deadline: a hang is a failed test.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Seek};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use tempfile::TempDir;

use crate::binary::plumbline;
use crate::published::Published;
use crate::{clips, process};

/// No run of these suites takes a tenth of this on an idle machine.
pub const DEADLINE: Duration = Duration::from_secs(120);

/// A directory for one test: sources in `videos`, results in `out` unless a test says otherwise.
#[derive(Debug)]
pub struct Place {
    directory: TempDir,
}

impl Default for Place {
    fn default() -> Self {
        Self::new()
    }
}

impl Place {
    /// An empty place.
    pub fn new() -> Self {
        let directory = TempDir::with_prefix("plumbline-tests-").expect("a temporary directory");
        std::fs::create_dir(directory.path().join("videos")).expect("videos");
        Self { directory }
    }

    /// A place with `count` moving clips, `videos/clip-00.mp4` and so on.
    pub fn with_clips(count: u64) -> Self {
        let place = Self::new();
        for seed in 0..count {
            clips::write_moving(&place.video(format!("clip-{seed:02}.mp4")), seed);
        }
        place
    }

    /// The place itself.
    pub fn root(&self) -> &Path {
        self.directory.path()
    }

    /// Something in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root().join(name)
    }

    /// Something in `videos`, whose directories are made.
    pub fn video(&self, name: impl AsRef<OsStr>) -> PathBuf {
        let path = self.root().join("videos").join(name.as_ref());
        std::fs::create_dir_all(path.parent().expect("a parent")).expect("directories");
        path
    }

    /// A command that runs here, with nothing of the caller's settings.
    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.current_dir(self.root());
        for (name, _) in std::env::vars_os() {
            if name.to_string_lossy().starts_with("PLUMBLINE_") {
                command.env_remove(name);
            }
        }
        command
    }

    /// `plumbline score` with further words after it.
    pub fn score(&self, words: &[&str]) -> Command {
        let mut command = self.command(plumbline());
        command.arg("score").args(words);
        command
    }

    /// Scores `videos` into `out` at `draft`, to the end.
    pub fn run(&self, out: &str, words: &[&str]) -> Ended {
        let mut command = self.score(&["videos", "--out", out, "--profile", "draft"]);
        Started::start(command.args(words)).wait()
    }

    /// What lies in `out`.
    pub fn published(&self, out: &str) -> Published {
        Published::new(self.path(out))
    }
}

/// A run under way; dropping it ends it.
#[derive(Debug)]
pub struct Started {
    child: Child,
    stdout: File,
    stderr: File,
}

/// A run that has ended.
#[derive(Debug)]
pub struct Ended {
    /// How.
    pub status: ExitStatus,
    /// All it wrote to standard output.
    pub stdout: String,
    /// All it wrote to standard error.
    pub stderr: String,
}

impl Started {
    /// Starts a command; its output goes to files, so that no full pipe stops it.
    pub fn start(command: &mut Command) -> Self {
        let (stdout, stderr) = (
            tempfile::tempfile().expect("file"),
            tempfile::tempfile().expect("file"),
        );
        let child = command
            .stdin(Stdio::null())
            .stdout(stdout.try_clone().expect("second handle"))
            .stderr(stderr.try_clone().expect("second handle"))
            .spawn()
            .expect("the command starts");
        Self {
            child,
            stdout,
            stderr,
        }
    }

    /// Its process id.
    pub fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// Whether it is still running.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("its status").is_none()
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        process::signal(self.pid(), signal);
    }

    /// Waits for its end.
    pub fn wait(self) -> Ended {
        self.wait_within(DEADLINE)
    }

    /// Waits for its end, where that may take longer.
    pub fn wait_within(mut self, deadline: Duration) -> Ended {
        let started = Instant::now();
        while self.is_running() {
            if started.elapsed() > deadline {
                let _gone = self.child.kill();
                panic!(
                    "no end within {deadline:?}; standard error:\n{}",
                    all_of(&mut self.stderr)
                );
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ended {
            status: self.child.wait().expect("its status"),
            stdout: all_of(&mut self.stdout),
            stderr: all_of(&mut self.stderr),
        }
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _gone = self.child.kill();
        let _gone = self.child.wait();
    }
}

fn all_of(file: &mut File) -> String {
    let mut bytes = Vec::new();
    file.rewind().expect("the file rewinds");
    file.read_to_end(&mut bytes).expect("the file reads");
    String::from_utf8_lossy(&bytes).into_owned()
}

impl Ended {
    /// Fails unless it ended with this exit code.
    #[track_caller]
    pub fn expect_code(self, code: i32) -> Self {
        assert_eq!(
            self.status.code(),
            Some(code),
            "{}; standard error:\n{}",
            self.status,
            self.stderr
        );
        self
    }

    /// Fails unless this signal ended it.
    #[track_caller]
    pub fn expect_signal(self, signal: Signal) -> Self {
        assert_eq!(
            self.status.signal(),
            Some(signal.as_raw()),
            "{}",
            self.stderr
        );
        self
    }

    /// Fails unless one line of standard error holds all of these.
    #[track_caller]
    pub fn expect_line(self, words: &[&str]) -> Self {
        let holds = |line: &str| words.iter().all(|word| line.contains(word));
        assert!(
            self.stderr.lines().any(holds),
            "no line with {words:?} in:\n{}",
            self.stderr
        );
        self
    }

    /// Standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{error}: {:?}", self.stdout))
    }
}
