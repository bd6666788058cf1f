//! The elimination of a block of depths: E C⁻¹ Eᵀ and E C⁻¹ w of all edge pairs of one source.

use nalgebra::Matrix6;

use super::tile::{TILE, TILES, Tiled, add_tile, position};
use super::workspace::{BLOCK, DOF, Scratch};
use crate::slam::lanes::{LANES, Lanes, add_sums};

/// Position of the pair of edges a ≤ b among those of one source with `edges` edges.
pub(super) fn pair(edges: usize, a: usize, b: usize) -> usize {
    a * (2 * edges - a - 1) / 2 + b
}

/// The product of a pair as a matrix. Of an edge with itself the tile below the diagonal is not summed:
/// it is the one above, transposed.
pub(super) fn matrix(product: &Tiled, is_diagonal: bool) -> Matrix6<f64> {
    Matrix6::from_fn(|row, column| {
        let is_mirrored = is_diagonal && row >= TILE && column < TILE;
        let (tile, entry) = if is_mirrored {
            position(column, row)
        } else {
            position(row, column)
        };
        product[tile][entry]
    })
}

/// Adds a block of cells of one source to `products` (pairs a ≤ b, see [`pair`]) and `reduced`, E C⁻¹ w
/// of each edge. The scratch holds the coupling. A depth whose diagonal is 0 is not observed: it couples
/// nothing.
#[inline(always)]
pub(super) fn eliminate_block(
    scratch: &mut Scratch,
    diagonal: &[f64],
    rhs: &[f64],
    products: &mut [Tiled],
    reduced: &mut [[f64; DOF]],
) {
    let Scratch {
        coupling,
        scaled,
        inverse,
    } = scratch;
    let (edges, length) = (reduced.len(), diagonal.len());
    let mut at = 0;
    while at < length {
        inverse_diagonal(Lanes::load(diagonal, at)).store(inverse, at);
        at += LANES;
    }
    for a in 0..edges {
        let rows = &coupling[a * DOF * BLOCK..(a + 1) * DOF * BLOCK];
        let mut sums = [Lanes::ZERO; DOF];
        for (k, total) in sums.iter_mut().enumerate() {
            let rows = &rows[k * BLOCK..][..length];
            let scaled = &mut scaled[k * BLOCK..][..length];
            let mut sum = Lanes::ZERO;
            let mut at = 0;
            while at < length {
                let value = Lanes::load(rows, at) * Lanes::load(inverse, at);
                value.store(scaled, at);
                sum = sum + value * Lanes::load(rhs, at);
                at += LANES;
            }
            *total = sum;
        }
        add_sums(&sums, &mut reduced[a]);
        for b in a..edges {
            let other = &coupling[b * DOF * BLOCK..(b + 1) * DOF * BLOCK];
            let product = &mut products[pair(edges, a, b)];
            for (totals, (row, column)) in product.iter_mut().zip(TILES) {
                if a < b || row <= column {
                    add_tile(
                        [0, 1, 2].map(|k| &scaled[(row + k) * BLOCK..][..length]),
                        [0, 1, 2].map(|k| &other[(column + k) * BLOCK..][..length]),
                        totals,
                    );
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
