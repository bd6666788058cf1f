//! Linear axes: from values to positions and bins.

/// Share of values left beyond each end of a trimmed axis, so that one outlier cannot press all
/// others together.
const TRIM: f64 = 0.005;

/// A finite interval of values of positive length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Axis {
    pub(crate) lo: f64,
    pub(crate) hi: f64,
}

impl Axis {
    /// From the 0.5% to the 99.5% quantile; `None` without values.
    pub(crate) fn trimmed(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        Some(Self::spanning(
            *sorted.get(place(TRIM, last))?,
            *sorted.get(place(1.0 - TRIM, last))?,
        ))
    }

    /// From `lo` to `hi`, widened where they are equal or too far apart to subtract.
    pub(crate) fn spanning(lo: f64, hi: f64) -> Self {
        // Half of the largest float: the length of the interval stays finite.
        const REACH: f64 = f64::MAX / 4.0;
        let (lo, hi) = (lo.clamp(-REACH, REACH), hi.clamp(-REACH, REACH));
        if hi > lo && (hi - lo) > lo.abs().max(hi.abs()) * f64::EPSILON * 16.0 {
            return Self { lo, hi };
        }
        let pad = lo.abs().max(1.0) * 0.5;
        Self {
            lo: lo - pad,
            hi: hi + pad,
        }
    }

    /// Whether round numbers can be told apart along it: a chart of a longer or finer one is left out.
    pub(super) fn is_drawable(self) -> bool {
        let length = self.hi - self.lo;
        let largest = self.lo.abs().max(self.hi.abs());
        (1e-90..1e90).contains(&length) && length > 1e-6 * largest
    }

    /// Shares of `values` in `bins` equal bins; those beyond the ends are in the outer ones.
    pub(super) fn shares(self, values: &[f64], bins: usize) -> Vec<f64> {
        let mut counts = vec![0_usize; bins];
        for value in values {
            if let Some(count) = counts.get_mut(self.bin(*value, bins)) {
                *count += 1;
            }
        }
        let all = as_float(values.len().max(1));
        counts
            .into_iter()
            .map(|count| as_float(count) / all)
            .collect()
    }

    /// Wider by `share` of the length at each end.
    pub(crate) fn padded(self, share: f64) -> Self {
        let pad = (self.hi - self.lo) * share;
        Self {
            lo: self.lo - pad,
            hi: self.hi + pad,
        }
    }

    /// Position in [0, 1]; values beyond the ends stand at them.
    pub(crate) fn position(self, value: f64) -> f64 {
        ((value - self.lo) / (self.hi - self.lo)).clamp(0.0, 1.0)
    }

    /// Whether the value stands at its true place.
    pub(crate) fn holds(self, value: f64) -> bool {
        (self.lo..=self.hi).contains(&value)
    }

    /// The bin of `value` among `bins` equal ones.
    pub(crate) fn bin(self, value: f64, bins: usize) -> usize {
        let last = bins.saturating_sub(1);
        (floor_index(self.position(value) * as_float(bins))).min(last)
    }
}

/// The place of a quantile in a sorted list whose last index is `last`.
fn place(quantile: f64, last: usize) -> usize {
    floor_index(quantile * as_float(last) + 0.5).min(last)
}

#[expect(clippy::cast_precision_loss, reason = "counts of marks on a page")]
pub(crate) fn as_float(count: usize) -> f64 {
    count as f64
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positions on a page: not negative, small; `as` saturates"
)]
fn floor_index(value: f64) -> usize {
    value.max(0.0) as usize
}

/// The middle of sorted values; `None` without any.
pub(crate) fn median(sorted: &[f64]) -> Option<f64> {
    let half = sorted.len() / 2;
    let upper = *sorted.get(half)?;
    if sorted.len() % 2 == 1 {
        return Some(upper);
    }
    let lower = *sorted.get(half.checked_sub(1)?)?;
    Some(lower / 2.0 + upper / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_stay_finite() {
        for (lo, hi) in [
            (0.0, 0.0),
            (1e300, 1e300),
            (-1.7e308, 1.7e308),
            (5e-324, 1e-323),
            (1e15, 1e15 + 0.125),
        ] {
            let axis = Axis::spanning(lo, hi);
            for value in [lo, hi, 0.0, 1e308] {
                let position = axis.position(value);
                assert!((0.0..=1.0).contains(&position), "{lo} {hi} {position}");
            }
            assert_eq!(axis.bin(f64::MAX, 10), 9);
        }
        assert_eq!(Axis::trimmed(std::iter::empty()), None);
    }

    #[test]
    fn an_outlier_does_not_stretch_a_trimmed_axis() {
        let values = (0..1_000).map(|i| as_float(i) / 1_000.0).chain([1e9]);
        let axis = Axis::trimmed(values).unwrap();
        assert!(axis.hi < 1.0);
        assert!(!axis.holds(1e9));
    }

    #[test]
    fn median_of_even_and_odd() {
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[1.0]), Some(1.0));
        assert_eq!(median(&[1.0, 2.0]), Some(1.5));
        assert_eq!(median(&[f64::MAX, f64::MAX]), Some(f64::MAX));
    }
}
