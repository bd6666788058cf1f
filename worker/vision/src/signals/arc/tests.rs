//! The three signals against plain twins, on motions whose values are known, and the selection.

use super::*;
use crate::consistency::{ConsistencyParams, GridFlow, NormalisedFrame};
use crate::flow::FlowError;
use crate::image::Plane;

const SIDE: usize = 128;

/// A forward flow, and a backward flow that agrees with it.
fn evidence(flow: impl Fn(usize, usize) -> [f32; 2]) -> Evidence {
    let grid = |sign: f32| GridFlow {
        width: SIDE,
        height: SIDE,
        cells_per_px: [0.5, 0.5],
        flow_px: (0..SIDE * SIDE)
            .map(|i| flow(i % SIDE, i / SIDE).map(|v| sign * v))
            .collect(),
    };
    let frame = frame(|_, _| 0.0);
    let params = ConsistencyParams::default();
    let mut evidence = Evidence::new(&grid(1.0), &grid(-1.0), &frame, &frame, &params).unwrap();
    // Where the flow varies, its negative on the same cell is not quite its inverse; what is under
    // test is what the signals make of consistent cells.
    evidence.rho.fill(0.0);
    evidence
}

fn frame(grey: impl Fn(usize, usize) -> f32) -> NormalisedFrame {
    let grey = Plane::from_fn(SIDE, SIDE, grey);
    NormalisedFrame::new(&grey, &ConsistencyParams::default()).unwrap()
}

fn texture(x: f64, y: f64) -> f32 {
    (128.0 + 60.0 * libm::sin(0.9 * x + 0.2 * y) * libm::cos(0.8 * y)) as f32
}

#[test]
fn a_layer_that_speeds_up_or_turns_steadily_has_no_acceleration_of_its_own() {
    let params = ArcParams::default();
    let rigid = |scale: f32| evidence(move |_, _| [4.0 * scale, 3.0 * scale]);
    // α takes any change of speed; what remains is the 0.2 px² beside |F|² = 25, most of it common
    // and so removed too.
    let faster = layer_acceleration(&rigid(1.0), &rigid(1.5), &params)
        .unwrap()
        .mean;
    assert!(faster < 1e-3, "{faster}");
    let turned = layer_acceleration(&rigid(1.0), &evidence(|_, _| [3.0, 4.0]), &params)
        .unwrap()
        .mean;
    assert!(turned < 2e-3, "{turned}");
    // Every other cell jerks by ±2 px: |H| = 2, d = 5 + 1 or a little more.
    let jerk = evidence(|x, y| {
        let sign = if (x + y) % 2 == 0 { 1.0 } else { -1.0 };
        [4.0 + 2.0 * sign, 3.0]
    });
    let own = layer_acceleration(&evidence(|_, _| [4.0, 4.0]), &jerk, &params)
        .unwrap()
        .mean;
    assert!((0.2..0.5).contains(&own), "{own}");
    // Too slow to count.
    let slow = evidence(|_, _| [0.5, 0.0]);
    assert_eq!(layer_acceleration(&slow, &slow, &params), None);
}

/// accs from its definition, f64, one window at a time.
#[test]
fn layer_acceleration_equals_its_definition() {
    let wave = |x: usize, y: usize, phase: f64| {
        let (x, y) = (x as f64 * 0.11 + phase, y as f64 * 0.07 - phase);
        [
            (3.0 * libm::sin(x) + 2.0 * libm::cos(y)) as f32,
            (2.0 * libm::cos(x + y)) as f32,
        ]
    };
    let (step, next) = (
        evidence(|x, y| wave(x, y, 0.0)),
        evidence(|x, y| wave(x, y, 0.4)),
    );
    let cells = SIDE * SIDE;
    let at = |cell: usize| [0, 1].map(|k| f64::from(step.flow_px[cell][k]));
    let mut later = vec![[0.0; 2]; cells];
    let mut d = vec![0.0; cells];
    let mut counted = vec![false; cells];
    for cell in 0..cells {
        let [u, v] = at(cell);
        let x = ((cell % SIDE) as f64 + u / 2.0).clamp(0.0, 127.0);
        let y = ((cell / SIDE) as f64 + v / 2.0).clamp(0.0, 127.0);
        let (l, t) = (x.floor() as usize, y.floor() as usize);
        let (r, b) = ((l + 1).min(127), (t + 1).min(127));
        let (fx, fy) = (x - l as f64, y - t as f64);
        for k in [0, 1] {
            let value = |x: usize, y: usize| f64::from(next.flow_px[y * SIDE + x][k]);
            later[cell][k] = (1.0 - fy) * ((1.0 - fx) * value(l, t) + fx * value(r, t))
                + fy * ((1.0 - fx) * value(l, b) + fx * value(r, b));
        }
        d[cell] = (u.hypot(v) + later[cell][0].hypot(later[cell][1])) / 2.0 + 1.0;
        counted[cell] = step.consistent(cell) && d[cell] > 2.0;
    }
    let window = |cell: usize, value: &dyn Fn(usize) -> f64| {
        let mirror = |i: i64| if i < 0 { -i } else { i.min(254 - i) } as usize;
        let (x, y) = ((cell % SIDE) as i64, (cell / SIDE) as i64);
        let mut sum = 0.0;
        for dy in -7..=7 {
            for dx in -7..=7 {
                let other = mirror(y + dy) * SIDE + mirror(x + dx);
                if counted[other] {
                    sum += value(other);
                }
            }
        }
        sum / 225.0
    };
    let mut change = vec![[0.0; 2]; cells];
    for cell in (0..cells).filter(|&cell| counted[cell]) {
        let product = window(cell, &|c| at(c)[0] * later[c][0] + at(c)[1] * later[c][1]);
        let energy = window(cell, &|c| at(c)[0] * at(c)[0] + at(c)[1] * at(c)[1]);
        let ratio = (product / (energy + 0.2)).clamp(-2.0, 3.0);
        change[cell] = [0, 1].map(|k| later[cell][k] - ratio * at(cell)[k]);
    }
    let mut residuals = Vec::new();
    for cell in (0..cells).filter(|&cell| counted[cell]) {
        let share = window(cell, &|_| 1.0) + 0.001;
        let own = [0, 1].map(|k| change[cell][k] - window(cell, &|c| change[c][k]) / share);
        residuals.push((own[0].hypot(own[1]) / d[cell]).min(4.0));
    }
    let found = layer_acceleration(&step, &next, &ArcParams::default()).unwrap();
    let mean = residuals.iter().sum::<f64>() / residuals.len() as f64;
    residuals.sort_unstable_by(f64::total_cmp);
    let place = (residuals.len() - 1) as f64 / 4.0;
    let (below, above) = (residuals[place as usize], residuals[place.ceil() as usize]);
    let quartile = below + place.fract() * (above - below);
    // f32 sums of 225 products up to 13; cells on the edge of k may fall on either side.
    for (found, expected) in [(found.mean, mean), (found.lower_quartile, quartile)] {
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }
}

#[test]
fn a_step_is_summed_up_by_mean_and_lower_quartile() {
    let sample = |values: &[f32]| {
        let mut sample = CellSample::default();
        for &value in values {
            sample.add(value);
        }
        sample.over(3)
    };
    assert_eq!(sample(&[1.0, 2.0, 3.0]), None);
    let summary = |mean, lower_quartile| {
        Some(CellSummary {
            mean,
            lower_quartile,
        })
    };
    // The quartile's place is (n − 1)/4: 3/4 of the way from 1 to 2, and the second of five.
    assert_eq!(sample(&[4.0, 2.0, 1.0, 3.0]), summary(2.5, 1.75));
    assert_eq!(sample(&[9.0, 2.0, 1.0, 3.0, 5.0]), summary(4.0, 2.0));
    // A minority of broken cells lifts the mean alone.
    let mut values = [0.1f32; 100];
    values[70..].fill(4.0);
    assert_eq!(
        sample(&values).map(|cells| cells.lower_quartile),
        Some(f64::from(0.1f32))
    );
}

#[test]
fn shear_is_zero_for_similarities_and_known_for_a_shear() {
    let params = ArcParams::default();
    // Rotation by 0.05 and growth by 0.03 about the middle, plus 5 px: free of deformation.
    let similar = evidence(|x, y| {
        let (x, y) = (2.0 * (x as f32 - 64.0), 2.0 * (y as f32 - 64.0));
        [0.03 * x - 0.05 * y + 9.0, 0.05 * x + 0.03 * y + 9.0]
    });
    assert!(interior_shear(&similar, &params).unwrap() < 1e-6);
    // u = 0.02 y + 6 px: dev = 0.02 everywhere; mean |F| over the interior, rows 6..=121 or so.
    let sheared = evidence(|_, y| [0.02 * (2.0 * y as f32 - 127.0) + 6.0, 0.0]);
    let found = interior_shear(&sheared, &params).unwrap();
    assert!((found - 0.02 / 6.0).abs() < 1e-5, "{found}");
    // Two rigid layers: the boundary is one-sided and does not count.
    let layers = evidence(|x, _| if x < 64 { [3.0, 0.0] } else { [-3.0, 2.0] });
    assert_eq!(interior_shear(&layers, &params), Some(0.0));
    assert_eq!(interior_shear(&evidence(|_, _| [0.9, 0.0]), &params), None);
}

#[test]
fn detail_change_is_zero_along_the_true_motion_and_known_for_lost_contrast() {
    let params = ArcParams::default();
    // 2 px of 256 per step are one cell: after four steps the texture is four cells to the right.
    let step = evidence(|_, _| [2.0, 0.0]);
    let steps = [&step, &step, &step, &step];
    let first = frame(|x, y| texture(x as f64, y as f64));
    let moved = |contrast: f32| {
        frame(move |x, y| 128.0 + contrast * (texture(x as f64 - 4.0, y as f64) - 128.0))
    };
    let detail = |frame: &NormalisedFrame| DetailFrame::new(frame, &params.detail);
    let same = detail_change(&detail(&first), steps, &detail(&moved(1.0)), &params)
        .unwrap()
        .mean;
    // Only the borders' reflection differs, within 11 cells of the sides.
    assert!(same < 0.02, "{same}");
    let faded = detail_change(&detail(&first), steps, &detail(&moved(0.5)), &params).unwrap();
    let (faded, least) = (faded.mean, faded.lower_quartile);
    // D is some 20 levels, so that ln((D/2 + 1)/(D + 1)) is near ln 2.
    assert!((faded - std::f64::consts::LN_2).abs() < 0.08, "{faded}");
    // The fading is everywhere, so that the quartile sees it too.
    assert!((least - std::f64::consts::LN_2).abs() < 0.12, "{least}");
    // Displaced by no more than 3 px.
    let slow = evidence(|_, _| [0.7, 0.0]);
    let none = detail_change(&detail(&first), [&slow; 4], &detail(&first), &params);
    assert_eq!(none, None);
    assert_eq!(
        detail_change(&detail(&first), [], &detail(&first), &params),
        None
    );
}

#[test]
fn points_that_are_lost_once_stay_lost() {
    let params = ArcParams::default();
    let first = frame(|x, y| texture(x as f64, y as f64));
    let detail = DetailFrame::new(&first, &params.detail);
    let good = evidence(|_, _| [2.0, 0.0]);
    let mut lost = good.clone();
    lost.rho.fill(1.0);
    for position in 0..4 {
        let mut steps = [&good; 4];
        steps[position] = &lost;
        assert_eq!(detail_change(&detail, steps, &detail, &params), None);
    }
}

#[test]
fn the_stream_dates_steps_and_takes_medians() {
    let mut signals = ArcSignals::new(ArcParams::default()).unwrap();
    let still = frame(|x, y| texture(x as f64, y as f64));
    for k in 0..8usize {
        let step = evidence(move |_, y| [0.01 * k as f32 * (2.0 * y as f32 - 127.0) + 8.0, 0.0]);
        signals
            .push(10 * k, &still, (k > 0).then_some(step))
            .unwrap();
    }
    let clip = signals.finish();
    assert_eq!(clip.steps.len(), 7);
    assert_eq!(clip.steps[0].frame, 10);
    assert_eq!(clip.steps[0].layer_acceleration, None);
    assert!(clip.steps[1].layer_acceleration.is_some());
    let with_detail: Vec<usize> = clip
        .steps
        .iter()
        .filter(|step| step.detail_change.is_some())
        .map(|step| step.frame)
        .collect();
    // Points start at kept frames 0 and 2 and end four later; two values are too few.
    assert_eq!(with_detail, [40, 60]);
    assert_eq!(clip.detail_change, None);
    let middle = clip.steps[3].interior_shear.unwrap();
    assert_eq!(clip.interior_shear, Some(middle));
}

#[test]
fn the_stream_refuses_gaps_and_other_grids() {
    let mut signals = ArcSignals::new(ArcParams::default()).unwrap();
    let still = frame(|_, _| 9.0);
    signals.push(0, &still, None).unwrap();
    assert!(matches!(
        signals.push(1, &still, None),
        Err(ArcError::MissingEvidence { frame: 1 })
    ));
    let small = NormalisedFrame {
        grey: Plane::from_fn(8, 8, |_, _| 0.0),
        normalised: Plane::from_fn(8, 8, |_, _| 0.0),
    };
    assert!(matches!(
        signals.push(1, &small, None),
        Err(ArcError::SizeMismatch { .. })
    ));
    let mut params = ArcParams::default();
    params.detail.stride = 0;
    assert!(ArcSignals::new(params).is_err());
    let empty = ArcSignals::new(ArcParams::default()).unwrap();
    assert_eq!(empty.finish(), ArcClip::default());
}

/// The frames of a clip that the selector keeps, the texture moving by `px` reference pixels each.
fn kept(px: f64, frames: usize) -> Vec<usize> {
    let mut selector = ArcSelector::new(ArcSelectorParams::default());
    (0..frames)
        .filter(|&t| {
            let shift = px / 2.0 * t as f64;
            let wavy = move |x: usize, y: usize| {
                let (x, y) = (x as f64 - shift, y as f64);
                let value = libm::sin(0.21 * x + 0.07 * y) + libm::cos(0.17 * y - 0.05 * x);
                (128.0 + 50.0 * value) as f32
            };
            selector.push(&frame(wavy)).unwrap()
        })
        .collect()
}

#[test]
fn frames_are_kept_by_motion_not_by_time() {
    assert_eq!(kept(4.5, 6), [0, 1, 2, 3, 4, 5]);
    // 3 · 1.5 px reach 3.5 px, 2 · 1.5 px do not.
    assert_eq!(kept(1.5, 10), [0, 3, 6, 9]);
    // A still clip keeps every twelfth.
    assert_eq!(kept(0.0, 30), [0, 12, 24]);
    assert_eq!(kept(4.5, 60).len(), 44);
}

#[test]
fn a_frame_that_is_no_picture_is_not_fed() {
    let mut selector = ArcSelector::new(ArcSelectorParams::default());
    let good = frame(|x, y| texture(x as f64, y as f64));
    assert!(selector.push(&good).unwrap());
    let tiny = NormalisedFrame {
        grey: Plane::from_fn(4, 4, |_, _| 0.0),
        normalised: Plane::from_fn(4, 4, |_, _| 0.0),
    };
    assert!(matches!(
        selector.push(&tiny),
        Err(FlowError::TooSmall { .. })
    ));
    assert!(!selector.push(&good).unwrap());
    assert_eq!(selector.kept_frames(), 1);
}
