//! The options by which rows become scores and decisions, wherever the rows come from.

use std::collections::BTreeSet;
use std::num::NonZeroU16;

use clap::{Args, ValueEnum};

use crate::publish::Format;
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::select::KeepRule;

/// What was typed.
#[derive(Debug, Args)]
pub(super) struct ReducingArgs {
    /// Signals combined into the anomaly score
    #[arg(long, value_enum, default_value = "balanced")]
    recipe: Recipe,
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
    /// Formats of the tables
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "jsonl,parquet,csv"
    )]
    format: Vec<FormatArg>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum FormatArg {
    Jsonl,
    Parquet,
    Csv,
}

impl ReducingArgs {
    /// How rows that a profile of this digest measured are reduced.
    pub(super) fn options(&self, profile_digest: String) -> ReduceOptions {
        ReduceOptions {
            recipe: self.recipe,
            bins: self.bins,
            range: self.range,
            keep: self.keep,
            profile_digest,
            normalise_within: self.normalise_within,
        }
    }

    pub(super) fn formats(&self) -> BTreeSet<Format> {
        let format = |&format: &FormatArg| match format {
            FormatArg::Jsonl => Format::Jsonl,
            FormatArg::Parquet => Format::Parquet,
            FormatArg::Csv => Format::Csv,
        };
        self.format.iter().map(format).collect()
    }
}
