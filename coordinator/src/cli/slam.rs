//! `plumbline slam`: the camera's trajectory of one video, and its depths where they can be known.

use std::path::{Path, PathBuf};

use clap::Args;
use plumbline_vision::slam::trajectory::{TimedPose, parse_tum};

use super::explain::{OneVideoArgs, failure};
use super::measuring::{ComputingArgs, Measuring};
use super::summary::printable;
use super::{Failure, exit, print_json};
use crate::progress::say;
use crate::slam::{self, SlamOptions};

/// Finds the camera's trajectory (TUM format) and inverse depths of one video by dense bundle adjustment
#[derive(Debug, Args)]
pub(super) struct SlamArgs {
    #[command(flatten)]
    video: OneVideoArgs,
    /// Directory for the results; those of an earlier run are replaced
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// True trajectory (TUM format) to measure the error against
    #[arg(long, value_name = "TRAJECTORY")]
    gt: Option<PathBuf>,
    #[command(flatten)]
    computing: ComputingArgs,
    /// Print slam.json on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: SlamArgs) -> Result<u8, Failure> {
    let Measuring { profile, slots } = args.computing.usable(Some(1))?;
    let options = SlamOptions {
        video: args.video.into(),
        out: args.out,
        profile,
        truth: args.gt.as_deref().map(read_truth).transpose()?,
        slots,
    };
    let runtime = super::runtime()?;
    let result = runtime.block_on(slam::slam(&options));
    runtime.shutdown_background();
    let result = result.map_err(|error| failure(&error))?;
    for line in &result.summary {
        say(&printable(line));
    }
    if args.json {
        print_json(&result.json, &options.out)?;
    }
    Ok(if result.tracked {
        exit::OK
    } else {
        exit::INCOMPLETE
    })
}

fn read_truth(path: &Path) -> Result<Vec<TimedPose>, Failure> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        Failure::usage(format!(
            "{name}: {error}; check that the file exists and may be read"
        ))
    })?;
    parse_tum(&text).map_err(|error| Failure::usage(format!("{name}: {error}")))
}
