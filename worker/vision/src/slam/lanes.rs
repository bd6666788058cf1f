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

    /// The values of `slice` from `at` on; zeros beyond its end.
    #[inline(always)]
    pub(super) fn load_f32(slice: &[f32], at: usize) -> Self {
        let mut lanes = [0.0f32; LANES];
        if let Some(whole) = slice.get(at..at + LANES) {
            lanes.copy_from_slice(whole);
        } else if let Some(rest) = slice.get(at..) {
            lanes[..rest.len()].copy_from_slice(rest);
        }
        Self(lanes.map(f64::from))
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
        let mut lanes = self.0;
        for (lane, c) in lanes.iter_mut().zip(condition.0) {
            *lane = if c > 0.0 { *lane } else { 0.0 };
        }
        Self(lanes)
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

impl Lanes {
    /// This where `condition` is at least `least`, 0 elsewhere (and where it is NaN).
    #[inline(always)]
    pub(super) fn where_at_least(self, condition: Self, least: f64) -> Self {
        let mut lanes = self.0;
        for (lane, c) in lanes.iter_mut().zip(condition.0) {
            *lane = if c >= least { *lane } else { 0.0 };
        }
        Self(lanes)
    }

    /// This where it is at least `least`, 1 elsewhere.
    #[inline(always)]
    pub(super) fn or_one_below(self, least: f64) -> Self {
        Self(self.0.map(|x| if x >= least { x } else { 1.0 }))
    }
}
