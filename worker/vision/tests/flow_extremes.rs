//! The hard frames through every preset and both end-point errors: flow finite everywhere, errors
//! finite or absent, never NaN. Constant and saturated frames have no flow at all.
//!
//! (4096 × 2160 and pictures smaller than a patch stand beside the solver, in `flow/dis/tests.rs`.)

#![expect(clippy::unwrap_used, reason = "what cannot be measured fails the test")]

use plumbline_vision::consistency::{ConsistencyParams, EndPointError, worldscore_epe};
use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::Plane;

fn presets() -> [DisParams; 5] {
    [
        DisParams::ultrafast(2),
        DisParams::ultrafast(1),
        DisParams::ultrafast(0),
        DisParams::fast(),
        DisParams::medium(),
    ]
}

/// Whole grey levels without repetition over some thousand pixels.
fn noise(x: i64, y: i64) -> f32 {
    let mixed = (x.wrapping_mul(7919) ^ y.wrapping_mul(104_729)).wrapping_mul(2_654_435_761);
    ((mixed >> 16) & 255) as f32
}

/// Smooth waves, moved by `(u, v)`.
fn waves(width: usize, height: usize, [u, v]: [f64; 2]) -> Plane {
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = (x as f64 - u, y as f64 - v);
        let sum = libm::sin(0.31 * x + 0.12 * y) + libm::sin(0.29 * y - 0.17 * x + 1.1);
        (128.0 + 60.0 * sum) as f32
    })
}

/// Both directions at a preset, checked for finite vectors and errors.
fn flows(first: &Plane, second: &Plane, params: &DisParams, name: &str) -> [Flow; 2] {
    let frame = |plane| DisFrame::new(plane, params).unwrap();
    let (a, b) = (frame(first), frame(second));
    let mut dis = Dis::new(params.clone());
    let flows = [dis.flow(&a, &b).unwrap(), dis.flow(&b, &a).unwrap()];
    for flow in &flows {
        assert_eq!(
            (flow.width, flow.height, flow.data.len()),
            (first.width, first.height, first.data.len())
        );
        assert!(
            flow.data.iter().flatten().all(|c| c.is_finite()),
            "{name}: {params:?}"
        );
    }
    let consistency = ConsistencyParams::default();
    for (ahead, back) in [(&flows[0], &flows[1]), (&flows[1], &flows[0])] {
        let corrected = EndPointError::new(ahead, back, &consistency).unwrap();
        let finite = |value: Option<f64>| value.is_none_or(f64::is_finite);
        assert!(finite(corrected.mean_px), "{name}");
        assert!(finite(corrected.occluded_fraction), "{name}");
        assert!(
            corrected.error_px.iter().flatten().all(|e| e.is_finite()),
            "{name}"
        );
        let worldscore = worldscore_epe(ahead, back).unwrap();
        assert!(finite(worldscore.average_px), "{name}");
        // Nothing is left of small pictures once 30 rows and columns are cut away.
        let has_crop = ahead.width > 30 && ahead.height > 30;
        assert_eq!(worldscore.average_px.is_some(), has_crop, "{name}");
    }
    flows
}

#[test]
fn constant_and_saturated_frames_have_no_flow() {
    for (width, height) in [(16, 16), (96, 64)] {
        for (a, b) in [
            (0.0, 0.0),
            (255.0, 255.0),
            (128.0, 128.0),
            (0.0, 255.0),
            (255.0, 0.0),
        ] {
            let plane = |value| Plane::from_fn(width, height, |_, _| value);
            for params in presets() {
                let name = format!("{a} to {b}, {width}x{height}");
                for flow in flows(&plane(a), &plane(b), &params, &name) {
                    assert!(flow.data.iter().all(|v| *v == [0.0; 2]), "{name}");
                }
            }
        }
    }
}

#[test]
fn half_black_half_white_frames_stay_still_where_nothing_moves() {
    let (width, height) = (96, 64);
    let split = |at: usize| Plane::from_fn(width, height, |x, _| if x < at { 0.0 } else { 255.0 });
    for params in presets() {
        for flow in flows(&split(48), &split(48), &params, "a still edge") {
            assert!(flow.data.iter().all(|v| *v == [0.0; 2]));
        }
        // A straight edge alone has no unique motion: its structure tensor is singular, and the search
        // leaves it where it is (as OpenCV's does). It must not become large or NaN.
        flows(&split(48), &split(51), &params, "a moving edge");
        let inverted = Plane::from_fn(width, height, |x, _| if x < 48 { 255.0 } else { 0.0 });
        flows(&split(48), &inverted, &params, "an inverted edge");
    }
}

#[test]
fn the_smallest_pictures_work() {
    for (width, height) in [(8, 8), (16, 16), (16, 200), (200, 8)] {
        for params in presets() {
            let name = format!("{width}x{height}");
            let still = waves(width, height, [0.0; 2]);
            flows(&still, &waves(width, height, [0.6, -0.4]), &params, &name);
            for flow in flows(&still, &still, &params, &name) {
                let longest = flow
                    .data
                    .iter()
                    .flatten()
                    .fold(0.0_f32, |m, c| m.max(c.abs()));
                assert!(
                    longest < 1e-3,
                    "{name}: {longest} px between equal pictures"
                );
            }
        }
    }
}

#[test]
fn displacements_larger_than_the_frame_stay_finite_and_bounded() {
    let (width, height) = (96, 64);
    for shift in [[97.0, 0.0], [-300.0, 200.0], [1e4, -1e4]] {
        for params in presets() {
            let name = format!("moved by {shift:?}");
            let still = waves(width, height, [0.0; 2]);
            for flow in flows(&still, &waves(width, height, shift), &params, &name) {
                // Five scales, at each of which two sweeps move a patch by no more than its size, and
                // candidates are others' vectors: far less than the bound that consistency refuses at.
                assert!(flow.data.iter().flatten().all(|c| c.abs() < 1e4), "{name}");
            }
            let [dx, dy] = shift.map(|s| s as i64);
            let world = |dx: i64, dy: i64| {
                Plane::from_fn(width, height, |x, y| noise(x as i64 - dx, y as i64 - dy))
            };
            flows(&world(0, 0), &world(dx, dy), &params, &name);
        }
    }
}
