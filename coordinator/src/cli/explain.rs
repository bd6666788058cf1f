//! `plumbline explain`: one video's absolute assessment, told in a few lines and in files.

use std::path::PathBuf;

use clap::Args;

use super::measuring::{Measuring, MeasuringArgs, ThresholdsArg};
use super::summary::printable;
use super::{Failure, exit, print_text};
use crate::explain::{self, ExplainOptions, Explained, OneVideo, RunError};
use crate::progress::say;
use crate::publish::PublishError;

/// The video of a command on one.
#[derive(Debug, Args)]
pub(super) struct OneVideoArgs {
    /// The video, a directory of numbered images, or a dataset or shard that holds it
    #[arg(value_name = "VIDEO")]
    source: String,
    /// Which of the source's videos, by its name in scores.*
    #[arg(long = "video", value_name = "NAME")]
    name: Option<String>,
}

impl From<OneVideoArgs> for OneVideo {
    fn from(args: OneVideoArgs) -> Self {
        Self {
            source: args.source,
            name: args.name,
        }
    }
}

/// Explains one video: its series, peak and faults with frame, time and place, heat maps, and an overlay video
#[derive(Debug, Args)]
pub(super) struct ExplainArgs {
    #[command(flatten)]
    video: OneVideoArgs,
    /// Directory for the results; those of an earlier explanation are replaced
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    measuring: MeasuringArgs,
    #[command(flatten)]
    thresholds: ThresholdsArg,
    /// Print explain.json on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: ExplainArgs) -> Result<u8, Failure> {
    let measuring = args.measuring.usable(Some(1))?;
    measuring.load_networks()?;
    let Measuring { mut profile, slots } = measuring;
    let fault_calibration = args.thresholds.apply(&mut profile)?;
    let options = ExplainOptions {
        video: args.video.into(),
        out: args.out,
        profile,
        fault_calibration,
        slots,
    };
    let runtime = super::runtime()?;
    let explained = runtime.block_on(explain::explain(&options));
    runtime.shutdown_background();
    match explained {
        Ok(explained) => {
            tell(&explained);
            if args.json {
                print_text(&explained.json, &options.out)?;
            }
            Ok(if explained.complete() {
                exit::OK
            } else {
                exit::INCOMPLETE
            })
        }
        Err(error) => Err(failure(&error)),
    }
}

/// How a command on one video fails.
pub(super) fn failure(error: &RunError) -> Failure {
    Failure {
        code: match error {
            RunError::Interrupted => exit::INTERRUPTED,
            RunError::Corpus(_)
            | RunError::NotOne { .. }
            | RunError::NoSuchVideo { .. }
            | RunError::OutInUse { .. }
            | RunError::ScoresThere { .. }
            | RunError::Profile(_)
            | RunError::Publish(PublishError::InTheWay { .. }) => exit::USAGE,
            _ => exit::STOPPED,
        },
        message: error.to_string(),
    }
}

fn tell(explained: &Explained) {
    for line in explained.summary() {
        say(&printable(&line));
    }
}
