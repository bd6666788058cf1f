//! Equal-width histograms.
//!
//! They follow `numpy.histogram` (design section 8): `bins` equal-width bins on [min, max], edges
//! min + i·(max − min)/bins with the last one exactly max; bin i holds edge_i ≤ x < edge_i+1, the
//! last bin its upper edge too. A value is compared with the published edges, so that counts can be
//! checked from `corpus.json`; where floats are too coarse for `bins` distinct edges (1e15 + small
//! offsets), edges repeat and the bins between equal edges are empty, where numpy raises. A range
//! that overflows or underflows is divided in another unit.
//!
//! In the unit of the values. Nothing fails here; values are finite ([`Values`]).

use std::num::NonZeroU16;

use super::order::OrderStatistics;
use super::outcome::Range;
use super::values::Values;

/// The winsorised range spans these quantiles (design section 8), or less: see [`range_of`].
pub const WINSORISED_QUANTILES: (f64, f64) = (0.005, 0.995);

/// From so many values on, the winsorised range leaves out at least one at either end. The quantiles
/// alone do so from 201 on; below, they lie between the two outermost values, and a single outlier
/// still stretches all bins. One of fewer than 20 values is more than 5% of them: too much to call
/// an outlier.
pub const WINSORISE_ONE_FROM: u64 = 20;

/// The quantiles behind the Freedman-Diaconis rule.
pub const QUARTILES: (f64, f64) = (0.25, 0.75);

/// More Freedman-Diaconis bins than this say that the middle half of the values is very narrow, not
/// that the histogram should be finer.
const FREEDMAN_DIACONIS_MOST_BINS: u16 = 1000;

/// Steps from the bin that arithmetic says to the one that the edges say, before they are searched.
const CORRECTIONS: usize = 4;

/// The bins of a histogram.
#[derive(Debug, Clone, PartialEq)]
pub struct Edges {
    /// `bins + 1` edges, ascending (equal ones where floats are too coarse).
    edges: Vec<f64>,
    unit: f64,
    start: f64,
    step: f64,
}

impl Edges {
    /// `bins` equal bins from `min` to `max`, as `numpy.linspace` computes them.
    #[must_use]
    pub fn equal_width((min, max): (f64, f64), bins: NonZeroU16) -> Self {
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
        Self {
            edges,
            unit,
            start,
            step,
        }
    }

    /// The edges in ascending order.
    #[must_use]
    pub fn edges(&self) -> &[f64] {
        &self.edges
    }

    /// Where the outer edges lie.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        (self.edges[0], self.edges[self.edges.len() - 1])
    }

    /// The edges between bins.
    fn inner(&self) -> &[f64] {
        &self.edges[1..self.edges.len() - 1]
    }

    /// The bin of a value: as many as there are inner edges at or below it. Values beyond the range
    /// belong to the outer bins; where the range has no width, to the last one.
    #[must_use]
    pub fn bin(&self, value: f64) -> usize {
        let inner = self.inner();
        // Saturates; NaN, from a range without width, becomes 0.
        let guess = ((value * self.unit - self.start) / self.step) as usize;
        let mut bin = guess.min(inner.len());
        for _ in 0..CORRECTIONS {
            if bin > 0 && inner[bin - 1] > value {
                bin -= 1;
            } else if bin < inner.len() && inner[bin] <= value {
                bin += 1;
            } else {
                return bin;
            }
        }
        inner.partition_point(|&edge| edge <= value)
    }

    /// Counts of `values` for several sets of bins, in one pass.
    ///
    /// # Errors
    /// Where the values cannot be read.
    pub fn count<V: Values>(sets: &[Self], values: &V) -> Result<Vec<Vec<u64>>, V::Error> {
        values.fold(
            &|| {
                sets.iter()
                    .map(|set| vec![0; set.edges.len() - 1])
                    .collect::<Vec<Vec<u64>>>()
            },
            &|counts, piece| {
                for (set, counts) in sets.iter().zip(counts) {
                    for &value in piece {
                        counts[set.bin(value)] += 1;
                    }
                }
            },
            &|counts, more| {
                for (counts, more) in counts.iter_mut().zip(more) {
                    counts.iter_mut().zip(more).for_each(|(a, b)| *a += b);
                }
            },
        )
    }
}

/// The range that a histogram spans; `None` without values. The winsorised one goes from the 0.5% to
/// the 99.5% quantile, and from [`WINSORISE_ONE_FROM`] values on no further than the second value from
/// either end. `order` holds the two outermost values and [`WINSORISED_QUANTILES`].
#[must_use]
pub fn range_of(order: &OrderStatistics, range: Range) -> Option<(f64, f64)> {
    let find = |q, rank| Some((order.quantile(q)?, order.nth(rank)));
    range_by(order.n(), range, &find)
}

/// The same without one copy of `value`, which is among the values.
#[must_use]
pub fn range_without(order: &OrderStatistics, range: Range, value: f64) -> Option<(f64, f64)> {
    let find = |q, rank| {
        Some((
            order.quantile_without(q, value)?,
            order.nth_without(rank, value),
        ))
    };
    range_by(order.n().checked_sub(1)?, range, &find)
}

/// `find` gives a quantile and the value of a rank, of `n` values.
fn range_by(
    n: u64,
    range: Range,
    find: &dyn Fn(f64, u64) -> Option<(f64, Option<f64>)>,
) -> Option<(f64, f64)> {
    let (low, high) = match range {
        Range::Full => (0.0, 1.0),
        Range::Winsorised => WINSORISED_QUANTILES,
    };
    let (low, second) = find(low, 1)?;
    let (high, last_but_one) = find(high, n.saturating_sub(2))?;
    if range == Range::Full || n < WINSORISE_ONE_FROM {
        return Some((low, high));
    }
    Some((low.max(second?), high.min(last_but_one?)))
}

/// Bins after Freedman and Diaconis (1981): ⌈(max − min) / (2 IQR n^(−1/3))⌉, at least 1 and at
/// most 1000. `None` where the rule says nothing: no values, or an interquartile range of zero.
#[must_use]
pub fn freedman_diaconis_bins(order: &OrderStatistics, n: u64) -> Option<NonZeroU16> {
    let (min, max) = range_of(order, Range::Full)?;
    let (q25, q75) = (order.quantile(QUARTILES.0)?, order.quantile(QUARTILES.1)?);
    let unit = unit_for(min, max);
    let width = 2.0 * (q75 * unit - q25 * unit) / libm::cbrt(n as f64);
    if width <= 0.0 {
        return None;
    }
    let bins = ((max * unit - min * unit) / width).ceil();
    // `as` saturates, also from infinity.
    NonZeroU16::new((bins as u16).clamp(1, FREEDMAN_DIACONIS_MOST_BINS))
}

/// True where max − min is beyond the largest float.
#[must_use]
pub fn range_overflows(min: f64, max: f64) -> bool {
    !(max - min).is_finite()
}

/// A power of two by which values are multiplied so that their range is a finite float.
fn unit_for(min: f64, max: f64) -> f64 {
    if range_overflows(min, max) { 0.25 } else { 1.0 }
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
    use crate::reduce::values::InMemory;

    fn bins(n: u16) -> NonZeroU16 {
        NonZeroU16::new(n).unwrap()
    }

    struct Histogram {
        edges: Vec<f64>,
        counts: Vec<u64>,
    }

    struct Sample {
        values: InMemory,
        n: u64,
        order: OrderStatistics,
    }

    impl Sample {
        fn new(values: Vec<f64>) -> Self {
            let n = values.len() as u64;
            let values: InMemory = values.into_iter().collect();
            let (a, b) = (WINSORISED_QUANTILES, QUARTILES);
            let Ok(order) = OrderStatistics::find(&values, n, &[a.0, a.1, b.0, b.1], 3);
            Self { values, n, order }
        }

        fn histogram(&self, bins: NonZeroU16, range: Range) -> Option<Histogram> {
            let edges = Edges::equal_width(range_of(&self.order, range)?, bins);
            let Ok(mut counts) = Edges::count(std::slice::from_ref(&edges), &self.values);
            Some(Histogram {
                edges: edges.edges,
                counts: counts.remove(0),
            })
        }

        fn freedman_diaconis_bins(&self) -> Option<NonZeroU16> {
            freedman_diaconis_bins(&self.order, self.n)
        }
    }

    fn counts(values: &[f64], n: u16) -> Vec<u64> {
        Sample::new(values.to_vec())
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
            Sample::new(vec![])
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
        let sorted = Sample::new(values);
        // Positions 5 and 995 of 0..=1000: the values 5 and 995.
        assert_eq!(
            range_of(&sorted.order, Range::Winsorised),
            Some((5.0, 995.0))
        );
        let h = sorted.histogram(bins(10), Range::Winsorised).unwrap();
        // Bins of 99 on [5, 995]; 0–4 go to the first, 995–999 and the outlier to the last.
        assert_eq!(h.counts, [104, 99, 99, 99, 99, 99, 99, 99, 99, 105]);
    }

    /// However far the outlier lies, and whichever value is left out.
    #[test]
    fn from_twenty_values_on_one_at_either_end_is_left_out() {
        let range = |n: u32, outlier: f64| {
            let values = (1..n).map(f64::from).chain([outlier]).collect();
            range_of(&Sample::new(values).order, Range::Winsorised).unwrap()
        };
        for outlier in [1e3, 1e300] {
            assert_eq!(range(20, outlier), (2.0, 19.0));
            assert_eq!(range(49, outlier), (2.0, 48.0));
            assert_eq!(range(201, outlier), (2.0, 200.0));
            assert!(range(19, outlier).1 > 18.5, "19 are too few to tell");
        }
        let values: Vec<f64> = (1..49).map(f64::from).chain([1e9]).collect();
        let whole = Sample::new(values.clone());
        for &value in &values {
            let mut rest = values.clone();
            rest.retain(|&other| other != value);
            for range in [Range::Full, Range::Winsorised] {
                assert_eq!(
                    range_without(&whole.order, range, value),
                    range_of(&Sample::new(rest.clone()).order, range),
                    "{range:?} without {value}"
                );
            }
        }
    }

    #[test]
    fn freedman_diaconis() {
        // 0..=1000: IQR 500, n^(1/3) = 10.0033…, width 99.97, 1000/99.97 = 10.003 → 11 bins.
        let sorted = Sample::new((0..=1000).map(f64::from).collect());
        assert_eq!(sorted.freedman_diaconis_bins(), Some(bins(11)));
        let outlier = Sample::new(vec![1.0, 2.0, 3.0, 4.0, 1e300]);
        assert_eq!(outlier.freedman_diaconis_bins(), Some(bins(1000)));
        assert_eq!(
            Sample::new(vec![1.0, 1.0, 1.0, 1.0, 2.0]).freedman_diaconis_bins(),
            None
        );
        assert!(
            Sample::new(vec![-f64::MAX, 0.0, f64::MAX])
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
            let sample = Sample::new(values.clone());
            prop_assume!(sample.order.min() < sample.order.max());
            let h = sample.histogram(bins(n), Range::Full).unwrap();
            prop_assert_eq!((h.edges, h.counts), numpy_histogram(&values, usize::from(n)));
        }

        #[test]
        fn every_value_is_counted_once_between_its_edges(
            values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO, 1..60),
            n in 1_u16..60,
        ) {
            let sorted = Sample::new(values.clone());
            for range in [Range::Full, Range::Winsorised] {
                let h = sorted.histogram(bins(n), range).unwrap();
                prop_assert!(h.edges.is_sorted());
                prop_assert!(h.edges.iter().all(|edge| edge.is_finite()));
                let last = h.counts.len() - 1;
                for (i, &count) in h.counts.iter().enumerate() {
                    let brute = values.iter().filter(|&&v| {
                        (i == 0 || v >= h.edges[i]) && (i == last || v < h.edges[i + 1])
                    });
                    prop_assert_eq!(brute.count() as u64, count);
                }
            }
        }
    }
}
