//! Four doubles that are computed alike; the compiler keeps them in vector registers. The sum over
//! lanes has one fixed order, so that results do not depend on the instruction set.

/// Values per [`Lanes`].
pub(super) const LANES: usize = 4;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lanes(pub(super) [f64; LANES]);

impl Lanes {
    pub(super) const ZERO: Self = Self([0.0; LANES]);

    #[inline(always)]
    pub(super) fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    pub(super) fn load(slice: &[f64], at: usize) -> Self {
        let mut lanes = [0.0; LANES];
        lanes.copy_from_slice(&slice[at..at + LANES]);
        Self(lanes)
    }

    /// The same values as doubles.
    #[inline(always)]
    pub(super) fn widen(&[a, b, c, d]: &[f32; LANES]) -> Self {
        Self([f64::from(a), f64::from(b), f64::from(c), f64::from(d)])
    }

    #[inline(always)]
    pub(super) fn store(self, slice: &mut [f64], at: usize) {
        slice[at..at + LANES].copy_from_slice(&self.0);
    }

    /// (l₀ + l₁) + (l₂ + l₃).
    #[inline(always)]
    pub(super) fn sum(self) -> f64 {
        let [a, b, c, d] = self.0;
        (a + b) + (c + d)
    }

    /// This where `condition` is positive, 0 elsewhere (and where it is NaN).
    #[inline(always)]
    pub(super) fn where_positive(self, condition: Self) -> Self {
        self.zip(condition, |value, c| if c > 0.0 { value } else { 0.0 })
    }

    /// This where `condition` is at least `least`, 0 elsewhere (and where it is NaN).
    #[inline(always)]
    pub(super) fn where_at_least(self, condition: Self, least: f64) -> Self {
        self.zip(condition, |value, c| if c >= least { value } else { 0.0 })
    }

    /// This where it is at least `least`, 1 elsewhere.
    #[inline(always)]
    pub(super) fn or_one_below(self, least: f64) -> Self {
        let one = Self::splat(1.0);
        self.zip(one, |x, one| if x >= least { x } else { one })
    }

    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        self.zip(self, |x, _| x.abs())
    }

    /// The smaller of both.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    /// The larger of both.
    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn zip(self, other: Self, op: impl Fn(f64, f64) -> f64) -> Self {
        let mut lanes = self.0;
        for (lane, value) in lanes.iter_mut().zip(other.0) {
            *lane = op(*lane, value);
        }
        Self(lanes)
    }
}

/// Adds each sum over lanes to its total. Not inlined: a compiler that sees these sums behind a loop
/// packs its values by total instead of by lane, and shuffles them in every round (3 times slower).
#[inline(never)]
pub(super) fn add_sums<const N: usize>(lanes: &[Lanes; N], totals: &mut [f64; N]) {
    for (total, lanes) in totals.iter_mut().zip(lanes) {
        *total += lanes.sum();
    }
}

macro_rules! operator {
    ($name:ident, $method:ident, $op:tt) => {
        impl std::ops::$name for Lanes {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.zip(other, |a, b| a $op b)
            }
        }
    };
}

operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);
