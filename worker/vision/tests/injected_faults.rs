//! The fault detectors on a few real clips with injected faults; `examples/injected_faults.rs` runs all
//! of them and prints the table. Skips without `../shared` beside the repository or without ffmpeg.

mod inject;
mod support;

use inject::evaluate::{bootstrap, detector_auroc, measure, pointing, share, temporal};
use inject::{Kind, real};
use plumbline_vision::faults::FaultKind;

/// Clips of the quick run, spread over the sources.
const CLIPS: usize = 4;

#[test]
fn injected_faults_are_found_in_time_and_place() {
    let Some(paths) = real::static_clips() else {
        println!("skipped: no ../shared or no ffmpeg");
        return;
    };
    let step = paths.len() / CLIPS;
    let chosen: Vec<_> = paths.into_iter().step_by(step).take(CLIPS).collect();
    let kinds = [
        Kind::Noise,
        Kind::Foreign,
        Kind::Blur,
        Kind::Appear,
        Kind::Freeze,
    ];
    let sources = measure(&chosen, &kinds);
    let sources: Vec<_> = sources.iter().collect();
    assert!(sources.len() >= 3, "{} clips long enough", sources.len());
    // Floors below the full run's figures by about what four clips scatter.
    let floors = [
        (Kind::Noise, FaultKind::BadFrame, 1.0, 1.0, 0.0),
        (Kind::Foreign, FaultKind::BadFrame, 1.0, 1.0, 0.0),
        (Kind::Blur, FaultKind::BadFrame, 0.9, 0.8, 0.0),
        (Kind::Appear, FaultKind::Appear, 0.8, 0.8, 0.8),
        (Kind::Freeze, FaultKind::Freeze, 0.8, 0.8, 0.0),
    ];
    for (kind, detector, auroc, hit, place) in floors {
        let found = [
            detector_auroc(&sources, kind, detector),
            temporal(&sources, kind, detector),
        ];
        let interval = bootstrap(&sources, |s| detector_auroc(s, kind, detector));
        println!("{kind:?}: AUROC {interval}, hit {:.2}", found[1]);
        assert!(found[0] >= auroc && found[1] >= hit, "{kind:?}: {found:?}");
        if place > 0.0 {
            let found = pointing(&sources, kind, detector);
            assert!(found >= place, "{kind:?}: pointing {found}");
        }
    }
    // The paper's rule misplaces single bad frames; were it as good, V would not be needed.
    let paper = share(sources.iter().flat_map(|source| {
        let single = source.outcomes.iter().filter(|o| o.span[0] == o.span[1]);
        single.map(|outcome| outcome.is_near(outcome.scores.paper_peak().0))
    }));
    println!("paper's rule on single frames: hit {paper:.2}");
    assert!(paper < 0.9, "{paper}");
}
