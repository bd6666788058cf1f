//! The fault detectors on clips with known faults, `evidence.md`, section 4, as Markdown:
//! `cargo run --release -p plumbline-vision --example injected_faults fit | sample | real [EVERY]`
//!
//! The real clips are those of static cameras in `../shared/data/rollouts/real` with at least 26 frames,
//! in two halves by a hash of the file name. `fit` prints the 99th percentile of the first half's clean
//! clips, on which everything else was chosen, too. `real` tables the other half (every EVERYth clip) at
//! the shipped thresholds, `sample` the rendered sample's faults under a static camera. Takes minutes.
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

use inject::evaluate::{Source, measure as measure_injected, print_tables};
use inject::real::Half;
use inject::{KINDS, real};
use plumbline_sample::{ClipSpec, Family, sample_corpus};
use plumbline_vision::faults::{FaultThresholds, fit_thresholds};
use support::{STANDARD, measure, on_two_threads, picture};

const PERCENTILE: f64 = 99.0;
/// Seeds of the sample that its thresholds were not fitted on.
const SAMPLE_SEEDS: [u64; 2] = [0, 7];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let every = arguments.get(1).map_or(1, |text| text.parse().unwrap());
    match arguments.first().map(String::as_str) {
        Some("fit") => fit(),
        Some("sample") => sample(),
        Some("real") => table(every),
        _ => println!("usage: injected_faults fit | sample | real [EVERY]"),
    }
}

fn clips(half: Half) -> Vec<std::path::PathBuf> {
    let Some(paths) = real::static_clips() else {
        println!("skipped: no ../shared or no ffmpeg");
        return Vec::new();
    };
    let of_half = paths.into_iter().filter(|path| Half::of(path) == half);
    of_half.collect()
}

fn fit() {
    let paths: Vec<_> = clips(Half::Fit)
        .into_iter()
        .filter(|path| real::is_clean(path))
        .collect();
    let sources = measure_injected(&paths, &[]);
    let clean = sources.iter().map(|source| &source.clean.faults);
    let fitted = fit_thresholds(clean, PERCENTILE).unwrap();
    println!("fitted on {} clean clips: {fitted:?}", sources.len());
    for (name, reason) in real::NOT_CLEAN {
        println!("not clean, left out: `{name}` ({reason})");
    }
}

fn table(every: usize) {
    let paths: Vec<_> = clips(Half::HeldOut).into_iter().step_by(every).collect();
    let sources = measure_injected(&paths, &KINDS);
    if sources.is_empty() {
        return;
    }
    let injections: usize = sources.iter().map(|source| source.outcomes.len()).sum();
    println!(
        "{} held-out clips, {injections} injections, at `STANDARD_RECORDED`\n",
        sources.len()
    );
    print_tables(
        &sources.iter().collect::<Vec<&Source>>(),
        &FaultThresholds::STANDARD_RECORDED,
    );
}

fn sample() {
    let is_static = |clip: &ClipSpec| {
        let family = clip.family;
        matches!(family, Family::Pick | Family::Push | Family::Reach)
    };
    let clips: Vec<ClipSpec> = SAMPLE_SEEDS
        .into_iter()
        .flat_map(sample_corpus)
        .filter(|clip| clip.fault.is_some() && is_static(clip))
        .collect();
    let events = |clip: &ClipSpec| {
        let pictures = (1..clip.frames).map(|frame| picture(clip.render_frame(frame).unwrap()));
        let series = measure(pictures, 1, STANDARD, true).0;
        series.events(&FaultThresholds::STANDARD)
    };
    let results = on_two_threads(&clips, |clip| (events(clip), events(&clip.clean_twin())));
    println!("Rendered clips at `STANDARD`, seeds {SAMPLE_SEEDS:?}:\n");
    println!("| clip | fault, frames | events within one frame | others | on its clean twin |");
    println!("|---|---|---|---|---|");
    for (clip, (faulty, clean)) in clips.iter().zip(&results) {
        let truth = clip.fault_truth().unwrap().unwrap();
        let near = |frame: usize| (truth.first_frame..=truth.last_frame + 2).contains(&(frame + 1));
        let kinds: Vec<_> = faulty
            .iter()
            .filter(|event| near(event.frame))
            .map(|event| event.kind.as_str())
            .collect();
        println!(
            "| {} | {:?}, {}–{} | {} | {} | {} |",
            clip.name,
            truth.kind,
            truth.first_frame,
            truth.last_frame,
            kinds.join(", "),
            faulty.len() - kinds.len(),
            clean.len()
        );
    }
}
