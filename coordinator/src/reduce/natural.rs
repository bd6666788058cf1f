//! Natural numbers of any size: the few operations that exact moments need.
//!
//! Digits of 32 bits, least significant first, no leading zeros. The only rounding is in
//! [`Natural::to_f64`], to nearest, ties to even. Nothing fails: what is larger than the largest
//! float becomes infinite there.

const DIGIT_BITS: usize = 32;

/// A natural number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Natural(Vec<u32>);

impl Natural {
    /// From digits of 32 bits, least significant first.
    pub(super) fn from_digits(mut digits: Vec<u32>) -> Self {
        while digits.last() == Some(&0) {
            digits.pop();
        }
        Self(digits)
    }

    pub(super) fn is_zero(&self) -> bool {
        self.0.is_empty()
    }

    /// Position of the highest set bit plus one; 0 for zero.
    pub(super) fn bits(&self) -> usize {
        match self.0.last() {
            None => 0,
            Some(top) => self.0.len() * DIGIT_BITS - top.leading_zeros() as usize,
        }
    }

    pub(super) fn times(&self, factor: u64) -> Self {
        let mut digits = Vec::with_capacity(self.0.len() + 2);
        let mut carry = 0_u128;
        for &digit in &self.0 {
            // (2³²−1)(2⁶⁴−1) plus a carry below 2⁶⁵ stays below 2⁹⁷.
            carry += u128::from(digit) * u128::from(factor);
            digits.push(carry as u32);
            carry >>= DIGIT_BITS;
        }
        while carry > 0 {
            digits.push(carry as u32);
            carry >>= DIGIT_BITS;
        }
        Self::from_digits(digits)
    }

    pub(super) fn squared(&self) -> Self {
        let mut digits = vec![0_u32; 2 * self.0.len()];
        for (i, &a) in self.0.iter().enumerate() {
            let mut carry = 0_u64;
            for (j, &b) in self.0.iter().enumerate() {
                // At most (2³²−1)² + 2(2³²−1) = 2⁶⁴−1.
                carry += u64::from(a) * u64::from(b) + u64::from(digits[i + j]);
                digits[i + j] = carry as u32;
                carry >>= DIGIT_BITS;
            }
            digits[i + self.0.len()] = carry as u32;
        }
        Self::from_digits(digits)
    }

    /// `self − other`; zero where `other` is larger.
    pub(super) fn minus(&self, other: &Self) -> Self {
        let mut digits = Vec::with_capacity(self.0.len());
        let mut borrow = 0_i64;
        for (i, &digit) in self.0.iter().enumerate() {
            let subtrahend = other.0.get(i).copied().unwrap_or(0);
            let difference = i64::from(digit) - i64::from(subtrahend) + borrow;
            digits.push(difference as u32);
            borrow = difference >> DIGIT_BITS;
        }
        if borrow != 0 || other.0.len() > self.0.len() {
            return Self(Vec::new());
        }
        Self::from_digits(digits)
    }

    /// `self · 2^(32·digits)`.
    pub(super) fn shifted_up(&self, digits: usize) -> Self {
        let mut shifted = vec![0; digits];
        shifted.extend_from_slice(&self.0);
        Self::from_digits(shifted)
    }

    /// `⌊self / divisor⌋`, and whether a remainder was left. Dividing by zero gives zero.
    pub(super) fn divided_by(&self, divisor: u64) -> (Self, bool) {
        if divisor == 0 {
            return (Self(Vec::new()), !self.is_zero());
        }
        let mut digits = vec![0; self.0.len()];
        let mut remainder = 0_u128;
        for (quotient, &digit) in digits.iter_mut().zip(&self.0).rev() {
            let dividend = (remainder << DIGIT_BITS) | u128::from(digit);
            *quotient = (dividend / u128::from(divisor)) as u32;
            remainder = dividend % u128::from(divisor);
        }
        (Self::from_digits(digits), remainder > 0)
    }

    /// Splits into the leading `leading` bits (times their power of two) and the rest.
    pub(super) fn split(&self, leading: usize) -> (Self, Self) {
        let low_bits = self.bits().saturating_sub(leading);
        let (whole, part) = (low_bits / DIGIT_BITS, low_bits % DIGIT_BITS);
        let mut high = self.0.clone();
        let mut low = self.0.clone();
        for (i, (high, low)) in high.iter_mut().zip(&mut low).enumerate() {
            let mask = match i.cmp(&whole) {
                std::cmp::Ordering::Less => u32::MAX,
                std::cmp::Ordering::Equal => (1_u32 << part) - 1,
                std::cmp::Ordering::Greater => 0,
            };
            *high &= !mask;
            *low &= mask;
        }
        (Self::from_digits(high), Self::from_digits(low))
    }

    /// `(self + tail) · 2^exponent` to nearest, ties to even; `tail` says that something in (0, 1)
    /// is to be added (the remainder of a division).
    pub(super) fn to_f64(&self, exponent: i32, tail: bool) -> f64 {
        let bits = self.bits();
        if bits == 0 {
            return 0.0;
        }
        let (leading, below) = self.leading_64();
        let tail = tail || below;
        // The value is leading · 2^unit, with 2⁶³ ≤ leading < 2⁶⁴.
        let unit = exponent + bits as i32 - 64;
        // Below 2^−1022 the last place stays at 2^−1074.
        let drop = 11.max(f64::MIN_EXP - f64::MANTISSA_DIGITS as i32 - unit);
        if drop > 64 {
            return 0.0; // less than half of the smallest float
        }
        let leading = u128::from(leading);
        let half = 1_u128 << (drop - 1);
        let (kept, rest) = (leading >> drop, leading & ((half << 1) - 1));
        let up = rest > half || (rest == half && (tail || kept & 1 == 1));
        // At most 2⁵³: exact in f64, and so is the scaling, save for overflow.
        libm::scalbn((kept as u64 + u64::from(up)) as f64, unit + drop)
    }

    /// The leading 64 bits, the first of them set, and whether any bit below them is set.
    fn leading_64(&self) -> (u64, bool) {
        let mut digits = self.0.iter().rev();
        let mut next = || digits.next().copied().unwrap_or(0);
        let window = (u128::from(next()) << 64) | (u128::from(next()) << 32) | u128::from(next());
        // `window` has 96 bits, the first within its leading 32.
        let shift = (self.bits() + DIGIT_BITS - 1) % DIGIT_BITS + 1;
        let leading = (window >> shift) as u64;
        let below = window & ((1 << shift) - 1) != 0 || digits.any(|&digit| digit != 0);
        (leading, below)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn natural(value: u128) -> Natural {
        Natural::from_digits((0..4).map(|i| (value >> (32 * i)) as u32).collect())
    }

    proptest! {
        /// Against the machine's own 128-bit integers.
        #[test]
        fn agrees_with_u128(a in any::<u64>(), b in any::<u64>(), wide in any::<u128>(), k in 1_u64..) {
            let (a128, b128) = (u128::from(a), u128::from(b));
            prop_assert_eq!(natural(a128).times(b), natural(a128 * b128));
            prop_assert_eq!(natural(a128).squared(), natural(a128 * a128));
            prop_assert_eq!(natural(wide).minus(&natural(b128)), natural(wide.saturating_sub(b128)));
            prop_assert_eq!(natural(b128).minus(&natural(wide)), natural(b128.saturating_sub(wide)));
            prop_assert_eq!(natural(a128).shifted_up(2), natural(a128 << 64));
            let (quotient, left) = natural(wide).divided_by(k);
            prop_assert_eq!(quotient, natural(wide / u128::from(k)));
            prop_assert_eq!(left, wide % u128::from(k) != 0);
        }

        /// The machine converts u128 to f64 to nearest even as well.
        #[test]
        fn rounds_as_the_machine_does(wide in any::<u128>(), shift in 0_u32..128) {
            let value = wide >> shift;
            prop_assert_eq!(natural(value).to_f64(0, false), value as f64);
        }

        #[test]
        fn splits_without_loss(wide in any::<u128>(), shift in 0_u32..128, leading in 1_usize..140) {
            let value = wide >> shift;
            let (high, low) = natural(value).split(leading);
            prop_assert_eq!(&natural(value).minus(&low), &high);
            prop_assert_eq!(natural(value).minus(&high), low);
            prop_assert!(high.to_f64(0, false) <= value as f64 || leading > 53);
        }
    }

    #[test]
    fn rounding_at_the_edges() {
        // Ties to even, and a tail breaks the tie: 2⁵³ + 1 lies between 2⁵³ and 2⁵³ + 2.
        let tie = natural((1 << 53) + 1);
        assert_eq!(tie.to_f64(0, false), 9_007_199_254_740_992.0);
        assert_eq!(tie.to_f64(0, true), 9_007_199_254_740_994.0);
        // Half of the smallest float rounds to even, zero; a little more rounds up.
        assert_eq!(natural(1).to_f64(-1075, false), 0.0);
        assert_eq!(natural(1).to_f64(-1075, true), 5e-324);
        assert_eq!(natural(3).to_f64(-1075, false), 1e-323);
        assert_eq!(natural(1).to_f64(-1076, true), 0.0);
        assert_eq!(
            natural(u128::MAX).to_f64(-1200, false),
            libm::scalbn(1.0, -1072)
        );
        // Overflow starts at 2¹⁰²⁴ − 2⁹⁷⁰.
        assert_eq!(natural((1 << 53) - 1).to_f64(971, false), f64::MAX);
        assert_eq!(natural((1 << 54) - 1).to_f64(970, false), f64::INFINITY);
        assert_eq!(natural(0).to_f64(5000, true), 0.0);
    }
}
