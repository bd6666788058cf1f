//! `plumbline reduce`: scores, manifests and rewards from rows that exist.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::reducing::ReducingArgs;
use super::{Failure, exit, print_json};
use crate::corpus::GroupBy;
use crate::progress::say;
use crate::reduce_files::{Budget, ReduceFilesOptions, ReducedFiles, reduce_files};

/// Reduces rows that exist (another recipe, bins, groups or keep rule), without a look at any video
#[derive(Debug, Args)]
pub(super) struct ReduceArgs {
    /// Rows (.parquet or .jsonl, with a column `video`), or directories: a run's OUT, or parts
    #[arg(required = true, value_name = "SCORES")]
    sources: Vec<PathBuf>,
    /// Directory for the results, another one than that of the rows
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    reducing: ReducingArgs,
    /// Groups: a COLUMN, path:N (N-th directory of `video`) or prefix:SEP (file name before SEP) [default: the column `group`]
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Threads for the statistics [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Print the summary as JSON on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: ReduceArgs) -> Result<u8, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let options = ReduceFilesOptions {
        sources: args.sources,
        out: args.out,
        group_by: args.group_by,
        // The profile's digest is in the rows.
        reduce: args.reducing.options(None)?,
        formats: args.reducing.formats(),
        threads: args.threads.map_or(cores, usize::from),
        budget: Budget::default(),
    };
    let reduced = reduce_files(&options).map_err(|error| {
        if error.is_usage() {
            Failure::usage(error)
        } else {
            Failure::stopped(error)
        }
    })?;
    tell(&reduced, &options);
    if args.json {
        let summary = json!({
            "out": options.out.to_string_lossy(),
            "files": reduced.files,
            "rows": reduced.rows,
            "statuses": reduced.statistics.statuses,
            "decisions": reduced.statistics.decisions,
            "weights": reduced.statistics.weights(),
            "reference": reduced.statistics.reference,
            "warnings": reduced.statistics.warnings,
        });
        print_json(&summary, &options.out)?;
    }
    Ok(if reduced.complete() {
        exit::OK
    } else {
        exit::INCOMPLETE
    })
}

fn tell(reduced: &ReducedFiles, options: &ReduceFilesOptions) {
    let decisions = reduced.statistics.decisions.iter();
    let decisions: Vec<String> = decisions
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    say(&format!("{} rows: {}", reduced.rows, decisions.join(", ")));
    for warning in &reduced.statistics.warnings {
        say(&format!("note: {warning}"));
    }
    say(&format!("results: {}", options.out.display()));
}
