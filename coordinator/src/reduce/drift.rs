//! Whether a corpus still looks like the reference that it is scored against.
//!
//! Per signal, and for the score itself:
//! - the population stability index, PSI = Σ (q − p) ln(q/p) over ten bins with a tenth of the
//!   reference each; p, q the shares of reference and corpus, an empty bin counted as half a row. By
//!   convention below 0.1 is stable, from 0.25 on a major shift. Without any shift PSI·nm/(n + m) is
//!   about χ² with one degree less than there are bins (Yurdakul 2018), so that few rows alone give
//!   large values: an index that chance explains (5%) is none, and where chance reaches 0.25 the
//!   index judges nothing.
//! - the two-sample Kolmogorov-Smirnov distance D = max |F − G| with its asymptotic p-value (Stephens'
//!   correction, as in Numerical Recipes 14.3; used from nm/(n + m) = 8 on). It judges where rows are
//!   too few for the index: below p = 0.001 D is large by itself then.
//!
//! No unit. Only reading the values can fail. Exponentials and logarithms are `libm`'s, so that what
//! is published has the same bits everywhere.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::distribution::{Distribution, Placed};
use super::values::Values;

/// PSI from which a shift is moderate, and from which it is major.
pub const PSI_LEVELS: (f64, f64) = (0.1, 0.25);

/// Bins of the index.
const PSI_BINS: u64 = 10;

/// 95% points of χ² with 1 to 9 degrees of freedom.
const CHI_SQUARE_95: [f64; PSI_BINS as usize - 1] = [
    3.841, 5.991, 7.815, 9.488, 11.070, 12.592, 14.067, 15.507, 16.919,
];

/// Below this p-value a distance is no chance: seven signals and the score are looked at in each run.
const KS_P: f64 = 0.001;

/// nm/(n + m) below which the asymptotic p-value says nothing.
const KS_LEAST: f64 = 8.0;

/// What can be said of a shift.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No more than chance, or below 0.1.
    Stable,
    /// PSI from 0.1.
    Moderate,
    /// PSI from 0.25; with few rows: a distance that is no chance.
    Major,
    /// Too few rows to judge by, or nothing to compare.
    TooFew,
}

/// One signal of a corpus against the reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// Rows of the corpus that have it.
    pub n: u64,
    /// Population stability index; absent where there are no rows, or the reference is one value.
    pub psi: Option<f64>,
    /// What the index exceeds by chance in one corpus of 20, for so many rows.
    pub psi_by_chance: Option<f64>,
    /// Kolmogorov-Smirnov distance.
    pub ks: Option<f64>,
    /// How often chance gives such a distance; absent with too few rows.
    pub ks_p: Option<f64>,
    /// What that comes to.
    pub verdict: Verdict,
}

/// The reference that a corpus was scored against, for `corpus.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Digest of the reference.
    pub digest: String,
    /// Scored rows behind it.
    pub n: u64,
    /// Its entropy weights, which weigh the paper's signals.
    pub weights: BTreeMap<String, f64>,
    /// By column name: every signal, and `anomaly`.
    pub drift: BTreeMap<String, Drift>,
}

/// Compares values with the reference's.
///
/// # Errors
/// Where the values cannot be read.
pub fn drift<V: Values>(reference: &Distribution, values: &V) -> Result<Drift, V::Error> {
    let placed = reference.place(values)?;
    let psi = psi(reference, &placed);
    let ks = ks(reference, &placed);
    let ks_p = ks.and_then(|d| ks_p(d, reference.n, placed.n));
    let (psi, psi_by_chance) = (psi.map(|p| p.0), psi.map(|p| p.1));
    let by_index = psi
        .zip(psi_by_chance)
        .filter(|&(_, chance)| chance < PSI_LEVELS.1)
        .map(|(psi, chance)| match psi {
            psi if psi < PSI_LEVELS.0 || psi <= chance => Verdict::Stable,
            psi if psi < PSI_LEVELS.1 => Verdict::Moderate,
            _ => Verdict::Major,
        });
    let by_distance = ks_p.filter(|&p| p < KS_P).map(|_| Verdict::Major);
    Ok(Drift {
        n: placed.n,
        psi,
        psi_by_chance,
        ks,
        ks_p,
        verdict: by_index.or(by_distance).unwrap_or(Verdict::TooFew),
    })
}

/// The index and what it exceeds by chance.
fn psi(reference: &Distribution, placed: &Placed) -> Option<(f64, f64)> {
    let (n, m) = (reference.n, placed.n);
    if m == 0 {
        return None;
    }
    // Upper ends of all bins but the last.
    let mut ends: Vec<usize> = (1..PSI_BINS)
        .map(|k| {
            reference.at_most.partition_point(|&c| {
                u128::from(c) * u128::from(PSI_BINS) < u128::from(k) * u128::from(n)
            })
        })
        .filter(|&end| reference.at_most.get(end).is_some_and(|&count| count < n))
        .collect();
    ends.dedup();
    let degrees = ends.len().checked_sub(1)?;
    let shares = |at_most: &[u64], all: u64| -> Vec<f64> {
        let ends = ends.iter().map(|&end| at_most[end]).chain([all]);
        let mut before = 0;
        ends.map(|end| {
            let count = end - before;
            before = end;
            let rows = if count == 0 { 0.5 } else { count as f64 };
            rows / all as f64
        })
        .collect()
    };
    let (p, q) = (shares(&reference.at_most, n), shares(&placed.at_most, m));
    let index = p
        .iter()
        .zip(&q)
        .map(|(p, q)| (q - p) * libm::log(q / p))
        .sum::<f64>();
    Some((
        index,
        CHI_SQUARE_95[degrees] * (1.0 / n as f64 + 1.0 / m as f64),
    ))
}

/// max |F − G| over the kept values, just below each and at it: exact where all were kept.
fn ks(reference: &Distribution, placed: &Placed) -> Option<f64> {
    if reference.n == 0 || placed.n == 0 {
        return None;
    }
    let gap =
        |(&f, &g): (&u64, &u64)| (f as f64 / reference.n as f64 - g as f64 / placed.n as f64).abs();
    let below = reference.below.iter().zip(&placed.below).map(gap);
    let at = reference.at_most.iter().zip(&placed.at_most).map(gap);
    Some(below.chain(at).fold(0.0, f64::max))
}

/// P(D ≥ d) of two samples from one distribution; `None` with too few.
fn ks_p(d: f64, n: u64, m: u64) -> Option<f64> {
    let (n, m) = (n as f64, m as f64);
    let effective = n * m / (n + m);
    if effective < KS_LEAST {
        return None;
    }
    let root = effective.sqrt();
    Some(kolmogorov((root + 0.12 + 0.11 / root) * d))
}

/// Q(λ) = 2 Σ (−1)^(k−1) exp(−2 k² λ²), Kolmogorov's distribution from above.
fn kolmogorov(lambda: f64) -> f64 {
    // Below, 1 − Q is smaller than 1e-14, and the series converges slowly.
    if lambda < 0.18 {
        return 1.0;
    }
    let mut sum = 0.0;
    let mut sign = 1.0;
    for k in 1..=100_u32 {
        let k = f64::from(k);
        let term = libm::exp(-2.0 * k * k * lambda * lambda);
        sum += sign * term;
        if term < 1e-17 {
            break;
        }
        sign = -sign;
    }
    (2.0 * sum).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::values::InMemory;

    fn compared(reference: &[f64], values: &[f64]) -> Drift {
        let of = |values: &[f64]| -> InMemory { values.iter().copied().collect() };
        let Ok(reference) = Distribution::of(&of(reference));
        let Ok(found) = drift(&reference, &of(values));
        found
    }

    /// scipy 1.17.1: `scipy.special.kolmogorov`.
    #[test]
    fn kolmogorovs_distribution() {
        for (lambda, q) in [
            (0.1, 1.0),
            (0.3, 0.999_990_694_198_665_5),
            (0.5, 0.963_945_243_664_875_1),
            (0.8, 0.544_142_411_574_198_1),
            (1.0, 0.269_999_671_677_354_56),
            (1.36, 0.049_485_876_755_377_876),
            (1.95, 0.000_995_910_842_883_58),
            (3.0, 3.045_995_948_942_526e-8),
        ] {
            // An alternating series of terms up to 1, each rounded.
            assert!((kolmogorov(lambda) - q).abs() < 2e-15, "{lambda}");
        }
    }

    /// scipy 1.17.1: exact two-sample p-values as `scipy.stats.ks_2samp` finds them. The asymptotic ones
    /// are within a fifth, and a factor of two too careful at the edge of what is judged (34, 11).
    #[test]
    fn p_values_are_near_the_exact_ones() {
        for (n, m, d, exact, slack) in [
            (20, 14, 0.6, 0.002_625_132_146_709_118_5, 0.2),
            (
                34,
                11,
                0.649_732_620_320_855_7,
                0.000_511_516_963_736_565_4,
                1.0,
            ),
            (100, 9, 0.6, 0.002_269_595_188_376_141, 0.2),
            (50, 200, 0.115, 0.641_882_038_843_187_1, 0.2),
            (84, 85, 0.3, 0.000_812_692_223_765_029_7, 0.2),
            (1000, 30, 0.37, 0.000_441_513_721_662_286_7, 0.2),
        ] {
            let found = ks_p(d, n, m).unwrap();
            assert!((found / exact - 1.0).abs() < slack, "{n} {m} {found}");
        }
        assert_eq!(ks_p(1.0, 15, 15), None);
    }

    /// scipy 1.17.1, `ks_2samp`: the distance of i/84 and 0.3 + 0.8 i/60.
    #[test]
    fn distance_as_scipy_has_it() {
        let a: Vec<f64> = (0..84).map(|i| f64::from(i) / 84.0).collect();
        let b: Vec<f64> = (0..60).map(|i| 0.3 + 0.8 * f64::from(i) / 60.0).collect();
        let found = compared(&a, &b);
        assert!((found.ks.unwrap() - 0.309_523_809_523_809_5).abs() < 1e-15);
        // Ties and values outside: F = 0, ½, 1 and G = ⅓, ⅓, 1 at 1, 2, 3.
        assert_eq!(compared(&[2.0, 3.0], &[1.0, 3.0, 3.0]).ks, Some(1.0 / 3.0));
    }

    /// Reference 0..100 has ten in each bin; of 200 values 11 to 29 instead of 20 each.
    #[test]
    fn index_by_hand() {
        let reference: Vec<f64> = (0..100).map(f64::from).collect();
        let values: Vec<f64> = (0..10)
            .flat_map(|bin| vec![f64::from(bin) * 10.0 + 5.0; 11 + 2 * bin as usize])
            .collect();
        let found = compared(&reference, &values);
        let twin: f64 = (0..10)
            .map(|bin| f64::from(11 + 2 * bin) / 200.0)
            .map(|q| (q - 0.1) * (q / 0.1).ln())
            .sum();
        assert!((found.psi.unwrap() - twin).abs() < 1e-15);
        // χ²(9) at 95% is 16.919.
        assert!((found.psi_by_chance.unwrap() - 16.919 * 0.015).abs() < 1e-12);
        let equal = compared(&[4.0; 20], &values);
        assert_eq!((equal.psi, equal.ks), (None, Some(1.0)));
    }
}
