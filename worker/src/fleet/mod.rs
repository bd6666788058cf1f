//! The worker of a fleet: jobs from a queue, rows into the results queue of their run.
//!
//! ```text
//! receive ─► judge ─► run still there? ─► fetch ─► compute (child) ─► verdict ─► publish ─► settle
//!              │             │              └────────────┴── hand back (drained)
//!              │             └── no: Done, counted as dropped
//!              └── never to be done: a row where run and video are known, and a dead letter
//! ```
//!
//! One unsettled job per slot. The result is confirmed before its job is settled, so that whatever crashes,
//! a job comes again rather than is lost; `common/src/queue/design.md` goes through the crash points.

mod files;
mod judge;
mod metrics;
mod recent;
mod serve;
mod stop;
mod verdict;
mod work;

use std::path::PathBuf;
use std::time::Duration;

use plumbline_common::backoff::Backoff;
use plumbline_common::queue::{JobKind, Queue};

pub use metrics::Metrics;
pub use serve::{ServeError, serve};
pub use stop::{Stop, on_signals};

use crate::child::ComputeLimits;
use crate::fetch::Fetcher;

/// The queue of the jobs that are done here.
pub const JOBS: Queue = Queue::Jobs(JobKind::Fused);

/// Receivers that died with a job, or lost their connection with it, after which nobody tries it again. The
/// broker does not tell the two apart, and a bad night of a network loses a few connections in a row; a video
/// that kills its compute child ends long before, as a row at once.
pub const MAX_REDELIVERIES: u32 = 8;

/// Waits between attempts to fetch an object: about ten minutes in all, a store's own attempts not counted.
pub const FETCH_RETRIES: Backoff = Backoff {
    first: Duration::from_secs(1),
    longest: Duration::from_secs(256),
    attempts: 10,
};

/// A usable `plumbline-worker`.
#[derive(Debug, Clone)]
pub struct WorkerOptions {
    /// The worker's name in results and costs.
    pub name: String,
    /// Jobs in work at once.
    pub slots: u16,
    /// How long jobs in work may go on once the worker is told to stop.
    pub grace: Duration,
    /// The directory whose videos jobs may name, canonical; `None` for none.
    pub files: Option<PathBuf>,
    /// Who computes.
    pub compute: Compute,
    /// Where objects come from.
    pub fetcher: Fetcher,
    /// Waits between attempts to fetch an object.
    pub fetch_retries: Backoff,
}

/// Who computes.
#[derive(Debug, Clone)]
pub enum Compute {
    /// A child per slot.
    Children {
        /// What it runs: a Plumbline binary.
        program: PathBuf,
        /// What one video may cost.
        limits: ComputeLimits,
    },
    /// Nobody: every job is answered by the same `static` row after this time, to see what queues can do.
    Nobody {
        /// How long an answer takes.
        job_time: Duration,
    },
}
