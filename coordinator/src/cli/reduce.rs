//! `plumbline reduce`: scores, manifests and rewards from rows that exist.

use std::io::Write;
use std::num::NonZeroU16;
use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::score::FormatArg;
use super::{Failure, exit};
use crate::corpus::GroupBy;
use crate::progress::say;
use crate::publish::Format;
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::select::KeepRule;
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
    /// Signals combined into the anomaly score
    #[arg(long, value_enum, default_value = "balanced")]
    recipe: Recipe,
    /// Groups: a COLUMN, path:N (N-th directory of `video`) or prefix:SEP (file name before SEP) [default: the column `group`]
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Which scored videos to keep, per group: a number N, a share P%, or s<=X
    #[arg(long, value_name = "RULE", default_value = "80%")]
    keep: KeepRule,
    /// Histogram bins behind the entropy weights
    #[arg(long, value_name = "N", default_value = "30")]
    bins: NonZeroU16,
    /// Histogram range behind the entropy weights
    #[arg(long, value_enum, default_value = "full")]
    range: Range,
    /// Population behind the z-scores; `group` for groups of different cameras, sizes or frame rates
    #[arg(long, value_enum, default_value = "corpus")]
    normalise_within: NormaliseWithin,
    /// Formats of scores and rewards
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "jsonl,parquet,csv"
    )]
    format: Vec<FormatArg>,
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
        reduce: ReduceOptions {
            recipe: args.recipe,
            bins: args.bins,
            range: args.range,
            keep: args.keep,
            profile_digest: String::new(),
            normalise_within: args.normalise_within,
        },
        formats: args.format.into_iter().map(Format::from).collect(),
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
            "weights": reduced.statistics.corpus.weights,
            "warnings": reduced.statistics.warnings,
        });
        let text = serde_json::to_string_pretty(&summary).map_err(Failure::stopped)?;
        writeln!(std::io::stdout(), "{text}").map_err(Failure::stopped)?;
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
