//! `plumbline score`: from what was typed to a run, and from a run to an exit code.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use plumbline_common::observe::{self, Pulse};
use prometheus_client::registry::Registry;
use tokio::net::TcpListener;

use super::measuring::{Measuring, MeasuringArgs, ThresholdsArg};
use super::queue::QueueArgs;
use super::reducing::ReducingArgs;
use super::watching::WatchingArgs;
use super::{Failure, exit, print_json, summary};
use crate::cascade::budget::Budget;
use crate::corpus::{Choice, CorpusError, GroupBy};
use crate::metrics::Metrics;
use crate::publish::PublishError;
use crate::reduce::outcome::NormaliseWithin;
use crate::report::state::told_command;
use crate::run::{self, CascadeOptions, RunError, ScoreOptions};
use crate::watch;

/// Scores every video of a source: scores, manifests, rewards and a report
#[derive(Debug, Args)]
pub(super) struct ScoreArgs {
    /// Videos, directories (recursive), globs, s3://BUCKET/PREFIX, LeRobot datasets, WebDataset shards
    /// (rollout-{000..127}.tar), or lists (.txt, .csv, .jsonl, .parquet with a column `video`)
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
    /// Directory or s3://BUCKET/PREFIX for the results; a run that was stopped resumes from it
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    #[command(flatten)]
    measuring: MeasuringArgs,
    #[command(flatten)]
    thresholds: ThresholdsArg,
    /// Also draw the worst frame of each of the K most anomalous videos, linked from the report
    #[arg(long, value_name = "K", default_value_t = 0)]
    heatmaps: usize,
    /// Measure at draft, and with --profile only where a keep/drop decision is uncertain: until auto (99% of
    /// the decisions are expected to be those of --profile), agreement=P%, cpu=TIME or per-video=TIME (s, min, h)
    #[arg(long, value_name = "BUDGET", conflicts_with_all = ["reference", "watch"])]
    budget: Option<Budget>,
    #[command(flatten)]
    reducing: ReducingArgs,
    /// Groups: a list's COLUMN, path:N (N-th directory below SOURCE) or prefix:SEP (file name before SEP)
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Only videos of this camera (a LeRobot video key such as observation.images.top, or a list's column
    /// `camera`); again for more [default: all]
    #[arg(long = "camera", value_name = "KEY")]
    cameras: Vec<String>,
    /// Videos measured at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Measure everything again, whatever --out already holds
    #[arg(long, overrides_with = "resume")]
    no_resume: bool,
    /// Take over what an earlier run into --out has measured (the default)
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    fleet: QueueArgs,
    /// Address for /healthz, /readyz and /metrics while the run lasts [default: none]
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    #[command(flatten)]
    watching: WatchingArgs,
    /// Print the summary as JSON on standard output; with --watch, each row as a line when it is final
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: ScoreArgs) -> Result<u8, Failure> {
    let json = args.json;
    let watch = args.watching.usable(json)?;
    args.check_fleet(watch.is_some())?;
    let runtime = super::runtime()?;
    let fleet = runtime.block_on(args.fleet.usable())?;
    let listen = args.listen;
    let options = ScoreOptions {
        fleet,
        ..args.into_options()?
    };
    if let Some(address) = listen {
        runtime.block_on(show(address, &options))?;
    }
    let finished = runtime.block_on(async {
        match &watch {
            Some(watch) => watch::watch(&options, watch).await,
            None => run::score(&options).await,
        }
    });
    // Children are ended by dropping their handles, which needs the runtime no longer.
    runtime.shutdown_background();
    match finished {
        Ok(finished) => {
            summary::table(&finished);
            if json && watch.is_none() {
                print_json(&summary::json(&finished), &finished.out)?;
            }
            Ok(if finished.complete() {
                exit::OK
            } else {
                exit::INCOMPLETE
            })
        }
        Err(error) => Err(Failure {
            code: match &error {
                RunError::Interrupted { .. } => exit::INTERRUPTED,
                RunError::Corpus(CorpusError::Store(error)) if error.is_transient() => {
                    exit::STOPPED
                }
                RunError::Corpus(_)
                | RunError::OutInUse { .. }
                | RunError::RunInUse { .. }
                | RunError::Name(_)
                | RunError::Profile(_)
                | RunError::Publish(PublishError::InTheWay { .. }) => exit::USAGE,
                _ => exit::STOPPED,
            },
            message: error.to_string(),
        }),
    }
}

/// Serves the run's figures until the runtime ends.
async fn show(address: SocketAddr, options: &ScoreOptions) -> Result<(), Failure> {
    let listener = TcpListener::bind(address).await.map_err(|error| {
        Failure::usage(format!("--listen {address} is not to be had ({error})"))
    })?;
    let mut registry = Registry::default();
    let metrics = options.metrics.clone();
    metrics.register(&mut registry, options.fleet.is_some());
    if let Some(fleet) = &options.fleet {
        tokio::spawn(metrics.watch_queues(Arc::clone(&fleet.broker)));
    }
    tokio::spawn(observe::serve(listener, registry, Pulse::new(|| true)));
    Ok(())
}

impl ScoreArgs {
    /// What a fleet does not do, or does by its own rules.
    fn check_fleet(&self, watches: bool) -> Result<(), Failure> {
        if watches && self.out.to_string_lossy().contains("://") {
            return Err(Failure::usage(
                "--watch writes to a directory: name one by --out",
            ));
        }
        if !self.fleet.is_given() {
            return Ok(());
        }
        if watches {
            return Err(Failure::usage(
                "--watch measures on this machine: leave out --queue",
            ));
        }
        let jobs = self.jobs.map(|_| "--jobs");
        match jobs.or(self.measuring.typed_limit()) {
            Some(flag) => Err(Failure::usage(format!(
                "{flag} is for videos measured on this machine; with --queue each worker has its own: give it to plumbline-worker"
            ))),
            None => Ok(()),
        }
    }

    /// From what was typed to what is usable.
    fn into_options(self) -> Result<ScoreOptions, Failure> {
        let measuring = self.measuring.usable(self.jobs)?;
        // A fleet's workers have places and libraries of their own.
        if !self.fleet.is_given() {
            measuring.load_networks()?;
        }
        let Measuring { mut profile, slots } = measuring;
        let fault_calibration = self.thresholds.apply(&mut profile)?;
        let reduce = self.reducing.options(Some(&profile))?;
        let cascade = self
            .budget
            .map(|budget| CascadeOptions::up_to(&profile, budget));
        let cascade = cascade.transpose().map_err(Failure::usage)?;
        if cascade.is_some() && reduce.normalise_within == NormaliseWithin::Group {
            return Err(Failure::usage(
                "--budget calibrates profiles on a sample of the whole corpus: leave out --normalise-within group",
            ));
        }
        Ok(ScoreOptions {
            sources: self.sources,
            out: self.out,
            choice: Choice {
                group_by: self.group_by,
                cameras: self.cameras,
            },
            profile,
            reduce,
            resume: !self.no_resume,
            formats: self.reducing.formats(),
            fault_calibration,
            heat_maps: self.heatmaps,
            slots,
            cascade,
            fleet: None,
            metrics: Metrics::default(),
            command: told_command(std::env::args()),
        })
    }
}
