//! 1 − exp(−x) for x ≥ 0 as `libm::expm1f` computes it, bit for bit, without branches, so that kernels do
//! it in whole vectors.
//!
//! Source: FreeBSD's s_expm1f.c by way of the `libm` crate; its cases for negative arguments become
//! selections. Not defined for negative or NaN x.

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
}
