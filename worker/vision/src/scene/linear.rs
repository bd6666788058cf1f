//! Small dense linear algebra: null spaces of minimal systems, rank-2 projection.
//!
//! Unitless. Eigenvalue iterations are bounded and fail as [`FitError::NoConvergence`]; a system
//! of lower rank than asked for gives `None`.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::FitError;

/// A pivot this much below the first one means that the rows are dependent. Rows are built from
/// normalised coordinates (of order 1), where rounding alone leaves pivots near 1e-16.
const RELATIVE_PIVOT: f64 = 1e-11;

/// A 3 × 3 QR iteration converges in a handful of sweeps; this only bounds the loop.
const MAX_EIGEN_ITERATIONS: usize = 100;

/// Basis of the null space of `M` independent rows of 9, by elimination with complete pivoting;
/// `K` must be `9 - M`. `None` where the rows are dependent.
pub(super) fn null_space<const M: usize, const K: usize>(
    mut a: [[f64; 9]; M],
) -> Option<[[f64; 9]; K]> {
    const { assert!(M + K == 9) };
    let mut column_of: [usize; 9] = std::array::from_fn(|i| i);
    let mut first_pivot = 0.0;
    for k in 0..M {
        let (mut row, mut column, mut largest) = (k, k, -1.0);
        for (r, values) in a.iter().enumerate().skip(k) {
            for (c, value) in values.iter().enumerate().skip(k) {
                if value.abs() > largest {
                    (row, column, largest) = (r, c, value.abs());
                }
            }
        }
        if k == 0 {
            first_pivot = largest;
        }
        if largest.is_nan() || largest <= RELATIVE_PIVOT * first_pivot {
            return None;
        }
        a.swap(k, row);
        for values in &mut a {
            values.swap(k, column);
        }
        column_of.swap(k, column);
        let pivot_row = a[k];
        let inverse = 1.0 / pivot_row[k];
        for (r, values) in a.iter_mut().enumerate() {
            if r != k {
                let factor = values[k] * inverse;
                for c in k..9 {
                    values[c] -= factor * pivot_row[c];
                }
            }
        }
    }
    let mut basis = [[0.0; 9]; K];
    for (j, vector) in basis.iter_mut().enumerate() {
        vector[column_of[M + j]] = 1.0;
        for (k, values) in a.iter().enumerate() {
            vector[column_of[k]] = -values[M + j] / values[k];
        }
    }
    Some(basis)
}

/// Nine numbers as a row-major 3 × 3 matrix of Frobenius norm 1; `None` if all are 0.
pub(super) fn unit_matrix(values: &[f64; 9]) -> Option<Matrix3<f64>> {
    unit(Matrix3::from_row_slice(values))
}

/// `m` scaled to Frobenius norm 1; `None` if it is 0 or not finite.
pub(super) fn unit(m: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let norm = m.norm();
    (norm.is_finite() && norm > 0.0).then(|| m / norm)
}

/// The cofactor matrix: the gradient of the determinant.
pub(super) fn cofactors(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (
        m.row(0).transpose(),
        m.row(1).transpose(),
        m.row(2).transpose(),
    );
    Matrix3::from_rows(&[
        b.cross(&c).transpose(),
        c.cross(&a).transpose(),
        a.cross(&b).transpose(),
    ])
}

/// The matrix of the cross product: `cross_matrix(a) * b == a × b`.
pub(super) fn cross_matrix(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// The nearest (Frobenius) matrix of rank 2: without the smallest singular component,
/// `M (I - v vᵀ)` with `v` the smallest right singular vector.
///
/// # Errors
/// [`FitError::NoConvergence`] if the bounded eigenvalue iteration stops early.
pub(super) fn rank_two(m: &Matrix3<f64>) -> Result<Matrix3<f64>, FitError> {
    let eigen = SymmetricEigen::try_new(m.transpose() * m, f64::EPSILON, MAX_EIGEN_ITERATIONS)
        .ok_or(FitError::NoConvergence)?;
    let v = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    Ok(m - m * v * v.transpose())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn null_space_is_annihilated_and_independent(values in proptest::array::uniform32(-1.0..1.0f64), more in proptest::array::uniform31(-1.0..1.0f64)) {
            let all: Vec<f64> = values.into_iter().chain(more).collect();
            let rows: [[f64; 9]; 7] = std::array::from_fn(|r| std::array::from_fn(|c| all[r * 9 + c]));
            let Some(basis) = null_space::<7, 2>(rows) else { return Ok(()) };
            for vector in &basis {
                let norm = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
                for row in &rows {
                    let dot: f64 = row.iter().zip(vector).map(|(a, b)| a * b).sum();
                    // Complete pivoting is backward stable: the error follows the vector's size.
                    prop_assert!(dot.abs() <= 1e-12 * norm);
                }
            }
            // Each basis vector is 1 at its own free column and 0 at the other's.
            prop_assert!((0..9).any(|c| basis[0][c] == 1.0 && basis[1][c] == 0.0));
        }

        #[test]
        fn rank_two_matches_the_singular_value_definition(values in proptest::array::uniform9(-1.0..1.0f64)) {
            let m = Matrix3::from_row_slice(&values);
            let projected = rank_two(&m).unwrap();
            let svd = m.svd(true, true);
            let smallest = svd.singular_values.min();
            prop_assert!(projected.determinant().abs() < 1e-12);
            // Eckart-Young: the distance to the nearest rank-2 matrix is the smallest singular
            // value. The eigenproblem squares the condition, hence half the digits near ties.
            prop_assert!(((m - projected).norm() - smallest).abs() < 1e-7);
        }
    }

    #[test]
    fn dependent_rows_have_no_minimal_null_space() {
        assert!(null_space::<8, 1>([[1.0; 9]; 8]).is_none());
        assert!(null_space::<7, 2>([[0.0; 9]; 7]).is_none());
        assert!(null_space::<7, 2>([[f64::NAN; 9]; 7]).is_none());
    }
}
