//! Sorted samples: equal-width histograms, quantiles, medians.
//!
//! Histograms follow `numpy.histogram` (design section 8): `bins` equal-width bins on [min, max],
//! edges min + i·(max − min)/bins with the last one exactly max; bin i holds edge_i ≤ x < edge_i+1,
//! the last bin its upper edge too. A value is compared with the published edges, so that counts
//! can be checked from `corpus.json`; where floats are too coarse for `bins` distinct edges
//! (1e15 + small offsets), edges repeat and the bins between equal edges are empty, where numpy
//! raises. A range that overflows or underflows is divided in another unit.
//!
//! In the unit of the values. Nothing fails; values must be finite, which [`Sorted::new`] sees to.

use std::num::NonZeroU16;

use super::outcome::Range;

/// The winsorised range spans these quantiles (design section 8).
const WINSORISED_QUANTILES: (f64, f64) = (0.005, 0.995);

/// More Freedman-Diaconis bins than this say that the middle half of the values is very narrow, not
/// that the histogram should be finer.
const FREEDMAN_DIACONIS_MOST_BINS: u16 = 1000;

/// Finite values in ascending order.
#[derive(Debug, Clone, PartialEq)]
pub struct Sorted(Vec<f64>);

/// Counts of values between edges.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    /// `bins + 1` edges, ascending (equal ones where floats are too coarse).
    pub edges: Vec<f64>,
    /// One count per bin.
    pub counts: Vec<u64>,
}

impl Sorted {
    /// Sorts; leaves out what is not finite. −0 becomes 0, so that equal values have equal bits.
    #[must_use]
    pub fn new(mut values: Vec<f64>) -> Self {
        values.retain(|value| value.is_finite());
        values.iter_mut().for_each(|value| *value += 0.0);
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }

    /// The values.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// The same without one value that is in it.
    #[must_use]
    pub fn without(&self, value: f64) -> Self {
        let mut rest = self.0.clone();
        let at = rest.partition_point(|&other| other < value);
        if rest.get(at) == Some(&value) {
            rest.remove(at);
        }
        Self(rest)
    }

    /// The q-quantile, linear between order statistics (numpy's default); `None` without values.
    #[must_use]
    pub fn quantile(&self, q: f64) -> Option<f64> {
        let last = self.0.len().checked_sub(1)?;
        let position = q.clamp(0.0, 1.0) * last as f64;
        let below = (position as usize).min(last);
        let (a, b) = (self.0[below], self.0[(below + 1).min(last)]);
        let t = position - below as f64;
        // Two products cannot overflow where b − a would; the clamp removes their rounding.
        Some((a * (1.0 - t) + b * t).clamp(a, b))
    }

    /// The median: the middle value, or the midpoint of the two; `None` without values.
    #[must_use]
    pub fn median(&self) -> Option<f64> {
        median_of_sorted(&self.0)
    }

    /// The range that a histogram spans; `None` without values.
    #[must_use]
    pub fn range(&self, range: Range) -> Option<(f64, f64)> {
        match range {
            Range::Full => Some((*self.0.first()?, *self.0.last()?)),
            Range::Winsorised => Some((
                self.quantile(WINSORISED_QUANTILES.0)?,
                self.quantile(WINSORISED_QUANTILES.1)?,
            )),
        }
    }

    /// The histogram; values beyond the range fall into the outer bins. `None` without values.
    ///
    /// Equal values all fall into the last bin.
    #[must_use]
    pub fn histogram(&self, bins: NonZeroU16, range: Range) -> Option<Histogram> {
        let (min, max) = self.range(range)?;
        let edges = equal_width_edges(min, max, bins);
        let below = |edge: f64| self.0.partition_point(|&value| value < edge);
        let mut counts = Vec::with_capacity(usize::from(bins.get()));
        let mut counted = 0;
        for &upper in &edges[1..usize::from(bins.get())] {
            let up_to = below(upper).max(counted);
            counts.push((up_to - counted) as u64);
            counted = up_to;
        }
        counts.push((self.0.len() - counted) as u64);
        Some(Histogram { edges, counts })
    }

    /// Bins after Freedman and Diaconis (1981): ⌈(max − min) / (2 IQR n^(−1/3))⌉, at least 1 and at
    /// most 1000. `None` where the rule says nothing: no values, or an interquartile range of zero.
    #[must_use]
    pub fn freedman_diaconis_bins(&self) -> Option<NonZeroU16> {
        let (min, max) = self.range(Range::Full)?;
        let (q25, q75) = (self.quantile(0.25)?, self.quantile(0.75)?);
        let unit = unit_for(min, max);
        let width = 2.0 * (q75 * unit - q25 * unit) / libm::cbrt(self.0.len() as f64);
        if width <= 0.0 {
            return None;
        }
        let bins = ((max * unit - min * unit) / width).ceil();
        // `as` saturates, also from infinity.
        NonZeroU16::new((bins as u16).clamp(1, FREEDMAN_DIACONIS_MOST_BINS))
    }
}

/// A power of two by which values are multiplied so that their range is a finite float.
fn unit_for(min: f64, max: f64) -> f64 {
    if (max - min).is_finite() { 1.0 } else { 0.25 }
}

/// `bins + 1` edges from `min` to `max`, as `numpy.linspace` computes them.
fn equal_width_edges(min: f64, max: f64, bins: NonZeroU16) -> Vec<f64> {
    let count = f64::from(bins.get());
    let unit = unit_for(min, max);
    let start = min * unit;
    let width = max * unit - start;
    let step = width / count;
    let mut edges: Vec<f64> = (0..bins.get())
        .map(|i| {
            let i = f64::from(i);
            // A denormal step has lost digits; numpy does the same where it is zero.
            let offset = if step < f64::MIN_POSITIVE {
                i / count * width
            } else {
                i * step
            };
            ((start + offset) / unit).clamp(min, max)
        })
        .collect();
    edges.push(max);
    edges
}

/// The median of values in ascending order.
pub(super) fn median_of_sorted(sorted: &[f64]) -> Option<f64> {
    let upper = *sorted.get(sorted.len() / 2)?;
    if sorted.len() % 2 == 1 {
        return Some(upper);
    }
    Some(f64::midpoint(sorted[sorted.len() / 2 - 1], upper))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn bins(n: u16) -> NonZeroU16 {
        NonZeroU16::new(n).unwrap()
    }

    fn counts(values: &[f64], n: u16) -> Vec<u64> {
        Sorted::new(values.to_vec())
            .histogram(bins(n), Range::Full)
            .unwrap()
            .counts
    }

    /// The slow twin, one value at a time: numpy's own steps (`numpy/lib/_histograms_impl.py`), an
    /// index from arithmetic, then a correction by one against the computed edges.
    fn numpy_histogram(values: &[f64], bins: usize) -> (Vec<f64>, Vec<u64>) {
        let min = values.iter().copied().fold(f64::INFINITY, f64::min);
        let max = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let step = (max - min) / bins as f64;
        let mut edges: Vec<f64> = (0..=bins).map(|i| i as f64 * step + min).collect();
        edges[bins] = max;
        let mut counts = vec![0; bins];
        for &value in values {
            let mut i = ((value - min) / (max - min) * bins as f64) as usize;
            if i == bins {
                i -= 1;
            }
            if value < edges[i] {
                i -= 1;
            }
            if value >= edges[i + 1] && i != bins - 1 {
                i += 1;
            }
            counts[i] += 1;
        }
        (edges, counts)
    }

    #[test]
    fn bins_are_closed_below_and_the_last_one_above_too() {
        assert_eq!(counts(&[0.0, 1.0, 2.0, 3.0], 3), [1, 1, 2]);
        assert_eq!(counts(&[0.0, 0.5, 1.0], 1), [3]);
        assert_eq!(counts(&[7.0], 4), [0, 0, 0, 1]);
        assert_eq!(counts(&[7.0; 9], 2), [0, 9]);
        assert!(
            Sorted::new(vec![])
                .histogram(bins(3), Range::Full)
                .is_none()
        );
        // numpy 2.4.6: np.histogram(np.arange(7) * 0.1, 6). The edges are rounded, and decide.
        let tenths: Vec<f64> = (0..7).map(|i| f64::from(i) * 0.1).collect();
        assert_eq!(counts(&tenths, 6), [2, 1, 0, 2, 1, 1]);
    }

    #[test]
    fn ranges_beyond_floats() {
        // Overflow: a quarter each of [−MAX, MAX].
        assert_eq!(
            counts(&[-f64::MAX, -1e308, -1.0, 1.0, 1e308, f64::MAX], 4),
            [2, 1, 1, 2]
        );
        // Denormals: 40 steps in 4 bins of 10, and 2 steps in 4 bins, of which two have no width.
        let tiny = 5e-324;
        let tens: Vec<f64> = (0..=40).map(|i| f64::from(i) * tiny).collect();
        assert_eq!(counts(&tens, 4), [10, 10, 10, 11]);
        assert_eq!(counts(&[0.0, tiny, 2.0 * tiny], 4).iter().sum::<u64>(), 3);
        // One outlier at 1e300 puts everything else into the first bin.
        assert_eq!(counts(&[0.0, 1.0, 2.0, 1e300], 30)[0], 3);
        // 1e15 + i/8: eight distinct values, however many bins.
        let coarse: Vec<f64> = (0..8).map(|i| 1e15 + f64::from(i) / 8.0).collect();
        assert_eq!(counts(&coarse, 30).iter().filter(|&&c| c > 0).count(), 8);
    }

    #[test]
    fn winsorised_range_ignores_an_outlier() {
        let mut values: Vec<f64> = (0..1000).map(f64::from).collect();
        values.push(1e9);
        let sorted = Sorted::new(values);
        // Positions 5 and 995 of 0..=1000: the values 5 and 995.
        assert_eq!(sorted.range(Range::Winsorised), Some((5.0, 995.0)));
        let h = sorted.histogram(bins(10), Range::Winsorised).unwrap();
        // Bins of 99 on [5, 995]; 0–4 go to the first, 995–999 and the outlier to the last.
        assert_eq!(h.counts, [104, 99, 99, 99, 99, 99, 99, 99, 99, 105]);
    }

    #[test]
    fn quantiles_and_medians() {
        let sorted = Sorted::new(vec![4.0, 1.0, f64::NAN, 2.0, 3.0]);
        assert_eq!(sorted.median(), Some(2.5));
        assert_eq!(sorted.quantile(0.25), Some(1.75));
        assert_eq!(sorted.quantile(1.0), Some(4.0));
        assert_eq!(Sorted::new(vec![]).quantile(0.5), None);
        assert_eq!(Sorted::new(vec![]).median(), None);
        let wide = Sorted::new(vec![-f64::MAX, f64::MAX]);
        assert_eq!((wide.median(), wide.quantile(0.5)), (Some(0.0), Some(0.0)));
        assert_eq!(Sorted::new(vec![0.0, -0.0]).values()[0].to_bits(), 0);
    }

    #[test]
    fn freedman_diaconis() {
        // 0..=1000: IQR 500, n^(1/3) = 10.0033…, width 99.97, 1000/99.97 = 10.003 → 11 bins.
        let sorted = Sorted::new((0..=1000).map(f64::from).collect());
        assert_eq!(sorted.freedman_diaconis_bins(), Some(bins(11)));
        let outlier = Sorted::new(vec![1.0, 2.0, 3.0, 4.0, 1e300]);
        assert_eq!(outlier.freedman_diaconis_bins(), Some(bins(1000)));
        assert_eq!(
            Sorted::new(vec![1.0, 1.0, 1.0, 1.0, 2.0]).freedman_diaconis_bins(),
            None
        );
        assert!(
            Sorted::new(vec![-f64::MAX, 0.0, f64::MAX])
                .freedman_diaconis_bins()
                .is_some()
        );
    }

    proptest! {
        #[test]
        fn agrees_with_numpys_steps(
            values in prop::collection::vec(-100_i32..100, 2..200),
            unit in prop::sample::select(vec![1.0, 0.1, 1e-9, 1e200]),
            n in 1_u16..60,
        ) {
            let values: Vec<f64> = values.iter().map(|&v| f64::from(v) * unit).collect();
            let sorted = Sorted::new(values);
            prop_assume!(sorted.values().first() < sorted.values().last());
            let h = sorted.histogram(bins(n), Range::Full).unwrap();
            prop_assert_eq!((h.edges, h.counts), numpy_histogram(sorted.values(), usize::from(n)));
        }

        #[test]
        fn every_value_is_counted_once_between_its_edges(
            values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO, 1..60),
            n in 1_u16..60,
        ) {
            let sorted = Sorted::new(values);
            for range in [Range::Full, Range::Winsorised] {
                let h = sorted.histogram(bins(n), range).unwrap();
                prop_assert!(h.edges.is_sorted());
                prop_assert!(h.edges.iter().all(|edge| edge.is_finite()));
                let last = h.counts.len() - 1;
                for (i, &count) in h.counts.iter().enumerate() {
                    let brute = sorted.values().iter().filter(|&&v| {
                        (i == 0 || v >= h.edges[i]) && (i == last || v < h.edges[i + 1])
                    });
                    prop_assert_eq!(brute.count() as u64, count);
                }
            }
        }
    }
}
