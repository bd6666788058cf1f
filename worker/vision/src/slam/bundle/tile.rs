//! Products of rows with rows, three by three: the one inner loop of elimination and factorisation.

use crate::slam::lanes::{LANES, Lanes, add_sums};

/// Rows on either side: 9 sums and 6 operands stay in registers.
pub(super) const TILE: usize = 3;

/// First row and column of each tile of a 6 × 6 block.
pub(super) const TILES: [(usize, usize); 4] = [(0, 0), (0, TILE), (TILE, 0), (TILE, TILE)];

/// A 6 × 6 block, tile by tile, each row by row.
pub(super) type Tiled = [[f64; TILE * TILE]; TILES.len()];

/// Position of an entry of a block in [`Tiled`].
#[inline(always)]
pub(super) fn position(row: usize, column: usize) -> (usize, usize) {
    (
        2 * (row / TILE) + column / TILE,
        TILE * (row % TILE) + column % TILE,
    )
}

#[inline(always)]
fn lanes(row: &[f64]) -> &[[f64; LANES]] {
    row.as_chunks().0
}

/// Adds Σₖ left\[i\]\[k\] right\[j\]\[k\] to `totals`; all rows have one length.
#[inline(always)]
pub(super) fn add_tile(
    left: [&[f64]; TILE],
    right: [&[f64]; TILE],
    totals: &mut [f64; TILE * TILE],
) {
    let ([l0, l1, l2], [r0, r1, r2]) = (left, right);
    let length = l0.len();
    let whole = length / LANES;
    let (l0, l1, l2) = (
        &lanes(l0)[..whole],
        &lanes(l1)[..whole],
        &lanes(l2)[..whole],
    );
    let (r0, r1, r2) = (
        &lanes(r0)[..whole],
        &lanes(r1)[..whole],
        &lanes(r2)[..whole],
    );
    // No bounds checks, no `map`, and no array whose address is taken: the sums stay in registers.
    let [mut s0, mut s1, mut s2] = [[Lanes::ZERO; TILE]; TILE];
    for k in 0..whole {
        let r = [Lanes(r0[k]), Lanes(r1[k]), Lanes(r2[k])];
        for j in 0..TILE {
            s0[j] = s0[j] + Lanes(l0[k]) * r[j];
            s1[j] = s1[j] + Lanes(l1[k]) * r[j];
            s2[j] = s2[j] + Lanes(l2[k]) * r[j];
        }
    }
    let sums = [
        s0[0], s0[1], s0[2], s1[0], s1[1], s1[2], s2[0], s2[1], s2[2],
    ];
    add_sums(&sums, totals);
    for k in whole * LANES..length {
        for i in 0..TILE {
            for j in 0..TILE {
                totals[TILE * i + j] += left[i][k] * right[j][k];
            }
        }
    }
}
