//! How likely a decision is to be another one at the top rung.
//!
//! A row that is scored at both: its residual, anomaly at the top less anomaly here, is taken as a Student t
//! with four degrees of freedom (a few residuals are large, which a normal distribution would rule out) of
//! the mean and standard deviation of the residuals of the [`NEIGHBOURS`] known videos nearest in anomaly
//! here: errors are larger among the anomalous. That videos are chosen to be known by their anomaly here
//! biases nothing, given that anomaly. The decision flips where that takes it across the cut.
//! A verdict that may change (`scored`, `static`, `collapsed`): the share of known videos of that verdict
//! for which it did.

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Status};

use crate::reduce::ReduceOptions;
use crate::reduce::select::{Candidate, select};
use crate::reduce::tally::Cuts;

use super::{Seen, Video};

/// Residuals behind a spread: its own error is then some 15%.
pub const NEIGHBOURS: usize = 24;

/// Decisions, and where they are cut.
pub struct Decided<'a> {
    /// One per video.
    pub decisions: Vec<Decision>,
    /// By group.
    pub cuts: Cuts<Option<&'a str>>,
}

/// Applies the keep rule to what is known of each video: its rung and its anomaly.
#[must_use]
pub fn decide<'a>(
    videos: &'a [Video],
    placed: &[Option<(usize, Option<f64>)>],
    options: &ReduceOptions,
) -> Decided<'a> {
    // Names only break ties, and videos come in their order.
    let names: Vec<VideoId> = (0..videos.len())
        .filter_map(|index| VideoId::new(format!("{index:020}")).ok())
        .collect();
    let candidates: Vec<Candidate<'_>> = videos
        .iter()
        .zip(placed)
        .zip(&names)
        .map(|((video, placed), name)| Candidate {
            video: name,
            group: video.group.as_deref(),
            anomaly: placed.and_then(|(_, anomaly)| anomaly),
        })
        .collect();
    let selected = select(&candidates, &options.keep);
    let decisions = selected.into_iter().map(|selected| selected.decision);
    let decisions: Vec<Decision> = decisions.collect();
    let mut cuts = Cuts::default();
    for ((video, placed), &decision) in videos.iter().zip(placed).zip(&decisions) {
        if let Some((_, Some(anomaly))) = placed {
            cuts.note(video.group.as_deref(), *anomaly, decision);
        }
    }
    Decided { decisions, cuts }
}

/// What is known of the way from one rung to the top.
#[derive(Debug, Clone, Default)]
pub struct Residuals {
    /// Anomaly here and at the top, ascending.
    pairs: Vec<(f64, f64)>,
    /// By verdict here, `scored`, `static` and `collapsed`: videos known, and how many of them get another
    /// verdict at the top.
    verdicts: [(u64, u64); 3],
}

impl Residuals {
    /// From every one of these videos that was measured at both rungs.
    pub fn of<'a>(
        videos: impl Iterator<Item = &'a Video>,
        rung: usize,
        top: usize,
        anomaly: &dyn Fn(&Video, usize) -> Option<f64>,
    ) -> Self {
        let mut residuals = Self::default();
        for video in videos {
            let (Some(here), Some(there)) = (video.at(rung), video.at(top)) else {
                continue;
            };
            let pair = anomaly(video, rung).zip(anomaly(video, top));
            residuals.pairs.extend(pair);
            if let Some((known, changed)) = residuals.verdict_mut(here.status) {
                *known += 1;
                *changed += u64::from(here.status != there.status);
            }
        }
        residuals
            .pairs
            .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        residuals
    }

    fn verdict_mut(&mut self, status: Status) -> Option<&mut (u64, u64)> {
        match status {
            Status::Scored => Some(&mut self.verdicts[0]),
            Status::Static => Some(&mut self.verdicts[1]),
            Status::Collapsed => Some(&mut self.verdicts[2]),
            _ => None,
        }
    }

    /// The probability that the top decides otherwise than `decision`, of a row of this rung.
    #[must_use]
    pub fn flip(
        &self,
        status: Status,
        anomaly: Option<f64>,
        decision: Decision,
        cut: Option<f64>,
    ) -> f64 {
        let [scored, standing, collapsed] = self.verdicts;
        match (status, anomaly) {
            (Status::Scored, Some(anomaly)) => {
                let (known, changed) = scored;
                let other_verdict = changed as f64 / known.max(1) as f64;
                let crosses = match (cut, decision) {
                    (Some(cut), Decision::Keep) => 1.0 - self.at_most(cut, anomaly),
                    (Some(cut), Decision::Drop) => self.at_most(cut, anomaly),
                    // All of the group is kept, or all dropped.
                    _ => 0.0,
                };
                other_verdict + (1.0 - other_verdict) * crosses
            }
            // Nothing but the verdict is known of it.
            (Status::Scored, None) => share(scored),
            (Status::Static, _) => share(standing),
            (Status::Collapsed, _) => share(collapsed),
            _ => 0.0,
        }
    }

    /// The probability that the anomaly at the top is at most `cut`, of a video that has `anomaly` here.
    fn at_most(&self, cut: f64, anomaly: f64) -> f64 {
        let near = self.nearest(anomaly);
        let n = near.len() as f64;
        if near.len() < 2 {
            // Nothing is known: a coin.
            return 0.5;
        }
        let mean = near.iter().map(|(here, top)| top - here).sum::<f64>() / n;
        let square = |(here, top): &(f64, f64)| (top - here - mean) * (top - here - mean);
        let variance = near.iter().map(square).sum::<f64>() / (n - 1.0);
        // Of one more residual: the mean is uncertain, too.
        let spread = (variance * (1.0 + 1.0 / n)).sqrt();
        let distance = cut - anomaly - mean;
        match spread > 0.0 {
            true => student_t4(distance / spread),
            false if distance < 0.0 => 0.0,
            false => 1.0,
        }
    }

    /// The pairs nearest in anomaly here.
    fn nearest(&self, anomaly: f64) -> &[(f64, f64)] {
        let n = self.pairs.len();
        let count = NEIGHBOURS.min(n);
        let mut first = self.pairs.partition_point(|pair| pair.0 < anomaly);
        first = first.saturating_sub(count).min(n - count);
        // Moved up as long as the next one is nearer than the first.
        while let (Some(low), Some(next)) = (self.pairs.get(first), self.pairs.get(first + count)) {
            if anomaly - low.0 <= next.0 - anomaly {
                break;
            }
            first += 1;
        }
        self.pairs.get(first..first + count).unwrap_or_default()
    }
}

/// Of a verdict that may change: half a change among one more, where few are known (Jeffreys).
fn share((known, changed): (u64, u64)) -> f64 {
    (changed as f64 + 0.5) / (known as f64 + 1.0)
}

/// The distribution function of a Student t with four degrees of freedom, scaled to a standard deviation of
/// 1 (closed form; Abramowitz and Stegun 26.7.4).
fn student_t4(deviations: f64) -> f64 {
    let t = deviations.clamp(-1e6, 1e6) * std::f64::consts::SQRT_2;
    let sine = t / (4.0 + t * t).sqrt();
    let cosine_squared = 4.0 / (4.0 + t * t);
    (0.5 + 0.5 * sine * (1.0 + 0.5 * cosine_squared)).clamp(0.0, 1.0)
}

/// Whether anything but the file itself decides the verdict.
pub(super) fn open(seen: Option<&Seen>) -> bool {
    seen.is_some_and(Seen::may_change)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of Student's t with 4 degrees of freedom: P(t ≤ 2.776) = 0.975, P(t ≤ 1.533) = 0.9 (any table).
    #[test]
    fn the_distribution_is_that_of_the_tables() {
        for (t, p) in [(0.0, 0.5), (1.533, 0.9), (2.776, 0.975), (-2.132, 0.05)] {
            let found = student_t4(t / std::f64::consts::SQRT_2);
            assert!((found - p).abs() < 1e-4, "{t}: {found}");
        }
        assert_eq!(student_t4(f64::INFINITY), 1.0);
    }

    #[test]
    fn the_nearest_are_those_of_a_full_search() {
        let pairs: Vec<(f64, f64)> = (0..60)
            .map(|k| (f64::from(k * k % 97) / 7.0, 0.0))
            .collect();
        let mut residuals = Residuals {
            pairs,
            ..Residuals::default()
        };
        residuals.pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        for anomaly in [-5.0, 0.0, 3.3, 7.0, 13.9, 99.0] {
            let mut distances: Vec<f64> = residuals
                .pairs
                .iter()
                .map(|p| (p.0 - anomaly).abs())
                .collect();
            distances.sort_by(f64::total_cmp);
            let near = residuals.nearest(anomaly).iter();
            let mut found: Vec<f64> = near.map(|p| (p.0 - anomaly).abs()).collect();
            found.sort_by(f64::total_cmp);
            assert_eq!(found, distances[..NEIGHBOURS]);
        }
    }

    #[test]
    fn far_from_the_cut_is_sure_and_at_it_a_coin() {
        let pairs = (0..40)
            .map(|k| (f64::from(k), f64::from(k) + f64::from(k % 3 - 1)))
            .collect();
        let residuals = Residuals {
            pairs,
            verdicts: [(40, 0), (0, 0), (9, 1)],
        };
        let flip =
            |anomaly, decision| residuals.flip(Status::Scored, Some(anomaly), decision, Some(20.0));
        assert!(flip(1.0, Decision::Keep) < 1e-3);
        assert!(flip(39.0, Decision::Drop) < 1e-3);
        assert!((flip(20.0, Decision::Keep) - 0.5).abs() < 0.05);
        assert_eq!(
            residuals.flip(Status::Static, None, Decision::Review, None),
            0.5
        );
        assert_eq!(
            residuals.flip(Status::Collapsed, None, Decision::Review, None),
            0.15
        );
        let undecodable = residuals.flip(Status::Undecodable, None, Decision::Review, None);
        assert_eq!(undecodable, 0.0);
    }
}
