//! The 90% interval of a clip's anomaly score: moving-block bootstrap over its frame pairs.
//!
//! Neighbouring pairs are not independent, so whole blocks of them are drawn (Künsch 1989), of
//! ⌈n^(1/3)⌉ pairs, at least 2. Each replicate recomputes the clip's signals from the drawn pairs
//! (s_3: mean of e_t weighed by cells; s_p: mean; the others: medians) and scores them with the
//! corpus' yardstick held fixed: the interval says how far the clip's own frames bear its score out,
//! not how the corpus might have been different.
//!
//! The replicates are shifted so that the score recomputed from the whole series falls on the row's
//! score, and the interval is widened to contain that score: blocks draw the first and last pairs
//! less often, which can push a short clip's replicates to one side.
//!
//! Seeded by the video alone: the same bits whatever order rows come in. Nothing fails; a clip with
//! too few pairs has no interval.

use plumbline_common::row::Series;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use super::draw::index_below;
use super::histogram::median_of_sorted;
use super::outcome::Recipe;
use super::recipe::{BySignal, Signal, Yardstick, signals_of};

/// How the interval is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct IntervalParams {
    /// Bootstrap replicates: 200 leave 10 beyond either end.
    pub replicates: u32,
    /// Percentiles of the replicates that bound the interval.
    pub percentiles: (u32, u32),
    /// With fewer pairs (of any signal that counts) the blocks are too few to say anything.
    pub min_pairs: usize,
    /// The same for signals of steps of constant visual motion, which lie several pairs apart; the
    /// least that their clip value needs.
    pub min_steps: usize,
    /// Shortest block.
    pub min_block: usize,
}

impl Default for IntervalParams {
    fn default() -> Self {
        Self {
            replicates: 200,
            percentiles: (5, 95),
            min_pairs: 8,
            min_steps: 3,
            min_block: 2,
        }
    }
}

impl IntervalParams {
    fn least(&self, signal: Signal) -> usize {
        if signal.is_per_step() {
            self.min_steps
        } else {
            self.min_pairs
        }
    }
}

/// The interval of `anomaly`, the row's score under `recipe` with `values`; `seed` names the video.
#[must_use]
pub fn anomaly_interval(
    series: &Series,
    values: &BySignal<Option<f64>>,
    anomaly: f64,
    yardstick: &Yardstick,
    recipe: Recipe,
    seed: &[u8],
    params: &IntervalParams,
) -> Option<(f64, f64)> {
    let signals: Vec<Signal> = signals_of(recipe)
        .filter(|&signal| values[signal].is_some() && yardstick.counts(recipe, signal))
        .collect();
    if signals.is_empty()
        || signals
            .iter()
            .any(|&s| defined_pairs(series, s) < params.least(s))
    {
        return None;
    }
    let score = |pairs: &[usize]| {
        let mut resampled = BySignal::default();
        for &signal in &signals {
            // A replicate that lost a signal altogether is no replicate of this score.
            resampled[signal] = Some(clip_value(series, signal, pairs)?);
        }
        yardstick.anomaly(recipe, &resampled)
    };

    let n = signals
        .iter()
        .map(|&signal| pair_values(series, signal).len())
        .max()?;
    let whole: Vec<usize> = (0..n).collect();
    let shift = anomaly - score(&whole)?;
    let mut rng = Pcg64::from_seed(*blake3::hash(seed).as_bytes());
    let mut replicates = Vec::with_capacity(params.replicates as usize);
    for _ in 0..params.replicates {
        let pairs = draw_blocks(n, block_pairs(n, params.min_block), &mut rng);
        replicates.extend(score(&pairs).map(|replicate| replicate + shift));
    }
    if replicates.len() * 2 < params.replicates as usize {
        return None;
    }
    replicates.sort_unstable_by(f64::total_cmp);
    let lo = nearest_rank(&replicates, params.percentiles.0)?.min(anomaly);
    let hi = nearest_rank(&replicates, params.percentiles.1)?.max(anomaly);
    (lo.is_finite() && hi.is_finite()).then_some((lo + 0.0, hi + 0.0))
}

fn pair_values(series: &Series, signal: Signal) -> &[Option<f64>] {
    match signal {
        Signal::ReprojPx => &series.reproj_px,
        Signal::AepeWorldscorePx => &series.aepe_worldscore_px,
        Signal::PiecewiseResidual => &series.piecewise_residual,
        Signal::AppearanceRatio => &series.appearance_ratio,
        Signal::LayerAcceleration => &series.layer_acceleration_q25,
        Signal::InteriorShear => &series.interior_shear,
        Signal::DetailChange => &series.detail_change_q25,
    }
}

/// What a pair counts in the clip's value: its cells for s_3, else 1.
fn pair_weight(series: &Series, signal: Signal, pair: usize) -> f64 {
    match signal {
        Signal::ReprojPx => f64::from(series.reproj_cells.get(pair).copied().unwrap_or(0)),
        _ => 1.0,
    }
}

fn defined_pairs(series: &Series, signal: Signal) -> usize {
    let values = pair_values(series, signal);
    (0..values.len())
        .filter(|&pair| values[pair].is_some() && pair_weight(series, signal, pair) > 0.0)
        .count()
}

/// The clip's signal from these pairs; `None` where none of them has it.
fn clip_value(series: &Series, signal: Signal, pairs: &[usize]) -> Option<f64> {
    let values = pair_values(series, signal);
    let defined = pairs.iter().filter_map(|&pair| {
        Some((
            values.get(pair).copied()??,
            pair_weight(series, signal, pair),
        ))
    });
    if signal.is_robust() {
        let mut values: Vec<f64> = defined.map(|(value, _)| value).collect();
        values.sort_unstable_by(f64::total_cmp);
        return median_of_sorted(&values);
    }
    let (sum, weight) = defined.fold((0.0, 0.0), |(sum, total), (value, weight)| {
        (sum + weight * value, total + weight)
    });
    (weight > 0.0).then(|| sum / weight)
}

/// ⌈n^(1/3)⌉ by integers, at least `min_block`, at most n.
fn block_pairs(n: usize, min_block: usize) -> usize {
    let root = (1..=n)
        .find(|&block| block.saturating_pow(3) >= n)
        .unwrap_or(n);
    root.max(min_block).min(n)
}

/// n pairs in blocks that start anywhere; the last block is cut.
fn draw_blocks(n: usize, block: usize, rng: &mut impl Rng) -> Vec<usize> {
    let starts = n - block + 1;
    let mut pairs = Vec::with_capacity(n + block);
    while pairs.len() < n {
        let start = index_below(starts, rng);
        pairs.extend(start..start + block);
    }
    pairs.truncate(n);
    pairs
}

/// The ⌈percent/100 · m⌉-th smallest of m values.
fn nearest_rank(sorted: &[f64], percent: u32) -> Option<f64> {
    let rank = (sorted.len() * percent as usize).div_ceil(100).max(1);
    sorted.get(rank - 1).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::moments::Moments;
    use crate::reduce::standardise::Ruler;

    /// s_p alone counts, with z = s − 2.
    fn yardstick() -> Yardstick {
        let standard = Ruler::Standard(Moments::of(&[1.0, 3.0]).unwrap().standard().unwrap());
        Yardstick {
            rulers: BySignal(Signal::ALL.map(|signal| match signal {
                Signal::AepeWorldscorePx => standard,
                _ => Ruler::Absent,
            })),
            paper_weights: Some([0.0, 1.0]),
        }
    }

    fn interval(aepe: &[f64], seed: &str) -> Option<(f64, f64)> {
        let series = Series {
            aepe_worldscore_px: aepe.iter().copied().map(Some).collect(),
            ..Series::default()
        };
        let mean = aepe.iter().sum::<f64>() / aepe.len() as f64;
        let values = BySignal([None, Some(mean), None, None, None, None, None]);
        let y = yardstick();
        let anomaly = y.anomaly(Recipe::Paper, &values).unwrap();
        let found = anomaly_interval(
            &series,
            &values,
            anomaly,
            &y,
            Recipe::Paper,
            seed.as_bytes(),
            &IntervalParams::default(),
        );
        if let Some((lo, hi)) = found {
            assert!(lo <= anomaly && anomaly <= hi);
        }
        found
    }

    #[test]
    fn a_constant_series_has_no_width() {
        assert_eq!(interval(&[3.0; 20], "a"), Some((1.0, 1.0)));
    }

    #[test]
    fn too_few_pairs() {
        assert_eq!(interval(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "a"), None);
        assert!(interval(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], "a").is_some());
    }

    /// 64 alternating pairs 1, 3 in blocks of 4: every block has two of each, so every replicate
    /// mean is 2. Ones then threes in halves: 16 blocks, nearly all of one kind, so that the mean is
    /// about binomial, 2 ± 1.645·2·√(0.25/16) = 2 ± 0.41.
    #[test]
    fn blocks_keep_the_correlation() {
        let alternating: Vec<f64> = (0..64)
            .map(|i| if i % 2 == 0 { 1.0 } else { 3.0 })
            .collect();
        assert_eq!(interval(&alternating, "a"), Some((0.0, 0.0)));
        let halves: Vec<f64> = (0..64).map(|i| if i < 32 { 1.0 } else { 3.0 }).collect();
        let (lo, hi) = interval(&halves, "a").unwrap();
        // 200 replicates place a 5% point within about ±0.1.
        assert!(
            (lo + 0.41).abs() < 0.12 && (hi - 0.41).abs() < 0.12,
            "{lo} {hi}"
        );
    }

    #[test]
    fn the_video_is_the_seed() {
        let rising: Vec<f64> = (0..40).map(|i| libm::sqrt(f64::from(i))).collect();
        assert_eq!(interval(&rising, "a"), interval(&rising, "a"));
        assert_ne!(interval(&rising, "a"), interval(&rising, "b"));
    }

    #[test]
    fn clip_values_by_hand() {
        let series = Series {
            reproj_px: vec![Some(1.0), None, Some(4.0), Some(9.0)],
            reproj_cells: vec![1, 7, 2, 0],
            appearance_ratio: vec![Some(5.0), Some(1.0), None, Some(2.0)],
            ..Series::default()
        };
        assert_eq!(
            clip_value(&series, Signal::ReprojPx, &[0, 1, 2, 3]),
            Some(3.0)
        );
        assert_eq!(clip_value(&series, Signal::ReprojPx, &[1, 3]), None);
        assert_eq!(
            clip_value(&series, Signal::AppearanceRatio, &[0, 1, 2, 3]),
            Some(2.0)
        );
        assert_eq!(
            clip_value(&series, Signal::AppearanceRatio, &[0, 0, 1, 2]),
            Some(5.0)
        );
        assert_eq!(defined_pairs(&series, Signal::ReprojPx), 2);
    }

    #[test]
    fn blocks_and_ranks() {
        assert_eq!(
            [8, 9, 27, 28, 1000].map(|n| block_pairs(n, 2)),
            [2, 3, 3, 4, 10]
        );
        let mut rng = Pcg64::from_seed([7; 32]);
        let mut seen = [false; 9];
        for _ in 0..100 {
            let pairs = draw_blocks(11, 3, &mut rng);
            assert_eq!(pairs.len(), 11);
            for block in pairs.chunks(3) {
                assert!(block.windows(2).all(|w| w[1] == w[0] + 1) && block[0] <= 8);
                seen[block[0]] = true;
            }
        }
        assert_eq!(seen, [true; 9]);
        let ranks: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!(
            (nearest_rank(&ranks, 5), nearest_rank(&ranks, 95)),
            (Some(10.0), Some(190.0))
        );
        assert_eq!(nearest_rank(&[], 5), None);
    }
}
