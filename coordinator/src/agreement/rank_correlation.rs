//! Rank correlations with ties.

use std::cmp::Ordering;

/// Spearman's ρ: Pearson's correlation of average ranks. `None` where either side has no spread.
#[must_use]
pub fn spearman(pairs: &[(f64, f64)]) -> Option<f64> {
    let x = ranks(pairs.iter().map(|pair| pair.0));
    let y = ranks(pairs.iter().map(|pair| pair.1));
    let mean = (pairs.len() as f64 + 1.0) / 2.0;
    let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
    // Ranks are halves of whole numbers: up to some 10^5 pairs these sums are exact in any order.
    for (x, y) in x.iter().zip(&y) {
        xy += (x - mean) * (y - mean);
        xx += (x - mean) * (x - mean);
        yy += (y - mean) * (y - mean);
    }
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx * yy).sqrt())
}

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<(f64, usize)> = values
        .enumerate()
        .map(|(i, value)| (value + 0.0, i))
        .collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut ranks = vec![0.0; sorted.len()];
    let mut before = 0;
    for tie in sorted.chunk_by(|a, b| a.0 == b.0) {
        let rank = before as f64 + (tie.len() as f64 + 1.0) / 2.0;
        for (_, index) in tie {
            ranks[*index] = rank;
        }
        before += tie.len();
    }
    ranks
}

/// Kendall's τ-b, (C − D)/√((P − Tx)(P − Ty)) over the P pairs of pairs: C in the same order on both sides,
/// D in the opposite one, Tx and Ty tied on a side (Kendall 1945), by Knight's algorithm (1966) in
/// O(n log n): exact counts up to the division. `None` where either side has no spread.
#[must_use]
pub fn kendall(pairs: &[(f64, f64)]) -> Option<f64> {
    // −0 is 0.
    let mut pairs: Vec<(f64, f64)> = pairs.iter().map(|(x, y)| (x + 0.0, y + 0.0)).collect();
    let by_x_y = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    pairs.sort_unstable_by(by_x_y);
    let tied_x = tied(pairs.chunk_by(|a, b| a.0 == b.0));
    let tied_both = tied(pairs.chunk_by(|a, b| by_x_y(a, b) == Ordering::Equal));
    let mut y: Vec<f64> = pairs.iter().map(|pair| pair.1).collect();
    // Ordered by x and within equal x by y, a pair out of order in y is one in opposite orders.
    let opposite = i128::from(inversions(&mut y));
    let tied_y = tied(y.chunk_by(|a, b| a == b));
    let all = among(pairs.len());
    let untied = (all - tied_x, all - tied_y);
    if untied.0 == 0 || untied.1 == 0 {
        return None;
    }
    let same = all - tied_x - tied_y + tied_both - opposite;
    Some((same - opposite) as f64 / (untied.0 as f64 * untied.1 as f64).sqrt())
}

/// Pairs among n.
fn among(n: usize) -> i128 {
    let n = n as i128;
    n * (n - 1).max(0) / 2
}

fn tied<'a, T: 'a>(ties: impl Iterator<Item = &'a [T]>) -> i128 {
    ties.map(|tie| among(tie.len())).sum()
}

/// Sorts, and counts the pairs that were in descending order.
fn inversions(values: &mut [f64]) -> u64 {
    let half = values.len() / 2;
    if half == 0 {
        return 0;
    }
    let (left, right) = values.split_at_mut(half);
    let mut count = inversions(left) + inversions(right);
    let mut merged = Vec::with_capacity(left.len() + right.len());
    let (mut l, mut r) = (left.iter().peekable(), right.iter().peekable());
    while let (Some(&&a), Some(&&b)) = (l.peek(), r.peek()) {
        if a <= b {
            merged.push(a);
            l.next();
        } else {
            count += l.len() as u64;
            merged.push(b);
            r.next();
        }
    }
    merged.extend(l.chain(r));
    values.copy_from_slice(&merged);
    count
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn spearman_of_known_sequences() {
        let up: Vec<_> = (0..10).map(|i| (f64::from(i), f64::from(i * i))).collect();
        assert_eq!(spearman(&up), Some(1.0));
        let down: Vec<_> = up.iter().map(|(x, y)| (*x, -y)).collect();
        assert_eq!(spearman(&down), Some(-1.0));
        assert_eq!(spearman(&[(1.0, 2.0), (1.0, 3.0)]), None);
        // Ranks (1, 2.5, 2.5, 4) against (1, 3, 2, 4): 4.5 / √(4.5 · 5).
        let tied = [(0.0, 0.0), (1.0, 5.0), (1.0, 4.0), (2.0, 9.0)];
        let rho = spearman(&tied).unwrap();
        assert!((rho - 4.5 / (4.5_f64 * 5.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn kendall_of_known_sequences() {
        let up: Vec<_> = (0..9).map(|i| (f64::from(i), f64::from(i * i))).collect();
        assert_eq!(kendall(&up), Some(1.0));
        let down: Vec<_> = up.iter().map(|(x, y)| (*x, -y)).collect();
        assert_eq!(kendall(&down), Some(-1.0));
        assert_eq!((kendall(&[]), kendall(&[(1.0, 2.0)])), (None, None));
        assert_eq!(kendall(&[(1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(kendall(&[(0.0, 1.0), (-0.0, 2.0)]), None);
    }

    proptest! {
        #[test]
        fn both_agree_with_their_definitions(pairs in prop::collection::vec((-4_i8..4, -4_i8..4), 0..40)) {
            let pairs: Vec<(f64, f64)> = pairs.into_iter().map(|(x, y)| (x.into(), y.into())).collect();
            let (mut sum, mut spread_x, mut spread_y) = (0_i32, 0_i32, 0_i32);
            for (i, a) in pairs.iter().enumerate() {
                for b in &pairs[..i] {
                    let sign = |x: f64, y: f64| x.partial_cmp(&y).unwrap() as i32;
                    let (x, y) = (sign(a.0, b.0), sign(a.1, b.1));
                    sum += x * y;
                    spread_x += x * x;
                    spread_y += y * y;
                }
            }
            match kendall(&pairs) {
                None => prop_assert!(spread_x == 0 || spread_y == 0),
                Some(tau) => {
                    let expected = f64::from(sum) / f64::from(spread_x).sqrt() / f64::from(spread_y).sqrt();
                    prop_assert!((tau - expected).abs() < 1e-12);
                }
            }
            // A rank is half the values at most as large plus half those below, plus a half.
            let rank = |of: &dyn Fn(&(f64, f64)) -> f64, value: f64| {
                let below = pairs.iter().filter(|pair| of(pair) < value).count();
                let up_to = pairs.iter().filter(|pair| of(pair) <= value).count();
                (below + up_to) as f64 / 2.0 + 0.5
            };
            for (pair, (x, y)) in pairs.iter().zip(ranks(pairs.iter().map(|p| p.0)).into_iter().zip(ranks(pairs.iter().map(|p| p.1)))) {
                prop_assert_eq!(x, rank(&|p| p.0, pair.0));
                prop_assert_eq!(y, rank(&|p| p.1, pair.1));
            }
            let mut turned = pairs.clone();
            turned.reverse();
            prop_assert_eq!(kendall(&turned), kendall(&pairs));
            prop_assert_eq!(spearman(&turned), spearman(&pairs));
        }
    }
}
