//! The command line: what was typed, made usable, handed to the library; results to exit codes.

mod evaluate;
mod examples;
mod explain;
mod fleet;
mod flow;
mod judge;
mod measuring;
mod profile;
mod queue;
mod reduce;
mod reducing;
mod reference;
mod report;
mod sample;
mod score;
mod slam;
mod summary;
mod tradeoff;
mod watching;

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use plumbline_common::queue::QueueError;
use plumbline_common::telemetry::{self, LogFormat};
use plumbline_worker::packaging::Packaging;

/// Exit codes of every command (design, section 3).
pub mod exit {
    /// Finished; every row is scored or static.
    pub const OK: u8 = 0;
    /// Stopped before the end; run again to resume.
    pub const STOPPED: u8 = 1;
    /// Usage, configuration or empty input.
    pub const USAGE: u8 = 2;
    /// Finished, but some rows have no score.
    pub const INCOMPLETE: u8 = 3;
    /// Interrupted; resumable.
    pub const INTERRUPTED: u8 = 130;
}

/// Tells which generated videos break physics, without any reference.
#[derive(Debug, Parser)]
#[command(name = "plumbline", version, arg_required_else_help = true, after_help = examples::PLUMBLINE)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Logs on standard error: a level or a tracing filter such as plumbline_worker=debug
    #[arg(long, global = true, default_value = "error", value_name = "FILTER")]
    log: String,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(after_help = examples::SCORE)]
    Score(Box<score::ScoreArgs>),
    #[command(after_help = examples::EVALUATE)]
    Evaluate(evaluate::EvaluateArgs),
    #[command(after_help = examples::EXPLAIN)]
    Explain(explain::ExplainArgs),
    #[command(after_help = examples::FLEET)]
    Fleet(fleet::FleetArgs),
    #[command(after_help = examples::FLOW)]
    Flow(flow::FlowArgs),
    #[command(after_help = examples::JUDGE)]
    Judge(Box<judge::JudgeArgs>),
    #[command(after_help = examples::PROFILE)]
    Profile(profile::ProfileArgs),
    #[command(after_help = examples::REFERENCE)]
    Reference(reference::ReferenceArgs),
    #[command(after_help = examples::REDUCE)]
    Reduce(Box<reduce::ReduceArgs>),
    #[command(after_help = examples::REPORT)]
    Report(report::ReportArgs),
    #[command(after_help = examples::SAMPLE)]
    Sample(sample::SampleArgs),
    #[command(after_help = examples::SLAM)]
    Slam(slam::SlamArgs),
    #[command(after_help = examples::TRADEOFF)]
    Tradeoff(Box<tradeoff::TradeoffArgs>),
    /// Measures videos for a parent process (internal)
    #[command(name = plumbline_worker::child::CHILD_ARGUMENT, hide = true)]
    ComputeChild {
        #[arg(long)]
        memory_mib: u64,
    },
    #[command(flatten)]
    Packaging(Packaging),
}

/// Parses the command line and runs it. Errors are one line on standard error.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    telemetry::init(&cli.log, LogFormat::Text);
    let outcome = match cli.command {
        Command::Score(args) => score::run(*args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Explain(args) => explain::run(args),
        Command::Fleet(args) => fleet::run(args),
        Command::Flow(args) => flow::run(&args),
        Command::Judge(args) => judge::run(*args),
        Command::Profile(args) => profile::run(args),
        Command::Reference(args) => reference::run(args),
        Command::Reduce(args) => reduce::run(*args),
        Command::Report(args) => report::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Slam(args) => slam::run(args),
        Command::Tradeoff(args) => tradeoff::run(*args),
        Command::ComputeChild { memory_mib } => plumbline_worker::child::run(memory_mib)
            .map(|()| exit::OK)
            .map_err(|error| Failure {
                code: exit::STOPPED,
                message: format!("{error:#}"),
            }),
        Command::Packaging(packaging) => packaging
            .run(Cli::command())
            .map(|()| exit::OK)
            .map_err(|error| Failure::stopped(format!("{error:#}"))),
    };
    match outcome {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            crate::progress::say(&format!("plumbline: {}", failure.message));
            ExitCode::from(failure.code)
        }
    }
}

/// Threads for pipes and signals; the work itself is done by compute processes.
fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(Failure::stopped)
}

/// Puts a result on standard output; the files in `out` are whole whether or not that succeeds.
fn print_json(result: &serde_json::Value, out: &Path) -> Result<(), Failure> {
    print_text(
        &serde_json::to_string_pretty(result).map_err(Failure::stopped)?,
        out,
    )
}

fn print_text(text: &str, out: &Path) -> Result<(), Failure> {
    writeln!(std::io::stdout(), "{text}").map_err(|error| {
        Failure::stopped(format!(
            "the result cannot be written to standard output ({error}); the results are whole, in {}",
            out.display()
        ))
    })
}

/// A line of a result that is nowhere else; a reader that has closed the pipe wants no more of them.
fn print_line(line: &str) -> Result<(), Failure> {
    match writeln!(std::io::stdout(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::stopped(format!(
            "standard output cannot be written ({error})"
        ))),
        _ => Ok(()),
    }
}

/// A broker's error as a command's: an address can be mended, a broker may come back.
fn queue_failure(error: QueueError) -> Failure {
    match error {
        QueueError::Address { .. } => Failure::usage(error),
        _ => Failure::stopped(error),
    }
}

/// How a command fails: the code and the line that says why.
#[derive(Debug)]
struct Failure {
    code: u8,
    message: String,
}

impl Failure {
    fn usage(error: impl std::fmt::Display) -> Self {
        Self {
            code: exit::USAGE,
            message: error.to_string(),
        }
    }

    fn stopped(error: impl std::fmt::Display) -> Self {
        Self {
            code: exit::STOPPED,
            message: error.to_string(),
        }
    }
}
