//! Signals on evidence whose answer is known.

use super::*;
use crate::consistency::{GridFlow, NormalisedFrame, worldscore_epe};
use crate::flow::Flow;
use crate::image::Plane;

const SIDE: usize = 256;

/// Working-resolution flow `field(x, y)`, its exact inverse where the field is a translation.
fn flow(field: impl Fn(usize, usize) -> [f32; 2]) -> Flow {
    Flow {
        width: SIDE,
        height: SIDE,
        data: (0..SIDE * SIDE)
            .map(|i| field(i % SIDE, i / SIDE))
            .collect(),
    }
}

fn grey(value: impl Fn(f64, f64) -> f64) -> Plane {
    Plane::from_fn(SIDE, SIDE, |x, y| value(x as f64, y as f64) as f32)
}

fn evidence(forward: &Flow, backward: &Flow, first: &Plane, second: &Plane) -> Evidence {
    let params = ConsistencyParams::default();
    let on_grid = |flow| GridFlow::new(flow, &params).unwrap();
    let frame = |plane| NormalisedFrame::new(plane, &params).unwrap();
    Evidence::new(
        &on_grid(forward),
        &on_grid(backward),
        &frame(first),
        &frame(second),
        &params,
    )
    .unwrap()
}

fn flat() -> Plane {
    grey(|_, _| 100.0)
}

fn negated(flow: &Flow) -> Flow {
    Flow {
        data: flow.data.iter().map(|[u, v]| [-u, -v]).collect(),
        ..*flow
    }
}

/// P of a field whose counter-flow is taken as consistent everywhere: the slow rotation and shear
/// below change so little over one vector that F(x) and −B(x + F) agree within the tolerance.
fn residual(field: impl Fn(usize, usize) -> [f32; 2]) -> Option<f64> {
    let forward = flow(field);
    let evidence = evidence(&forward, &negated(&forward), &flat(), &flat());
    piecewise_residual(&evidence, 1.0, &PiecewiseParams::default())
}

#[test]
fn affine_motion_leaves_no_residual_and_random_motion_much() {
    let affine = residual(|x, y| {
        [
            2.0 + 0.01 * x as f32 - 0.004 * y as f32,
            -1.5 + 0.006 * y as f32,
        ]
    });
    // f32 coordinates of a few hundred pixels: a few 1e-5 px.
    assert!(affine.unwrap() < 1e-4, "{affine:?}");
    let two_halves = residual(|_, y| {
        if y < SIDE / 2 {
            [3.0, 0.0]
        } else {
            [-3.0, 1.0]
        }
    });
    assert!(two_halves.unwrap() < 1e-3, "{two_halves:?}");
    let rough = residual(|x, y| {
        // Blocks of 8 px, each with a vector of its own between 2 and 6 px.
        let hash = (x / 8 * 7919 + y / 8 * 104_729) % 97;
        [
            2.0 + 4.0 * hash as f32 / 97.0,
            3.0 * ((hash * 31 % 89) as f32 / 89.0),
        ]
    });
    assert!(rough.unwrap() > 0.05, "{rough:?}");
}

#[test]
fn residual_is_repeatable_and_the_seed_matters_little() {
    let field = |x: usize, y: usize| {
        let wave = libm::sinf(x as f32 * 0.05) * libm::cosf(y as f32 * 0.04);
        [3.0 + wave, -2.0 + 0.5 * wave]
    };
    assert_eq!(residual(field), residual(field));
    let forward = flow(field);
    let evidence = evidence(&forward, &negated(&forward), &flat(), &flat());
    let seeded = |seed| {
        let params = PiecewiseParams {
            seed,
            ..PiecewiseParams::default()
        };
        piecewise_residual(&evidence, 1.0, &params).unwrap()
    };
    for seed in 1..6 {
        // Another 600 of some 14,000 cells: a standard error of about 4%.
        assert!(
            (seeded(seed) / seeded(0) - 1.0).abs() < 0.25,
            "{} {}",
            seeded(seed),
            seeded(0)
        );
    }
}

#[test]
fn too_little_motion_is_none_never_zero() {
    let still = flow(|_, _| [0.0; 2]);
    let evidence = evidence(&still, &still, &flat(), &flat());
    let params = SignalParams::default();
    assert_eq!(piecewise_residual(&evidence, 1.0, &params.piecewise), None);
    assert_eq!(appearance_ratio(&evidence, &params), None);
    assert_eq!(motion_px(&evidence), Some(0.0));
    assert_eq!(moving_fraction(&evidence, &params), Some(0.0));
}

#[test]
fn collinear_moving_cells_do_not_break_the_search() {
    // One grid row of moving cells, so that every sample is a line.
    let forward = flow(|_, y| if y / 2 == 64 { [4.0, 0.0] } else { [0.0; 2] });
    let evidence = evidence(&forward, &negated(&forward), &flat(), &flat());
    let p = piecewise_residual(&evidence, 1.0, &PiecewiseParams::default());
    // No model exists: every residual is the limit, over |F| + 1 = 5.
    assert_eq!(p, Some(2.0));
}

#[test]
fn appearance_ratio_sees_change_on_what_moves() {
    let texture = |x: f64, y: f64| 128.0 + 40.0 * libm::sin(0.35 * x) * libm::cos(0.3 * y);
    // The left half moves by (4, 0); the right half rests.
    let forward = flow(|x, _| if x < SIDE / 2 { [4.0, 0.0] } else { [0.0; 2] });
    let first = grey(texture);
    let noise = |x: f64, y: f64| ((x * 12.0 + y * 7.0) as i64 % 5 - 2) as f64;
    let half = SIDE as f64 / 2.0;
    let seconds = |moving_gain: f64| {
        grey(move |x, y| {
            if x < half {
                texture(x - 4.0, y) + moving_gain * noise(x, y)
            } else {
                texture(x, y) + noise(x, y)
            }
        })
    };
    let ratio = |gain: f64| {
        let evidence = evidence(&forward, &negated(&forward), &first, &seconds(gain));
        appearance_ratio(&evidence, &SignalParams::default()).unwrap()
    };
    assert!((ratio(1.0) - 1.0).abs() < 0.2, "{}", ratio(1.0));
    assert!(ratio(4.0) > 1.4, "{}", ratio(4.0));
}

#[test]
fn pair_signals_collect_the_measures_in_reference_pixels() {
    let params = ConsistencyParams::default();
    let forward = flow(|_, _| [3.0, 4.0]);
    let backward = flow(|_, _| [-3.0, -3.0]);
    let evidence = evidence(&forward, &backward, &flat(), &flat());
    let end_point = EndPointError::new(&forward, &backward, &params).unwrap();
    let worldscore = worldscore_epe(&forward, &backward).unwrap();
    let signals = PairSignals::new(
        &evidence,
        &end_point,
        &worldscore,
        &params,
        &SignalParams::default(),
    );
    assert_eq!(signals.motion_px, Some(5.0));
    assert_eq!(signals.moving_fraction, Some(1.0));
    assert_eq!(signals.aepe_px, Some(1.0));
    assert_eq!(signals.aepe_worldscore_px, Some(1.0));
    // 1 > 0.5 + 0.01 (25 + 18): not consistent anywhere.
    assert_eq!(signals.occluded_fraction, Some(1.0));
    assert_eq!(signals.piecewise_residual, None);
}
