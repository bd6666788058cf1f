//! The fault detectors on real clips with injected faults, `evidence.md`, section 4, in full:
//! `cargo run --release -p plumbline-vision --example injected_faults [PERCENTILE]`
//!
//! All static-camera clips of `../shared/data/rollouts/real` with at least 26 frames. Thresholds at the
//! PERCENTILE (default 99) of the clean scores of every other clip; figures on the rest. Takes minutes.
//! Panics where a clip cannot be decoded.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a tool for developers"
)]

#[path = "../tests/inject/mod.rs"]
mod inject;
#[path = "../tests/support/mod.rs"]
mod support;

use inject::evaluate::{Source, largest, measure, print_table, share};
use inject::{KINDS, real};
use plumbline_vision::faults::{FaultKind, FaultThresholds, fit_thresholds};

fn main() {
    let percentile = std::env::args()
        .nth(1)
        .map_or(99.0, |text| text.parse().unwrap());
    let Some(paths) = real::static_clips() else {
        println!("skipped: no ../shared or no ffmpeg");
        return;
    };
    let sources = measure(&paths, &KINDS);
    let half = |rest: usize| sources.iter().skip(rest).step_by(2).collect::<Vec<_>>();
    let (fit, test) = (half(0), half(1));
    let thresholds =
        fit_thresholds(fit.iter().map(|source| &source.clean.faults), percentile).unwrap();
    println!(
        "{} clips to fit, {} to test; {thresholds:?}",
        fit.len(),
        test.len()
    );
    print_table(&test, &thresholds);
    let all = fit_thresholds(sources.iter().map(|s| &s.clean.faults), percentile).unwrap();
    println!("\nfitted on all {} clips: {all:?}", sources.len());
    let shipped = FaultThresholds::STANDARD;
    for kind in FaultKind::ALL {
        let above = |s: &Source| {
            shipped
                .of(kind)
                .is_some_and(|t| largest(&s.clean, kind) > t)
        };
        println!(
            "clean clips above the rendered sample's threshold of {:9} {:.2}",
            kind.as_str(),
            share(sources.iter().map(above))
        );
    }
    println!(
        "\nall {} clips, same thresholds (the AUROC and hit columns need none):",
        sources.len()
    );
    print_table(&sources.iter().collect::<Vec<_>>(), &thresholds);
}
