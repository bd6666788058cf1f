//! Other processes, as /proc shows them: whose child is who, and who is still alive.

use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// A process; ids are reused, start times are not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Process {
    /// Its id.
    pub pid: i32,
    /// When it started, clock ticks since the machine did.
    started_ticks: u64,
}

struct Stat {
    state: char,
    parent: i32,
    user_ticks: u64,
    started_ticks: u64,
}

/// Fields of `/proc/<pid>/stat` after the command's name, which alone may hold spaces and brackets.
fn stat(pid: i32) -> Option<Stat> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    Some(Stat {
        state: fields.first()?.chars().next()?,
        parent: fields.get(1)?.parse().ok()?,
        user_ticks: fields.get(11)?.parse().ok()?,
        started_ticks: fields.get(19)?.parse().ok()?,
    })
}

/// The living children of a process.
pub fn children_of(parent: i32) -> Vec<Process> {
    let all = std::fs::read_dir("/proc").expect("/proc is mounted");
    let pids = all.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<i32>().ok());
    pids.filter_map(|pid| {
        let stat = stat(pid).filter(|stat| stat.parent == parent && stat.state != 'Z')?;
        Some(Process {
            pid,
            started_ticks: stat.started_ticks,
        })
    })
    .collect()
}

impl Process {
    /// Whether it still runs; a dead one that nobody has asked about yet does not.
    pub fn is_alive(self) -> bool {
        stat(self.pid).is_some_and(|stat| {
            stat.started_ticks == self.started_ticks && !matches!(stat.state, 'Z' | 'X')
        })
    }

    /// Whether it has computed for a fifth of a second: it is past its start and at work.
    pub fn has_worked(self) -> bool {
        /// Linux counts a hundred ticks a second for programs, whatever its own clock.
        const FIFTH_OF_A_SECOND_TICKS: u64 = 20;
        stat(self.pid).is_some_and(|stat| stat.user_ticks >= FIFTH_OF_A_SECOND_TICKS)
    }

    /// Ends it without a chance to object.
    pub fn kill(self) {
        signal(self.pid, Signal::KILL);
    }
}

/// Sends a signal; to a process that is gone already, none.
pub fn signal(pid: i32, signal: Signal) {
    let pid = Pid::from_raw(pid).expect("a process id");
    let _gone = kill_process(pid, signal);
}

/// Whether the tests run as root, whom permissions do not stop.
pub fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// Polls until `condition` holds; fails after `deadline`, saying what was waited for.
pub fn wait_until(what: &str, deadline: Duration, mut condition: impl FnMut() -> bool) {
    const INTERVAL: Duration = Duration::from_millis(5);
    let started = Instant::now();
    while !condition() {
        assert!(
            started.elapsed() < deadline,
            "waited {deadline:?} in vain: {what}"
        );
        std::thread::sleep(INTERVAL);
    }
}

/// The living processes that have `marker` (`NAME=value`) in the environment they were started with.
pub fn marked(marker: &str) -> Vec<i32> {
    let all = std::fs::read_dir("/proc").expect("/proc is mounted");
    let pids = all.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<i32>().ok());
    pids.filter(|pid| {
        let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let is_marked = environment
            .split(|byte| *byte == 0)
            .any(|variable| variable == marker.as_bytes());
        is_marked && stat(*pid).is_some_and(|stat| !matches!(stat.state, 'Z' | 'X'))
    })
    .collect()
}
