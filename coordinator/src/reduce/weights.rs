//! Entropy weights: the less a signal's values are spread over its histogram, the more it weighs.
//!
//! H = −Σ p ln p in nats, weights = softmax(−H) (the paper's equations; design section 8). A signal
//! without spread has entropy 0 and would weigh most; it gets weight 0 instead. Both are found in
//! twice the precision and rounded once, so that a weight is right to its last place whatever the
//! entropies (`twin` checks it). Nothing fails.

use super::double::Double;

/// H = −Σ p ln p with p = c/n, 0 ln 0 = 0; in [0, ln bins]. `None` where nothing was counted.
#[must_use]
pub fn entropy_nats(counts: &[u64]) -> Option<f64> {
    entropy(counts).map(Double::value)
}

/// The entropy before it is rounded to a float.
#[must_use]
pub fn entropy(counts: &[u64]) -> Option<Double> {
    let n: u64 = counts.iter().sum();
    if n == 0 {
        return None;
    }
    let zero = Double::default();
    let sum = counts
        .iter()
        .filter(|&&count| count > 0 && count < n)
        .fold(zero, |sum, &count| {
            let p = Double::from(count).over(Double::from(n));
            sum + p * (zero - p.ln())
        });
    Some(sum)
}

/// softmax(−H), shifted by the smallest H so that the largest exponential is 1.
#[must_use]
pub fn softmax_of_negated(entropies: &[Double]) -> Vec<f64> {
    let least = entropies
        .iter()
        .copied()
        .reduce(|least, h| if h.is_below(least) { h } else { least })
        .unwrap_or_default();
    let powers: Vec<Double> = entropies.iter().map(|&h| (least - h).exp()).collect();
    let total = powers.iter().fold(Double::default(), |sum, &p| sum + p);
    powers.iter().map(|p| p.over(total).value()).collect()
}

/// Weights of signals by entropy; `None` stands for a signal that says nothing, which weighs 0.
/// `None` where no signal says anything; otherwise the weights sum to 1.
#[must_use]
pub fn entropy_weights(entropies: &[Option<Double>]) -> Option<Vec<f64>> {
    let defined: Vec<Double> = entropies.iter().copied().flatten().collect();
    if defined.is_empty() {
        return None;
    }
    let mut weights = softmax_of_negated(&defined).into_iter();
    Some(
        entropies
            .iter()
            .map(|h| h.and_then(|_| weights.next()).unwrap_or(0.0))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn softmax_of_negated(entropies: &[f64]) -> Vec<f64> {
        super::softmax_of_negated(
            &entropies
                .iter()
                .copied()
                .map(Double::from)
                .collect::<Vec<_>>(),
        )
    }

    fn entropy_weights(entropies: &[Option<f64>]) -> Option<Vec<f64>> {
        super::entropy_weights(
            &entropies
                .iter()
                .map(|h| h.map(Double::from))
                .collect::<Vec<_>>(),
        )
    }

    /// The two corpora of the paper, to its two decimals.
    #[test]
    fn paper_weights() {
        for (entropies, expected) in [([2.16, 2.88], [0.67, 0.33]), ([1.73, 2.35], [0.65, 0.35])] {
            let weights = softmax_of_negated(&entropies);
            for (weight, expected) in weights.iter().zip(expected) {
                assert!((weight - expected).abs() < 0.005, "{weights:?}");
            }
        }
    }

    #[test]
    fn entropies_known_in_closed_form() {
        assert_eq!(entropy_nats(&[]), None);
        assert_eq!(entropy_nats(&[0, 0]), None);
        let one_bin = entropy_nats(&[0, 5, 0]).unwrap();
        assert!(one_bin == 0.0 && one_bin.is_sign_positive());
        // Every bin 1/30: ln 30, to 1 ulp.
        assert!((entropy_nats(&[4; 30]).unwrap() - libm::log(30.0)).abs() <= f64::EPSILON * 2.0);
        // (1/2, 1/4, 1/4): 3/2 ln 2.
        let h = entropy_nats(&[2, 1, 1, 0]).unwrap();
        assert!((h - 1.5 * std::f64::consts::LN_2).abs() <= f64::EPSILON);
        // p = 1 − 1e-7, by 40-digit arithmetic (mpmath); −p ln p of the rounded p alone would be wrong
        // in the tenth digit.
        let h = entropy_nats(&[9_999_999, 1]).unwrap();
        assert!(
            (h / 1.711_809_560_095_831_8e-6 - 1.0).abs() < 4e-16,
            "{h:e}"
        );
    }

    #[test]
    fn degenerate_signals_weigh_nothing() {
        assert_eq!(entropy_weights(&[None, None]), None);
        assert_eq!(entropy_weights(&[None, Some(2.0)]), Some(vec![0.0, 1.0]));
        assert_eq!(
            entropy_weights(&[Some(2.0), None, Some(2.0)]),
            Some(vec![0.5, 0.0, 0.5])
        );
    }

    #[test]
    fn softmax_of_huge_entropies() {
        assert_eq!(softmax_of_negated(&[1e308, 1e308]), [0.5, 0.5]);
        assert_eq!(softmax_of_negated(&[-1e308, 1e308]), [1.0, 0.0]);
        assert_eq!(softmax_of_negated(&[]), [0.0; 0]);
    }

    proptest! {
        /// Slack of a few ulp of ln 60 ≈ 4.1: n terms, each rounded.
        #[test]
        fn entropy_is_bounded(counts in prop::collection::vec(0_u64..1000, 1..60)) {
            prop_assume!(counts.iter().any(|&c| c > 0));
            let h = entropy_nats(&counts).unwrap();
            prop_assert!(h >= 0.0 && h <= (counts.len() as f64).ln() + 4e-15);
            // The obvious twin.
            let n: u64 = counts.iter().sum();
            let twin: f64 = counts.iter().filter(|&&c| c > 0)
                .map(|&c| c as f64 / n as f64).map(|p| -p * p.ln()).sum();
            prop_assert!((h - twin).abs() < 1e-14);
        }

        /// Entropies and shift are multiples of 2⁻²⁰, so that shifting them is exact.
        #[test]
        fn softmax_sums_to_one_and_ignores_a_shift(
            h in prop::collection::vec(-1_000_000_i32..1_000_000, 1..6), shift in -1_000_000_i32..1_000_000,
        ) {
            let of = |shift: i32| {
                let shifted: Vec<f64> = h.iter().map(|&h| f64::from(h + shift) / 1_048_576.0).collect();
                softmax_of_negated(&shifted)
            };
            prop_assert_eq!(of(0), of(shift));
            prop_assert!((of(0).iter().sum::<f64>() - 1.0).abs() < 1e-15);
        }
    }
}
