//! wip
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "what cannot be read fails the test; the table is what it is for"
)]

#[path = "prototype/compare.rs"]
mod compare;
#[path = "prototype/export.rs"]
mod export;
#[path = "prototype/measured.rs"]
mod measured;

use std::path::{Path, PathBuf};

use compare::{Deviations, Tolerance};
use export::Export;
use measured::{Input, Measured, Series, change_pair, measure};
use plumbline_vision::consistency::{ConsistencyParams, Evidence, NormalisedFrame};
use plumbline_vision::faults::ChangePair;

/// Runs this crate on the frames and flow of an export.
fn on_the_prototypes_flow(export: &mut Export) -> Measured {
    let greys = export.planes("grid_grey");
    let params = ConsistencyParams {
        reference_height_px: export.reference_height_px,
        grid_height: greys[0].height,
        ..ConsistencyParams::default()
    };
    let frames: Vec<NormalisedFrame> = greys
        .iter()
        .map(|grey| NormalisedFrame::new(grey, &params).unwrap())
        .collect();
    let mut pairs = |span: usize| -> Vec<ChangePair> {
        let forward = export.grid_flows(&format!("forward{span}"));
        let backward = export.grid_flows(&format!("backward{span}"));
        let flows = forward.iter().zip(&backward).enumerate();
        flows
            .map(|(t, (ahead, back))| {
                change_pair(ahead, back, &frames[t], &frames[t + span], &params)
            })
            .collect()
    };
    let (adjacent, skip) = (pairs(1), pairs(2));
    let kept = export.indices("kept");
    let steps: Vec<Evidence> = if export.has("kept_forward") {
        let forward = export.grid_flows("kept_forward");
        let backward = export.grid_flows("kept_backward");
        let flows = forward.iter().zip(&backward).zip(kept.windows(2));
        flows
            .map(|((ahead, back), step)| {
                let (first, second) = (&frames[step[0]], &frames[step[1]]);
                Evidence::new(ahead, back, first, second, &params).unwrap()
            })
            .collect()
    } else {
        adjacent.iter().map(|pair| pair.forward.clone()).collect()
    };
    measure(Input {
        frames: &frames,
        pictures: &export.pictures("grid_rgb"),
        adjacent: &adjacent,
        skip: &skip,
        kept: &kept,
        steps,
    })
}

/// Adds what is comparable value by value.
fn compare_series(clip: &str, ours: &Measured, export: &mut Export, into: &mut Deviations) {
    for signal in ["P", "T", "accs", "Sd", "sh", "V"] {
        into.add(clip, signal, &ours.series[signal], &export.series(signal));
    }
    into.add(clip, "xr", &ours.series["xr"][1..], &export.series("xr"));
    for signal in ["step_text", "vanq", "pers_in_frame"] {
        let theirs = export.series(signal);
        // The prototype has 0 where there are too few frames to judge.
        let judged = |(ours, theirs): (&Option<f64>, &Option<f64>)| ours.and(*theirs);
        let theirs: Series = ours.series[signal].iter().zip(&theirs).map(judged).collect();
        into.add(clip, signal, &ours.series[signal], &theirs);
    }
    let freeze = freeze_scores(&export.series("change"));
    into.add(clip, "freeze", &ours.series["freeze"][1..], &freeze);
    let (moved, changed) = (export.value("U"), export.value("R_c"));
    into.add(clip, "U", &[Some(ours.moved_share)], &[Some(moved)]);
    into.add(clip, "R_c", &[Some(ours.revealed_changed)], &[Some(changed)]);
}

fn freeze_scores(changes: &[Option<f64>]) -> Series {
    let changes: Vec<f64> = changes.iter().map(|change| change.unwrap()).collect();
    let median = plumbline_vision::signals::median(&mut changes.clone()).unwrap();
    (0..changes.len())
        .map(|pair| {
            let mut quietest = f64::INFINITY;
            for start in pair.saturating_sub(1)..=pair.min(changes.len() - 2) {
                quietest = quietest.min(changes[start].max(changes[start + 1]));
            }
            Some((1.0 - quietest / median).max(0.0))
        })
        .collect()
}

fn tolerance(_signal: &str) -> Tolerance {
    Tolerance {
        relative: 1e-3,
        absolute: 1e-6,
        share_beyond: 1.0,
    }
}

fn clips() -> Option<Vec<PathBuf>> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("prototype");
    let mut clips: Vec<PathBuf> = std::fs::read_dir(folder).ok()?.map(|entry| entry.unwrap().path()).collect();
    clips.sort();
    Some(clips)
}

#[test]
fn the_rendered_clip_agrees_on_the_prototypes_flow() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/prototype.npz");
    let mut export = Export::open(&path);
    let ours = on_the_prototypes_flow(&mut export);
    let mut deviations = Deviations::default();
    compare_series("rendered clip", &ours, &mut export, &mut deviations);
    deviations.check(tolerance);
}

#[test]
fn ten_clips_agree_on_the_prototypes_flow() {
    let Some(clips) = clips() else {
        println!("skipped");
        return;
    };
    let mut deviations = Deviations::default();
    for path in clips {
        let mut export = Export::open(&path);
        let ours = on_the_prototypes_flow(&mut export);
        compare_series(path.to_str().unwrap(), &ours, &mut export, &mut deviations);
    }
    deviations.check(tolerance);
}
