//! What to measure next, for a goal.

use super::flip::open;
use super::{Assessment, Video, assess};
use crate::reduce::ReduceOptions;

/// When a cascade has done enough.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// This share of decisions is expected to be the top's. Depends on measurements alone: the same
    /// everywhere and every time.
    Agreement(f64),
    /// So much processor time is spent, seconds over all measurements. Depends on the machine.
    Cpu(f64),
}

/// Videos to be measured at a rung, by index, ascending.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wave {
    /// The rung.
    pub rung: usize,
    /// The videos.
    pub videos: Vec<usize>,
}

/// Why nothing more is to be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// As many decisions as wanted are expected to be the top's, or all that can be.
    Reached,
    /// Too few videos for a sample: all of them were measured at the top, and nothing else.
    AllAtTop,
    /// The budget is spent.
    Spent,
    /// The budget does not reach beyond the cheapest rung.
    CheapestOnly,
}

impl End {
    /// For a person.
    #[must_use]
    pub fn reason(self) -> &'static str {
        match self {
            Self::Reached => "the target is met, or no decision is uncertain any more",
            Self::Spent => "the budget is spent",
            Self::AllAtTop => {
                "too few videos for a sample to tell anything: all of them were measured with the top profile"
            }
            Self::CheapestOnly => {
                "the budget does not pay for a sample at the top profile: all rows are those of the cheapest, and how many decisions differ is not known"
            }
        }
    }
}

/// What is to be done.
#[derive(Debug, Clone)]
pub enum Step {
    /// Measure these, then ask again.
    Measure(Wave),
    /// Publish.
    Done(Box<Assessment>, End),
}

/// Where videos wait for a later wave, each wave takes at least one in so many of the corpus: a fleet idles
/// at the end of each.
const LEAST_SHARE_OF_WAVE: usize = 100;

/// ...and at most one in so many: what one wave finds may spare the next.
const MOST_SHARE_OF_WAVE: usize = 10;

/// A flip that is less likely is not worth a measurement, whatever the budget.
const NEGLIGIBLE: f64 = 1e-3;

/// What to measure next. `videos` and `sample` as for [`assess`]; each video that a wave names comes back
/// measured at its rung, or the corpus is never done.
#[must_use]
pub fn next(videos: &[Video], sample: &[usize], goal: &Goal, options: &ReduceOptions) -> Step {
    let all = videos;
    let top = videos
        .first()
        .map_or(0, |video| video.seen.len().saturating_sub(1));
    let unseen = |rung: usize, among: &mut dyn Iterator<Item = usize>| -> Vec<usize> {
        among
            .filter(|&index| {
                let video = videos.get(index);
                video.is_some_and(|video| video.at(rung).is_none())
            })
            .collect()
    };
    if sample.len() == videos.len() && matches!(goal, Goal::Agreement(_)) {
        return match unseen(top, &mut (0..videos.len())) {
            none if none.is_empty() => done(videos, sample, options, End::AllAtTop),
            videos => Step::Measure(Wave { rung: top, videos }),
        };
    }
    let cheapest = unseen(0, &mut (0..videos.len()));
    if !cheapest.is_empty() {
        let videos = cheapest;
        return Step::Measure(Wave { rung: 0, videos });
    }
    let worth_asking = |index: &usize| open(videos.get(*index).and_then(|video| video.at(0)));
    for rung in (1..=top).rev() {
        let waiting = unseen(rung, &mut sample.iter().copied().filter(worth_asking));
        if waiting.is_empty() {
            continue;
        }
        let videos = match goal {
            Goal::Agreement(_) => waiting,
            Goal::Cpu(budget_s) => affordable(all, rung, waiting, *budget_s),
        };
        if videos.is_empty() {
            return cheapest_only(all, options);
        }
        return Step::Measure(Wave { rung, videos });
    }
    let assessment = assess(videos, sample, options);
    match goal {
        Goal::Agreement(target) => towards(videos, assessment, *target),
        Goal::Cpu(budget_s) => within(videos, assessment, *budget_s),
    }
}

fn done(videos: &[Video], sample: &[usize], options: &ReduceOptions, end: End) -> Step {
    Step::Done(Box::new(assess(videos, sample, options)), end)
}

/// What is published where the sample cannot be afforded: half a sample makes no calibration.
fn cheapest_only(videos: &[Video], options: &ReduceOptions) -> Step {
    let mut videos = videos.to_vec();
    for video in &mut videos {
        video.seen.iter_mut().skip(1).for_each(|seen| *seen = None);
    }
    done(&videos, &[], options, End::CheapestOnly)
}

/// The least certain videos, as many as leave no more flips than the target allows; where too many hang on
/// the calibration, too, the next least certain ones.
fn towards(videos: &[Video], assessment: Assessment, target: f64) -> Step {
    let n = videos.len();
    let allowed = (1.0 - target).max(0.0) * n as f64;
    let mut left = assessment.expected_flips();
    let order = match left <= allowed {
        true => Vec::new(),
        false => by_worth(videos, &assessment, |_, flip| flip),
    };
    if order.is_empty() {
        return Step::Done(Box::new(assessment), End::Reached);
    }
    let (least, most) = (
        n.div_ceil(LEAST_SHARE_OF_WAVE),
        n.div_ceil(MOST_SHARE_OF_WAVE),
    );
    let mut chosen = Vec::new();
    for (index, flip, rung) in order {
        if chosen.len() >= most || (left <= allowed && chosen.len() >= least) {
            break;
        }
        left -= flip;
        chosen.push((rung, index));
    }
    Step::Measure(lowest_rung(&chosen))
}

/// The videos with most flips to be had per second, in what is left of the budget.
fn within(videos: &[Video], assessment: Assessment, budget_s: f64) -> Step {
    let top = videos.first().map_or(0, |video| video.seen.len());
    let factors: Vec<f64> = (0..top).map(|rung| cost_factor(videos, rung)).collect();
    let cost = |index: usize, rung: usize| -> f64 {
        let cheapest = videos.get(index).and_then(|video| video.at(0));
        let factor = factors.get(rung).copied().unwrap_or(f64::INFINITY);
        cheapest.map_or(0.0, |seen| seen.cpu_s) * factor
    };
    let left_s = budget_s - spent_s(videos);
    let rung_of = |index: usize| assessment.judged.get(index).copied().flatten();
    let worth = |index: usize, flip: f64| {
        let rung = rung_of(index).map_or(0, |judged| judged.rung + 1);
        flip / cost(index, rung).max(f64::MIN_POSITIVE)
    };
    let order = by_worth(videos, &assessment, worth);
    if order.iter().all(|(_, flip, _)| *flip < NEGLIGIBLE) {
        return Step::Done(Box::new(assessment), End::Reached);
    }
    let mut cost_s = 0.0;
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for &(index, flip, rung) in &order {
        if flip < NEGLIGIBLE {
            continue;
        }
        let more_s = cost(index, rung);
        let room_s = match chosen.is_empty() {
            true => left_s,
            // Costs are foretold: half of what is left, so that the error shrinks from wave to wave.
            false => left_s / 2.0,
        };
        if cost_s + more_s > room_s {
            continue;
        }
        cost_s += more_s;
        chosen.push((rung, index));
    }
    match chosen.is_empty() {
        true => Step::Done(Box::new(assessment), End::Spent),
        false => Step::Measure(lowest_rung(&chosen)),
    }
}

/// Index, flip probability and next rung of the videos of which a dearer rung may say more, those of most
/// worth first.
fn by_worth(
    videos: &[Video],
    assessment: &Assessment,
    worth: impl Fn(usize, f64) -> f64,
) -> Vec<(usize, f64, usize)> {
    let known = videos.iter().zip(&assessment.judged).enumerate();
    let mut order: Vec<(f64, usize, f64, usize)> = known
        .filter_map(|(index, (video, judged))| {
            let judged = (*judged)?;
            let open = judged.rung + 1 < video.seen.len() && open(video.at(judged.rung));
            open.then(|| {
                let worth = worth(index, judged.flip);
                (worth, index, judged.flip, judged.rung + 1)
            })
        })
        .collect();
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let order = order.into_iter();
    order
        .map(|(_, index, flip, rung)| (index, flip, rung))
        .collect()
}

/// Those of the chosen that go to the lowest rung; the others are asked for again when that is known.
fn lowest_rung(chosen: &[(usize, usize)]) -> Wave {
    let rung = chosen.iter().map(|(rung, _)| *rung).min().unwrap_or(0);
    let there = chosen.iter().filter(|(r, _)| *r == rung);
    let mut videos: Vec<usize> = there.map(|(_, index)| *index).collect();
    videos.sort_unstable();
    Wave { rung, videos }
}

/// As many of the waiting as half of what is left pays for; one where nothing is known of the rung's cost.
fn affordable(videos: &[Video], rung: usize, waiting: Vec<usize>, budget_s: f64) -> Vec<usize> {
    let left_s = budget_s - spent_s(videos);
    let seen: Vec<f64> = videos
        .iter()
        .filter_map(|video| video.at(rung))
        .map(|seen| seen.cpu_s)
        .collect();
    let each_s = seen.iter().sum::<f64>() / seen.len().max(1) as f64;
    if left_s <= each_s {
        return Vec::new();
    }
    let most = match each_s > 0.0 {
        true => ((left_s / 2.0 / each_s) as usize).max(1),
        false => 1,
    };
    waiting.into_iter().take(most).collect()
}

/// How much dearer a rung is than the cheapest, over the videos measured at both.
fn cost_factor(videos: &[Video], rung: usize) -> f64 {
    let both = videos
        .iter()
        .filter_map(|video| video.at(0).zip(video.at(rung)));
    let (mut here, mut cheapest) = (0.0, 0.0);
    for (below, seen) in both {
        cheapest += below.cpu_s;
        here += seen.cpu_s;
    }
    match cheapest > 0.0 {
        true => here / cheapest,
        false => 1.0,
    }
}

/// Processor time of all measurements.
#[must_use]
pub fn spent_s(videos: &[Video]) -> f64 {
    let seen = videos.iter().flat_map(|video| video.seen.iter().flatten());
    seen.map(|seen| seen.cpu_s).sum()
}
