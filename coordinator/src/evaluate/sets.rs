//! Low, middle, high and random sets of videos per task, and their success rates (the paper's Tables 1
//! and 3).
//!
//! Sets are chosen among the videos that can be compared. A task with fewer than three times as many
//! gives equally smaller sets, so that low, middle and high never share a video; random may share with
//! any. Ties fall by name. Rates in percent, differences in percentage points.

use std::collections::BTreeMap;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;
use serde::Serialize;

use super::input::Judged;
use crate::reduce::draw;
use crate::reduce::success::SuccessRate;

/// Which videos.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Set {
    /// The lowest anomaly scores.
    Low,
    /// Those around the median.
    Middle,
    /// The highest.
    High,
    /// Drawn without a look at the score.
    Random,
    /// All that can be compared.
    All,
}

impl Set {
    /// In the order of every table.
    pub const ALL: [Self; 5] = [Self::Low, Self::Middle, Self::High, Self::Random, Self::All];

    /// The name in every output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Middle => "middle",
            Self::High => "high",
            Self::Random => "random",
            Self::All => "all",
        }
    }
}

/// The success rate of a set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetRate {
    /// Which.
    pub set: Set,
    /// Its rate.
    #[serde(flatten)]
    pub rate: SuccessRate,
}

/// One task.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaskRates {
    /// Its name; absent for videos without a task.
    pub task: Option<String>,
    /// Videos compared.
    pub compared: usize,
    /// Videos in each of low, middle, high and random.
    pub per_set: usize,
    /// The rates.
    pub sets: Vec<SetRate>,
    /// Which videos, by set (but `all`).
    pub videos: BTreeMap<Set, Vec<String>>,
}

/// The rate of one set over that of another, as if they were independent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Which set.
    pub of: Set,
    /// Over which.
    pub over: Set,
    /// Percentage points.
    pub points: f64,
    /// Its standard error.
    pub standard_error: Option<f64>,
}

/// How far judged success lies above success in the real world, over the videos of a set that have both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RealGap {
    /// Which set.
    pub set: Set,
    /// The rate in the real world.
    pub real: SuccessRate,
    /// Judged minus real, percentage points.
    pub gap_points: f64,
    /// Its standard error, from the differences of each video.
    pub standard_error: Option<f64>,
}

/// Everything rated.
pub(super) struct Rated {
    pub(super) sets: Vec<SetRate>,
    pub(super) real: Vec<RealGap>,
    pub(super) tasks: Vec<TaskRates>,
    pub(super) left_out: Vec<String>,
}

/// A seed for one purpose.
pub(super) fn seed_of(seed: u64, purpose: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(purpose.as_bytes());
    *hasher.finalize().as_bytes()
}

/// Rates `videos` (by name), with `per_set` of each task in every set.
pub(super) fn rate(videos: &[Judged], per_set: usize, seed: u64) -> Rated {
    let mut by_task: BTreeMap<Option<&str>, Vec<&Judged>> = BTreeMap::new();
    for video in videos {
        by_task
            .entry(video.task.as_deref())
            .or_default()
            .push(video);
    }
    let mut chosen: BTreeMap<Set, Vec<&Judged>> = BTreeMap::new();
    let (mut tasks, mut left_out) = (Vec::new(), Vec::new());
    for (task, members) in by_task {
        let sets = choose(&members, per_set, seed_of(seed, task.unwrap_or_default()));
        let size = sets.get(&Set::Low).map_or(0, Vec::len);
        if size == 0 {
            left_out.push(task.unwrap_or("(no task)").to_owned());
        } else {
            let names = |set: &Vec<&Judged>| set.iter().map(|video| video.video.clone()).collect();
            tasks.push(TaskRates {
                task: task.map(str::to_owned),
                compared: members.len(),
                per_set: size,
                sets: rates(&sets),
                videos: sets
                    .iter()
                    .filter(|(set, _)| **set != Set::All)
                    .map(|(set, videos)| (*set, names(videos)))
                    .collect(),
            });
        }
        for (set, videos) in sets {
            chosen.entry(set).or_default().extend(videos);
        }
    }
    Rated {
        sets: rates(&chosen),
        real: chosen
            .iter()
            .filter_map(|(set, videos)| real_gap(*set, videos))
            .collect(),
        tasks,
        left_out,
    }
}

fn choose<'a>(
    members: &[&'a Judged],
    per_set: usize,
    seed: [u8; 32],
) -> BTreeMap<Set, Vec<&'a Judged>> {
    let n = members.len();
    let size = per_set.min(n / 3);
    let mut ranked = members.to_vec();
    ranked.sort_by(|a, b| {
        a.anomaly
            .total_cmp(&b.anomaly)
            .then_with(|| a.video.cmp(&b.video))
    });
    let middle = (n - size) / 2;
    let drawn = draw::sample(n, size, &mut Pcg64::from_seed(seed));
    BTreeMap::from([
        (Set::Low, ranked[..size].to_vec()),
        (Set::Middle, ranked[middle..middle + size].to_vec()),
        (Set::High, ranked[n - size..].to_vec()),
        (
            Set::Random,
            drawn.into_iter().map(|place| members[place]).collect(),
        ),
        (Set::All, members.to_vec()),
    ])
}

fn rates(sets: &BTreeMap<Set, Vec<&Judged>>) -> Vec<SetRate> {
    let rate = |(&set, videos): (&Set, &Vec<&Judged>)| {
        let labels: Vec<f64> = videos.iter().map(|video| video.label).collect();
        // Labels lie in [0, 1], so that no sum refuses one.
        let rate = SuccessRate::of(&labels).ok()??;
        Some(SetRate { set, rate })
    };
    sets.iter().filter_map(rate).collect()
}

/// What a reader asks first: what choosing low scores gains.
pub(super) fn differences(rates: &[SetRate]) -> Vec<Difference> {
    let rate = |set| {
        rates
            .iter()
            .find(|rate| rate.set == set)
            .map(|rate| rate.rate)
    };
    let over = |other| {
        let (points, standard_error) = rate(Set::Low)?.gain_over(&rate(other)?);
        Some(Difference {
            of: Set::Low,
            over: other,
            points,
            standard_error,
        })
    };
    [Set::Middle, Set::High, Set::Random]
        .into_iter()
        .filter_map(over)
        .collect()
}

fn real_gap(set: Set, videos: &[&Judged]) -> Option<RealGap> {
    let both = || {
        videos
            .iter()
            .filter_map(|video| Some((video.label, video.real?)))
    };
    let real: Vec<f64> = both().map(|(_, real)| real).collect();
    let gaps: Vec<f64> = both().map(|(label, real)| label - real).collect();
    let gap = SuccessRate::of(&gaps).ok()??;
    Some(RealGap {
        set,
        real: SuccessRate::of(&real).ok()??,
        gap_points: gap.percent,
        standard_error: gap.standard_error,
    })
}
