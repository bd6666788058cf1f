//! What a worker counts, under `plumbline_worker_`.

use std::time::Duration;

use plumbline_common::row::{Cost, Status};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

/// One label and its value.
type Label = [(&'static str, &'static str); 1];

/// What becomes of jobs beside rows.
const OTHER_OUTCOMES: [&str; 5] = [
    "dropped",
    "retried",
    "handed_back",
    "unreadable",
    "repeated",
];

/// What a job's time goes into.
const STAGES: [&str; 8] = [
    "fetch",
    "decode",
    "flow",
    "signals",
    "geometry",
    "photometric",
    "tracking",
    "publish",
];

/// The counters; clones count into the same.
#[derive(Debug, Clone)]
pub struct Metrics {
    jobs: Family<Label, Counter>,
    stages: Family<Label, Histogram, fn() -> Histogram>,
    fetched_bytes: Counter,
    children_lost: Counter,
    dead_letters: Counter,
    pub(super) in_work: Gauge,
    pub(super) slots: Gauge,
}

impl Default for Metrics {
    fn default() -> Self {
        // From what a no-op takes to far beyond what is worth waiting for: 1 ms to 17 min.
        let histogram: fn() -> Histogram = || Histogram::new(exponential_buckets(0.001, 4.0, 11));
        Self {
            jobs: Family::default(),
            stages: Family::new_with_constructor(histogram),
            fetched_bytes: Counter::default(),
            children_lost: Counter::default(),
            dead_letters: Counter::default(),
            in_work: Gauge::default(),
            slots: Gauge::default(),
        }
    }
}

impl Metrics {
    /// Shows them in `registry`. Every count is there from the start, so that its first increase is one.
    pub fn register(&self, registry: &mut Registry) {
        let rows = Status::ALL.map(Status::as_str);
        for outcome in rows.into_iter().chain(OTHER_OUTCOMES) {
            drop(self.jobs.get_or_create(&[("outcome", outcome)]));
        }
        for stage in STAGES {
            drop(self.stages.get_or_create(&[("stage", stage)]));
        }
        let registry = registry.sub_registry_with_prefix("plumbline_worker");
        let about = "Jobs by what became of them: a row's status, dropped (the run is gone), retried, handed_back (the worker was told to stop), unreadable, repeated (answered before)";
        registry.register("jobs", about, self.jobs.clone());
        let about = "Time per job and stage";
        registry.register_with_unit("stage", about, Unit::Seconds, self.stages.clone());
        let about = "Bytes of objects fetched";
        registry.register_with_unit("fetched", about, Unit::Bytes, self.fetched_bytes.clone());
        let about = "Compute processes that died or passed the deadline";
        registry.register("children_lost", about, self.children_lost.clone());
        let about = "Jobs put away as dead letters";
        registry.register("dead_letters", about, self.dead_letters.clone());
        registry.register("jobs_in_work", "Jobs in work", self.in_work.clone());
        registry.register(
            "slots",
            "Jobs that can be in work at once",
            self.slots.clone(),
        );
    }

    pub(super) fn job(&self, outcome: &'static str) {
        self.jobs.get_or_create(&[("outcome", outcome)]).inc();
    }

    pub(super) fn stages(&self, cost: &Cost) {
        let stages = [
            ("decode", cost.decode_s),
            ("flow", cost.flow_s),
            ("signals", cost.signals_s),
            ("geometry", cost.geometry_s),
            ("photometric", cost.photometric_s),
            ("tracking", cost.tracking_s),
        ];
        for (stage, seconds) in stages {
            self.stage(stage, seconds);
        }
    }

    pub(super) fn fetched(&self, bytes: u64, took: Duration) {
        self.fetched_bytes.inc_by(bytes);
        self.stage("fetch", took.as_secs_f64());
    }

    pub(super) fn published(&self, took: Duration) {
        self.stage("publish", took.as_secs_f64());
    }

    pub(super) fn children_lost(&self, children: u64) {
        self.children_lost.inc_by(children);
    }

    pub(super) fn dead_letter(&self) {
        self.dead_letters.inc();
    }

    fn stage(&self, stage: &'static str, seconds: f64) {
        self.stages
            .get_or_create(&[("stage", stage)])
            .observe(seconds);
    }
}
