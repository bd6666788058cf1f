//! The elimination of a block of depths: E C⁻¹ Eᵀ and E C⁻¹ w of all edge pairs of one source.

use super::workspace::{BLOCK, DOF};
use crate::slam::lanes::{LANES, Lanes};

/// Rows and columns of a tile whose sums stay in registers: 9 sums and 6 operands.
const TILE: usize = 3;

/// Adds the block's part to `products` (`[edges, edges, 6, 6]`, pairs a ≤ b) and `reduced`
/// (`[edges, 6]`). `coupling` is `[edges, 6, BLOCK]`, `scaled` scratch. A depth whose diagonal is 0
/// is not observed: it couples nothing.
#[expect(clippy::too_many_arguments, reason = "slices of one kernel")]
#[inline(always)]
pub(super) fn eliminate_block(
    edges: usize,
    length: usize,
    coupling: &[f64],
    scaled: &mut [f64],
    diagonal: &[f64],
    rhs: &[f64],
    products: &mut [f64],
    reduced: &mut [f64],
) {
    let mut inverse = [0.0; BLOCK];
    let mut at = 0;
    while at < length {
        inverse_diagonal(Lanes::load(diagonal, at)).store(&mut inverse, at);
        at += LANES;
    }
    for a in 0..edges {
        let rows = &coupling[a * DOF * BLOCK..(a + 1) * DOF * BLOCK];
        for k in 0..DOF {
            let mut sum = Lanes::ZERO;
            let mut at = 0;
            while at < length {
                let value = Lanes::load(rows, k * BLOCK + at) * Lanes::load(&inverse, at);
                value.store(scaled, k * BLOCK + at);
                sum = sum + value * Lanes::load(rhs, at);
                at += LANES;
            }
            reduced[a * DOF + k] += sum.sum();
        }
        for b in a..edges {
            let other = &coupling[b * DOF * BLOCK..(b + 1) * DOF * BLOCK];
            let to = (a * edges + b) * DOF * DOF;
            let product = &mut products[to..to + DOF * DOF];
            for row in [0, TILE] {
                for column in [0, TILE] {
                    add_tile(length, scaled, other, product, row, column);
                }
            }
        }
    }
}

/// 1/c where c > 0, else 0.
#[inline(always)]
pub(super) fn inverse_diagonal(c: Lanes) -> Lanes {
    (Lanes::splat(1.0) / c).where_positive(c)
}

#[inline(always)]
fn add_tile(
    length: usize,
    left: &[f64],
    right: &[f64],
    product: &mut [f64],
    row: usize,
    column: usize,
) {
    let mut sums = [[Lanes::ZERO; TILE]; TILE];
    let left: [&[f64]; TILE] = [0, 1, 2].map(|k| &left[(row + k) * BLOCK..(row + k + 1) * BLOCK]);
    let right: [&[f64]; TILE] =
        [0, 1, 2].map(|k| &right[(column + k) * BLOCK..(column + k + 1) * BLOCK]);
    let mut at = 0;
    while at < length {
        let l = left.map(|plane| Lanes::load(plane, at));
        let r = right.map(|plane| Lanes::load(plane, at));
        for i in 0..TILE {
            for j in 0..TILE {
                sums[i][j] = sums[i][j] + l[i] * r[j];
            }
        }
        at += LANES;
    }
    for (i, sums) in sums.iter().enumerate() {
        for (j, sum) in sums.iter().enumerate() {
            product[(row + i) * DOF + column + j] += sum.sum();
        }
    }
}
