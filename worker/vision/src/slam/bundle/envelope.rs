//! Symmetric positive definite systems of 6 × 6 blocks, stored and factored inside their envelope.
//!
//! Of block row i the blocks from its first occupied one to the diagonal are kept; Cholesky's factor
//! fills no others (A. George, J. Liu, "Computer Solution of Large Sparse Positive Definite Systems",
//! 1981, ch. 4). Frames stand in order of time and most edges join neighbours, so that the envelope is
//! a band, with a few long rows where the camera comes back. Its worst case is the dense matrix.

use nalgebra::Matrix6;

use super::tile::{TILES, Tiled, add_tile, position};
use super::workspace::DOF;
use crate::flow::simd::{Kernel, dispatch};
use crate::slam::lanes::{LANES, Lanes};

/// A lower triangle of blocks.
#[derive(Debug, Clone, Default)]
pub(super) struct Envelope {
    rows: Vec<BlockRow>,
    values: Vec<f64>,
}

/// Block row i: columns `first..=i`, as six rows of 6 (i − first + 1) numbers.
#[derive(Debug, Clone, Copy)]
struct BlockRow {
    first: usize,
    start: usize,
    width: usize,
}

impl BlockRow {
    /// Row `r` of the block row, from block column `from` up to that of `to`.
    fn range(&self, r: usize, from: usize, to: usize) -> std::ops::Range<usize> {
        let row = self.start + r * self.width;
        row + (from - self.first) * DOF..row + (to - self.first) * DOF
    }
}

impl Envelope {
    /// Lays the envelope out: `first` gives each block row's first occupied column. All is zero.
    pub(super) fn shape(&mut self, first: &[usize]) {
        self.rows.clear();
        let mut start = 0;
        for (i, &first) in first.iter().enumerate() {
            let first = first.min(i);
            let width = (i - first + 1) * DOF;
            self.rows.push(BlockRow {
                first,
                start,
                width,
            });
            start += width * DOF;
        }
        self.values.resize(start, 0.0);
        self.clear();
    }

    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    pub(super) fn copy_from(&mut self, other: &Self) {
        self.rows.clone_from(&other.rows);
        self.values.clone_from(&other.values);
    }

    /// Adds to block (i, j), which lies in the envelope or, as its transpose, above the diagonal.
    pub(super) fn add(&mut self, i: usize, j: usize, block: &Matrix6<f64>) {
        let (row, j, transposed) = if i >= j { (i, j, false) } else { (j, i, true) };
        for r in 0..DOF {
            let range = self.rows[row].range(r, j, j + 1);
            for (c, value) in self.values[range].iter_mut().enumerate() {
                *value += if transposed {
                    block[(c, r)]
                } else {
                    block[(r, c)]
                };
            }
        }
    }

    /// Entry (k, k).
    pub(super) fn diagonal_mut(&mut self, k: usize) -> &mut f64 {
        let (i, r) = (k / DOF, k % DOF);
        let at = self.rows[i].range(r, i, i + 1).start + r;
        &mut self.values[at]
    }

    /// The whole symmetric matrix.
    pub(super) fn to_dense(&self) -> nalgebra::DMatrix<f64> {
        let size = self.rows.len() * DOF;
        let mut dense = nalgebra::DMatrix::zeros(size, size);
        for (i, row) in self.rows.iter().enumerate() {
            for r in 0..DOF {
                let values = &self.values[row.range(r, row.first, i + 1)];
                for (c, value) in values
                    .iter()
                    .enumerate()
                    .take((i - row.first) * DOF + r + 1)
                {
                    dense[(i * DOF + r, row.first * DOF + c)] = *value;
                }
            }
        }
        dense.fill_upper_triangle_with_lower_triangle();
        dense
    }

    /// Replaces the matrix by its factor L. False where there is none: a pivot is not positive, or
    /// NaN; the values then have no meaning.
    #[must_use]
    pub(super) fn factor(&mut self) -> bool {
        dispatch(Factor(self))
    }

    /// Solves L Lᵀ x = b in place.
    pub(super) fn solve(&self, x: &mut [f64]) {
        for (i, row) in self.rows.iter().enumerate() {
            for r in 0..DOF {
                let k = i * DOF + r;
                let from = row.first * DOF;
                let values = &self.values[row.range(r, row.first, i + 1)][..=k - from];
                let (before, pivot) = (&values[..k - from], values[k - from]);
                x[k] = (x[k] - dot(before, &x[from..k])) / pivot;
            }
        }
        for (i, row) in self.rows.iter().enumerate().rev() {
            for r in (0..DOF).rev() {
                let k = i * DOF + r;
                let from = row.first * DOF;
                let values = &self.values[row.range(r, row.first, i + 1)][..=k - from];
                x[k] /= values[k - from];
                let known = x[k];
                for (other, value) in x[from..k].iter_mut().zip(values) {
                    *other -= value * known;
                }
            }
        }
    }
}

/// Sum of products: over four lanes, then the rest.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_lanes, b_lanes) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_lanes.remainder().iter().zip(b_lanes.remainder());
    let rest: f64 = rest.map(|(a, b)| a * b).sum();
    let mut sum = Lanes::ZERO;
    for (a, b) in a_lanes.zip(b_lanes) {
        sum = sum + Lanes::load(a, 0) * Lanes::load(b, 0);
    }
    sum.sum() + rest
}

struct Factor<'a>(&'a mut Envelope);

impl Kernel for Factor<'_> {
    type Output = bool;

    /// Block by block: L_ij L_jjᵀ = S_ij − Σ_k L_ik L_jkᵀ.
    #[inline(always)]
    fn run(self) -> bool {
        let Envelope { rows, values } = self.0;
        for i in 0..rows.len() {
            let row = rows[i];
            for j in row.first..=i {
                let column = rows[j];
                let from = row.first.max(column.first);
                let mut products: Tiled = Default::default();
                for (totals, (r, c)) in products.iter_mut().zip(TILES) {
                    add_tile(
                        [0, 1, 2].map(|k| &values[row.range(r + k, from, j)]),
                        [0, 1, 2].map(|k| &values[column.range(c + k, from, j)]),
                        totals,
                    );
                }
                for r in 0..DOF {
                    // Of a diagonal block only the lower triangle.
                    let columns = if i == j { r + 1 } else { DOF };
                    for c in 0..columns {
                        let (tile, entry) = position(r, c);
                        let at = row.range(r, j, j + 1).start;
                        let diagonal = column.range(c, j, j + 1).start;
                        let mut value = values[at + c] - products[tile][entry];
                        for m in 0..c {
                            value -= values[at + m] * values[diagonal + m];
                        }
                        if i == j && c == r {
                            // NaN fails this too.
                            let is_positive = value > 0.0;
                            if !is_positive {
                                return false;
                            }
                            values[at + c] = libm::sqrt(value);
                        } else {
                            values[at + c] = value / values[diagonal + c];
                        }
                    }
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Cholesky, DVector};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    /// A matrix with some occupied blocks and a diagonal that dominates them.
    fn system(seed: u64, blocks: usize) -> Envelope {
        let random = &mut Pcg64::seed_from_u64(seed);
        let first: Vec<usize> = (0..blocks).map(|i| random.random_range(0..=i)).collect();
        let mut system = Envelope::default();
        system.shape(&first);
        for (i, &first) in first.iter().enumerate() {
            for j in first..i {
                if random.random_bool(0.7) {
                    let block = Matrix6::from_fn(|_, _| random.random_range(-1.0..1.0));
                    // Either triangle is a way to name it.
                    if random.random_bool(0.5) {
                        system.add(i, j, &block);
                    } else {
                        system.add(j, i, &block);
                    }
                }
            }
        }
        for k in 0..blocks * DOF {
            *system.diagonal_mut(k) += 1.0 + (6 * blocks) as f64;
        }
        system
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Both are backward stable, and the condition of these systems is below 10.
        #[test]
        fn factor_and_solution_are_those_of_the_dense_matrix(seed in any::<u64>(), blocks in 0usize..9) {
            let mut system = system(seed, blocks);
            let dense = Cholesky::new(system.to_dense()).unwrap();
            let size = blocks * DOF;
            let b = DVector::from_fn(size, |k, _| (k as f64 * 0.7).sin());
            let mut x = b.clone();
            prop_assert!(system.factor());
            system.solve(x.as_mut_slice());
            let lower = system.to_dense().lower_triangle();
            let difference = |a: f64, b: f64| (a - b).abs() <= 1e-13 * (1.0 + b.abs());
            prop_assert!(lower.iter().zip(dense.l().iter()).all(|(a, b)| difference(*a, *b)));
            prop_assert!(x.iter().zip(dense.solve(&b).iter()).all(|(a, b)| difference(*a, *b)));
        }

        #[test]
        fn what_is_not_positive_definite_has_no_factor(
            seed in any::<u64>(),
            blocks in 1usize..6,
            at in any::<prop::sample::Index>(),
            pivot in prop_oneof![Just(0.0), Just(-1.0), Just(f64::NAN), Just(f64::NEG_INFINITY)],
        ) {
            let mut system = system(seed, blocks);
            *system.diagonal_mut(at.index(blocks * DOF)) = pivot;
            prop_assert!(!system.factor());
        }
    }
}
