//! Numbers of twice the precision: the unevaluated sum of two f64, about 106 bits.
//!
//! Entropies are carried so, since a weight depends on their difference: an entropy of 3 nats rounded
//! to f64 is off by 2e-16, which alone moves a weight by two units in its last place. After Dekker
//! (1971) and Hida, Li, Bailey, "Library for double-double and quad-double arithmetic" (2001). No
//! unit. Nothing fails; values must be finite. A sum beyond the largest float is infinite.

use std::ops::{Add, Mul, Sub};

/// ln 2 to 106 bits.
const LN_2: Double = Double {
    hi: std::f64::consts::LN_2,
    lo: 2.319_046_813_846_299_6e-17,
};

/// exp halves its argument so often before the series, and squares as often after it.
const EXP_HALVINGS: i32 = 9;

/// Terms of the exponential series: |x| < 2⁻¹⁰ there, so that the next one is below 2⁻¹¹⁰.
const EXP_TERMS: u32 = 9;

/// Arguments below this have an exponential below the smallest float.
const EXP_UNDERFLOW: f64 = -746.0;

/// `hi + lo`, |lo| ≤ half a unit in the last place of `hi`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Double {
    hi: f64,
    lo: f64,
}

impl Double {
    /// The nearest f64.
    #[must_use]
    pub fn value(self) -> f64 {
        self.hi
    }

    /// Whether it is the smaller one.
    #[must_use]
    pub fn is_below(self, other: Self) -> bool {
        self.hi < other.hi || (self.hi == other.hi && self.lo < other.lo)
    }

    /// The exact sum of two floats.
    fn sum(a: f64, b: f64) -> Self {
        let hi = a + b;
        let b_seen = hi - a;
        let a_seen = hi - b_seen;
        Self {
            hi,
            lo: (a - a_seen) + (b - b_seen),
        }
    }

    /// The exact sum of two floats, |a| ≥ |b| or a = 0.
    fn ordered_sum(a: f64, b: f64) -> Self {
        let hi = a + b;
        Self {
            hi,
            lo: b - (hi - a),
        }
    }

    /// The exact product of two floats.
    fn product(a: f64, b: f64) -> Self {
        let hi = a * b;
        Self {
            hi,
            lo: a.mul_add(b, -hi),
        }
    }

    fn scaled(self, exponent: i32) -> Self {
        Self {
            hi: libm::scalbn(self.hi, exponent),
            lo: libm::scalbn(self.lo, exponent),
        }
    }

    /// The quotient, to about 2⁻¹⁰⁴ of it.
    #[must_use]
    pub fn over(self, divisor: Self) -> Self {
        let first = self.hi / divisor.hi;
        let rest = self - divisor * Self::from(first);
        let second = rest.hi / divisor.hi;
        let rest = rest - divisor * Self::from(second);
        Self::ordered_sum(first, second) + Self::from(rest.hi / divisor.hi)
    }

    /// e to this power, to about 2⁻¹⁰⁰ of it; 0 where it lies below the smallest float. For arguments
    /// up to 0.
    #[must_use]
    pub fn exp(self) -> Self {
        if self.hi < EXP_UNDERFLOW {
            return Self::default();
        }
        let halves = (self.hi / LN_2.hi).round();
        let x = (self - LN_2 * Self::from(halves)).scaled(-EXP_HALVINGS);
        // e^x − 1 by Horner: x (1 + x/2 (1 + x/3 (…)))
        let one = Self::from(1.0);
        let mut series = one;
        for k in (2..=EXP_TERMS).rev() {
            series = one + (x * series).over(Self::from(f64::from(k)));
        }
        let mut less_one = x * series;
        for _ in 0..EXP_HALVINGS {
            less_one = less_one.scaled(1) + less_one * less_one;
        }
        (one + less_one).scaled(halves as i32)
    }

    /// The natural logarithm, to about 2⁻⁹⁵ absolutely: one step of Newton's method on exp. For
    /// arguments in (0, 1].
    #[must_use]
    pub fn ln(self) -> Self {
        let near = Self::from(libm::log(self.hi));
        // e^near is in (0, 1] up to rounding; the step is x e^(−near) − 1 = (x − e^near)/e^near.
        let back = near.exp();
        near + (self - back).over(back)
    }
}

impl From<f64> for Double {
    fn from(value: f64) -> Self {
        Self { hi: value, lo: 0.0 }
    }
}

impl From<u64> for Double {
    /// Exact.
    fn from(count: u64) -> Self {
        let (high, low) = (count >> 32, count & 0xFFFF_FFFF);
        Self::sum(high as f64 * 4_294_967_296.0, low as f64)
    }
}

impl Add for Double {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let high = Self::sum(self.hi, other.hi);
        let low = Self::sum(self.lo, other.lo);
        if !high.hi.is_finite() {
            return Self::from(high.hi);
        }
        let partly = Self::ordered_sum(high.hi, high.lo + low.hi);
        Self::ordered_sum(partly.hi, partly.lo + low.lo)
    }
}

impl Sub for Double {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + Self {
            hi: -other.hi,
            lo: -other.lo,
        }
    }
}

impl Mul for Double {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = Self::product(self.hi, other.hi);
        let cross = self.hi * other.lo + self.lo * other.hi;
        Self::ordered_sum(product.hi, product.lo + cross)
    }
}
