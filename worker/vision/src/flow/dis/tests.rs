//! The search and the densification against slow, obvious twins, and the whole method on known motion
//! and on degenerate frames.

use super::densify::{DenseField, Densifier, Upsampler};
use super::frame::{Level, coarsest_scale};
use super::patch::{Comparison, Placement, Template, compare};
use super::search::Search;
use super::{Dis, DisFrame, DisParams, RefinementParams};
use crate::flow::simd::{Kernel, dispatch};
use crate::flow::{Flow, FlowError};
use crate::image::Plane;

/// A texture without repetition over the frame, moved by `(u, v)`.
fn texture(width: usize, height: usize, u: f32, v: f32) -> Plane {
    let waves = [
        (0.31, 0.12, 0.3),
        (-0.17, 0.29, 1.1),
        (0.07, -0.11, 2.0),
        (0.05, 0.43, 0.7),
    ];
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = (f64::from(x as f32 - u), f64::from(y as f32 - v));
        let sum: f64 = waves
            .iter()
            .map(|(a, b, c)| libm::sin(a * x + b * y + c))
            .sum();
        (128.0 + 30.0 * sum) as f32
    })
}

fn solve(first: &Plane, second: &Plane, params: &DisParams) -> Flow {
    let frame = |plane| DisFrame::new(plane, params).unwrap();
    Dis::new(params.clone())
        .flow(&frame(first), &frame(second))
        .unwrap()
}

fn all_params() -> Vec<DisParams> {
    let plain = DisParams {
        mean_normalisation: false,
        spatial_propagation: false,
        ..DisParams::ultrafast(0)
    };
    let sized = |patch_size, patch_stride| DisParams {
        patch_size,
        patch_stride,
        ..DisParams::ultrafast(0)
    };
    vec![
        DisParams::ultrafast(0),
        DisParams::medium(),
        plain,
        sized(4, 2),
        sized(12, 5),
        sized(16, 16),
    ]
}

// ---- twins ----

/// Pixel of a level with the edge repeated.
fn pixel(level: &Level, x: i64, y: i64) -> f64 {
    let column = x.clamp(0, level.width as i64 - 1) as usize;
    let row = y.clamp(0, level.height as i64 - 1) as usize;
    f64::from(level.pixels_at(column, row)[0])
}

fn interpolate(level: &Level, x: f64, y: f64) -> f64 {
    let (left, top) = (x.floor(), y.floor());
    let (a, b) = (x - left, y - top);
    let at = |dx: i64, dy: i64| pixel(level, left as i64 + dx, top as i64 + dy);
    (1.0 - b) * ((1.0 - a) * at(0, 0) + a * at(1, 0)) + b * ((1.0 - a) * at(0, 1) + a * at(1, 1))
}

/// Differences of the patch at `(x, y)` moved by `vector`, no further than one pixel's touch.
fn twin_differences(
    first: &Level,
    second: &Level,
    x: usize,
    y: usize,
    vector: [f64; 2],
    size: usize,
) -> Vec<f64> {
    let reach = 1.0 - size as f64;
    let to_x = (x as f64 + vector[0]).clamp(reach, second.width as f64 - 1.0);
    let to_y = (y as f64 + vector[1]).clamp(reach, second.height as f64 - 1.0);
    let mut differences = Vec::new();
    for row in 0..size {
        for column in 0..size {
            differences.push(
                interpolate(second, to_x + column as f64, to_y + row as f64)
                    - pixel(first, (x + column) as i64, (y + row) as i64),
            );
        }
    }
    differences
}

fn twin_gradient(level: &Level, x: usize, y: usize) -> [f64; 2] {
    let at = |dx: i64, dy: i64| pixel(level, x as i64 + dx, y as i64 + dy);
    let smooth = [(-1, 1.0), (0, 2.0), (1, 1.0)];
    [
        smooth
            .iter()
            .map(|&(k, w)| w * (at(1, k) - at(-1, k)))
            .sum::<f64>()
            / 8.0,
        smooth
            .iter()
            .map(|&(k, w)| w * (at(k, 1) - at(k, -1)))
            .sum::<f64>()
            / 8.0,
    ]
}

/// (squared distance, step direction H⁻¹ Σ g d) of one patch, in f64 from first principles.
fn twin_compare(
    first: &Level,
    second: &Level,
    x: usize,
    y: usize,
    vector: [f64; 2],
    params: &DisParams,
) -> (f64, [f64; 2]) {
    let size = params.patch_size;
    let mut differences = twin_differences(first, second, x, y, vector, size);
    if params.mean_normalisation {
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        differences.iter_mut().for_each(|d| *d -= mean);
    }
    let (mut xx, mut xy, mut yy, mut bx, mut by) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for row in 0..size {
        for column in 0..size {
            let [gx, gy] = twin_gradient(first, x + column, y + row);
            let d = differences[row * size + column];
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
            bx += gx * d;
            by += gy * d;
        }
    }
    let determinant = (xx * yy - xy * xy).max(0.001 / 4096.0);
    let step = [
        (yy * bx - xy * by) / determinant,
        (xx * by - xy * bx) / determinant,
    ];
    (differences.iter().map(|d| d * d).sum(), step)
}

/// The two sweeps as the paper and OpenCV describe them, on a grid of vectors.
fn twin_search(
    first: &Level,
    second: &Level,
    start: &[[f32; 2]],
    params: &DisParams,
) -> Vec<[f64; 2]> {
    let (columns, rows) = (first.patch_columns.len(), first.patch_rows.len());
    let mut field: Vec<[f64; 2]> = start.iter().map(|v| v.map(f64::from)).collect();
    let sweeps: &[i64] = if params.spatial_propagation {
        &[1, -1]
    } else {
        &[1]
    };
    let stripe = |row: i64| row / (rows.div_ceil(params.propagation_stripes) as i64);
    for &direction in sweeps {
        let order: Vec<usize> = if direction > 0 {
            (0..rows * columns).collect()
        } else {
            (0..rows * columns).rev().collect()
        };
        for index in order {
            let (row, column) = ((index / columns) as i64, (index % columns) as i64);
            let (x, y) = (
                first.patch_columns[column as usize],
                first.patch_rows[row as usize],
            );
            let compare = |v: [f64; 2]| twin_compare(first, second, x, y, v, params);
            let mut best = field[index];
            if params.spatial_propagation {
                for (r, c) in [(row, column - direction), (row - direction, column)] {
                    let exists = r >= 0
                        && r < rows as i64
                        && c >= 0
                        && c < columns as i64
                        && stripe(r) == stripe(row);
                    if exists {
                        let candidate = field[(r * columns as i64 + c) as usize];
                        if compare(candidate).0 < compare(best).0 {
                            best = candidate;
                        }
                    }
                }
            }
            let mut vector = best;
            let mut previous = f64::INFINITY;
            for _ in 0..params.gradient_descent_iterations / sweeps.len() {
                let (distance, step) = compare(vector);
                vector[0] -= f64::from(params.step_length) * step[0];
                vector[1] -= f64::from(params.step_length) * step[1];
                if distance >= previous {
                    break;
                }
                previous = distance;
            }
            let moved = (vector[0] - best[0]).hypot(vector[1] - best[1]);
            field[index] = if moved <= params.patch_size as f64 {
                vector
            } else {
                best
            };
        }
    }
    field
}

/// Per pixel, the weighted mean of the patches that cover it.
fn twin_densify(vectors: &[[f32; 2]], first: &Level, second: &Level, size: usize) -> Vec<[f64; 2]> {
    let columns = first.patch_columns.len();
    let mut dense = Vec::new();
    for y in 0..first.height {
        for x in 0..first.width {
            let (mut sum, mut total) = ([0.0; 2], 0.0);
            for (r, &top) in first.patch_rows.iter().enumerate() {
                for (c, &left) in first.patch_columns.iter().enumerate() {
                    if (top..top + size).contains(&y) && (left..left + size).contains(&x) {
                        let vector = vectors[r * columns + c].map(f64::from);
                        let differences = twin_differences(first, second, left, top, vector, size);
                        let difference = differences[(y - top) * size + x - left];
                        let weight = 1.0 / difference.abs().max(1.0);
                        sum[0] += weight * vector[0];
                        sum[1] += weight * vector[1];
                        total += weight;
                    }
                }
            }
            dense.push([sum[0] / total, sum[1] / total]);
        }
    }
    dense
}

#[test]
fn search_and_densification_match_their_twins() {
    for params in all_params() {
        let (first, second) = (texture(43, 37, 0.0, 0.0), texture(43, 37, 0.8, -0.6));
        let params = DisParams {
            finest_scale: 0,
            ..params
        };
        let a = DisFrame::new(&first, &params).unwrap();
        let b = DisFrame::new(&second, &params).unwrap();
        let (a, b) = (a.levels().last().unwrap(), b.levels().last().unwrap());
        let mut search = Search::default();
        let mut field = DenseField::default();
        search.start_from(&field, a, &params);
        let start = search.vectors().to_vec();
        search.run(a, b, &params);
        let twin = twin_search(a, b, &start, &params);
        for (fast, slow) in search.vectors().iter().zip(&twin) {
            for axis in 0..2 {
                // f32 against f64: distances near a stop may fall on either side of it, which
                // costs one step of an eighth of a converged (hence tiny) Gauss-Newton step.
                let error = (f64::from(fast[axis]) - slow[axis]).abs();
                assert!(error < 2e-3, "{params:?}: {fast:?} vs {slow:?}");
            }
        }
        Densifier::default().densify(search.vectors(), a, b, &params, &mut field);
        let dense = twin_densify(search.vectors(), a, b, params.patch_size);
        for ((&u, &v), slow) in field.u.iter().zip(&field.v).zip(&dense) {
            // Weighted means of vectors around 1 px, weights good to f32's 1e-6 or so.
            assert!((f64::from(u) - slow[0]).abs() < 1e-4);
            assert!((f64::from(v) - slow[1]).abs() < 1e-4);
        }
    }
}

/// One patch comparison in plain f32 scalars, in the order that `patch` states: columns down the
/// rows, then halves of the columns added pairwise.
fn scalar_compare(
    first: &Level,
    second: &Level,
    (x, y): (usize, usize),
    at: [f32; 2],
) -> Comparison {
    const P: usize = 8;
    let border = second.border as f32;
    let (column, row) = (x as f32 + at[0] + border, y as f32 + at[1] + border);
    let (left, top) = (column as usize, row as usize);
    let (a, b) = (column - left as f32, row - top as f32);
    let value = |c: usize, r: usize| second.padded[r * second.stride + c];
    let along = |c: usize, r: usize| value(c, r) + a * (value(c + 1, r) - value(c, r));
    let mut sums = [[0.0f32; P]; 4];
    for r in 0..P {
        for c in 0..P {
            let (upper, lower) = (along(left + c, top + r), along(left + c, top + r + 1));
            let reference = first.pixels_at(x + c, y + r)[0];
            let d = upper + b * (lower - upper) - reference;
            let pixel = (y + r) * first.width + x + c;
            let terms = [
                d,
                d * d,
                d * first.gradient_x[pixel],
                d * first.gradient_y[pixel],
            ];
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[c] += term;
            }
        }
    }
    let [sum, square, gx, gy] =
        sums.map(|s| ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])));
    let index = first.patch_columns.len() * (y / 4) + x / 4;
    let tensor = &first.tensors[index];
    Comparison {
        distance: square - sum * sum / 64.0,
        square,
        descent: [gx - sum * tensor.mean_x, gy - sum * tensor.mean_y],
    }
}

#[test]
fn patch_comparison_equals_plain_scalars_bit_for_bit() {
    struct Compare<'a>(&'a Level, &'a Level, (usize, usize), [f32; 2]);
    impl Kernel for Compare<'_> {
        type Output = Comparison;

        #[inline(always)]
        fn run(self) -> Comparison {
            let Self(first, second, (x, y), at) = self;
            compare::<8>(
                &Template::new(first, x, y),
                second,
                Placement::new(second, x, y, at, 8),
                &first.tensors[first.patch_columns.len() * (y / 4) + x / 4],
                true,
            )
        }
    }
    let params = DisParams::ultrafast(0);
    let level = |u, v| {
        let frame = DisFrame::new(&texture(44, 40, u, v), &params).unwrap();
        frame.levels().last().unwrap().clone()
    };
    let (a, b) = (level(0.0, 0.0), level(1.3, -0.7));
    for y in (0..32).step_by(4) {
        for x in (0..36).step_by(4) {
            let at = [0.37 * (x % 7) as f32 - 1.0, 0.83 - 0.21 * (y % 5) as f32];
            let expected = scalar_compare(&a, &b, (x, y), at);
            assert_eq!(dispatch(Compare(&a, &b, (x, y), at)), expected);
            assert_eq!(Compare(&a, &b, (x, y), at).run(), expected);
        }
    }
}

#[test]
fn lookup_at_patch_centres_equals_the_upsampled_field() {
    let field = DenseField {
        width: 5,
        height: 4,
        u: (0..20).map(|i| (i * 7 % 11) as f32).collect(),
        v: (0..20).map(|i| (i * 5 % 13) as f32).collect(),
    };
    let mut big = Flow::default();
    Upsampler::default().upsample(&field, 11, 9, &mut big);
    for y in 0..9 {
        for x in 0..11 {
            let one = field.sample_scaled(x, y, 11, 9);
            let all = big.data[y * 11 + x];
            // The same three products, scaled before or after: a few units in the last place.
            assert!((one[0] - all[0]).abs() < 1e-4 && (one[1] - all[1]).abs() < 1e-4);
        }
    }
}

// ---- the whole method ----

#[test]
fn sub_pixel_and_large_translations_are_recovered() {
    // Steps are an eighth of Gauss-Newton's, so that 12 iterations per scale leave some of the way:
    // hence a tolerance per preset rather than a small fixed one.
    let cases = [(0.3, -0.7), (2.25, 1.5), (-6.0, 4.0), (8.5, 3.0)];
    for (params, tolerance_px) in [(DisParams::ultrafast(0), 0.1), (DisParams::default(), 0.25)] {
        for (u, v) in cases {
            let (width, height) = (128, 96);
            let flow = solve(
                &texture(width, height, 0.0, 0.0),
                &texture(width, height, u, v),
                &params,
            );
            let mut errors = Vec::new();
            // Away from the border, where the texture that moved in is not in the first frame.
            for y in 24..height - 24 {
                for x in 24..width - 24 {
                    let [fu, fv] = flow.data[y * width + x];
                    errors.push(f64::from(fu - u).hypot(f64::from(fv - v)));
                }
            }
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!(
                mean < tolerance_px,
                "({u}, {v}): {mean} px off with {params:?}"
            );
        }
    }
}

#[test]
fn textureless_and_saturated_frames_give_exactly_zero() {
    for (a, b) in [(0.0, 0.0), (255.0, 255.0), (0.0, 255.0), (128.0, 127.0)] {
        for params in all_params() {
            let plane = |value| Plane::from_fn(64, 48, |_, _| value);
            let flow = solve(&plane(a), &plane(b), &params);
            assert!(flow.data.iter().all(|v| *v == [0.0, 0.0]), "{a} {b}");
        }
    }
}

#[test]
fn one_dimensional_and_noisy_structure_stay_finite() {
    let stripes = |shift: usize| {
        Plane::from_fn(70, 50, |x, _| {
            if ((x + shift) / 3).is_multiple_of(2) {
                0.0
            } else {
                255.0
            }
        })
    };
    let noise = |seed: usize| {
        Plane::from_fn(70, 50, |x, y| {
            ((x * 7919 + y * 104_729 + seed * 31_337) % 256) as f32
        })
    };
    for (a, b) in [
        (stripes(0), stripes(1)),
        (noise(1), noise(2)),
        (stripes(0), noise(3)),
    ] {
        for params in all_params() {
            let flow = solve(&a, &b, &params);
            assert!(flow.data.iter().flatten().all(|c| c.is_finite()));
        }
    }
}

#[test]
fn every_size_from_one_patch_up_works() {
    for (width, height) in [(8, 8), (16, 16), (17, 9), (9, 31), (100, 8), (257, 131)] {
        let params = DisParams::default();
        let flow = solve(
            &texture(width, height, 0.0, 0.0),
            &texture(width, height, 0.5, 0.25),
            &params,
        );
        assert_eq!(
            (flow.width, flow.height, flow.data.len()),
            (width, height, width * height)
        );
        assert!(flow.data.iter().flatten().all(|c| c.is_finite()));
    }
}

#[test]
fn a_cinema_frame_works() {
    let params = DisParams::ultrafast(3);
    let cheap = |shift: usize| {
        Plane::from_fn(4096, 2160, |x, y| {
            (((x + shift) / 9 * 31 + y / 7 * 57) % 256) as f32
        })
    };
    let flow = solve(&cheap(0), &cheap(2), &params);
    assert_eq!(flow.data.len(), 4096 * 2160);
    assert!(flow.data.iter().flatten().all(|c| c.is_finite()));
}

#[test]
fn repeated_runs_and_reused_buffers_give_the_same_bits() {
    let params = DisParams::default();
    let frames: Vec<DisFrame> = [(0.0, 0.0), (1.5, 0.5), (-3.0, 2.0)]
        .iter()
        .map(|&(u, v)| DisFrame::new(&texture(90, 70, u, v), &params).unwrap())
        .collect();
    let fresh = Dis::new(params.clone())
        .flow(&frames[0], &frames[1])
        .unwrap();
    let mut dis = Dis::new(params);
    dis.flow(&frames[2], &frames[0]).unwrap();
    assert_eq!(dis.flow(&frames[0], &frames[1]).unwrap(), fresh);
}

/// FNV-1a over the bit patterns of a flow.
fn fingerprint(flow: &Flow) -> u64 {
    let bytes = flow.data.iter().flatten().flat_map(|c| c.to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The bits of the first version, found on x86-64 without AVX: neither a faster kernel nor another
/// instruction set may change them.
#[test]
fn bits_never_change() {
    let plain = DisParams {
        mean_normalisation: false,
        spatial_propagation: false,
        patch_size: 12,
        ..DisParams::ultrafast(0)
    };
    let whole_frame = DisParams {
        propagation_stripes: 1,
        ..DisParams::ultrafast(1)
    };
    let cases = [
        (whole_frame, 0xbfa4_2a07_3e55_18f2),
        (DisParams::ultrafast(0), 0x8bc4_ed7b_f31b_63d1),
        (DisParams::ultrafast(1), 0x4761_5f1b_9066_3b75),
        (DisParams::ultrafast(2), 0x59f8_f2bd_d080_eedd),
        (plain, 0x4270_1880_8959_b771),
    ];
    for (params, expected) in cases {
        let flow = solve(
            &texture(157, 118, 0.0, 0.0),
            &texture(157, 118, 2.3, -1.6),
            &params,
        );
        assert_eq!(fingerprint(&flow), expected, "{params:?}");
    }
}

#[test]
fn bad_input_is_a_typed_error() {
    let params = DisParams::default();
    let frame = |w, h| DisFrame::new(&texture(w, h, 0.0, 0.0), &params);
    assert!(matches!(
        frame(7, 64),
        Err(FlowError::TooSmall { patch_size: 8, .. })
    ));
    assert!(matches!(
        DisFrame::new(
            &Plane {
                width: 9,
                height: 9,
                data: vec![0.0; 3]
            },
            &params
        ),
        Err(FlowError::Image(_))
    ));
    for bad in [f32::NAN, f32::INFINITY, -1e20] {
        let mut plane = texture(32, 32, 0.0, 0.0);
        plane.data[77] = bad;
        assert!(matches!(
            DisFrame::new(&plane, &params),
            Err(FlowError::PixelOutOfRange { index: 77, .. })
        ));
    }
    let mut dis = Dis::new(params.clone());
    let (small, wide) = (frame(32, 32).unwrap(), frame(40, 32).unwrap());
    assert!(matches!(
        dis.flow(&small, &wide),
        Err(FlowError::SizeMismatch { .. })
    ));
    let other = DisFrame::new(&texture(32, 32, 0.0, 0.0), &DisParams::medium()).unwrap();
    assert!(matches!(
        dis.flow(&small, &other),
        Err(FlowError::ParamsMismatch)
    ));
    let invalid = [
        DisParams {
            patch_size: 7,
            ..params.clone()
        },
        DisParams {
            patch_stride: 0,
            ..params.clone()
        },
        DisParams {
            patch_stride: 9,
            ..params.clone()
        },
        DisParams {
            step_length: f32::NAN,
            ..params.clone()
        },
        DisParams {
            finest_scale: 99,
            ..params.clone()
        },
        DisParams {
            propagation_stripes: 0,
            ..params.clone()
        },
        DisParams {
            refinement: RefinementParams {
                relaxation: 2.0,
                ..RefinementParams::default()
            },
            ..params.clone()
        },
        DisParams {
            refinement: RefinementParams {
                epsilon: f32::NAN,
                ..RefinementParams::default()
            },
            ..params.clone()
        },
    ];
    for params in invalid {
        assert!(matches!(
            DisFrame::new(&texture(32, 32, 0.0, 0.0), &params),
            Err(FlowError::InvalidParameter { .. })
        ));
    }
}

#[test]
fn coarsest_scale_follows_frame_and_patch() {
    // 256 px: the longer side is 8 quarter-patch widths, so 2^3; a 16-px side holds an 8-px patch
    // at scale 1 at most.
    assert_eq!(coarsest_scale(256, 256, 8), Some(3));
    assert_eq!(coarsest_scale(512, 384, 8), Some(4));
    assert_eq!(coarsest_scale(256, 16, 8), Some(1));
    assert_eq!(coarsest_scale(16, 16, 8), Some(0));
    assert_eq!(coarsest_scale(7, 64, 8), None);
}

#[test]
fn nothing_moves_between_a_frame_and_itself_to_the_bit() {
    // Texture, a flat wall, and noise.
    let pictures = [
        texture(96, 64, 0.0, 0.0),
        Plane::from_fn(96, 64, |_, _| 17.3),
        Plane::from_fn(96, 64, |x, y| ((x * 7919 + y * 104_729) % 251) as f32),
    ];
    for params in all_params()
        .into_iter()
        .filter(|p| p.refinement_iterations == 0)
    {
        for picture in &pictures {
            assert_eq!(solve(picture, picture, &params), Flow::still(96, 64));
        }
    }
}
