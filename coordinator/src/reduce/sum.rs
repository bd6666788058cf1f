//! Exact sums of floats, the same bits for any order and any split into parts.
//!
//! A superaccumulator: one fixed-point number wide enough for every finite f64 (and for every
//! square of one), kept as 32-bit digits in 64-bit cells so that carries are settled rarely. After
//! Kulisch, and Neal, "Fast exact summation using small and large superaccumulators" (2015). It is
//! written here instead of taken from a crate, because the exact integer itself is needed: variance
//! is found from it without any rounding (`moments`).
//!
//! Fails on NaN and infinities ([`NotFinite`]).

use super::natural::Natural;

const DIGIT_BITS: i32 = 32;

/// Smallest power of two in an f64, and in the square of one.
pub(super) const VALUE_EXPONENT: i32 = -1074;
pub(super) const SQUARE_EXPONENT: i32 = 2 * VALUE_EXPONENT;
const VALUE_TOP: i32 = f64::MAX_EXP;
const SQUARE_TOP: i32 = 2 * f64::MAX_EXP;

/// Room for 2⁶⁴ terms.
const COUNT_BITS: i32 = 64;

/// One addition changes a cell by less than 2³³ (a square is added in two pieces that overlap), so
/// that 2²⁹ of them stay below 2⁶².
const ADDITIONS_BEFORE_CARRY: u32 = 1 << 29;

/// A value that has no place in a sum.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{0} is not a finite number")]
pub struct NotFinite(pub f64);

/// A fixed-point number: `Σ cells[i] · 2^(32 i + exponent)`.
#[derive(Debug, Clone)]
struct FixedPoint {
    cells: Vec<i64>,
    uncarried: u32,
}

impl FixedPoint {
    fn new(exponent: i32, top: i32) -> Self {
        // One digit more for a partly filled one, two for pieces that reach past their top bit.
        let digits = (top - exponent + COUNT_BITS) / DIGIT_BITS + 3;
        Self {
            cells: vec![0; digits as usize],
            uncarried: 0,
        }
    }

    /// Adds ± `significand` · 2^(position + exponent).
    fn add(&mut self, significand: u64, position: usize, negative: bool) {
        let (cell, shift) = (position / 32, position % 32);
        let shifted = u128::from(significand) << shift;
        for (i, cell) in self.cells[cell..cell + 3].iter_mut().enumerate() {
            let digit = i64::from((shifted >> (32 * i)) as u32);
            *cell += if negative { -digit } else { digit };
        }
    }

    fn count_addition(&mut self) {
        self.uncarried += 1;
        if self.uncarried >= ADDITIONS_BEFORE_CARRY {
            self.carry();
        }
    }

    /// Brings every cell but the last into [0, 2³²); the last one keeps the sign.
    fn carry(&mut self) {
        let mut carry = 0;
        if let Some((last, cells)) = self.cells.split_last_mut() {
            for cell in cells {
                let value = *cell + carry;
                carry = value >> DIGIT_BITS;
                *cell = value & 0xFFFF_FFFF;
            }
            *last += carry;
        }
        self.uncarried = 0;
    }

    fn merge(&mut self, other: &Self) {
        self.carry();
        let mut other = other.clone();
        other.carry();
        for (cell, more) in self.cells.iter_mut().zip(&other.cells) {
            *cell += more;
        }
        self.carry();
    }

    /// Sign and magnitude, in units of 2^exponent.
    fn magnitude(&self) -> (bool, Natural) {
        let mut settled = self.clone();
        settled.carry();
        let negative = settled.cells.last().is_some_and(|&top| top < 0);
        if negative {
            settled.cells.iter_mut().for_each(|cell| *cell = -*cell);
            settled.carry();
        }
        let mut digits = Vec::with_capacity(settled.cells.len() + 1);
        digits.extend(settled.cells.iter().map(|&cell| cell as u32));
        // Nothing reaches above 32 bits of the last cell: `COUNT_BITS` leaves room.
        (negative, Natural::from_digits(digits))
    }
}

/// Sign, significand and the power of two of its last bit, counted from 2^−1074.
fn parts(value: f64) -> Result<(bool, u64, usize), NotFinite> {
    if !value.is_finite() {
        return Err(NotFinite(value));
    }
    let bits = value.to_bits();
    let biased = (bits >> 52) & 0x7FF;
    let fraction = bits & ((1 << 52) - 1);
    let significand = if biased == 0 {
        fraction
    } else {
        fraction | (1 << 52)
    };
    Ok((
        value.is_sign_negative(),
        significand,
        biased.saturating_sub(1) as usize,
    ))
}

/// An exact sum.
#[derive(Debug, Clone)]
pub struct ExactSum(FixedPoint);

impl Default for ExactSum {
    fn default() -> Self {
        Self(FixedPoint::new(VALUE_EXPONENT, VALUE_TOP))
    }
}

impl ExactSum {
    /// Adds one value.
    ///
    /// # Errors
    /// [`NotFinite`]; the sum is then unchanged.
    pub fn add(&mut self, value: f64) -> Result<(), NotFinite> {
        let (negative, significand, position) = parts(value)?;
        self.0.add(significand, position, negative);
        self.0.count_addition();
        Ok(())
    }

    /// Adds the sum of another part.
    pub fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }

    /// The sum to nearest, ties to even. However far the terms went in between, only a sum that
    /// itself lies beyond the largest float is infinite. Zero is +0.
    #[must_use]
    pub fn value(&self) -> f64 {
        let (negative, magnitude) = self.0.magnitude();
        let value = magnitude.to_f64(VALUE_EXPONENT, false);
        if negative { -value } else { value }
    }

    /// The sum itself: sign and magnitude in units of 2^[`VALUE_EXPONENT`].
    pub(super) fn exact(&self) -> (bool, Natural) {
        self.0.magnitude()
    }
}

/// An exact sum of squares.
#[derive(Debug, Clone)]
pub(super) struct ExactSquareSum(FixedPoint);

impl Default for ExactSquareSum {
    fn default() -> Self {
        Self(FixedPoint::new(SQUARE_EXPONENT, SQUARE_TOP))
    }
}

impl ExactSquareSum {
    /// Adds `value²`.
    pub(super) fn add(&mut self, value: f64) -> Result<(), NotFinite> {
        let (_, significand, position) = parts(value)?;
        let square = u128::from(significand) * u128::from(significand);
        self.0.add(square as u64, 2 * position, false);
        self.0.add((square >> 64) as u64, 2 * position + 64, false);
        self.0.count_addition();
        Ok(())
    }

    /// Adds the sum of another part.
    pub(super) fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }

    /// The sum itself, in units of 2^[`SQUARE_EXPONENT`].
    pub(super) fn exact(&self) -> Natural {
        self.0.magnitude().1
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn sum(values: &[f64]) -> f64 {
        let mut sum = ExactSum::default();
        for &value in values {
            sum.add(value).unwrap();
        }
        sum.value()
    }

    #[test]
    fn what_a_running_sum_loses() {
        assert_eq!(sum(&[]), 0.0);
        assert_eq!(sum(&[1e16, 1.0, -1e16]), 1.0);
        assert_eq!(sum(&[0.1; 10]), 1.0); // ten times fl(0.1) is 1 + 5.6e-17, nearest 1
        assert_eq!(sum(&[f64::MAX, f64::MAX, -f64::MAX]), f64::MAX);
        assert_eq!(sum(&[f64::MAX, f64::MAX]), f64::INFINITY);
        assert_eq!(sum(&[-f64::MAX, -f64::MAX]), f64::NEG_INFINITY);
        assert_eq!(sum(&[5e-324, 5e-324, 5e-324]), 1.5e-323);
        assert_eq!(sum(&[f64::MAX, 5e-324, -f64::MAX]), 5e-324);
        assert_eq!(sum(&[f64::MAX, -5e-324, -f64::MAX]), -5e-324);
        assert!(sum(&[-0.0]).is_sign_positive());
    }

    #[test]
    fn non_finite_values_are_refused() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut sum = ExactSum::default();
            sum.add(2.0).unwrap();
            assert!(sum.add(value).is_err());
            assert_eq!(sum.value(), 2.0);
        }
    }

    #[test]
    fn carrying_early_changes_nothing() {
        let values = [1e300, -3.5, 1e-310, -1e300, 7e99, -7e99, 0.1];
        let mut eager = ExactSum::default();
        for value in values {
            eager.add(value).unwrap();
            eager.0.carry();
        }
        assert_eq!(eager.value(), sum(&values));
        assert_eq!(eager.exact(), {
            let mut lazy = ExactSum::default();
            values.iter().for_each(|&value| lazy.add(value).unwrap());
            lazy.exact()
        });
    }

    #[test]
    fn squares_are_exact() {
        let mut squares = ExactSquareSum::default();
        for value in [3.0, -5e-324, f64::MAX] {
            squares.add(value).unwrap();
        }
        // f64::MAX² + 9 + 2^−2148; the last bit is there, and so is the first.
        let exact = squares.exact();
        assert_eq!(exact.bits(), 2148 + 2048);
        let (max, rest) = exact.split(106);
        assert_eq!(
            max.to_f64(SQUARE_EXPONENT - 1024, false),
            libm::scalbn(1.0, 1024 - 52) * ((1_u64 << 52) as f64 - 1.0)
        );
        assert_eq!(rest.to_f64(SQUARE_EXPONENT, false), 9.0);
        assert_eq!(rest.split(rest.bits() - 1).1.to_f64(0, false), 1.0);
    }

    proptest! {
        /// The slow twin: multiples of 2⁻⁴⁰ summed as integers.
        #[test]
        fn agrees_with_integers(integers in prop::collection::vec(-(1_i64 << 53)..(1 << 53), 0..200)) {
            let unit = libm::scalbn(1.0, -40);
            let values: Vec<f64> = integers.iter().map(|&i| i as f64 * unit).collect();
            let expected: i128 = integers.iter().map(|&i| i128::from(i)).sum();
            prop_assert_eq!(sum(&values), expected as f64 * unit);
        }

        /// Any order and any split into parts give the same bits.
        #[test]
        fn order_and_parts_do_not_matter(
            values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO, 0..60),
            seed in any::<u64>(),
            cut in 0_usize..60,
        ) {
            let mut shuffled = values.clone();
            let mut state = seed;
            for i in (1..shuffled.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                shuffled.swap(i, (state >> 33) as usize % (i + 1));
            }
            prop_assert_eq!(sum(&values).to_bits(), sum(&shuffled).to_bits());
            let cut = cut.min(values.len());
            let (mut left, mut right) = (ExactSum::default(), ExactSum::default());
            values[..cut].iter().for_each(|&value| left.add(value).unwrap());
            values[cut..].iter().for_each(|&value| right.add(value).unwrap());
            left.merge(&right);
            prop_assert_eq!(left.value().to_bits(), sum(&values).to_bits());
        }
    }
}
