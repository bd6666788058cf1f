//! The fault detectors on real clips with injected faults, `evidence.md`, section 4, as Markdown:
//! `cargo run --release -p plumbline-vision --example injected_faults`
//!
//! All static-camera clips of `../shared/data/rollouts/real` with at least 26 frames, in two halves by a
//! hash of the file name. Thresholds are the 99th percentile of the first half's clean clips (everything
//! else was chosen on that half, too); the tables are of the other half, and of the rendered sample.
//! Takes minutes. Panics where a clip cannot be decoded.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a tool for developers"
)]

#[path = "../tests/inject/mod.rs"]
mod inject;
#[path = "../tests/support/mod.rs"]
mod support;

use inject::evaluate::{Source, measure, print_tables};
use inject::real::Half;
use inject::{KINDS, real};
use plumbline_vision::faults::{FaultThresholds, fit_thresholds};

const PERCENTILE: f64 = 99.0;

fn main() {
    let Some(paths) = real::static_clips() else {
        println!("skipped: no ../shared or no ffmpeg");
        return;
    };
    let half = |half| {
        let of_half = paths.iter().filter(|path| Half::of(path) == half);
        of_half.cloned().collect::<Vec<_>>()
    };
    // Only their clean scores are needed.
    let fit = measure(&half(Half::Fit), &[]);
    let fitted = fit_thresholds(fit.iter().map(|s| &s.clean.faults), PERCENTILE).unwrap();
    println!("- fitted on {} clean clips: `{fitted:?}`", fit.len());
    println!("- shipped: `{:?}`", FaultThresholds::STANDARD_RECORDED);
    let held_out = measure(&half(Half::HeldOut), &KINDS);
    let injections: usize = held_out.iter().map(|source| source.outcomes.len()).sum();
    println!(
        "- held out: {} clips, {injections} injections, at the fitted thresholds\n",
        held_out.len()
    );
    print_tables(&held_out.iter().collect::<Vec<&Source>>(), &fitted);
}
