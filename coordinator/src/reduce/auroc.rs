//! How well a score tells two classes apart: the area under the ROC curve, with an interval.
//!
//! The area is the share of pairs (one of each class) in which the positive one scores higher, ties
//! counting half (Mann and Whitney 1947): 0.5 is chance. The interval is a percentile bootstrap over
//! the videos of each class (Efron 1979), seeded by the caller: same bits for the same values in any
//! order. No unit.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;
use serde::Serialize;

use super::draw::index_below;

/// Bootstrap replicates: 1000 leave 25 beyond either end of the interval.
const REPLICATES: usize = 1000;
/// Replicates left out at either end of a 95% interval.
const TAIL: usize = 25;

/// An area under the ROC curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Auroc {
    /// The area.
    pub area: f64,
    /// 95% bootstrap interval.
    pub interval_95: (f64, f64),
    /// Videos of the positive class.
    pub positives: u64,
    /// Videos of the negative class.
    pub negatives: u64,
}

/// The area for finite scores; `None` where a class has none.
#[must_use]
pub fn auroc(positives: &[f64], negatives: &[f64], seed: [u8; 32]) -> Option<Auroc> {
    if positives.is_empty() || negatives.is_empty() {
        return None;
    }
    let mut levels: Vec<f64> = positives.iter().chain(negatives).map(|s| s + 0.0).collect();
    levels.sort_unstable_by(f64::total_cmp);
    levels.dedup();
    let places = |scores: &[f64]| -> Vec<usize> {
        let mut places: Vec<usize> = scores
            .iter()
            .map(|score| levels.partition_point(|level| level < score))
            .collect();
        // In this order the draws do not depend on that of the input.
        places.sort_unstable();
        places
    };
    let (positives, negatives) = (places(positives), places(negatives));
    let mut rng = Pcg64::from_seed(seed);
    let mut replicates: Vec<f64> = (0..REPLICATES)
        .map(|_| {
            let mut redraw = |places: &[usize]| {
                let mut counts = vec![0; levels.len()];
                for _ in places {
                    counts[places[index_below(places.len(), &mut rng)]] += 1;
                }
                counts
            };
            let (positives, negatives) = (redraw(&positives), redraw(&negatives));
            area(&positives, &negatives)
        })
        .collect();
    replicates.sort_unstable_by(f64::total_cmp);
    let counts = |places: &[usize]| {
        let mut counts = vec![0; levels.len()];
        places.iter().for_each(|&place| counts[place] += 1);
        counts
    };
    Some(Auroc {
        area: area(&counts(&positives), &counts(&negatives)),
        interval_95: (replicates[TAIL], replicates[REPLICATES - 1 - TAIL]),
        positives: positives.len() as u64,
        negatives: negatives.len() as u64,
    })
}

/// From counts per level, ascending. Whole numbers up to the division: exact for any order.
fn area(positives: &[u64], negatives: &[u64]) -> f64 {
    let mut below: u128 = 0;
    let mut halves: u128 = 0;
    for (&positive, &negative) in positives.iter().zip(negatives) {
        halves += u128::from(positive) * (2 * below + u128::from(negative));
        below += u128::from(negative);
    }
    let positives: u128 = positives.iter().map(|&n| u128::from(n)).sum();
    halves as f64 / (2 * positives * below) as f64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn by_hand() {
        let of = |p: &[f64], n: &[f64]| auroc(p, n, [0; 32]).map(|a| a.area);
        assert_eq!(of(&[2.0, 3.0], &[0.0, 1.0]), Some(1.0));
        assert_eq!(of(&[0.0], &[0.0, -0.0]), Some(0.5));
        // Pairs: 3 > 2, 3 > 1, 1 < 2, 1 = 1: 2.5 of 4.
        assert_eq!(of(&[1.0, 3.0], &[1.0, 2.0]), Some(0.625));
        assert_eq!((of(&[], &[1.0]), of(&[1.0], &[])), (None, None));
    }

    #[test]
    fn the_interval_covers_chance_when_there_is_nothing_to_tell() {
        let scores: Vec<f64> = (0..60).map(|i| f64::from(i * 37 % 60)).collect();
        let found = auroc(&scores[..30], &scores[30..], [1; 32]).unwrap();
        let (lo, hi) = found.interval_95;
        assert!(lo < 0.5 && 0.5 < hi && hi - lo < 0.35, "{found:?}");
        assert!(lo <= found.area && found.area <= hi);
    }

    proptest! {
        // A thousand replicates each.
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn agrees_with_all_pairs_in_any_order(
            p in prop::collection::vec(-5_i8..5, 1..20), n in prop::collection::vec(-5_i8..5, 1..20),
        ) {
            let floats = |values: &[i8]| -> Vec<f64> { values.iter().copied().map(f64::from).collect() };
            let mut wins = 0.0;
            for a in &p {
                for b in &n {
                    wins += match a.cmp(b) {
                        std::cmp::Ordering::Greater => 1.0,
                        std::cmp::Ordering::Equal => 0.5,
                        std::cmp::Ordering::Less => 0.0,
                    };
                }
            }
            let found = auroc(&floats(&p), &floats(&n), [3; 32]).unwrap();
            prop_assert!((found.area - wins / (p.len() * n.len()) as f64).abs() < 1e-12);
            let (mut back, mut back_n) = (floats(&p), floats(&n));
            back.reverse();
            back_n.reverse();
            prop_assert_eq!(auroc(&back, &back_n, [3; 32]).unwrap(), found);
        }
    }
}
