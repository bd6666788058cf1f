//! `plumbline report`: the page of a finished run, made again.

use std::path::PathBuf;

use clap::Args;

use super::{Failure, exit};
use crate::progress::say;
use crate::rebuild::rebuild;

/// Makes report.html again, of a run that `score` or `reduce` finished
#[derive(Debug, Args)]
pub(super) struct ReportArgs {
    /// Directory of the run
    #[arg(value_name = "OUT")]
    out: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> Result<u8, Failure> {
    let path = rebuild(&args.out).map_err(|error| {
        if error.is_usage() {
            Failure::usage(error)
        } else {
            Failure::stopped(error)
        }
    })?;
    say(&format!("report: {}", path.display()));
    Ok(exit::OK)
}
