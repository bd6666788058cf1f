//! The seven-point algorithm: fundamental matrices through a minimal sample.
//!
//! Hartley and Zisserman, *Multiple View Geometry*, 2nd ed., §11.1.2: two matrices span the null
//! space of seven epipolar equations; `det(B + t A) = 0` is a cubic in `t` with one or three real
//! roots. Normalised coordinates; dependent samples give no matrix.

use nalgebra::Matrix3;

use super::linear::{cofactors, null_space, unit, unit_matrix};

/// Newton steps that polish a closed-form root; it converges quadratically from many digits.
const POLISH_STEPS: usize = 2;

/// A leading coefficient this small beside the others leaves a polynomial of lower degree.
const RELATIVE_LEADING: f64 = 1e-12;

/// Appends the one or three fundamental matrices (Frobenius norm 1, determinant 0 to rounding)
/// with `targetᵀ F source = 0` for all seven `[x, y, u, v]`.
pub(super) fn seven_point(sample: &[[f64; 4]; 7], models: &mut Vec<Matrix3<f64>>) {
    let equations = sample.map(|[x, y, u, v]| [u * x, u * y, u, v * x, v * y, v, x, y, 1.0]);
    let Some([first, second]) = null_space::<7, 2>(equations) else {
        return;
    };
    let (Some(first), Some(b)) = (unit_matrix(&first), unit_matrix(&second)) else {
        return;
    };
    let a = first - b;
    let cubic = [
        a.determinant(),
        cofactors(&a).dot(&b),
        cofactors(&b).dot(&a),
        b.determinant(),
    ];
    models.extend(
        real_roots(cubic)
            .into_iter()
            .flatten()
            .filter_map(|t| unit(b + a * t)),
    );
}

/// Real roots of `c[0] t³ + c[1] t² + c[2] t + c[3]`; none for a constant.
fn real_roots(c: [f64; 4]) -> [Option<f64>; 3] {
    let size = c.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let roots = if c[0].abs() > RELATIVE_LEADING * size {
        cubic_roots(c[1] / c[0], c[2] / c[0], c[3] / c[0])
    } else if c[1].abs() > RELATIVE_LEADING * size {
        quadratic_roots(c[1], c[2], c[3])
    } else if c[2].abs() > RELATIVE_LEADING * size {
        [Some(-c[3] / c[2]), None, None]
    } else {
        [None; 3]
    };
    roots.map(|root| root.map(|t| polish(c, t)).filter(|t| t.is_finite()))
}

fn polish(c: [f64; 4], mut t: f64) -> f64 {
    for _ in 0..POLISH_STEPS {
        let value = ((c[0] * t + c[1]) * t + c[2]) * t + c[3];
        let slope = (3.0 * c[0] * t + 2.0 * c[1]) * t + c[2];
        let next = t - value / slope;
        // A double root has no slope: the closed form stands.
        if !next.is_finite() {
            break;
        }
        t = next;
    }
    t
}

/// Monic cubic `t³ + a t² + b t + c`: trigonometric form for three real roots, Cardano for one.
fn cubic_roots(a: f64, b: f64, c: f64) -> [Option<f64>; 3] {
    let shift = a / 3.0;
    let q = (a * a - 3.0 * b) / 9.0;
    let r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0;
    let discriminant = q * q * q - r * r;
    if discriminant > 0.0 {
        let theta = libm::acos((r / (q * q.sqrt())).clamp(-1.0, 1.0));
        let turn = std::f64::consts::TAU;
        return [theta, theta + turn, theta - turn]
            .map(|angle| Some(-2.0 * q.sqrt() * libm::cos(angle / 3.0) - shift));
    }
    let s = -r.signum() * libm::cbrt(r.abs() + (-discriminant).sqrt());
    let t = if s == 0.0 { 0.0 } else { q / s };
    [Some(s + t - shift), None, None]
}

fn quadratic_roots(a: f64, b: f64, c: f64) -> [Option<f64>; 3] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return [None; 3];
    }
    // The sum of like signs: no cancellation.
    let half = -0.5 * (b + b.signum() * discriminant.sqrt());
    if half == 0.0 {
        return [Some(0.0), None, None];
    }
    [Some(half / a), Some(c / half), None]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn roots_of_built_cubics_are_found(mut r in proptest::array::uniform3(-3.0..3.0f64), lead in 0.1..5.0f64) {
            r.sort_by(f64::total_cmp);
            // Closer roots are ill-conditioned: rounding of the coefficients alone moves them.
            prop_assume!(r[1] - r[0] > 0.05 && r[2] - r[1] > 0.05);
            let c = [lead, -lead * (r[0] + r[1] + r[2]), lead * (r[0] * r[1] + r[0] * r[2] + r[1] * r[2]), -lead * r[0] * r[1] * r[2]];
            let mut found: Vec<f64> = real_roots(c).into_iter().flatten().collect();
            found.sort_by(f64::total_cmp);
            prop_assert_eq!(found.len(), 3);
            for (f, e) in found.iter().zip(&r) {
                prop_assert!((f - e).abs() < 1e-9, "{} {}", f, e);
            }
        }

        #[test]
        fn one_real_root_is_found(root in -3.0..3.0f64, re in -2.0..2.0f64, im in 0.1..2.0f64) {
            let (p, q) = (-2.0 * re, re * re + im * im);
            let found: Vec<f64> = real_roots([1.0, p - root, q - p * root, -q * root]).into_iter().flatten().collect();
            prop_assert_eq!(found.len(), 1);
            prop_assert!((found[0] - root).abs() < 1e-8);
        }

        #[test]
        fn all_seven_points_satisfy_every_singular_matrix(values in proptest::array::uniform28(-1.4..1.4f64)) {
            let sample: [[f64; 4]; 7] = std::array::from_fn(|i| std::array::from_fn(|j| values[i * 4 + j]));
            let mut models = Vec::new();
            seven_point(&sample, &mut models);
            for f in &models {
                // A double root keeps half the digits of the determinant's root.
                prop_assert!(f.determinant().abs() < 1e-7);
                for [x, y, u, v] in sample {
                    let error = nalgebra::Vector3::new(u, v, 1.0).dot(&(f * nalgebra::Vector3::new(x, y, 1.0)));
                    prop_assert!(error.abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn lower_degrees_and_degenerate_samples() {
        assert_eq!(real_roots([0.0, 0.0, 2.0, -4.0]), [Some(2.0), None, None]);
        assert_eq!(real_roots([0.0, 1.0, 0.0, 1.0]), [None; 3]);
        assert_eq!(real_roots([0.0; 4]), [None; 3]);
        assert!(real_roots([0.0, 1.0, 0.0, 0.0])[0].is_some());
        let mut models = Vec::new();
        seven_point(&[[0.3, 0.1, 0.3, 0.1]; 7], &mut models);
        seven_point(&[[f64::NAN; 4]; 7], &mut models);
        assert!(models.is_empty());
    }
}
