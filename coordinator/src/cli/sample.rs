//! `plumbline sample`: renders the sample corpus, with its truth beside it.

use std::path::PathBuf;

use clap::Args;
use plumbline_sample::corpus::{camera_corpus, sample_corpus};

use super::{Failure, exit};
use crate::progress::{Progress, say};
use crate::sample::{SampleDir, Truth};

/// Renders a small corpus of robot clips with exact flow, depth and poses, half of them with a known fault
#[derive(Debug, Args)]
pub(super) struct SampleArgs {
    /// Directory for videos/, truth/ and labels.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Another seed renders another corpus
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Clips of one size and length whose cameras stand, turn or travel, without faults: to compare what they cost
    #[arg(long)]
    cameras: bool,
    /// Leave out the dense truth (flow, depth, bodies); poses and labels are always written
    #[arg(long)]
    no_dense_truth: bool,
}

pub(super) fn run(args: &SampleArgs) -> Result<u8, Failure> {
    let truth = if args.no_dense_truth {
        Truth::Poses
    } else {
        Truth::Dense
    };
    let sample = SampleDir::create(&args.out).map_err(Failure::stopped)?;
    let clips = match args.cameras {
        true => camera_corpus(args.seed),
        false => sample_corpus(args.seed),
    };
    let mut progress = Progress::start(clips.len() as u64, 0);
    let written = sample.write_clips(&clips, truth, || progress.advance(true));
    progress.finish();
    written.map_err(Failure::stopped)?;
    sample.write_labels(&clips).map_err(Failure::stopped)?;
    say(&format!(
        "{} clips in {}; their faults are in {}",
        clips.len(),
        sample.videos().display(),
        sample.labels().display()
    ));
    Ok(exit::OK)
}
