//! Decisions that differ between two measurements of the same videos.

use plumbline_common::row::Decision;
use serde::{Deserialize, Serialize};

use crate::reduce::select::{Candidate, KeepRule, select};

/// The decisions of a keep rule, one per candidate in the order given; review without a score.
#[must_use]
pub fn decisions(candidates: &[Candidate<'_>], keep: &KeepRule) -> Vec<Decision> {
    let selected = select(candidates, keep).into_iter();
    selected.map(|selected| selected.decision).collect()
}

/// Decisions that differ, by kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flips {
    /// Videos compared.
    pub videos: u64,
    /// Kept by the first, dropped by the second.
    pub keep_to_drop: u64,
    /// Dropped by the first, kept by the second.
    pub drop_to_keep: u64,
    /// Review by one of the two alone.
    pub review: u64,
}

impl Flips {
    /// Compares two aligned columns; what one of them has beyond the other is not compared.
    #[must_use]
    pub fn between(first: &[Decision], second: &[Decision]) -> Self {
        let mut flips = Self::default();
        for pair in first.iter().zip(second) {
            flips.videos += 1;
            match pair {
                (a, b) if a == b => {}
                (Decision::Keep, Decision::Drop) => flips.keep_to_drop += 1,
                (Decision::Drop, Decision::Keep) => flips.drop_to_keep += 1,
                _ => flips.review += 1,
            }
        }
        flips
    }

    /// All of them.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.keep_to_drop + self.drop_to_keep + self.review
    }

    /// The share of equal decisions; 1 without videos.
    #[must_use]
    pub fn agreement(&self) -> f64 {
        match self.videos {
            0 => 1.0,
            n => 1.0 - self.count() as f64 / n as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::id::VideoId;

    #[test]
    fn flips_of_known_columns() {
        let videos = ["a", "b", "c", "d"].map(|name| VideoId::new(name).unwrap());
        let decided = |anomalies: [Option<f64>; 4]| {
            let candidates: Vec<_> = videos
                .iter()
                .zip(anomalies)
                .map(|(video, anomaly)| Candidate {
                    video,
                    group: None,
                    anomaly,
                })
                .collect();
            decisions(&candidates, &"2".parse().unwrap())
        };
        let first = decided([Some(1.0), Some(2.0), Some(3.0), None]);
        let second = decided([Some(3.0), Some(2.0), Some(1.0), Some(9.0)]);
        use Decision::{Drop, Keep, Review};
        assert_eq!(first, [Keep, Keep, Drop, Review]);
        assert_eq!(second, [Drop, Keep, Keep, Drop]);
        let flips = Flips::between(&first, &second);
        assert_eq!(
            (flips.keep_to_drop, flips.drop_to_keep, flips.review),
            (1, 1, 1)
        );
        assert_eq!((flips.count(), flips.agreement()), (3, 0.25));
        assert_eq!(Flips::between(&[], &[]).agreement(), 1.0);
    }
}
