//! What a run will cost, from what a sample cost and what the headers of the run's videos say.
//!
//! Double sampling with a ratio estimator (Cochran, Sampling Techniques, 3rd ed., 1977, sections 6.2 and 12.9): what
//! a video costs follows its length and size, which headers tell of many videos for next to nothing. With a_i, the
//! cost of video i by the model of its shape,
//!
//! ```text
//! each_s = mean of a over the planned videos · (Σ w cpu_s / Σ w a over the sample)
//! ```
//!
//! The same headers are read of both, so that what is wrong with headers alike cancels, and the share of videos
//! that are refused is in the ratio. A video that is refused by its header costs nothing; one whose header is
//! silent is taken for the mean of the others, so that without any header the mean over the sample is left.
//!
//! The 90% interval is the percentile bootstrap over the sample and over the headers (unless these are those of
//! all videos of the run), with the model fitted anew; its width is that for a run over other videos than those
//! of the sample, which have a spread of their own: √(1 + n/N).
//!
//! Wall time is processor time by cores like this machine's that have nothing else to do, and half the
//! longest video, since the last ones leave cores idle. Reduce and report are not in it: seconds for
//! thousands of videos. Nothing fails; without videos there is no prediction.

use plumbline_worker::decode::Shape;
use plumbline_worker::measure::shape::Told;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;
use serde::Serialize;

use super::cost_model::{Spent, Working, fit};
use crate::reduce::draw::index_below;

/// Bootstrap replicates.
const REPLICATES: usize = 1000;
/// Share of them left out at either end of a 90% interval.
const TAIL: f64 = 0.05;

/// A video as it is known without decoding it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Listed {
    /// What its header says.
    pub(super) told: Told,
    /// How many videos it stands for.
    pub(super) weight: f64,
}

/// A video of the sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Costed {
    pub(super) listed: Listed,
    pub(super) spent: Spent,
}

/// What is asked of the planner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Question {
    /// Videos to score.
    pub videos: u64,
    /// Their length and size, where these were given; else what their headers say.
    pub shape: Option<Shape>,
    /// Cores to score them with.
    pub cores: u32,
    /// Hours there are.
    pub hours: f64,
}

/// What lengths and sizes a plan goes by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// The one of the question.
    Given,
    /// Those of the videos' headers.
    Headers,
    /// None: videos are taken to be like those of the sample.
    Mean,
}

/// A run's cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Plan {
    /// What it goes by.
    pub basis: Basis,
    /// Processor time, seconds.
    pub cpu_s: f64,
    /// Its 90% interval.
    pub cpu_interval_90_s: (f64, f64),
    /// Wall time, seconds.
    pub wall_s: f64,
    /// Its 90% interval.
    pub wall_interval_90_s: (f64, f64),
}

/// What one video costs, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Each {
    mean_s: f64,
    longest_s: f64,
}

/// Predicts the run of a question from the `sample` and the headers of the `planned` videos, which are `all` of
/// the run or some of many like them; `None` without a video.
pub(super) fn plan(
    sample: &[Costed],
    planned: &[Listed],
    all: bool,
    working: Working,
    question: &Question,
) -> Option<Plan> {
    let by = |basis| {
        let whole = each(sample, planned, basis, working, question.shape)?;
        Some((basis, whole))
    };
    let (basis, whole) = match question.shape {
        Some(_) => by(Basis::Given)?,
        None => by(Basis::Headers).or_else(|| by(Basis::Mean))?,
    };
    let mut rng = Pcg64::from_seed([0; 32]);
    let mut replicates: Vec<f64> = (0..REPLICATES)
        .filter_map(|_| {
            let sample = drawn(sample, &mut rng);
            let redrawn = (!all).then(|| drawn(planned, &mut rng));
            let planned = redrawn.as_deref().unwrap_or(planned);
            let each = each(&sample, planned, basis, working, question.shape)?;
            Some(each.mean_s)
        })
        .collect();
    replicates.sort_unstable_by(f64::total_cmp);
    let tail = (replicates.len() as f64 * TAIL) as usize;
    let (lo, hi) = (
        *replicates.get(tail)?,
        *replicates.get(replicates.len() - 1 - tail)?,
    );
    let videos = question.videos as f64;
    let others = (1.0 + sample.len() as f64 / videos.max(1.0)).sqrt();
    let bound = |of: f64| (whole.mean_s + (of - whole.mean_s) * others).max(0.0) * videos;
    let cpu_interval_90_s = (bound(lo), bound(hi));
    // No more cores are at work than there are videos.
    let cores = f64::from(question.cores).min(videos.max(1.0));
    let idle_s = (1.0 - 1.0 / cores) * whole.longest_s / 2.0;
    let wall = |cpu_s: f64| cpu_s / cores + idle_s;
    let cpu_s = whole.mean_s * videos;
    Some(Plan {
        basis,
        cpu_s,
        cpu_interval_90_s,
        wall_s: wall(cpu_s),
        wall_interval_90_s: (wall(cpu_interval_90_s.0), wall(cpu_interval_90_s.1)),
    })
}

fn drawn<T: Copy>(of: &[T], rng: &mut Pcg64) -> Vec<T> {
    of.iter().map(|_| of[index_below(of.len(), rng)]).collect()
}

/// The estimate; `None` where there is nothing to go by.
fn each(
    sample: &[Costed],
    planned: &[Listed],
    basis: Basis,
    working: Working,
    shape: Option<Shape>,
) -> Option<Each> {
    let cpu_s = weighed(sample.iter().map(|c| (c.spent.cpu_s, c.listed.weight)))?;
    let longest_of = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    if basis == Basis::Mean {
        return Some(Each {
            mean_s: cpu_s,
            longest_s: longest_of(&mut sample.iter().map(|c| c.spent.cpu_s)),
        });
    }
    let model = fit(sample.iter().map(|c| &c.spent), working)?;
    let of_shape = |shape: Shape| model.expected_s(shape, working);
    let of_told = |told: Told| match told {
        Told::Shape(shape) => Some(of_shape(shape)),
        Told::Refused => Some(0.0),
        Told::Silent => None,
    };
    // Mean and longest of a over what is planned, and the mean over the sample.
    let (mean, longest, of_sample) = match shape {
        Some(shape) => {
            let decoded = sample.iter().map(|c| {
                let a = c.spent.decoded.map_or(0.0, of_shape);
                (a, c.listed.weight)
            });
            (of_shape(shape), of_shape(shape), weighed(decoded)?)
        }
        None => {
            let known = || {
                let known = planned.iter();
                known.filter_map(|l| Some((of_told(l.told)?, l.weight)))
            };
            let mean = weighed(known())?;
            let sampled = sample.iter().map(|c| {
                let a = of_told(c.listed.told).unwrap_or(mean);
                (a, c.listed.weight)
            });
            let longest = longest_of(&mut known().map(|(a, _)| a));
            (mean, longest, weighed(sampled)?)
        }
    };
    let ratio = cpu_s / of_sample;
    ratio.is_finite().then_some(Each {
        mean_s: mean * ratio,
        longest_s: longest * ratio,
    })
}

/// The mean of values with weights; `None` without weight.
fn weighed(values: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (sum, weight) = values.fold((0.0, 0.0), |(sum, total), (value, weight)| {
        (sum + weight * value, total + weight)
    });
    (weight > 0.0).then(|| sum / weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORKING: Working = Working {
        height_px: 256,
        conditioning_frames: 1,
    };

    const fn shape(frames: u32, width: u32, height: u32) -> Shape {
        Shape {
            frames,
            width,
            height,
        }
    }

    const fn listed(told: Told) -> Listed {
        Listed { told, weight: 1.0 }
    }

    /// A video of the sample, whose header says what is decoded.
    const fn costed(shape: Shape, cpu_s: f64) -> Costed {
        Costed {
            listed: listed(Told::Shape(shape)),
            spent: Spent {
                decoded: Some(shape),
                parallax: false,
                cpu_s,
            },
        }
    }

    const fn question(videos: u64, shape: Option<Shape>) -> Question {
        Question {
            videos,
            shape,
            cores: 10,
            hours: 1.0,
        }
    }

    /// 2 ms per frame of 320×240, and 20 ms whatever the length: what no rate tells.
    fn cost_s(shape: Shape) -> f64 {
        let pixels = f64::from(shape.width * shape.height);
        0.02 + 0.002 * f64::from(shape.frames) * pixels / (320.0 * 240.0)
    }

    fn sample_of(shapes: &[Shape]) -> Vec<Costed> {
        let of = |&shape: &Shape| costed(shape, cost_s(shape));
        shapes.iter().map(of).collect()
    }

    #[test]
    fn like_videos_cost_the_weighed_mean() {
        let mut sample = [costed(shape(40, 320, 240), 0.0); 4];
        for (k, video) in sample.iter_mut().enumerate() {
            video.spent.cpu_s = 1.0 + k as f64;
            video.listed.told = Told::Silent;
        }
        sample[3].listed.weight = 3.0;
        let silent = [listed(Told::Silent)];
        let plan = plan(&sample, &silent, false, WORKING, &question(1000, None)).unwrap();
        // (1 + 2 + 3 + 3 · 4) / 6 = 3 s each; 10 cores; nine of ten wait for half the longest, 4 s.
        assert_eq!((plan.basis, plan.cpu_s), (Basis::Mean, 3000.0));
        assert!((plan.wall_s - 301.8).abs() < 1e-9);
        let (lo, hi) = plan.cpu_interval_90_s;
        assert!(1000.0 < lo && lo < 3000.0 && 3000.0 < hi && hi <= 4010.0);
        assert_eq!(
            super::plan(&[], &silent, false, WORKING, &question(1000, None)),
            None
        );
    }

    #[test]
    fn few_videos_keep_few_cores_busy() {
        let sample = [costed(shape(40, 320, 240), 8.0)];
        let asked = Question {
            cores: 64,
            ..question(2, None)
        };
        let planned = [sample[0].listed; 2];
        let plan = plan(&sample, &planned, true, WORKING, &asked).unwrap();
        // Two cores have one each, and one waits for half of it on average.
        assert!((plan.wall_s - 1.25 * 8.0).abs() < 1e-12);
    }

    #[test]
    fn headers_tell_of_videos_that_the_sample_is_not_like() {
        let sample = sample_of(&[
            shape(20, 320, 240),
            shape(40, 320, 240),
            shape(30, 640, 480),
            shape(60, 320, 240),
        ]);
        let shapes = [
            shape(400, 320, 240),
            shape(100, 640, 480),
            shape(25, 320, 240),
        ];
        let real_s: f64 = shapes.iter().map(|&shape| cost_s(shape)).sum();
        let planned: Vec<Listed> = shapes.map(|s| listed(Told::Shape(s))).to_vec();
        let asked = question(3, None);
        let by_headers = plan(&sample, &planned, true, WORKING, &asked).unwrap();
        // Slow and obvious: the model's cost of each, one after another, times what the sample cost over what the
        // model says of it.
        let model = fit(sample.iter().map(|c| &c.spent), WORKING).unwrap();
        let sum = |shapes: &[Shape]| -> f64 {
            shapes
                .iter()
                .map(|&shape| model.expected_s(shape, WORKING))
                .sum()
        };
        let sampled: Vec<Shape> = sample.iter().filter_map(|c| c.spent.decoded).collect();
        let spent_s: f64 = sample.iter().map(|c| c.spent.cpu_s).sum();
        let twin_s = sum(&shapes) * spent_s / sum(&sampled);
        assert_eq!(by_headers.basis, Basis::Headers);
        assert!((by_headers.cpu_s / twin_s - 1.0).abs() < 1e-12);
        // The mean would be off by a factor; the fixed cost, which no rate tells, leaves an eighth: 2.33 ms per
        // frame of the sample, 2.07 ms of these.
        let silent = [listed(Told::Silent); 3];
        let by_mean = plan(&sample, &silent, true, WORKING, &asked).unwrap();
        assert!(by_mean.cpu_s < 0.5 * real_s);
        assert!((by_headers.cpu_s / real_s - 1.0).abs() < 0.2);
        // Three like the given one are as dear as by their headers.
        let same = shape(400, 320, 240);
        let given = plan(&sample, &silent, true, WORKING, &question(3, Some(same))).unwrap();
        let headers = [listed(Told::Shape(same)); 3];
        let known = plan(&sample, &headers, true, WORKING, &asked).unwrap();
        assert_eq!((given.basis, known.basis), (Basis::Given, Basis::Headers));
        assert!((given.cpu_s / known.cpu_s - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_refused_costs_nothing_and_what_is_silent_the_mean() {
        let sample = sample_of(&[shape(20, 320, 240), shape(40, 320, 240)]);
        let cpu_s = |told: &[Told], videos| {
            let planned: Vec<Listed> = told.iter().map(|&told| listed(told)).collect();
            let asked = question(videos, None);
            plan(&sample, &planned, true, WORKING, &asked)
                .unwrap()
                .cpu_s
        };
        let long = Told::Shape(shape(200, 320, 240));
        let one = cpu_s(&[long], 1);
        assert!((cpu_s(&[long, Told::Refused], 2) / one - 1.0).abs() < 1e-12);
        assert!((cpu_s(&[long, Told::Silent], 2) / (2.0 * one) - 1.0).abs() < 1e-12);
        assert_eq!(cpu_s(&[Told::Refused], 1), 0.0);
    }

    /// Costs that follow the shapes exactly leave nothing uncertain where all headers are known, but the draw of
    /// the headers where they are not; without headers the spread of the sample is left.
    #[test]
    fn the_interval_is_of_what_is_not_known() {
        let frames = [20, 40, 60, 200, 30, 90, 150, 25];
        let sample: Vec<Costed> = frames
            .map(|frames| costed(shape(frames, 320, 240), f64::from(frames - 1)))
            .to_vec();
        let planned: Vec<Listed> = sample.iter().map(|c| c.listed).collect();
        let silent = [listed(Told::Silent); 8];
        let width = |planned: &[Listed], all: bool| {
            let found = plan(&sample, planned, all, WORKING, &question(100, None)).unwrap();
            let (lo, hi) = found.cpu_interval_90_s;
            (hi - lo) / found.cpu_s
        };
        assert!(width(&planned, true) < 0.02, "{}", width(&planned, true));
        assert!(width(&planned, false) > 0.3);
        assert!(width(&silent, true) > 0.3);
    }
}
