//! `plumbline reference`: what later runs are compared with.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::measuring::{Measuring, MeasuringArgs};
use super::summary::printable;
use super::{Failure, exit};
use crate::progress::say;
use crate::reference::{self, FitError, FitOptions, Fitted, MIN_CLIPS};

/// Clips left out that are named on the terminal.
const NAMED: usize = 10;

/// Fits what later runs are compared with
#[derive(Debug, Args)]
pub(super) struct ReferenceArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Fit(FitArgs),
}

/// Fits fault thresholds on clips known to be clean, for --fault-thresholds
#[derive(Debug, Args)]
struct FitArgs {
    /// Clean clips of the camera and codec to be judged: videos, directories, globs or lists
    #[arg(long, required = true, num_args = 1.., value_name = "CLEAN")]
    faults: Vec<String>,
    /// File for the thresholds
    #[arg(long, value_name = "THRESHOLDS.json")]
    out: PathBuf,
    /// Share of clean clips that stay below a threshold
    #[arg(long, value_name = "Q", default_value_t = 0.99)]
    quantile: f64,
    /// Videos measured at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    #[command(flatten)]
    measuring: MeasuringArgs,
}

pub(super) fn run(args: ReferenceArgs) -> Result<u8, Failure> {
    let What::Fit(args) = args.what;
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
    let fitted = runtime.block_on(reference::fit(&options));
    runtime.shutdown_background();
    let fitted = fitted.map_err(|error| Failure {
        code: match &error {
            FitError::Interrupted => exit::INTERRUPTED,
            FitError::Corpus(_) | FitError::TooFew { .. } | FitError::NoName { .. } => exit::USAGE,
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
