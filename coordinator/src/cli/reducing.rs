//! The options by which rows become scores and decisions, wherever the rows come from.

use std::collections::BTreeSet;
use std::num::NonZeroU16;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use plumbline_worker::profile::Profile;

use super::Failure;
use crate::publish::Format;
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::reference::Reference;
use crate::reduce::select::KeepRule;
use crate::reference::file;

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
    /// Statistics to score against in place of the corpus' own: a file that `reference fit` wrote
    #[arg(long, value_name = "REF.json", conflicts_with_all = ["bins", "range", "normalise_within"])]
    reference: Option<PathBuf>,
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
    /// How rows are reduced that a profile measures, or (`None`) that exist and say so themselves.
    pub(super) fn options(&self, profile: Option<&Profile>) -> Result<ReduceOptions, Failure> {
        let load = |path: &PathBuf| file::load(path, self.recipe, profile);
        let reference = self.reference.as_ref().map(load).transpose();
        let reference = reference.map_err(Failure::usage)?;
        let frozen = reference.as_deref().map(Reference::frozen);
        let digest = profile.map(Profile::digest).transpose();
        Ok(ReduceOptions {
            recipe: self.recipe,
            bins: frozen.map_or(self.bins, |frozen| frozen.bins),
            range: frozen.map_or(self.range, |frozen| frozen.range),
            keep: self.keep,
            profile_digest: digest.map_err(Failure::usage)?.unwrap_or_default(),
            normalise_within: self.normalise_within,
            reference,
        })
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
