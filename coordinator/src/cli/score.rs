//! `plumbline score`: from what was typed to a run, and from a run to an exit code.

use std::io::Write;
use std::num::NonZeroU16;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::measuring::{Measuring, MeasuringArgs, ThresholdsArg};
use super::{Failure, exit, summary};
use crate::corpus::GroupBy;
use crate::publish::Format;
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::select::KeepRule;
use crate::run::{self, RunError, ScoreOptions};

/// Scores every video of a source: scores, manifests, rewards and a report
#[derive(Debug, Args)]
pub(super) struct ScoreArgs {
    /// Videos, directories (recursive), globs, or lists (.txt, .csv, .jsonl, .parquet with a column `video`)
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
    /// Directory for the results; a run that was stopped resumes from it
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    measuring: MeasuringArgs,
    #[command(flatten)]
    thresholds: ThresholdsArg,
    /// Also draw the worst frame of each of the K most anomalous videos, linked from the report
    #[arg(long, value_name = "K", default_value_t = 0)]
    heatmaps: usize,
    /// Signals combined into the anomaly score
    #[arg(long, value_enum, default_value = "balanced")]
    recipe: Recipe,
    /// Groups: a list's COLUMN, path:N (N-th directory below SOURCE) or prefix:SEP (file name before SEP)
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Which scored videos to keep, per group: a number N, a share P%, or s<=X
    #[arg(long, value_name = "RULE", default_value = "80%")]
    keep: KeepRule,
    /// Videos measured at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Formats of scores, costs and rewards
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "jsonl,parquet,csv"
    )]
    format: Vec<FormatArg>,
    /// Measure everything again, whatever --out already holds
    #[arg(long, overrides_with = "resume")]
    no_resume: bool,
    /// Take over what an earlier run into --out has measured (the default)
    #[arg(long)]
    resume: bool,
    /// Histogram bins behind the entropy weights
    #[arg(long, value_name = "N", default_value = "30")]
    bins: NonZeroU16,
    /// Histogram range behind the entropy weights
    #[arg(long, value_enum, default_value = "full")]
    range: Range,
    /// Population behind the z-scores; `group` for groups of different cameras, sizes or frame rates
    #[arg(long, value_enum, default_value = "corpus")]
    normalise_within: NormaliseWithin,
    /// Print the summary as JSON on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum FormatArg {
    Jsonl,
    Parquet,
    Csv,
}

impl From<FormatArg> for Format {
    fn from(format: FormatArg) -> Self {
        match format {
            FormatArg::Jsonl => Self::Jsonl,
            FormatArg::Parquet => Self::Parquet,
            FormatArg::Csv => Self::Csv,
        }
    }
}

pub(super) fn run(args: ScoreArgs) -> Result<u8, Failure> {
    let json = args.json;
    let options = args.into_options()?;
    let runtime = super::runtime()?;
    let finished = runtime.block_on(run::score(&options));
    // Children are ended by dropping their handles, which needs the runtime no longer.
    runtime.shutdown_background();
    match finished {
        Ok(finished) => {
            summary::table(&finished);
            if json {
                let text = serde_json::to_string_pretty(&summary::json(&finished))
                    .map_err(Failure::stopped)?;
                writeln!(std::io::stdout(), "{text}").map_err(|error| {
                    let out = finished.out.display();
                    Failure::stopped(format!(
                        "the summary cannot be written to standard output ({error}); the results are whole, in {out}"
                    ))
                })?;
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
                RunError::Corpus(_) | RunError::OutInUse { .. } | RunError::Profile(_) => {
                    exit::USAGE
                }
                _ => exit::STOPPED,
            },
            message: error.to_string(),
        }),
    }
}

impl ScoreArgs {
    /// From what was typed to what is usable.
    fn into_options(self) -> Result<ScoreOptions, Failure> {
        let Measuring { mut profile, slots } = self.measuring.usable(self.jobs)?;
        let fault_calibration = self.thresholds.apply(&mut profile)?;
        let profile_digest = profile.digest().map_err(Failure::usage)?;
        Ok(ScoreOptions {
            sources: self.sources,
            out: self.out,
            group_by: self.group_by,
            profile,
            reduce: ReduceOptions {
                recipe: self.recipe,
                bins: self.bins,
                range: self.range,
                keep: self.keep,
                profile_digest,
                normalise_within: self.normalise_within,
            },
            resume: !self.no_resume,
            formats: self.format.into_iter().map(Format::from).collect(),
            fault_calibration,
            heat_maps: self.heatmaps,
            slots,
        })
    }
}
