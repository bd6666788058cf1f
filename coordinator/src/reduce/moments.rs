//! Mean and population standard deviation of floats, exact until the last rounding.
//!
//! From the exact integers S = Σx and Q = Σx² (`sum`): μ = S/n, n²σ² = nQ − S². The subtraction
//! cancels nothing, since nothing was rounded before it; so 10¹⁵ + small offsets, one outlier at
//! 1e300 and denormals are all right. μ is rounded once; σ is the root of a variance rounded once
//! (below 1 ulp in all). Same bits for any order and any split into parts.
//!
//! z = (s − μ)/σ is taken with μ in two floats and in a unit (a power of two) in which 1 ≤ σ ≤ 2,
//! so that neither cancellation, overflow nor underflow of s − μ costs digits.
//!
//! Fails on NaN and infinities ([`NotFinite`]).

use serde::{Deserialize, Serialize};

use super::sum::{ExactSquareSum, ExactSum, NotFinite, SQUARE_EXPONENT, VALUE_EXPONENT};

/// Digits of 32 bits put below a dividend, so that a quotient by up to 2⁶⁴ twice keeps at least 64
/// bits.
const GUARD_DIGITS: usize = 6;
const GUARD_EXPONENT: i32 = 32 * GUARD_DIGITS as i32;

/// Running exact moments.
#[derive(Debug, Clone, Default)]
pub struct Moments {
    n: u64,
    sum: ExactSum,
    squares: ExactSquareSum,
}

/// Mean, standard deviation and the ruler for z-scores.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standard {
    /// μ, to nearest.
    pub mean: f64,
    /// σ with ddof 0; zero for equal values, and where it lies below the smallest float.
    pub std: f64,
    /// Values are measured in units of 2^`unit_exponent`, in which 1 ≤ `unit_std` ≤ 2.
    unit_exponent: i32,
    unit_std: f64,
    /// μ = `unit_mean` + `unit_mean_tail` to 106 bits.
    unit_mean: f64,
    unit_mean_tail: f64,
}

impl Moments {
    /// The moments of a slice.
    ///
    /// # Errors
    /// [`NotFinite`] for the first value that is not.
    pub fn of(values: &[f64]) -> Result<Self, NotFinite> {
        let mut moments = Self::default();
        for &value in values {
            moments.add(value)?;
        }
        Ok(moments)
    }

    /// Adds one value.
    ///
    /// # Errors
    /// [`NotFinite`]; the moments are then unchanged.
    pub fn add(&mut self, value: f64) -> Result<(), NotFinite> {
        self.sum.add(value)?;
        self.squares.add(value)?;
        self.n += 1;
        Ok(())
    }

    /// Values so far.
    #[must_use]
    pub fn n(&self) -> u64 {
        self.n
    }

    /// Adds the moments of another part.
    pub fn merge(&mut self, other: &Self) {
        self.n += other.n;
        self.sum.merge(&other.sum);
        self.squares.merge(&other.squares);
    }

    /// Mean and standard deviation; `None` without values.
    #[must_use]
    pub fn standard(&self) -> Option<Standard> {
        if self.n == 0 {
            return None;
        }
        let (negative, sum) = self.sum.exact();
        let signed = |magnitude: f64| if negative { -magnitude } else { magnitude };
        let (mean, mean_tail) = sum.shifted_up(GUARD_DIGITS).divided_by(self.n);
        let mean_exponent = VALUE_EXPONENT - GUARD_EXPONENT;

        let spread = self.squares.exact().times(self.n).minus(&sum.squared());
        let (variance, tail) = spread.shifted_up(GUARD_DIGITS).divided_by(self.n);
        let (variance, more_tail) = variance.divided_by(self.n);
        let variance_exponent = SQUARE_EXPONENT - GUARD_EXPONENT;
        // 4^unit ≤ σ² < 4^(unit + 1)
        let unit_exponent = if variance.is_zero() {
            0
        } else {
            (variance.bits() as i32 - 1 + variance_exponent).div_euclid(2)
        };
        let unit_std = variance
            .to_f64(variance_exponent - 2 * unit_exponent, tail || more_tail)
            .sqrt();
        let (leading, rest) = mean.split(f64::MANTISSA_DIGITS as usize);
        Some(Standard {
            mean: signed(mean.to_f64(mean_exponent, mean_tail)),
            std: libm::scalbn(unit_std, unit_exponent),
            unit_exponent,
            unit_std,
            unit_mean: signed(leading.to_f64(mean_exponent - unit_exponent, false)),
            unit_mean_tail: signed(rest.to_f64(mean_exponent - unit_exponent, mean_tail)),
        })
    }
}

impl Standard {
    /// True where σ = 0: the values say nothing.
    #[must_use]
    pub fn is_degenerate(&self) -> bool {
        self.std == 0.0
    }

    /// True where the numbers can be those of some values: what was read from a file may be anything.
    #[must_use]
    pub(super) fn is_usable(&self) -> bool {
        let all = [
            self.mean,
            self.std,
            self.unit_std,
            self.unit_mean,
            self.unit_mean_tail,
        ];
        let spread = self.std == 0.0 || (1.0..=2.0).contains(&self.unit_std);
        all.iter().all(|number| number.is_finite()) && self.std >= 0.0 && spread
    }

    /// z = (value − μ)/σ, and 0 where σ = 0 (design section 8). Never NaN for a finite value; at most
    /// the largest float, for a value that far from those behind the moments.
    #[must_use]
    pub fn z(&self, value: f64) -> f64 {
        if self.is_degenerate() {
            return 0.0;
        }
        let value = libm::scalbn(value, -self.unit_exponent);
        if value.is_infinite() {
            return f64::MAX.copysign(value);
        }
        let (difference, error) = difference_and_error(value, self.unit_mean);
        // + 0 turns −0 into 0.
        let z = (difference + (error - self.unit_mean_tail)) / self.unit_std + 0.0;
        z.clamp(-f64::MAX, f64::MAX)
    }
}

/// a − b in two floats: the rounded difference and what the rounding lost (Knuth's TwoSum).
fn difference_and_error(a: f64, b: f64) -> (f64, f64) {
    let difference = a - b;
    let b_seen = a - difference;
    let a_seen = difference + b_seen;
    (difference, (a - a_seen) + (b_seen - b))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn standard(values: &[f64]) -> Standard {
        Moments::of(values).unwrap().standard().unwrap()
    }

    #[test]
    fn nothing_one_and_equal_values() {
        assert!(Moments::default().standard().is_none());
        for values in [
            &[0.1][..],
            &[0.1; 7],
            &[-5e-324; 3],
            &[f64::MAX; 5],
            &[0.0, -0.0],
        ] {
            let s = standard(values);
            assert_eq!((s.mean, s.std), (values[0], 0.0));
            assert!(s.is_degenerate());
            assert_eq!(s.z(12.0), 0.0);
        }
        assert!(Moments::of(&[1.0, f64::NAN]).is_err());
    }

    #[test]
    fn two_values_are_one_sigma_away() {
        for (a, b) in [
            (1.0, 3.0),
            (-f64::MAX, f64::MAX),
            (0.0, 1e-320),
            (1e300, -1e-300),
            (1e15, 1e15 + 0.125),
        ] {
            let s = standard(&[a, b]);
            assert_eq!(s.z(a), if a < b { -1.0 } else { 1.0 }, "{a} {b}");
            assert_eq!(s.z(b), -s.z(a), "{a} {b}");
        }
    }

    /// σ = 2⁻¹⁰⁷⁵ is no float: the signal counts as degenerate, as it would with frozen statistics.
    #[test]
    fn sigma_underflow_is_degenerate() {
        let s = standard(&[0.0, 5e-324]);
        assert_eq!(s.std, 0.0);
        assert_eq!(s.z(5e-324), 0.0);
        // σ = 3·2⁻¹⁰⁷⁵ is rounded to a float, but z does not suffer.
        let s = standard(&[0.0, 1.5e-323]);
        assert_eq!(s.std, 1e-323);
        assert_eq!((s.z(0.0), s.z(1.5e-323)), (-1.0, 1.0));
    }

    /// Offsets 0, 1, 2, 3, 4 eighths have σ = √2/8; 1e15 has a last place of 1/8, 1e15 + 2/8 the mean.
    #[test]
    fn small_offsets_on_a_large_base() {
        let values: Vec<f64> = (0..5).map(|i| 1e15 + f64::from(i) / 8.0).collect();
        let s = standard(&values);
        assert_eq!(s.mean, 1e15 + 0.25);
        assert_eq!(s.std, 2_f64.sqrt() / 8.0);
        assert!((s.z(values[0]) + 2_f64.sqrt()).abs() < 3e-16); // one ulp: √2 is rounded, then divided by
        // Mean 1e15 + 1/24 is no float; its tail keeps z right: z of the three values is −1/√2,
        // −1/√2, √2, here to 2 ulp (σ is rounded, and the division).
        let s = standard(&[1e15, 1e15, 1e15 + 0.125]);
        assert!((s.z(1e15) + 0.5_f64.sqrt()).abs() < 3e-16);
        assert!((s.z(1e15 + 0.125) - 2_f64.sqrt()).abs() < 5e-16);
    }

    /// n − 1 zeros and one huge value: μ = x/n, σ = x √(n−1)/n, z = √(n−1) and −1/√(n−1).
    #[test]
    fn one_outlier() {
        let mut values = vec![0.0; 16];
        values.push(1e300);
        let s = standard(&values);
        assert_eq!(s.mean, 1e300 / 17.0);
        assert!((s.std / (4e300 / 17.0) - 1.0).abs() < 3e-16);
        assert!((s.z(1e300) - 4.0).abs() < 1e-15);
        assert!((s.z(0.0) + 0.25).abs() < 1e-16);
    }

    proptest! {
        /// The slow twin: integers below 2²⁰, all sums in i128, one rounding (a variance below 2⁴⁰
        /// with n² below 2¹² has its numerator below 2⁵³, so that the division rounds once).
        #[test]
        fn agrees_with_integers(integers in prop::collection::vec(0_i32..1 << 20, 1..64), scale in -900..900) {
            let n = integers.len() as i128;
            let sum: i128 = integers.iter().map(|&i| i128::from(i)).sum();
            let squares: i128 = integers.iter().map(|&i| i128::from(i).pow(2)).sum();
            let variance = (n * squares - sum * sum) as f64 / (n * n) as f64;
            let values: Vec<f64> = integers.iter().map(|&i| libm::scalbn(f64::from(i), scale)).collect();
            let s = standard(&values);
            prop_assert_eq!(s.mean, libm::scalbn(sum as f64 / n as f64, scale));
            prop_assert_eq!(s.std, libm::scalbn(variance.sqrt(), scale));
        }

        #[test]
        fn z_scores_are_standard(values in prop::collection::vec(-1e6_f64..1e6, 2..50)) {
            let s = standard(&values);
            prop_assume!(!s.is_degenerate());
            let z: Vec<f64> = values.iter().map(|&value| s.z(value)).collect();
            let zs = standard(&z);
            // Each z is off by a few ulp of at most √n < 8.
            prop_assert!(zs.mean.abs() < 1e-14);
            prop_assert!((zs.std - 1.0).abs() < 1e-14);
        }

        #[test]
        fn parts_and_order_do_not_matter(
            values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL, 1..40),
            cut in 0_usize..40,
        ) {
            let cut = cut.min(values.len());
            let mut parts = Moments::of(&values[cut..]).unwrap();
            parts.merge(&Moments::of(&values[..cut]).unwrap());
            prop_assert_eq!(parts.standard(), Moments::of(&values).unwrap().standard());
            let s = standard(&values);
            prop_assert!(s.mean.is_finite() && s.std.is_finite());
            prop_assert!(values.iter().all(|&value| s.z(value).is_finite()));
        }
    }
}
