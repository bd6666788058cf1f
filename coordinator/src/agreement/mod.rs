//! How well two measurements of the same videos agree: pure functions of two aligned columns.
//!
//! Order ([`spearman`], [`kendall`]), size of the difference ([`score_error`]), and what follows from it:
//! which keep/drop decisions differ ([`decisions`], [`Flips`]). Pairs of one video each, in any order, give
//! the same bits. Nothing fails: what is undefined (too few pairs, no spread) is `None`. Values that are not
//! finite are left out by whoever pairs them.

mod flips;
mod rank_correlation;

pub use flips::{Flips, decisions};
pub use rank_correlation::{kendall, spearman};

use crate::reduce::order::OrderStatistics;
use crate::reduce::values::InMemory;

/// How far two scores of a video lie apart, |a − b|, in the unit of the scores.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreError {
    /// Median over the videos.
    pub median: f64,
    /// 95% quantile (linear between neighbours).
    pub p95: f64,
}

/// Median and 95% quantile of |a − b|; `None` without pairs.
#[must_use]
pub fn score_error(pairs: &[(f64, f64)]) -> Option<ScoreError> {
    const P95: f64 = 0.95;
    let errors: InMemory = pairs.iter().map(|(a, b)| (a - b).abs()).collect();
    let Ok(order) = OrderStatistics::find(&errors, pairs.len() as u64, &[P95], 0);
    Some(ScoreError {
        median: order.median()?,
        p95: order.quantile(P95)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn score_error_by_hand() {
        let pairs: Vec<_> = (0..=100)
            .map(|k| (f64::from(k), 2.0 * f64::from(k)))
            .collect();
        let found = score_error(&pairs).unwrap();
        assert_eq!((found.median, found.p95), (50.0, 95.0));
        assert_eq!(score_error(&[]), None);
    }
}
