//! Rewards for training: the anomaly scores turned round, in three scales.
//!
//! With r = −S_r over the rows that have a score: raw r; percentile 1 − (rank − 0.5)/n; soft weight
//! clip((r − (μ − 2σ))/(4σ + 1e-12), 0, 1) with the corpus' mean and population σ of r (design
//! section 8). Against a frozen reference, percentile and soft weight are relative to its scores, so
//! that they do not depend on the other rows. Higher is better. No unit. Nothing fails.

use plumbline_common::id::VideoId;
use serde::{Deserialize, Serialize};

use super::ReduceOptions;
use super::moments::{Moments, Standard};
use super::select::Place;

/// The soft weight rises from 0 to 1 over μ ± 2σ.
const SOFT_HALF_WIDTH_SIGMAS: f64 = 2.0;
/// Keeps the soft weight defined where σ = 0; every weight is then 0.
const SOFT_FLOOR: f64 = 1e-12;

/// One line of `rewards.parquet`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reward {
    /// The video.
    pub video: VideoId,
    /// Its group (prompt).
    pub group: Option<String>,
    /// −S_r.
    pub raw: f64,
    /// Share of the corpus (or the reference) that it is better than.
    pub percentile: f64,
    /// Soft weight in [0, 1].
    pub soft: f64,
    /// 1 is the best of its group.
    pub group_rank: u64,
    /// Rows of its group that have a rank.
    pub group_size: u64,
}

/// A row that has a score.
#[derive(Debug, Clone, Copy)]
pub struct Scored<'a> {
    /// The video.
    pub video: &'a VideoId,
    /// Its group.
    pub group: Option<&'a str>,
    /// S_r, finite.
    pub anomaly: f64,
    /// Its place.
    pub place: Place,
}

/// Mean and population σ of the rewards that a soft weight is relative to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Population σ.
    pub std: f64,
}

impl From<Standard> for Spread {
    fn from(standard: Standard) -> Self {
        Self {
            mean: standard.mean,
            std: standard.std,
        }
    }
}

/// Rewards in the order given; relative to the reference where there is one, else to each other.
#[must_use]
pub fn rewards(rows: &[Scored<'_>], options: &ReduceOptions) -> Vec<Reward> {
    let raw: Vec<f64> = rows.iter().map(|row| reward(row.anomaly)).collect();
    let own = || Some(Spread::from(Moments::of(&raw).ok()?.standard()?));
    let Some(spread) = options.reward_spread().or_else(own) else {
        return Vec::new();
    };
    rows.iter()
        .zip(&raw)
        .map(|(row, &raw)| Reward {
            video: row.video.clone(),
            group: row.group.map(str::to_owned),
            raw,
            percentile: options.standing(&row.place, row.anomaly).reward(),
            soft: soft_weight(raw, spread),
            group_rank: row.place.group_rank,
            group_size: row.place.group_size,
        })
        .collect()
}

/// −S_r, without a negative zero.
#[must_use]
pub fn reward(anomaly: f64) -> f64 {
    0.0 - anomaly
}

/// Soft weight in [0, 1] of a raw reward, by the mean and spread of the others.
#[must_use]
pub fn soft_weight(raw: f64, spread: Spread) -> f64 {
    let from_low = raw - (spread.mean - SOFT_HALF_WIDTH_SIGMAS * spread.std);
    let width = 2.0 * SOFT_HALF_WIDTH_SIGMAS * spread.std + SOFT_FLOOR;
    (from_low / width).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(anomalies: &[f64]) -> Vec<Reward> {
        let ids: Vec<VideoId> = (0..anomalies.len())
            .map(|i| VideoId::new(format!("v{i}")).unwrap())
            .collect();
        let rows: Vec<Scored<'_>> = anomalies
            .iter()
            .zip(&ids)
            .enumerate()
            .map(|(i, (&anomaly, video))| {
                let (rank, n) = (i as u64 + 1, anomalies.len() as u64);
                let place = Place {
                    rank,
                    ranked: n,
                    group_rank: rank,
                    group_size: n,
                };
                Scored {
                    video,
                    group: None,
                    anomaly,
                    place,
                }
            })
            .collect();
        let options = super::super::reference::tests::options(super::super::Recipe::Paper, "1");
        rewards(&rows, &options)
    }

    /// r = 1, −1: μ 0, σ 1, soft weights (1 + 2)/4 and (−1 + 2)/4.
    #[test]
    fn two_rows_by_hand() {
        let found = of(&[-1.0, 1.0]);
        assert_eq!((found[0].raw, found[1].raw), (1.0, -1.0));
        assert_eq!((found[0].percentile, found[1].percentile), (0.75, 0.25));
        // The floor of 1e-12 shows in the thirteenth digit.
        assert!((found[0].soft - 0.75).abs() < 1e-12 && (found[1].soft - 0.25).abs() < 1e-12);
    }

    #[test]
    fn none_and_equal_rows() {
        assert!(of(&[]).is_empty());
        let equal = of(&[0.0, 0.0]);
        assert!(
            equal
                .iter()
                .all(|r| r.soft == 0.0 && r.raw.is_sign_positive())
        );
    }

    /// 99 zeros and one outlier: z of the outlier is −√99 ≈ −10, beyond the clip.
    #[test]
    fn outliers_are_clipped() {
        let mut anomalies = vec![0.0; 99];
        anomalies.push(50.0);
        assert_eq!(of(&anomalies)[99].soft, 0.0);
    }
}
