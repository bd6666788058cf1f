//! `plumbline reference`: what later runs are compared with.

use std::num::NonZeroU16;
use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::measuring::{Measuring, MeasuringArgs};
use super::summary::printable;
use super::{Failure, exit};
use crate::progress::say;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::select::KeepRule;
use crate::reduce::{ReduceOptions, recipe_name};
use crate::reduce_files::freeze::freeze;
use crate::reduce_files::{Budget, ReduceFilesOptions};
use crate::reference::faults::{self, FitError, FitOptions, Fitted, MIN_CLIPS};
use crate::reference::file::{ReferenceError, ReferenceFile, directory_and_name};

/// Clips left out that are named on the terminal.
const NAMED: usize = 10;

/// Below so many rows a reference follows single ones; said, not refused.
const STEADY_ROWS: u64 = 30;

/// Fits what later runs are compared with
#[derive(Debug, Args)]
pub(super) struct ReferenceArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Fit(Box<FitArgs>),
}

/// Freezes the statistics of rows that exist, for --reference; or fits fault thresholds on clean clips,
/// for --fault-thresholds
#[derive(Debug, Args)]
struct FitArgs {
    /// Rows to freeze: a run's OUT, scores.parquet or .jsonl, or directories of parts
    // Arguments one by one where their struct holds others, since such a struct's group has no members.
    #[arg(required_unless_present = "faults", conflicts_with_all = ["faults", "conditioning_frames", "warmup", "profile", "SettingArgs"], value_name = "SCORES")]
    scores: Vec<PathBuf>,
    /// Clean clips of the camera and codec to be judged: videos, directories, globs or lists
    #[arg(long, num_args = 1.., value_name = "CLEAN")]
    faults: Vec<String>,
    /// File for the reference or the thresholds
    #[arg(long, value_name = "REF.json")]
    out: PathBuf,
    /// Histogram bins behind the entropy weights
    #[arg(
        long,
        value_name = "N",
        default_value = "30",
        conflicts_with = "faults"
    )]
    bins: NonZeroU16,
    /// Histogram range behind the entropy weights
    #[arg(long, value_enum, default_value = "full", conflicts_with = "faults")]
    range: Range,
    /// Share of clean clips that stay below a threshold
    #[arg(long, value_name = "Q", default_value_t = 0.99, requires = "faults")]
    quantile: f64,
    /// Clips measured, or threads for the statistics, at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    #[command(flatten)]
    measuring: MeasuringArgs,
}

pub(super) fn run(args: ReferenceArgs) -> Result<u8, Failure> {
    let What::Fit(args) = args.what;
    if args.faults.is_empty() {
        freeze_rows(*args)
    } else {
        fit_faults(*args)
    }
}

fn freeze_rows(args: FitArgs) -> Result<u8, Failure> {
    let refused = |error: ReferenceError| match error {
        ReferenceError::Publish(_) => Failure::stopped(error),
        _ => Failure::usage(error),
    };
    let (directory, _) = directory_and_name(&args.out).map_err(refused)?;
    std::fs::create_dir_all(directory)
        .map_err(|error| Failure::stopped(format!("{}: {error}", directory.display())))?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let options = ReduceFilesOptions {
        sources: args.scores,
        out: args.out.clone(),
        group_by: None,
        reduce: ReduceOptions {
            recipe: Recipe::Balanced,
            bins: args.bins,
            range: args.range,
            keep: KeepRule::Best(1),
            profile_digest: String::new(),
            normalise_within: NormaliseWithin::Corpus,
            reference: None,
        },
        formats: std::collections::BTreeSet::new(),
        threads: args.jobs.map_or(cores, usize::from),
        budget: Budget::default(),
    };
    let (frozen, profile) =
        freeze(&options, directory).map_err(|error| match error.is_usage() {
            true => Failure::usage(error),
            false => Failure::stopped(error),
        })?;
    let file = ReferenceFile::new(frozen, profile).map_err(refused)?;
    file.write(&args.out).map_err(refused)?;
    let frozen = file.statistics();
    let n = frozen.population.n;
    for recipe in [Recipe::Paper, Recipe::Balanced].map(recipe_name) {
        say(&match frozen.scores.get(recipe) {
            Some(scores) => format!("{recipe}: {} rows have a score", scores.distribution.n),
            None => format!("{recipe}: no signal tells the rows apart; it cannot be scored by"),
        });
    }
    if n < STEADY_ROWS {
        say(&format!(
            "note: of {n} rows, single ones move the statistics; {STEADY_ROWS} or more make a steadier reference"
        ));
    }
    say(&format!(
        "reference of {n} rows: {} ({})",
        args.out.display(),
        file.digest()
    ));
    Ok(exit::OK)
}

fn fit_faults(args: FitArgs) -> Result<u8, Failure> {
    if !(args.quantile > 0.0 && args.quantile <= 1.0) {
        return Err(Failure::usage("--quantile must be above 0 and at most 1"));
    }
    let Measuring { profile, slots } = args.measuring.usable(args.jobs)?;
    let options = FitOptions {
        sources: args.faults,
        out: args.out,
        profile,
        quantile: args.quantile,
        slots,
    };
    let runtime = super::runtime()?;
    let fitted = runtime.block_on(faults::fit(&options));
    runtime.shutdown_background();
    let fitted = fitted.map_err(|error| Failure {
        code: match &error {
            FitError::Interrupted => exit::INTERRUPTED,
            FitError::Corpus(_) | FitError::TooFew { .. } | FitError::NoName(_) => exit::USAGE,
            _ => exit::STOPPED,
        },
        message: error.to_string(),
    })?;
    tell(&options, &fitted);
    Ok(if fitted.unused.is_empty() {
        exit::OK
    } else {
        exit::INCOMPLETE
    })
}

fn tell(options: &FitOptions, fitted: &Fitted) {
    let file = &fitted.file;
    for kind in plumbline_vision::faults::FaultKind::ALL {
        let name = kind.as_str();
        let clips = file.kinds.get(name).map_or(0, |kind| kind.clips);
        say(&match file.thresholds.of(kind) {
            Some(threshold) => format!("{name}: {threshold:.4} ({clips} clips)"),
            None => format!(
                "{name}: not fitted, since only {clips} clips could be judged ({MIN_CLIPS} are needed); it will not be reported"
            ),
        });
    }
    // The quantile lies between the two largest clips: it follows them, not the clips as a whole.
    if (file.clips as f64) * (1.0 - file.quantile) < 1.0 {
        say(&format!(
            "note: with {} clips this quantile follows the largest of them; more clips make it steadier",
            file.clips
        ));
    }
    for (video, reason) in fitted.unused.iter().take(NAMED) {
        let line = format!("left out: {}: {reason}", video.as_str());
        say(&printable(&line));
    }
    if let Some(more) = fitted.unused.len().checked_sub(NAMED).filter(|n| *n > 0) {
        say(&format!("and {more} more left out"));
    }
    let name = options.out.display();
    say(&format!("thresholds of {} clips: {name}", file.clips));
}
