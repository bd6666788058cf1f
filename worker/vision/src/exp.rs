//! exp(−x) and 1 − exp(−x) for x ≥ 0 and ln(x) for positive normal x as `libm::expf`, `libm::expm1f` and
//! `libm::logf` compute them, bit for bit, without branches, so that kernels do them in whole vectors.
//!
//! Sources: FreeBSD's e_expf.c, s_expm1f.c and e_logf.c by way of the `libm` crate; the cases for negative
//! arguments become selections. Not defined for other or NaN x.

use crate::flow::simd::whole;

const LN2_HI: f32 = f32::from_bits(0x3f31_7180);
const LN2_LO: f32 = f32::from_bits(0x3717_f7d1);
const INV_LN2: f32 = f32::from_bits(0x3fb8_aa3b);
const Q1: f32 = -3.333_321_2e-2;
const Q2: f32 = 1.580_717_e-3;
/// 27 ln 2: from here on the result is 1.
const ALL: f32 = f32::from_bits(0x4195_b844);
const HALF_LN2: f32 = f32::from_bits(0x3eb1_7218);
const THREE_HALVES_LN2: f32 = f32::from_bits(0x3f85_1592);
/// 2⁻²⁵: below it the result is x.
const TINY: f32 = f32::from_bits(0x3300_0000);
const EXPONENT_SHIFT: u32 = 23;
const EXPONENT_BIAS: u32 = 0x7f;

/// The largest x for which [`exp_of_minus`] is defined: beyond, 2^−halvings is no normal number.
pub(crate) const MOST_NORMAL: f32 = 86.0;
const EXP_LN2_HI: f32 = f32::from_bits(0x3f31_7200);
const EXP_LN2_LO: f32 = f32::from_bits(0x35bf_be8e);
const P1: f32 = f32::from_bits(0x3e2a_aa8f);
const P2: f32 = f32::from_bits(0xbb35_5215);
/// 2⁻¹³: up to it the result is 1 − x.
const SMALL: f32 = f32::from_bits(0x3900_0000);

/// exp(−`exponent`), at most [`MOST_NORMAL`].
#[inline(always)]
pub(crate) fn exp_of_minus(exponent: f32) -> f32 {
    let many = (INV_LN2 * exponent + 0.5).floor();
    let few = if exponent > HALF_LN2 { 1.0 } else { 0.0 };
    let halvings = if exponent > THREE_HALVES_LN2 {
        many
    } else {
        few
    };
    let (high, low) = (halvings * EXP_LN2_HI - exponent, -(halvings * EXP_LN2_LO));
    let reduced = high - low;
    let square = reduced * reduced;
    let c = reduced - square * (P1 + square * P2);
    let power = 1.0 + (reduced * c / (2.0 - c) - low + high);
    let scale = f32::from_bits((EXPONENT_BIAS - whole(halvings)) << EXPONENT_SHIFT);
    if exponent > SMALL {
        power * scale
    } else {
        1.0 - exponent
    }
}

/// √½ rounded down, from which on the mantissa of a logarithm's argument is taken.
const SQRT_HALF: u32 = 0x3f35_04f3;
const ONE: u32 = 0x3f80_0000;
const MANTISSA: u32 = 0x007f_ffff;
const LG1: f32 = 0.666_666_6;
const LG2: f32 = 0.400_009_72;
const LG3: f32 = 0.284_987_87;
const LG4: f32 = 0.242_790_79;

/// ln(`value`).
#[inline(always)]
pub(crate) fn ln(value: f32) -> f32 {
    let bits = value.to_bits().wrapping_add(ONE - SQRT_HALF);
    let doublings = (bits >> EXPONENT_SHIFT) as i32 - EXPONENT_BIAS as i32;
    let reduced = f32::from_bits((bits & MANTISSA) + SQRT_HALF);
    let f = reduced - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let t1 = w * (LG2 + w * LG4);
    let t2 = z * (LG1 + w * LG3);
    let r = t2 + t1;
    let half = 0.5 * f * f;
    let k = doublings as f32;
    s * (half + r) + k * LN2_LO - half + f + k * LN2_HI
}

/// 1 − exp(−`exponent`).
#[inline(always)]
pub(crate) fn one_minus_exp_of_minus(exponent: f32) -> f32 {
    let x = -exponent.min(ALL);
    // exp(x) = 2^-halvings · exp(reduced).
    let many = (0.5 - INV_LN2 * x).floor();
    let few = if exponent > HALF_LN2 { 1.0 } else { 0.0 };
    let halvings = if exponent < THREE_HALVES_LN2 {
        few
    } else {
        many
    };
    let (high, low) = (x + halvings * LN2_HI, -(halvings * LN2_LO));
    let reduced = high - low;
    let lost = (high - reduced) - low;
    let half = 0.5 * reduced;
    let square = reduced * half;
    let r1 = 1.0 + square * (Q1 + square * Q2);
    let t = 3.0 - r1 * half;
    let e = square * ((r1 - t) / (6.0 - reduced * t));
    let unreduced = reduced - (reduced * e - square);
    let e = (reduced * (e - lost) - lost) - square;
    let halved = 0.5 * (reduced - e) - 0.5;
    let scale = f32::from_bits((EXPONENT_BIAS - whole(halvings)) << EXPONENT_SHIFT);
    let scaled = (reduced - e + 1.0) * scale - 1.0;
    let less = if halvings == 0.0 { unreduced } else { scaled };
    let less = if halvings == 1.0 { halved } else { less };
    let less = if exponent >= ALL { -1.0 } else { less };
    let less = if exponent < TINY { -exponent } else { less };
    -less
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_bits_as_libm() {
        let mut step = 0u32;
        // Every 1009th float from 0 to infinity, and all around the cases' bounds.
        let spread = std::iter::from_fn(|| {
            step += 1009;
            (step < f32::INFINITY.to_bits()).then_some(step)
        });
        let bounds = [TINY, HALF_LN2, THREE_HALVES_LN2, ALL, 0.0, 1.0, f32::MAX];
        let around = bounds.iter().flat_map(|bound| {
            let bits = bound.to_bits();
            bits.saturating_sub(2000)..=(bits + 2000).min(f32::MAX.to_bits())
        });
        for bits in spread.chain(around) {
            let x = f32::from_bits(bits);
            let (fast, slow) = (one_minus_exp_of_minus(x), -libm::expm1f(-x));
            assert_eq!(fast.to_bits(), slow.to_bits(), "{x}");
        }
    }

    #[test]
    fn exponentials_equal_libm_bit_for_bit() {
        let bounds = [SMALL, HALF_LN2, THREE_HALVES_LN2, 1.0, 20.0];
        let around = bounds.iter().flat_map(|bound| {
            let bits = bound.to_bits();
            bits - 2000..=bits + 2000
        });
        for bits in (0..=MOST_NORMAL.to_bits()).step_by(1009).chain(around) {
            let x = f32::from_bits(bits);
            let (fast, slow) = (exp_of_minus(x), libm::expf(-x));
            assert_eq!(fast.to_bits(), slow.to_bits(), "{x}");
        }
    }

    #[test]
    fn logarithms_equal_libm_bit_for_bit() {
        // Every 101st positive normal number; 1 and its neighbours.
        let normal = (0x0080_0000u32..0x7f80_0000).step_by(101);
        for bits in normal.chain(ONE - 3..ONE + 3) {
            let x = f32::from_bits(bits);
            assert_eq!(ln(x).to_bits(), libm::logf(x).to_bits(), "{x}");
        }
    }
}
