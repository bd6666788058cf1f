//! The cascade against a world whose residuals are known: what each video is at every rung is drawn first,
//! so that every decision of the top is known to the test and to nobody else.

use std::num::NonZeroU16;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use super::crossed::crossed;
use super::goal::spent_s;
use super::*;
use crate::agreement::Flips;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};

/// Seconds per rung, of every video.
const COST_S: [f64; 2] = [0.05, 2.0];

fn options(keep: &str) -> ReduceOptions {
    ReduceOptions {
        recipe: Recipe::Balanced,
        bins: NonZeroU16::MIN,
        range: Range::Full,
        keep: keep.parse().unwrap(),
        profile_digest: String::new(),
        normalise_within: NormaliseWithin::Corpus,
        reference: None,
    }
}

/// Everything that could be measured of `n` videos: draft signals are top signals in another unit, with
/// noise of `noise` times their spread.
fn world(n: usize, noise: f64, seed: u8) -> Vec<Video> {
    let mut rng = Pcg64::from_seed([seed; 32]);
    let mut uniform = || rng.next_u64() as f64 / u64::MAX as f64;
    // Twelve uniform numbers less their mean: normal enough, variance 1.
    let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    (0..n)
        .map(|index| {
            let common = normal();
            let top = BySignal::from_fn(|_| Some(5.0 + common + 0.7 * normal()));
            let draft =
                BySignal::from_fn(|signal| top[signal].map(|x| 3.0 + 0.5 * (x + noise * normal())));
            let seen = |values, rung: usize| {
                Some(Seen {
                    status: Status::Scored,
                    values,
                    frames: 10,
                    cpu_s: COST_S[rung],
                })
            };
            Video {
                group: Some(["a", "b"][index % 2].to_owned()),
                seen: vec![seen(draft, 0), seen(top, 1)],
            }
        })
        .collect()
}

fn with_status(mut video: Video, statuses: [Status; 2]) -> Video {
    for (seen, status) in video.seen.iter_mut().flatten().zip(statuses) {
        seen.status = status;
        if status != Status::Scored {
            seen.values = BySignal::default();
        }
    }
    video
}

struct Run {
    known: Vec<Video>,
    sample: Vec<usize>,
    assessment: Assessment,
    end: End,
    waves: Vec<Wave>,
}

impl Run {
    fn decisions(&self) -> Vec<Decision> {
        let judged = self.assessment.judged.iter();
        judged.map(|judged| judged.unwrap().decision).collect()
    }

    fn at_top(&self) -> usize {
        let seen = self.known.iter();
        seen.filter(|video| video.at(1).is_some()).count()
    }

    /// Against measuring everything at the top.
    fn flips(&self, world: &[Video], options: &ReduceOptions) -> Flips {
        let only_top = |video: &Video| Video {
            seen: vec![None, video.seen[1].clone()],
            ..video.clone()
        };
        let all: Vec<Video> = world.iter().map(only_top).collect();
        let truth: Vec<Decision> = assess(&all, &[], options)
            .judged
            .iter()
            .map(|judged| judged.unwrap().decision)
            .collect();
        Flips::between(&self.decisions(), &truth)
    }
}

/// Goes through the waves of a cascade over a world.
fn run(world: &[Video], goal: Goal, options: &ReduceOptions) -> Run {
    let mut known: Vec<Video> = world
        .iter()
        .map(|video| Video {
            seen: vec![None; video.seen.len()],
            ..video.clone()
        })
        .collect();
    let sample = sample::sample(world.len(), [9; 32]);
    let mut waves = Vec::new();
    loop {
        match next(&known, &sample, &goal, options) {
            Step::Measure(wave) => {
                assert!(!wave.videos.is_empty() && wave.videos.is_sorted());
                for &index in &wave.videos {
                    let seen = &mut known[index].seen[wave.rung];
                    assert!(seen.is_none(), "{index} asked twice");
                    seen.clone_from(&world[index].seen[wave.rung]);
                }
                waves.push(wave);
            }
            Step::Done(assessment, end) => {
                return Run {
                    known,
                    sample,
                    assessment: *assessment,
                    end,
                    waves,
                };
            }
        }
    }
}

#[test]
fn the_target_is_met_by_measuring_some() {
    for keep in ["80%", "100", "s<=1"] {
        let options = options(keep);
        let world = world(600, 0.15, 1);
        let found = run(&world, Goal::Agreement(0.98), &options);
        assert_eq!(found.end, End::Reached);
        let flips = found.flips(&world, &options);
        // Expected at most 12 flips; as a sum of independent ones, their spread is below 3.5.
        assert!(flips.count() <= 12 + 3 * 4, "{keep}: {flips:?}");
        assert!(found.assessment.expected_flips() <= 12.0);
        assert!(
            found.at_top() < world.len() * 3 / 4,
            "{keep}: {} at the top",
            found.at_top()
        );
        let crossed = crossed(&found.known, &found.sample, &found.assessment, &options);
        assert_eq!(crossed.videos, found.sample.len() as u64);
        assert!(crossed.agreed * 10 >= crossed.videos * 9, "{crossed:?}");
    }
}

#[test]
fn a_draft_that_says_all_needs_the_sample_alone() {
    let options = options("80%");
    let world = world(300, 0.0, 2);
    let found = run(&world, Goal::Agreement(0.99), &options);
    assert_eq!(found.at_top(), found.sample.len());
    assert_eq!(found.flips(&world, &options).count(), 0);
}

#[test]
fn a_draft_that_says_nothing_is_told_so() {
    let options = options("50%");
    let world = world(150, 30.0, 3);
    let found = run(&world, Goal::Agreement(0.99), &options);
    // Nearly everything is uncertain, and is measured.
    assert!(found.at_top() > 120, "{}", found.at_top());
    assert!(found.flips(&world, &options).agreement() >= 0.97);
}

#[test]
fn every_video_has_one_row_and_typed_verdicts_stay() {
    let options = options("80%");
    let mut world = world(150, 0.1, 5);
    for (index, statuses) in [
        [Status::Undecodable; 2],
        [Status::TooShort; 2],
        [Status::Failed; 2],
        [Status::Static; 2],
        [Status::Static, Status::Scored],
        [Status::Scored, Status::Static],
        [Status::Collapsed; 2],
    ]
    .into_iter()
    .enumerate()
    {
        world[10 * index] = with_status(world[10 * index].clone(), statuses);
    }
    let found = run(&world, Goal::Agreement(0.99), &options);
    assert!(found.assessment.judged.iter().all(Option::is_some));
    for hopeless in [0, 10, 20] {
        let judged = found.assessment.judged[hopeless].unwrap();
        assert_eq!((judged.rung, judged.flip), (0, 0.0));
        assert_eq!(judged.decision, Decision::Review);
    }
    // Of `static` nothing is known at first: it is asked, and what the top says counts.
    let asked = found.assessment.judged[40].unwrap();
    assert_eq!(asked.rung, 1);
    assert_ne!(asked.decision, Decision::Review);
    assert!(found.flips(&world, &options).agreement() >= 0.98);
}

#[test]
fn budgets_are_kept() {
    let options = options("80%");
    let world = world(300, 0.3, 6);
    let draft_s = 300.0 * COST_S[0];
    let sample_s = sample::size(300) as f64 * COST_S[1];
    for budget_s in [draft_s + sample_s + 1.0, 70.0, 120.0, 1e6] {
        let found = run(&world, Goal::Cpu(budget_s), &options);
        assert!(spent_s(&found.known) <= budget_s, "{budget_s}");
        let wanted = match budget_s < 1e6 {
            true => End::Spent,
            false => End::Reached,
        };
        assert_eq!(found.end, wanted, "{budget_s}");
        // What is left pays for nothing.
        assert!(wanted == End::Reached || budget_s - spent_s(&found.known) < COST_S[1] + 1e-9);
    }
    // More is never worse by more than chance.
    let flips = |budget_s| {
        let found = run(&world, Goal::Cpu(budget_s), &options);
        found.flips(&world, &options).count()
    };
    assert!(flips(120.0) <= flips(70.0));
    for too_small_s in [1.0, draft_s, draft_s + 0.5 * sample_s] {
        let found = run(&world, Goal::Cpu(too_small_s), &options);
        assert_eq!(found.end, End::CheapestOnly);
        let judged = found.assessment.judged.iter();
        assert!(judged.flatten().all(|judged| judged.rung == 0));
    }
}

#[test]
fn tiny_corpora_are_measured_at_the_top() {
    let options = options("80%");
    for n in [0, 1, 5, 2 * sample::FEWEST] {
        let world = world(n, 0.1, 7);
        let found = run(&world, Goal::Agreement(0.99), &options);
        assert_eq!(found.end, End::AllAtTop, "{n}");
        assert_eq!(found.at_top(), n);
        assert!(found.waves.iter().all(|wave| wave.rung == 1));
        assert_eq!(found.flips(&world, &options).count(), 0);
        assert_eq!(found.assessment.expected_flips(), 0.0);
        // In seconds, too: what the budget pays for.
        run(&world, Goal::Cpu(1.0), &options);
        run(&world, Goal::Cpu(1e9), &options);
    }
}

#[test]
fn the_sample_is_the_seed_s() {
    let drawn = |seed| sample::sample(1000, [seed; 32]);
    assert_eq!(drawn(1), drawn(1));
    assert_ne!(drawn(1), drawn(2));
    assert!(drawn(1).is_sorted() && drawn(1).len() == sample::size(1000));
    assert_eq!(sample::sample(5, [0; 32]), [0, 1, 2, 3, 4]);
    assert_eq!(sample::size(1_000_000), 400);
}
