//! Fits the shipped fault thresholds on the rendered sample's clean clips and prints them:
//! `cargo run --release -p plumbline-vision --example fit_fault_thresholds [draft|standard|accurate]...`
//!
//! Seeds 1 to 6 (72 clips of 32 frames at 256×192, two thirds with a static camera), the 99th
//! percentile of the clips' largest scores. Seed 0 is left for the test. Takes minutes: rendering and
//! flow. Panics where a clip cannot be rendered.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a tool for developers"
)]

#[path = "../tests/support/mod.rs"]
mod support;

use plumbline_sample::{Family, sample_corpus};
use plumbline_vision::faults::{FaultKind, fit_thresholds};
use support::{ACCURATE, DRAFT, Rung, STANDARD, measure, on_two_threads, picture};

const SEEDS: std::ops::RangeInclusive<u64> = 1..=6;
const PERCENTILE: f64 = 99.0;

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let rungs: Vec<Rung> = [DRAFT, STANDARD, ACCURATE]
        .into_iter()
        .filter(|rung| asked.is_empty() || asked.iter().any(|name| name == rung.name))
        .collect();
    let clips: Vec<_> = SEEDS
        .flat_map(sample_corpus)
        .filter(|clip| clip.fault.is_none())
        .collect();
    let series = on_two_threads(&clips, |clip| {
        // The first frame is left out, as the worker leaves out the conditioning frame.
        let pictures: Vec<_> = (1..clip.frames)
            .map(|frame| picture(clip.render_frame(frame).unwrap()))
            .collect();
        let is_static = matches!(clip.family, Family::Pick | Family::Push | Family::Reach);
        rungs
            .iter()
            .map(|&rung| measure(pictures.iter().cloned(), 1, rung, is_static).0)
            .collect::<Vec<_>>()
    });
    for (place, rung) in rungs.iter().enumerate() {
        let clean: Vec<_> = series.iter().map(|rungs| rungs[place].clone()).collect();
        println!(
            "{}: {:?}",
            rung.name,
            fit_thresholds(&clean, PERCENTILE).unwrap()
        );
        for kind in FaultKind::ALL {
            let mut largest: Vec<f64> = clean
                .iter()
                .filter_map(|series| Some(series.largest(kind)?.score))
                .collect();
            largest.sort_by(f64::total_cmp);
            let share = |p: f64| largest.get((p * (largest.len().max(1) - 1) as f64) as usize);
            println!(
                "  {:9} n {:2} median {:?} p90 {:?} largest {:?}",
                kind.as_str(),
                largest.len(),
                share(0.5),
                share(0.9),
                largest.last()
            );
        }
    }
}
