//! Clean and injected clips to the table of the evidence: AUROC, temporal hit, pointing, rates at the
//! threshold; with bootstrap intervals over clips.

use plumbline_vision::faults::{FaultKind, FaultThresholds};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::run::{CleanClip, Outcome, Scores};
use super::{KINDS, Kind, inject, real};
use crate::support::on_two_threads;

const BOOTSTRAPS: usize = 2000;

/// One source clip: its clean scores and its injections.
pub(crate) struct Source {
    pub(crate) clean: Scores,
    pub(crate) outcomes: Vec<Outcome>,
}

/// The seed of a fault in a clip of this name hash.
pub(crate) fn seed(name_hash: u64, kind: Kind) -> u64 {
    name_hash.wrapping_add(kind as u64)
}

/// Measures the clips, each clean and with every fault; the foreign clip is the seventh after it.
pub(crate) fn measure(paths: &[std::path::PathBuf], kinds: &[Kind]) -> Vec<Source> {
    let (hashes, clips): (Vec<u64>, Vec<_>) = paths
        .iter()
        .filter_map(|path| Some((real::name_hash(path), real::load(path)?)))
        .unzip();
    let numbers: Vec<usize> = (0..clips.len()).collect();
    on_two_threads(&numbers, |&number| {
        let other = &clips[(number + 7) % clips.len()];
        let mut clean = CleanClip::new(&clips[number]);
        let outcomes = kinds
            .iter()
            .filter_map(|&kind| {
                let seed = seed(hashes[number], kind);
                let injected = inject(&clips[number], kind, seed, other)?;
                Some(clean.with(kind, &injected))
            })
            .collect();
        Source {
            clean: clean.scores,
            outcomes,
        }
    })
}

/// The detector that is meant for a fault.
pub(crate) fn detector(kind: Kind) -> FaultKind {
    match kind {
        Kind::Noise | Kind::Foreign | Kind::Blur | Kind::Regenerated => FaultKind::BadFrame,
        Kind::Appear | Kind::Morph => FaultKind::Appear,
        Kind::Flicker => FaultKind::Flicker,
        Kind::Freeze => FaultKind::Freeze,
        Kind::Teleport => FaultKind::Jump,
        Kind::Vanish => FaultKind::Vanish,
    }
}

/// Share of (faulty, clean) pairs in order, ties half.
pub(crate) fn auroc(faulty: &[f64], clean: &[f64]) -> f64 {
    let order = |f: f64, c: f64| f64::from(u8::from(f > c)) + 0.5 * f64::from(u8::from(f == c));
    let sum: f64 = faulty
        .iter()
        .map(|&f| clean.iter().map(|&c| order(f, c)).sum::<f64>())
        .sum();
    sum / (faulty.len() * clean.len()) as f64
}

/// A figure and its 95% interval over resampled source clips.
pub(crate) struct Figure {
    pub(crate) value: f64,
    pub(crate) interval: [f64; 2],
}

impl std::fmt::Display for Figure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:4.2} [{:4.2}–{:4.2}]",
            self.value, self.interval[0], self.interval[1]
        )
    }
}

/// `statistic` of the sources, and of as many drawn with replacement.
pub(crate) fn bootstrap(sources: &[&Source], statistic: impl Fn(&[&Source]) -> f64) -> Figure {
    let mut random = Pcg64Mcg::seed_from_u64(0);
    let mut values: Vec<f64> = (0..BOOTSTRAPS)
        .map(|_| {
            let drawn: Vec<&Source> = sources
                .iter()
                .map(|_| sources[random.random_range(0..sources.len())])
                .collect();
            statistic(&drawn)
        })
        .filter(|value| value.is_finite())
        .collect();
    values.sort_by(f64::total_cmp);
    let quantile =
        |share: f64| values.get((share * values.len().saturating_sub(1) as f64).round() as usize);
    Figure {
        value: statistic(sources),
        interval: [0.025, 0.975].map(|share| quantile(share).copied().unwrap_or(f64::NAN)),
    }
}

pub(crate) fn largest(scores: &Scores, detector: FaultKind) -> f64 {
    scores
        .faults
        .largest(detector)
        .map_or(0.0, |point| point.score)
}

fn of_kind<'a>(sources: &'a [&Source], kind: Kind) -> impl Iterator<Item = &'a Outcome> {
    sources
        .iter()
        .flat_map(|source| &source.outcomes)
        .filter(move |outcome| outcome.kind == kind)
}

/// Share of `true`; NaN of nothing (a resample without the kind), which the bootstrap leaves out.
pub(crate) fn share(values: impl Iterator<Item = bool>) -> f64 {
    let (hits, count) = values.fold((0usize, 0usize), |(hits, count), hit| {
        (hits + usize::from(hit), count + 1)
    });
    hits as f64 / count as f64
}

/// AUROC of a fault's injections against the clean clips by a detector.
pub(crate) fn detector_auroc(sources: &[&Source], kind: Kind, detector: FaultKind) -> f64 {
    let faulty: Vec<f64> = of_kind(sources, kind)
        .map(|outcome| largest(&outcome.scores, detector))
        .collect();
    let clean: Vec<f64> = sources
        .iter()
        .map(|source| largest(&source.clean, detector))
        .collect();
    auroc(&faulty, &clean)
}

pub(crate) fn temporal(sources: &[&Source], kind: Kind, detector: FaultKind) -> f64 {
    share(of_kind(sources, kind).map(|outcome| outcome.hit(detector).temporal))
}

pub(crate) fn pointing(sources: &[&Source], kind: Kind, detector: FaultKind) -> f64 {
    share(of_kind(sources, kind).filter_map(|outcome| outcome.hit(detector).pointing))
}

/// Share of the faulty clips in which some event of any kind is within one frame of the fault.
fn found_by_any(sources: &[&Source], kind: Kind, thresholds: &FaultThresholds) -> f64 {
    share(of_kind(sources, kind).map(|outcome| {
        let events = outcome.scores.faults.events(thresholds);
        events.iter().any(|event| outcome.is_near(event.frame))
    }))
}

/// Share of a kind's injections whose worst frame is the fault's or later.
fn not_before(sources: &[&Source], kind: Kind, detector: FaultKind) -> f64 {
    share(of_kind(sources, kind).map(|outcome| {
        let worst = outcome.scores.faults.largest(detector);
        worst.is_some_and(|worst| worst.frame + 1 >= outcome.span[0])
    }))
}

/// Share of a kind's injections that score higher than the same clip without them, ties half.
fn paired(sources: &[&Source], kind: Kind, detector: FaultKind) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for source in sources {
        let clean = largest(&source.clean, detector);
        for outcome in source.outcomes.iter().filter(|o| o.kind == kind) {
            sum += auroc(&[largest(&outcome.scores, detector)], &[clean]);
            count += 1;
        }
    }
    sum / count as f64
}

fn paper_auroc(sources: &[&Source], kind: Kind) -> f64 {
    let faulty: Vec<f64> = of_kind(sources, kind)
        .map(|outcome| outcome.scores.paper_peak().1)
        .collect();
    let clean: Vec<f64> = sources.iter().map(|s| s.clean.paper_peak().1).collect();
    auroc(&faulty, &clean)
}

fn paper_hit(sources: &[&Source], kind: Kind) -> f64 {
    share(of_kind(sources, kind).map(|o| o.is_near(o.scores.paper_peak().0)))
}

/// The rows of `evidence.md`, section 4 and its last paragraph: AUROC / hit, pointing.
fn evidence(kind: Kind) -> &'static str {
    match kind {
        Kind::Noise | Kind::Foreign => "1.00 / 1.00",
        Kind::Blur | Kind::Regenerated => ".99 / .97",
        Kind::Appear => ".93 / .94, .94",
        Kind::Flicker => ".74 / .97, .76",
        Kind::Freeze => "TPR 1.00 at FPR .06",
        Kind::Teleport => ".96 / .87, .77–.84",
        Kind::Morph => ".58, unsolved",
        Kind::Vanish => ".80 / .61, .61",
    }
}

/// Prints the tables as Markdown.
pub(crate) fn print_tables(sources: &[&Source], thresholds: &FaultThresholds) {
    println!(
        "| fault | n | paper's rule: AUROC / hit | detector | AUROC | hit | pointing | TPR | any event | evidence |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for kind in KINDS {
        print_row(sources, thresholds, kind);
    }
    println!();
    for kind in [Kind::Teleport, Kind::Vanish, Kind::Morph] {
        let detector = detector(kind);
        println!(
            "- {kind:?}: above the same clip without it {}; worst frame at the fault or later {}",
            bootstrap(sources, |s| paired(s, kind, detector)),
            bootstrap(sources, |s| not_before(s, kind, detector)),
        );
    }
    println!("\n| clean clips flagged | share |\n|---|---|");
    for detector in FaultKind::ALL {
        let Some(threshold) = thresholds.of(detector) else {
            continue;
        };
        let alarms = bootstrap(sources, |s| {
            share(
                s.iter()
                    .map(|source| largest(&source.clean, detector) > threshold),
            )
        });
        println!("| {} | {alarms} |", detector.as_str());
    }
    let any = bootstrap(sources, |s| {
        share(
            s.iter()
                .map(|source| !source.clean.faults.events(thresholds).is_empty()),
        )
    });
    println!("| any kind | {any} |");
}

fn print_row(sources: &[&Source], thresholds: &FaultThresholds, kind: Kind) {
    let detector = detector(kind);
    let threshold = thresholds.of(detector).unwrap_or(f64::INFINITY);
    let has_place = of_kind(sources, kind).any(|o| o.hit(detector).pointing.is_some());
    let place = if has_place {
        bootstrap(sources, |s| pointing(s, kind, detector)).to_string()
    } else {
        "—".into()
    };
    println!(
        "| {kind:?} | {} | {:.2} / {:.2} | {} | {} | {} | {place} | {} | {:.2} | {} |",
        of_kind(sources, kind).count(),
        paper_auroc(sources, kind),
        paper_hit(sources, kind),
        detector.as_str(),
        bootstrap(sources, |s| detector_auroc(s, kind, detector)),
        bootstrap(sources, |s| temporal(s, kind, detector)),
        bootstrap(sources, |s| share(
            of_kind(s, kind).map(|o| largest(&o.scores, detector) > threshold)
        )),
        found_by_any(sources, kind, thresholds),
        evidence(kind),
    );
}
