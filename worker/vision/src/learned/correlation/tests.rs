//! The look-up against a volume of all pairs, pooled and read tap by tap.

use proptest::prelude::*;

use super::*;

/// Level 0: all pairs' scalar products; each next level: means of 2 × 2 of the second map's cells. Then
/// every tap bilinearly, each of its four corners with 0 outside.
fn from_volume(
    first: &[f32],
    second: &[f32],
    (channels, rows, columns): (usize, usize, usize),
    at: &[f32],
    window: Window,
) -> Vec<f32> {
    let cells = rows * columns;
    let product = |a: usize, b: usize| {
        let sum: f64 = (0..channels)
            .map(|k| f64::from(first[k * cells + a]) * f64::from(second[k * cells + b]))
            .sum();
        sum * f64::from(window.scale)
    };
    let mut volume: Vec<Vec<f64>> = (0..cells)
        .map(|a| (0..cells).map(|b| product(a, b)).collect())
        .collect();
    let (mut high, mut wide) = (rows, columns);
    let side = 2 * window.radius + 1;
    let mut out = vec![0.0; window.channels() * cells];
    for level in 0..LEVELS {
        let read = |plane: &[f64], row: f64, column: f64| {
            let inside = row >= 0.0 && column >= 0.0 && row < high as f64 && column < wide as f64;
            if inside {
                plane[row as usize * wide + column as usize]
            } else {
                0.0
            }
        };
        for cell in 0..cells {
            let shrink = f64::from(1u32 << level);
            let (x, y) = (
                f64::from(at[cell]) / shrink,
                f64::from(at[cells + cell]) / shrink,
            );
            for i in 0..side {
                for j in 0..side {
                    let x = x + i as f64 - window.radius as f64;
                    let y = y + j as f64 - window.radius as f64;
                    let (fx, fy) = (x - x.floor(), y - y.floor());
                    let mut value = 0.0;
                    for (dy, wy) in [(0.0, 1.0 - fy), (1.0, fy)] {
                        for (dx, wx) in [(0.0, 1.0 - fx), (1.0, fx)] {
                            value += wx * wy * read(&volume[cell], y.floor() + dy, x.floor() + dx);
                        }
                    }
                    let channel = level * side * side + i * side + j;
                    out[channel * cells + cell] = value as f32;
                }
            }
        }
        for plane in &mut volume {
            let mean = |row: usize, column: usize| {
                let corner = 2 * row * wide + 2 * column;
                (plane[corner]
                    + plane[corner + 1]
                    + plane[corner + wide]
                    + plane[corner + wide + 1])
                    / 4.0
            };
            *plane = (0..high / 2)
                .flat_map(|row| (0..wide / 2).map(move |column| (row, column)))
                .map(|(row, column)| mean(row, column))
                .collect();
        }
        (high, wide) = (high / 2, wide / 2);
    }
    out
}

fn looked_up(
    first: &[f32],
    second: &[f32],
    shape: (usize, usize, usize),
    at: &[f32],
    window: Window,
) -> Vec<f32> {
    let first = FeatureMap::from_planar(first, shape).unwrap();
    let second = FeaturePyramid::new(FeatureMap::from_planar(second, shape).unwrap());
    let mut out = vec![f32::NAN; window.channels() * shape.1 * shape.2];
    look_up(&first, &second, at, window, &mut out).unwrap();
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn equals_the_pooled_volume(
        channels in 1usize..40,
        rows in 1usize..12,
        columns in 1usize..12,
        radius in 1usize..=4,
        seed in any::<u64>(),
    ) {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 40) as f32 / (1u32 << 24) as f32) * 2.0 - 1.0
        };
        let cells = rows * columns;
        let first: Vec<f32> = (0..channels * cells).map(|_| next()).collect();
        let second: Vec<f32> = (0..channels * cells).map(|_| next()).collect();
        // Inside, at whole positions, around the border and far outside.
        let at: Vec<f32> = (0..2 * cells)
            .map(|n| match n % 5 {
                0 => (next() * 20.0).round(),
                1 => next() * 1e9,
                _ => next() * 14.0,
            })
            .collect();
        let window = Window { radius, scale: 0.25 };
        let shape = (channels, rows, columns);
        let found = looked_up(&first, &second, shape, &at, window);
        let expected = from_volume(&first, &second, shape, &at, window);
        for (found, expected) in found.iter().zip(&expected) {
            // Sums of at most 40 products below 1 in f32, and positions of up to 20 cells.
            prop_assert!((found - expected).abs() < 4e-5, "{found} {expected}");
        }
    }
}

#[test]
fn positions_that_are_no_numbers_read_nothing() {
    let ones = [1.0; 16];
    let mut at = [1.0; 32];
    at[0] = f32::NAN;
    at[17] = f32::INFINITY;
    let window = Window {
        radius: 3,
        scale: 1.0,
    };
    let out = looked_up(&ones, &ones, (1, 4, 4), &at, window);
    assert!(out.iter().all(|v| v.is_finite()));
    for cell in [0, 1] {
        assert!(out.iter().skip(cell).step_by(16).all(|&v| v == 0.0));
    }
    assert!(out.iter().skip(2).step_by(16).any(|&v| v == 1.0));
}

#[test]
fn sizes_that_do_not_fit_are_named() {
    let map = FeatureMap::from_planar(&[0.0; 12], (3, 2, 2)).unwrap();
    let other = FeaturePyramid::new(FeatureMap::from_planar(&[0.0; 8], (2, 2, 2)).unwrap());
    let own = FeaturePyramid::new(map.clone());
    let mut out = [0.0; 196 * 4];
    let (radius, scale) = (3, 1.0);
    let window = Window { radius, scale };
    assert!(look_up(&map, &other, &[0.0; 8], window, &mut out).is_err());
    assert!(look_up(&map, &own, &[0.0; 7], window, &mut out).is_err());
    assert!(look_up(&map, &own, &[0.0; 8], window, &mut out[1..]).is_err());
    let window = Window { radius: 5, scale };
    let mut out = vec![0.0; window.channels() * 4];
    let error = look_up(&map, &own, &[0.0; 8], window, &mut out).unwrap_err();
    assert!(error.to_string().contains("radius"));
    assert!(FeatureMap::from_planar(&[0.0; 11], (3, 2, 2)).is_err());
}
