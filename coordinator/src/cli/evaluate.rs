//! `plumbline evaluate`: scores against judgements, and populations side by side.

use std::num::NonZeroU16;
use std::path::PathBuf;

use clap::Args;

use super::summary::printable;
use super::{Failure, exit, print_text};
use crate::corpus::GroupBy;
use crate::evaluate::{self, EvaluateOptions, Evaluation};
use crate::progress::say;
use crate::publish::EVALUATION_FILES;
use crate::reduce::outcome::Range;

/// Compares scores with judgements: success rates of low, middle, high and random videos, by task
#[derive(Debug, Args)]
pub(super) struct EvaluateArgs {
    /// Scores (.parquet, .jsonl or .csv), or the OUT of a run
    #[arg(value_name = "SCORES")]
    scores: PathBuf,
    /// Judgements (.csv, .jsonl or .parquet): columns `video` and `label` (0, 0.5, 1), any number of rows per video
    #[arg(long, value_name = "LABELS", required_unless_present = "population")]
    labels: Option<PathBuf>,
    /// The column of the labels that holds the judgement
    #[arg(long, value_name = "COLUMN", default_value = "label")]
    label_column: String,
    /// Directory for evaluation.json, evaluation.md and the section of report.html [default: SCORES, if a directory]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Tasks: a COLUMN, path:N or prefix:SEP [default: the column `task`, else `group`]
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Videos per task in each of the sets
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    n: u32,
    /// Seed of the random set
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// A column with the outcome in the real world (0 to 1), to show the gap to it
    #[arg(long, value_name = "COLUMN")]
    real: Option<String>,
    /// A column of the scores that names populations (real, generated), shown side by side
    #[arg(long, value_name = "COLUMN")]
    population: Option<String>,
    /// Histogram bins behind the populations' entropies
    #[arg(long, value_name = "N", default_value = "30")]
    bins: NonZeroU16,
    /// Histogram range behind them
    #[arg(long, value_enum, default_value = "full")]
    range: Range,
    /// Print evaluation.json on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: EvaluateArgs) -> Result<u8, Failure> {
    let out = match args.out {
        Some(out) => out,
        None if args.scores.is_dir() => args.scores.clone(),
        None if !args.scores.exists() => {
            return Err(Failure::usage(format!(
                "{}: no such file or directory; check the path",
                args.scores.display()
            )));
        }
        None => {
            return Err(Failure::usage(format!(
                "{} is no directory that results could go to: name one with --out",
                args.scores.display()
            )));
        }
    };
    let options = EvaluateOptions {
        scores: args.scores,
        labels: args.labels,
        label_column: args.label_column,
        out,
        task: args.group_by,
        per_set: args.n as usize,
        seed: args.seed,
        real_column: args.real,
        population_column: args.population,
        bins: args.bins,
        range: args.range,
    };
    let evaluation = evaluate::evaluate(&options).map_err(|error| {
        if error.is_usage() {
            Failure::usage(printable(&error.to_string()))
        } else {
            Failure::stopped(error)
        }
    })?;
    tell(&evaluation, &options);
    if args.json {
        let text = serde_json::to_string_pretty(&evaluation).map_err(Failure::stopped)?;
        print_text(&text, &options.out)?;
    }
    Ok(exit::OK)
}

fn tell(evaluation: &Evaluation, options: &EvaluateOptions) {
    for line in evaluation.summary() {
        say(&printable(&line));
    }
    let [_, markdown] = EVALUATION_FILES;
    say(&format!("tables: {}", options.out.join(markdown).display()));
}
