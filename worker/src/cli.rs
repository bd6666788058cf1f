//! The command line of `plumbline-worker`: what was typed, made usable, handed to the library.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, CommandFactory, Parser, Subcommand};
use plumbline_common::observe::{self, Pulse};
use plumbline_common::queue::AmqpBroker;
use plumbline_common::telemetry::{self, LogFormat};
use prometheus_client::registry::Registry;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::child;
use crate::fetch::Fetcher;
use crate::fleet::{self, Compute, FETCH_RETRIES, Metrics, Stop, WorkerOptions, serve};
use crate::packaging::Packaging;
use crate::settings::Settings;

/// Drained.
const OK: u8 = 0;
/// The broker is lost, or nothing can be computed.
const STOPPED: u8 = 1;
/// Usage or configuration.
const USAGE: u8 = 2;
/// Told twice to stop.
const INTERRUPTED: u8 = 130;

/// RabbitMQ's own consumer timeout: how long it waits for a job to be settled before it takes the job back.
const BROKER_DEFAULT_TIMEOUT: Duration = Duration::from_secs(1800);

/// Shown below the help; the tests parse every line.
const EXAMPLES: &str = "Examples:
  plumbline-worker
  plumbline-worker --slots 4 --memory 2048 --grace 300 --listen 127.0.0.1:9090 --log-format json
  plumbline-worker --files /data/videos --scratch /fast/disk

The broker's address comes from PLUMBLINE_QUEUE__URL, the store's from AWS_ENDPOINT_URL, AWS_REGION and the
credentials that AWS's own tools find. The first SIGTERM drains, the second ends at once.";

/// Measures the videos of a fleet's runs: takes jobs from a queue, one per slot, and answers each with a row
#[derive(Debug, Parser)]
#[command(
    name = "plumbline-worker",
    version,
    args_conflicts_with_subcommands = true,
    after_help = EXAMPLES
)]
struct Cli {
    #[command(subcommand)]
    internal: Option<Internal>,
    #[command(flatten)]
    worker: WorkerArgs,
    /// Logs on standard error: a level or a tracing filter such as plumbline_worker=debug
    #[arg(long, default_value = "info", value_name = "FILTER")]
    log: String,
    /// How logs look: text or json
    #[arg(long, default_value = "text", value_name = "FORMAT")]
    log_format: LogFormat,
}

#[derive(Debug, Subcommand)]
enum Internal {
    /// Measures videos for a parent process (internal)
    #[command(name = child::CHILD_ARGUMENT, hide = true)]
    ComputeChild {
        #[arg(long)]
        memory_mib: u64,
    },
    #[command(flatten)]
    Packaging(Packaging),
}

/// The definition of the command line, for whoever documents or checks it.
#[must_use]
pub fn command() -> clap::Command {
    Cli::command()
}

#[derive(Debug, Args)]
struct WorkerArgs {
    /// The broker: amqp://user:password@host:port/vhost, or amqps:// [default: PLUMBLINE_QUEUE__URL]
    #[arg(long, value_name = "URL")]
    queue: Option<String>,
    /// Videos measured at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    slots: Option<u16>,
    /// Seconds that jobs in work may go on after SIGTERM; the rest is handed back
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    grace: u64,
    /// Address for /healthz, /readyz and /metrics [default: none]
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Directory whose videos jobs may name by path; without it only objects of a store are read
    #[arg(long, value_name = "DIR")]
    files: Option<PathBuf>,
    /// Directory for copies of objects: room for one of the largest videos per slot [default: the system's]
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,
    /// Name in results and costs [default: HOST/PROCESS]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Wall time for one video, seconds; below the broker's consumer timeout
    #[arg(long, value_name = "SECONDS")]
    deadline: Option<f64>,
    /// Memory of one compute process, MiB
    #[arg(long, value_name = "MIB")]
    memory: Option<u64>,
    /// Converted model sets of learned networks: a directory or s3://BUCKET/PREFIX [default: models.place]
    #[arg(long, value_name = "PLACE")]
    models: Option<String>,
    /// ONNX Runtime's shared library, which runs them [default: models.runtime]
    #[arg(long, value_name = "FILE")]
    onnxruntime: Option<PathBuf>,
    /// Answers every job with a fixed row, to try queues out
    #[arg(long, hide = true)]
    no_op: bool,
    /// How long such an answer takes
    #[arg(long, hide = true, value_name = "MILLISECONDS", default_value_t = 0)]
    no_op_ms: u64,
}

/// What is usable.
struct Usable {
    url: String,
    settings: Settings,
    options: WorkerOptions,
    listen: Option<SocketAddr>,
}

/// Parses the command line and runs it. Errors are one line on standard error.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let ended = match cli.internal {
        Some(Internal::ComputeChild { memory_mib }) => {
            telemetry::init("error", LogFormat::Text);
            child::run(memory_mib).map(|()| OK)
        }
        Some(Internal::Packaging(packaging)) => packaging.run(command()).map(|()| OK),
        None => {
            telemetry::init(&cli.log, cli.log_format);
            match cli.worker.usable() {
                Ok(usable) => run(usable),
                Err(error) => return end(USAGE, &error),
            }
        }
    };
    match ended {
        Ok(code) => ExitCode::from(code),
        Err(error) => end(STOPPED, &error),
    }
}

fn end(code: u8, error: &anyhow::Error) -> ExitCode {
    let _closed = writeln!(std::io::stderr(), "plumbline-worker: {error:#}");
    ExitCode::from(code)
}

impl WorkerArgs {
    fn usable(self) -> anyhow::Result<Usable> {
        let mut settings = Settings::load()?;
        if let Some(deadline_s) = self.deadline {
            settings.compute.deadline_s = deadline_s;
            settings.compute.learned_deadline_s = deadline_s;
        }
        settings.models.place = self.models.or(settings.models.place);
        settings.models.runtime = self.onnxruntime.or(settings.models.runtime);
        if let Some(memory_mib) = self.memory {
            settings.compute.memory_mib = memory_mib;
        }
        settings.validate()?;
        let url = self.queue.or_else(|| settings.queue.url.clone());
        let url = url.context("no broker is given: name one by --queue or PLUMBLINE_QUEUE__URL")?;
        let canonical = |dir: PathBuf| {
            let found = dir.canonicalize().ok().filter(|dir| dir.is_dir());
            found.with_context(|| format!("--files {}: there is no such directory", dir.display()))
        };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let scratch = self.scratch.unwrap_or_else(std::env::temp_dir);
        let compute = if self.no_op {
            Compute::Nobody {
                job_time: Duration::from_millis(self.no_op_ms),
            }
        } else {
            Compute::Children {
                program: std::env::current_exe().context("the program does not find itself")?,
                limits: settings.compute,
            }
        };
        Ok(Usable {
            url,
            options: WorkerOptions {
                name: self.name.unwrap_or_else(own_name),
                slots: self
                    .slots
                    .unwrap_or_else(|| u16::try_from(cores).unwrap_or(u16::MAX)),
                grace: Duration::from_secs(self.grace),
                files: self.files.map(canonical).transpose()?,
                compute,
                fetcher: Fetcher::new(settings.store.s3_options(), scratch)
                    .with_models(settings.models.clone()),
                fetch_retries: FETCH_RETRIES,
            },
            listen: self.listen,
            settings,
        })
    }
}

fn run(usable: Usable) -> anyhow::Result<u8> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let ended = runtime.block_on(run_until_stopped(usable));
    // Children are ended by dropping their handles, which needs the runtime no longer.
    runtime.shutdown_background();
    ended
}

async fn run_until_stopped(usable: Usable) -> anyhow::Result<u8> {
    let Usable {
        url,
        settings,
        options,
        listen,
    } = usable;
    let stop = fleet::on_signals()?;
    let metrics = Metrics::default();
    let (ready, is_ready) = watch::channel(None);
    if let Some(address) = listen {
        let listener = TcpListener::bind(address).await;
        let listener = listener.with_context(|| format!("--listen {address} is not to be had"))?;
        tracing::info!(address = %listener.local_addr()?, "listening");
        let mut registry = Registry::default();
        metrics.register(&mut registry);
        let pulse = Pulse::new(move || is_ready.borrow().as_ref().is_some_and(Pulse::is_alive));
        tokio::spawn(observe::serve(listener, registry, pulse));
    }
    warn_of_the_consumer_timeout(&options);
    tell_of_the_sandbox(&options);
    let mut told = stop.clone();
    let broker = tokio::select! {
        broker = AmqpBroker::connect(&url, settings.queue.amqp_options()) => broker?,
        _ = told.wait_for(|stop| *stop != Stop::No) => return Ok(OK),
    };
    tracing::info!(worker = options.name, slots = options.slots, "at work");
    serve(Arc::new(broker), options, metrics, stop.clone(), ready).await?;
    let at_once = *stop.borrow() == Stop::Now;
    Ok(if at_once { INTERRUPTED } else { OK })
}

/// A job is settled only when it is done, and the broker does not wait for ever.
fn warn_of_the_consumer_timeout(options: &WorkerOptions) {
    let Compute::Children { limits, .. } = &options.compute else {
        return;
    };
    // A fetch, a child that dies at the last moment, and another one.
    let longest_s = f64::from(1 + child::MAX_ATTEMPTS) * limits.deadline_s;
    if longest_s > BROKER_DEFAULT_TIMEOUT.as_secs_f64() {
        tracing::warn!(
            longest_s,
            "a job may take longer than RabbitMQ waits by default (consumer_timeout, 1800 s): unless it was raised there, the broker gives such jobs to other workers, and in the end to nobody"
        );
    }
}

/// What compute processes cannot do on this machine, and what they could.
fn tell_of_the_sandbox(options: &WorkerOptions) {
    let Compute::Children { limits, .. } = &options.compute else {
        return;
    };
    let memory_mib = limits.memory_mib;
    tracing::info!(
        memory_mib,
        "compute processes have a limit on memory, and write no file"
    );
    for protection in child::probe() {
        match protection.missing {
            None => tracing::info!("compute processes are refused: {}", protection.what),
            Some(reason) => tracing::warn!(
                reason,
                "compute processes are not, or not wholly, refused: {}; a newer kernel does it",
                protection.what
            ),
        }
    }
}

fn own_name() -> String {
    let host = rustix::system::uname();
    format!(
        "{}/{}",
        host.nodename().to_string_lossy(),
        std::process::id()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_examples_are_commands() {
        let lines = EXAMPLES.lines().map(str::trim);
        let commands = lines.filter(|line| line.starts_with("plumbline-worker"));
        let parsed: Vec<Cli> = commands
            .map(|line| Cli::try_parse_from(line.split(' ')).unwrap())
            .collect();
        assert_eq!(parsed.len(), 3);
    }
}
