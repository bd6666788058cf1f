//! What a run will cost, from what a sample cost.
//!
//! Videos like those sampled: the mean over the sample, each video weighed by how many it stands for, times
//! their number, with a 90% interval (percentile bootstrap over videos). Videos of another length or size: a
//! model with three rates, each at least 0, by least squares,
//!
//! ```text
//! cpu_s = decode · D + measure · W + adjust · W [parallax]
//! ```
//!
//! D being frames × pixels as decoded and W usable frames × pixels at the working size, both in millions.
//! Wall time is processor time by cores like this machine's that have nothing else to do, and half the
//! longest video, since the last ones leave cores idle. Reduce and report are not in it: seconds for
//! thousands of videos. Nothing fails; without videos there is no prediction.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;
use serde::Serialize;

use crate::reduce::draw::index_below;

/// Bootstrap replicates.
const REPLICATES: usize = 1000;
/// Replicates left out at either end of a 90% interval.
const TAIL: usize = 50;
/// Rates of the model.
const RATES: usize = 3;
const PIXELS_PER_MILLION: f64 = 1e6;

/// Length and size of a video.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shape {
    /// Frames.
    pub frames: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// What of a profile makes a video dear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Working {
    /// Rows of the working size.
    pub(super) height_px: u32,
    /// Frames left out.
    pub(super) conditioning_frames: u32,
}

/// What one video of the sample cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spent {
    /// `None` where it was not decoded.
    pub(super) shape: Option<Shape>,
    /// Whether it was adjusted.
    pub(super) parallax: bool,
    /// How many videos it stands for.
    pub(super) weight: f64,
    /// Processor time, seconds.
    pub(super) cpu_s: f64,
}

/// Processor time by length and size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CostModel {
    /// Seconds per million pixels decoded.
    pub decode_s_per_mpx: f64,
    /// Seconds per million pixels at the working size.
    pub measure_s_per_mpx: f64,
    /// Beyond that, for a video under parallax.
    pub adjust_s_per_mpx: f64,
    /// Share of the sample under parallax.
    pub parallax_share: f64,
}

/// What is asked of the planner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Question {
    /// Videos to score.
    pub videos: u64,
    /// Their length and size; like the sample's without.
    pub shape: Option<Shape>,
    /// Cores to score them with.
    pub cores: u32,
    /// Hours there are.
    pub hours: f64,
}

/// A run's cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Plan {
    /// Processor time, seconds.
    pub cpu_s: f64,
    /// Its 90% interval, from the spread of the sample.
    pub cpu_interval_90_s: (f64, f64),
    /// Wall time, seconds.
    pub wall_s: f64,
    /// Its 90% interval.
    pub wall_interval_90_s: (f64, f64),
}

/// Predicts the run of a question; `None` without a video.
pub(super) fn plan(spent: &[Spent], working: Working, question: &Question) -> Option<Plan> {
    let mean = |of: &[Spent]| -> Option<f64> {
        let weight: f64 = of.iter().map(|s| s.weight).sum();
        let sum: f64 = of.iter().map(|s| s.weight * s.cpu_s).sum();
        (weight > 0.0).then(|| sum / weight)
    };
    let like_sample = mean(spent)?;
    let mut rng = Pcg64::from_seed([0; 32]);
    let mut replicates: Vec<f64> = (0..REPLICATES)
        .filter_map(|_| {
            let drawn: Vec<Spent> = spent
                .iter()
                .map(|_| spent[index_below(spent.len(), &mut rng)])
                .collect();
            mean(&drawn)
        })
        .collect();
    replicates.sort_unstable_by(f64::total_cmp);
    let (lo, hi) = (
        *replicates.get(TAIL)?,
        *replicates.get(REPLICATES - 1 - TAIL)?,
    );
    // The spread of the sample stands for that of videos of another shape, too.
    let each_s = match question.shape {
        None => like_sample,
        Some(shape) => fit(spent, working)?.expected_s(shape, working),
    };
    let scale = if like_sample > 0.0 {
        each_s / like_sample
    } else {
        1.0
    };
    let videos = question.videos as f64;
    let cpu_interval_90_s = (lo * scale * videos, hi * scale * videos);
    // No more cores are at work than there are videos.
    let cores = f64::from(question.cores).min(videos.max(1.0));
    let longest_s = scale * spent.iter().map(|s| s.cpu_s).fold(0.0, f64::max);
    let wall = |cpu_s: f64| cpu_s / cores + (1.0 - 1.0 / cores) * longest_s / 2.0;
    Some(Plan {
        cpu_s: each_s * videos,
        cpu_interval_90_s,
        wall_s: wall(each_s * videos),
        wall_interval_90_s: (wall(cpu_interval_90_s.0), wall(cpu_interval_90_s.1)),
    })
}

impl CostModel {
    /// Processor time of one video, seconds, where as many are under parallax as in the sample.
    pub(super) fn expected_s(&self, shape: Shape, working: Working) -> f64 {
        let [decoded, measured] = pixels(shape, working);
        self.decode_s_per_mpx * decoded
            + (self.measure_s_per_mpx + self.adjust_s_per_mpx * self.parallax_share) * measured
    }
}

/// Millions of pixels decoded, and measured.
fn pixels(shape: Shape, working: Working) -> [f64; 2] {
    let (width, height) = (f64::from(shape.width), f64::from(shape.height));
    let rows = f64::from(working.height_px);
    let usable = shape.frames.saturating_sub(working.conditioning_frames);
    [
        f64::from(shape.frames) * width * height / PIXELS_PER_MILLION,
        f64::from(usable) * rows * rows * width / height / PIXELS_PER_MILLION,
    ]
}

/// Fits the three rates to the videos that were decoded; `None` without any.
pub(super) fn fit(spent: &[Spent], working: Working) -> Option<CostModel> {
    let decoded: Vec<(&Spent, Shape)> = spent
        .iter()
        .filter_map(|s| Some((s, s.shape.filter(|shape| shape.height > 0)?)))
        .collect();
    let rows: Vec<([f64; RATES], f64)> = decoded
        .iter()
        .map(|(s, shape)| {
            let [decoded, measured] = pixels(*shape, working);
            let adjusted = if s.parallax { measured } else { 0.0 };
            ([decoded, measured, adjusted], s.cpu_s)
        })
        .collect();
    let [decode, measure, adjust] = non_negative_least_squares(&rows)?;
    let parallax = decoded.iter().filter(|(s, _)| s.parallax).count();
    Some(CostModel {
        decode_s_per_mpx: decode,
        measure_s_per_mpx: measure,
        adjust_s_per_mpx: adjust,
        parallax_share: parallax as f64 / decoded.len() as f64,
    })
}

/// Least squares with coefficients of at least 0: the best of the solutions over each choice of columns
/// that has no negative one. Three columns have seven choices.
fn non_negative_least_squares(rows: &[([f64; RATES], f64)]) -> Option<[f64; RATES]> {
    let residual = |x: &[f64; RATES]| -> f64 {
        rows.iter()
            .map(|(a, b)| {
                let found: f64 = a.iter().zip(x).map(|(a, x)| a * x).sum();
                (found - b) * (found - b)
            })
            .sum()
    };
    (1_u32..1 << RATES)
        .filter_map(|choice| {
            let columns: Vec<usize> = (0..RATES).filter(|c| choice >> c & 1 == 1).collect();
            let mut x = [0.0; RATES];
            for (&column, value) in columns.iter().zip(solve(rows, &columns)?) {
                x[column] = value;
            }
            x.iter().all(|&x| x >= 0.0).then_some(x)
        })
        .min_by(|a, b| residual(a).total_cmp(&residual(b)))
}

/// The normal equations over some columns, by Gauss and Jordan with pivots; `None` where they do not
/// determine the solution (videos of one size cannot tell decoding from measuring).
fn solve(rows: &[([f64; RATES], f64)], columns: &[usize]) -> Option<Vec<f64>> {
    /// Relative size of a pivot that rounding alone leaves.
    const SINGULAR: f64 = 1e-9;
    let n = columns.len();
    let mut system = vec![vec![0.0; n + 1]; n];
    for (a, b) in rows {
        for (i, &ci) in columns.iter().enumerate() {
            for (j, &cj) in columns.iter().enumerate() {
                system[i][j] += a[ci] * a[cj];
            }
            system[i][n] += a[ci] * b;
        }
    }
    let sizes: Vec<f64> = (0..n).map(|i| system[i][i]).collect();
    for i in 0..n {
        let pivot = (i..n).max_by(|&a, &b| system[a][i].abs().total_cmp(&system[b][i].abs()))?;
        system.swap(i, pivot);
        let row = system[i].clone();
        if row[i].abs() <= SINGULAR * sizes[i] || row[i] == 0.0 {
            return None;
        }
        for (k, other) in system.iter_mut().enumerate() {
            let factor = if k == i { 0.0 } else { other[i] / row[i] };
            for (value, own) in other.iter_mut().zip(&row) {
                *value -= factor * own;
            }
        }
    }
    Some((0..n).map(|i| system[i][n] / system[i][i]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORKING: Working = Working {
        height_px: 256,
        conditioning_frames: 1,
    };

    fn video(frames: u32, width: u32, height: u32, parallax: bool) -> Spent {
        let shape = Shape {
            frames,
            width,
            height,
        };
        let truth = CostModel {
            decode_s_per_mpx: 0.01,
            measure_s_per_mpx: 0.2,
            adjust_s_per_mpx: if parallax { 0.4 } else { 0.0 },
            parallax_share: 1.0,
        };
        let cpu_s = truth.expected_s(shape, WORKING);
        Spent {
            shape: Some(shape),
            parallax,
            weight: 1.0,
            cpu_s,
        }
    }

    const fn question(shape: Option<Shape>) -> Question {
        Question {
            videos: 1000,
            shape,
            cores: 10,
            hours: 1.0,
        }
    }

    #[test]
    fn the_model_finds_rates_that_made_the_costs() {
        let spent = [
            video(40, 320, 240, false),
            video(80, 640, 480, true),
            video(60, 256, 256, true),
            video(120, 848, 480, false),
        ];
        let model = fit(&spent, WORKING).unwrap();
        assert!((model.decode_s_per_mpx - 0.01).abs() < 1e-9);
        assert!((model.measure_s_per_mpx - 0.2).abs() < 1e-9);
        assert!((model.adjust_s_per_mpx - 0.4).abs() < 1e-9);
        assert_eq!(model.parallax_share, 0.5);
        // Ten times as long is ten times as dear, but for the frame left out.
        let long = Shape {
            frames: 400,
            width: 320,
            height: 240,
        };
        let shape = Some(long);
        let each_s = plan(&spent, WORKING, &question(shape)).unwrap().cpu_s / 1000.0;
        assert!((each_s - model.expected_s(long, WORKING)).abs() < 1e-12);
    }

    #[test]
    fn videos_of_one_size_are_told_apart_by_length_alone() {
        let spent = [video(40, 320, 240, false), video(80, 320, 240, false)];
        let model = fit(&spent, WORKING).unwrap();
        let shape = Shape {
            frames: 60,
            width: 320,
            height: 240,
        };
        let expected = video(60, 320, 240, false).cpu_s;
        assert!((model.expected_s(shape, WORKING) / expected - 1.0).abs() < 1e-2);
        // Nothing negative comes of noise.
        let mut odd = spent;
        odd[1].cpu_s = odd[0].cpu_s / 2.0;
        let model = fit(&odd, WORKING).unwrap();
        assert!(model.decode_s_per_mpx >= 0.0 && model.measure_s_per_mpx >= 0.0);
    }

    #[test]
    fn like_videos_cost_the_weighed_mean() {
        let mut spent = [video(40, 320, 240, false); 4];
        for (k, video) in spent.iter_mut().enumerate() {
            video.cpu_s = 1.0 + k as f64;
        }
        spent[3].weight = 3.0;
        let plan = plan(&spent, WORKING, &question(None)).unwrap();
        // (1 + 2 + 3 + 3 · 4) / 6 = 3 s each; 10 cores; nine of ten wait for half the longest, 4 s.
        assert_eq!(plan.cpu_s, 3000.0);
        assert!((plan.wall_s - 301.8).abs() < 1e-9);
        let (lo, hi) = plan.cpu_interval_90_s;
        assert!(1000.0 < lo && lo < 3000.0 && 3000.0 < hi && hi <= 4000.0);
        assert_eq!(super::plan(&[], WORKING, &question(None)), None);
    }

    #[test]
    fn few_videos_keep_few_cores_busy() {
        let spent = [video(40, 320, 240, false)];
        let asked = Question {
            videos: 2,
            cores: 64,
            ..question(None)
        };
        let plan = plan(&spent, WORKING, &asked).unwrap();
        // Two cores have one each, and one waits for half of it on average.
        assert!((plan.wall_s - 1.25 * spent[0].cpu_s).abs() < 1e-12);
    }
}
