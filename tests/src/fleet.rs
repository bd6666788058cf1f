//! Long-running programs of a fleet: started, killed, started again with the same words.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use rustix::process::Signal;

use crate::process::{self, Process, children_of};

/// A program that writes its log to a file, over all its lives.
#[derive(Debug)]
pub struct Daemon {
    command: Command,
    log: PathBuf,
    child: Child,
}

impl Daemon {
    /// Starts it.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn start(command: Command, log: &Path) -> Self {
        let mut command = command;
        let child = spawn(&mut command, log);
        Self {
            command,
            log: log.to_owned(),
            child,
        }
    }

    /// Starts it again, as before, once it has ended.
    pub fn restart(&mut self) {
        self.kill();
        self.child = spawn(&mut self.command, &self.log);
    }

    /// How it ended; `None` while it runs.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("its status")
    }

    /// Its process id.
    pub fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// Its compute processes.
    pub fn children(&self) -> Vec<Process> {
        children_of(self.pid())
    }

    /// Ends it without a chance to object, and waits for that.
    pub fn kill(&mut self) {
        let _gone = self.child.kill();
        let _gone = self.child.wait();
    }

    /// Asks it to end, and waits at most so long; how it ended, if it did.
    pub fn terminate(&mut self, patience: Duration) -> Option<ExitStatus> {
        process::signal(self.pid(), Signal::TERM);
        let asked = std::time::Instant::now();
        loop {
            match self.ended() {
                None if asked.elapsed() < patience => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                ended => return ended,
            }
        }
    }

    /// The last lines of its log, for a failure's message.
    pub fn last_words(&self, lines: usize) -> String {
        let log = std::fs::read(&self.log).unwrap_or_default();
        let text = String::from_utf8_lossy(&log);
        let all: Vec<&str> = text.lines().collect();
        let from = all.len().saturating_sub(lines);
        format!("{}:\n{}", self.log.display(), all[from..].join("\n"))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.kill();
    }
}

fn spawn(command: &mut Command, log: &Path) -> Child {
    let log = OpenOptions::new().create(true).append(true).open(log);
    let log = log.expect("the log opens");
    command
        .stdin(Stdio::null())
        .stdout(log.try_clone().expect("second handle"))
        .stderr(log)
        .spawn()
        .expect("the program starts")
}
