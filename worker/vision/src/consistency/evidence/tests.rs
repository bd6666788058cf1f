//! The evidence against its definitions, and on pictures whose motion is known.

use super::*;
use crate::consistency::end_point::inside;
use crate::image::Bilinear;

fn flow(width: usize, height: usize, field: impl Fn(usize, usize) -> [f32; 2]) -> Flow {
    Flow {
        width,
        height,
        data: (0..width * height)
            .map(|i| field(i % width, i / width))
            .collect(),
    }
}

fn texture(width: usize, height: usize, shift: f64) -> Plane {
    // Wavelengths in units of the height, so that every working size shows the same picture.
    let unit = 256.0 / height as f64;
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = ((x as f64 + 0.5) * unit - shift, (y as f64 + 0.5) * unit);
        (128.0 + 50.0 * libm::sin(0.11 * x + 0.05 * y) * libm::cos(0.09 * y - 0.04 * x)) as f32
    })
}

fn measure(forward: &Flow, backward: &Flow, first: &Plane, second: &Plane) -> Evidence {
    let params = ConsistencyParams::default();
    let grid = |flow| GridFlow::new(flow, &params).unwrap();
    let frame = |plane| NormalisedFrame::new(plane, &params).unwrap();
    Evidence::new(
        &grid(forward),
        &grid(backward),
        &frame(first),
        &frame(second),
        &params,
    )
    .unwrap()
}

#[test]
fn true_motion_is_consistent_at_every_working_height() {
    for (width, height) in [
        (128, 128),
        (256, 256),
        (512, 512),
        (342, 256),
        (171, 128),
        (455, 341),
    ] {
        // 6 reference pixels to the right.
        let shift = 6.0 * height as f32 / 256.0;
        let forward = flow(width, height, |_, _| [shift, 0.0]);
        let backward = flow(width, height, |_, _| [-shift, 0.0]);
        let (first, second) = (texture(width, height, 0.0), texture(width, height, 6.0));
        let evidence = measure(&forward, &backward, &first, &second);
        assert_eq!(evidence.height, 128);
        let columns = (128.0 * width as f64 / height as f64).round_ties_even();
        assert_eq!(evidence.width, columns as usize);
        for index in (0..evidence.rho.len()).filter(|&i| evidence.counted[i]) {
            // f32 rounding of weights that sum to 1 on vectors of up to 12 px.
            assert!((evidence.speed_px[index] - 6.0).abs() < 1e-4);
            assert!(evidence.rho[index] < 1e-6 && evidence.consistent(index));
            // Local statistics reach 16 cells, and 3 cells of new picture enter at the left;
            // elsewhere bilinear look-up costs a few percent of a deviation, where a wrong
            // scale would cost tenths.
            let x = index % evidence.width;
            if (20..evidence.width - 20).contains(&x) {
                assert!(evidence.appearance[index] < 0.1, "{width}x{height}");
            }
        }
    }
}

/// One cell from the definitions, in f64, with its own bilinear look-up.
fn twin_cell(
    x: usize,
    y: usize,
    ahead: &GridFlow,
    back: &GridFlow,
    first: &Plane,
    second: &Plane,
) -> [f64; 3] {
    let (width, height) = (ahead.width, ahead.height);
    let lookup = |at: &dyn Fn(usize) -> f64, px: f64, py: f64| {
        let px = px.clamp(0.0, width as f64 - 1.0);
        let py = py.clamp(0.0, height as f64 - 1.0);
        let mut sum = 0.0;
        for row in 0..height {
            for column in 0..width {
                let weight = (1.0 - (px - column as f64).abs()).max(0.0)
                    * (1.0 - (py - row as f64).abs()).max(0.0);
                sum += weight * at(row * width + column);
            }
        }
        sum
    };
    let [u, v] = ahead.flow_px[y * width + x].map(f64::from);
    let px = x as f64 + u * f64::from(ahead.cells_per_px[0]);
    let py = y as f64 + v * f64::from(ahead.cells_per_px[1]);
    let bu = lookup(&|i| f64::from(back.flow_px[i][0]), px, py);
    let bv = lookup(&|i| f64::from(back.flow_px[i][1]), px, py);
    let e = (u + bu).hypot(v + bv);
    let rho = e * e / (0.5 + 0.01 * (u * u + v * v + bu * bu + bv * bv));
    let moved = lookup(&|i| f64::from(second.data[i]), px, py);
    let r = (f64::from(first.data[y * width + x]) - moved)
        .abs()
        .min(3.0);
    [e, rho, r]
}

#[test]
fn cells_match_the_definitions() {
    let params = ConsistencyParams::default();
    let field = |sign: f32| {
        move |x: usize, y: usize| {
            [
                sign * (2.0 + libm::sinf(x as f32 * 0.07)) * 4.0,
                sign * libm::cosf(y as f32 * 0.05) * 3.0,
            ]
        }
    };
    let (ahead, back) = (flow(192, 144, field(1.0)), flow(192, 144, field(-1.0)));
    let (first, second) = (texture(192, 144, 0.0), texture(192, 144, 9.0));
    let evidence = measure(&ahead, &back, &first, &second);
    let grid = |flow| GridFlow::new(flow, &params).unwrap();
    let normal = |plane| NormalisedFrame::new(plane, &params).unwrap().normalised;
    let (ahead, back) = (grid(&ahead), grid(&back));
    let (first, second) = (normal(&first), normal(&second));
    for (x, y) in [(0, 0), (5, 90), (64, 64), (100, 3), (170, 127), (90, 31)] {
        let index = y * evidence.width + x;
        let [e, rho, r] = twin_cell(x, y, &ahead, &back, &first, &second);
        // f32 positions up to 171 cells: fractions good to 1e-5, times slopes of about 1.
        assert!((f64::from(evidence.error_px[index]) - e).abs() < 1e-3);
        assert!((f64::from(evidence.rho[index]) - rho).abs() < 1e-3 * (1.0 + rho));
        assert!((f64::from(evidence.appearance[index]) - r).abs() < 1e-3);
    }
}

#[test]
fn normalised_frame_ignores_gain_and_offset_where_contrast_is_high() {
    let params = ConsistencyParams::default();
    let plain = texture(256, 256, 0.0);
    let brighter = Plane {
        data: plain.data.iter().map(|g| 1.2 * g + 20.0).collect(),
        ..plain
    };
    let a = NormalisedFrame::new(&plain, &params).unwrap().normalised;
    let b = NormalisedFrame::new(&brighter, &params).unwrap().normalised;
    let worst = a
        .data
        .iter()
        .zip(&b.data)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    // Only the variance floor of 25 tells them apart: 30% of 25 / variance at worst.
    assert!(worst < 0.25, "{worst}");
    let flat = NormalisedFrame::new(&Plane::from_fn(99, 77, |_, _| 255.0), &params).unwrap();
    assert!(flat.normalised.data.iter().all(|n| n.abs() < 1e-3));
}

#[test]
fn change_maps_are_zero_for_true_motion_and_high_for_a_foreign_frame() {
    let still = flow(256, 256, |_, _| [0.0; 2]);
    let first = texture(256, 256, 0.0);
    let same = measure(&still, &still, &first, &first);
    assert!(same.change_map().data.iter().all(|q| *q == 0.0));
    let foreign = measure(&still, &still, &first, &texture(256, 256, 31.0));
    let mean = |plane: Plane| plane.data.iter().sum::<f32>() / plane.data.len() as f32;
    assert!(mean(foreign.appearance_change_map()) > 0.4);
    assert!(
        foreign
            .change_map()
            .data
            .iter()
            .all(|q| (0.0..=1.0 + 1e-6).contains(q))
    );
}

#[test]
fn mismatched_and_broken_inputs_are_typed_errors() {
    let params = ConsistencyParams::default();
    let grid = |w, h| GridFlow::new(&flow(w, h, |_, _| [0.0; 2]), &params).unwrap();
    let frame = |w, h| NormalisedFrame::new(&texture(w, h, 0.0), &params).unwrap();
    let result = Evidence::new(
        &grid(64, 64),
        &grid(64, 64),
        &frame(64, 64),
        &frame(80, 64),
        &params,
    );
    assert!(matches!(result, Err(ConsistencyError::SizeMismatch { .. })));
    let mut broken = texture(16, 16, 0.0);
    broken.data[3] = f32::NAN;
    assert!(matches!(
        NormalisedFrame::new(&broken, &params),
        Err(ConsistencyError::PixelNotFinite { index: 3 })
    ));
    let nan = flow(16, 16, |_, _| [f32::NAN, 0.0]);
    assert!(matches!(
        GridFlow::new(&nan, &params),
        Err(ConsistencyError::FlowOutOfRange { .. })
    ));
    let zero = ConsistencyParams {
        grid_height: 0,
        ..params
    };
    assert!(matches!(
        GridFlow::new(&flow(16, 16, |_, _| [0.0; 2]), &zero),
        Err(ConsistencyError::InvalidParameter {
            name: "grid_height",
            ..
        })
    ));
}

/// The definition, cell by cell.
fn twin(
    forward: &GridFlow,
    backward: &GridFlow,
    first: &NormalisedFrame,
    second: &NormalisedFrame,
    params: &ConsistencyParams,
) -> Evidence {
    let (width, height) = (forward.width, forward.height);
    let mut evidence = Evidence {
        width,
        height,
        cells_per_px: forward.cells_per_px,
        flow_px: forward.flow_px.clone(),
        speed_px: Vec::new(),
        error_px: Vec::new(),
        rho: Vec::new(),
        appearance: Vec::new(),
        in_frame: Vec::new(),
        counted: Vec::new(),
        appearance_scale: params.appearance_scale,
    };
    for (index, &[u, v]) in forward.flow_px.iter().enumerate() {
        let (x, y) = (index % width, index / width);
        let to_x = x as f32 + u * forward.cells_per_px[0];
        let to_y = y as f32 + v * forward.cells_per_px[1];
        let at = Bilinear::at(to_x, to_y, width, height);
        let [a, b, c, d] = at.indices.map(|index| backward.flow_px[index]);
        let back = [0, 1].map(|axis| at.mix(a[axis], b[axis], c[axis], d[axis]));
        let squared = squared_norm([u + back[0], v + back[1]]);
        let difference = (first.normalised.data[index] - second.normalised.bilinear(at)).abs();
        let in_frame = inside(to_x, to_y, width, height);
        let margin = params.margin_cells;
        let central = (margin..width.saturating_sub(margin)).contains(&x)
            && (margin..height.saturating_sub(margin)).contains(&y);
        evidence.speed_px.push(squared_norm([u, v]).sqrt());
        evidence.error_px.push(squared.sqrt());
        evidence.rho.push(params.rho(squared, [u, v], back));
        let appearance = difference.min(params.appearance_limit);
        evidence.appearance.push(appearance);
        evidence.in_frame.push(in_frame);
        evidence.counted.push(in_frame && central);
    }
    evidence
}

#[test]
fn row_wise_kernels_equal_the_definitions_bit_for_bit() {
    for (width, height) in [(1, 1), (1, 9), (7, 1), (9, 8), (37, 23), (64, 48)] {
        let params = ConsistencyParams {
            grid_height: height,
            ..ConsistencyParams::default()
        };
        // Whole and broken vectors, some to the border exactly, some out of the frame.
        let field = |seed: usize, step: f32| GridFlow {
            width,
            height,
            cells_per_px: [0.5, 0.5],
            flow_px: (0..width * height)
                .map(|i| [7919, 104_729].map(|k| ((i * k + seed) % 23) as f32 * step - 3.0))
                .collect(),
        };
        let frame = |shift| NormalisedFrame::new(&texture(width, height, shift), &params).unwrap();
        let (first, second) = (frame(0.0), frame(6.0));
        for step in [0.25, 0.37, 1.0] {
            let (ahead, back) = (field(1, step), field(5, 0.31));
            let expected = twin(&ahead, &back, &first, &second, &params);
            let measured = Evidence::new(&ahead, &back, &first, &second, &params).unwrap();
            assert_eq!(measured, expected);
            let plain = Comparison {
                forward: &ahead,
                backward: &back,
                first: &first.normalised.data,
                second: &second.normalised.data,
                size: (width, height),
                params: &params,
            };
            assert_eq!(plain.run(), expected);
            for reads_flow in [true, false] {
                let change = |cell: usize| {
                    let ratio = expected.appearance[cell] / params.appearance_scale;
                    let flow = if reads_flow { expected.rho[cell] } else { 0.0 };
                    let share = -libm::expm1f(-(flow + ratio * ratio));
                    if expected.in_frame[cell] { share } else { 0.0 }
                };
                let by_cell: Vec<f32> = (0..width * height).map(change).collect();
                let map = ChangeMap {
                    evidence: &expected,
                    reads_flow,
                };
                assert_eq!(map.run(), by_cell);
            }
        }
    }
}
