//! The detectors on pictures and flows whose faults are known, each map against its definition, and
//! hostile input.

use super::maps;
use super::peak::peak;
use super::*;
use crate::consistency::{ConsistencyParams, Evidence, GridFlow, NormalisedFrame};
use crate::image::{Plane, box_mean};

const SIDE: usize = 128;

fn grid_flow(vector: [f32; 2]) -> GridFlow {
    GridFlow {
        width: SIDE,
        height: SIDE,
        cells_per_px: [0.5, 0.5],
        flow_px: vec![vector; SIDE * SIDE],
    }
}

fn picture(value: impl Fn(usize, usize) -> f32) -> NormalisedFrame {
    NormalisedFrame::new(
        &Plane::from_fn(SIDE, SIDE, value),
        &ConsistencyParams::default(),
    )
    .unwrap()
}

/// Smooth texture, the same on every frame.
fn ground(x: usize, y: usize) -> f32 {
    let (x, y) = (x as f64, y as f64);
    (128.0 + 40.0 * libm::sin(0.31 * x) * libm::cos(0.27 * y)) as f32
}

/// A chequered patch of 16 cells at (40, 60).
fn patch(x: usize, y: usize) -> f32 {
    let inside = (40..56).contains(&x) && (60..76).contains(&y);
    if inside && (x / 2 + y / 2).is_multiple_of(2) {
        240.0
    } else if inside {
        20.0
    } else {
        ground(x, y)
    }
}

fn pair(first: &NormalisedFrame, second: &NormalisedFrame, vector: [f32; 2]) -> ChangePair {
    let params = ConsistencyParams::default();
    let (ahead, back) = (grid_flow(vector), grid_flow(vector.map(|v| -v)));
    ChangePair::new(
        Evidence::new(&ahead, &back, first, second, &params).unwrap(),
        Evidence::new(&back, &ahead, second, first, &params).unwrap(),
    )
}

/// The scores of a clip that stands still but for its pictures.
fn still_clip(pictures: &[NormalisedFrame], first_frame: usize) -> FaultSeries {
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    for (t, picture) in pictures.iter().enumerate() {
        let adjacent = (t >= 1).then(|| pair(&pictures[t - 1], picture, [0.0; 2]));
        let skip = (t >= 2).then(|| pair(&pictures[t - 2], picture, [0.0; 2]));
        let input = FaultInput {
            frame: first_frame + t,
            picture,
            adjacent: adjacent.as_ref(),
            skip: skip.as_ref(),
            skip_ahead: None,
        };
        stream.push(input).unwrap();
    }
    stream.finish(true)
}

/// The place's peak lies in the patch, but for the box of the peak.
fn is_in_patch(place: Option<Place>) -> bool {
    place.is_some_and(|place| {
        let [x, y] = place.peak;
        let [x0, y0, x1, y1] = place.bounds;
        (40..56).contains(&x)
            && (60..76).contains(&y)
            && x0 <= x
            && x < x1
            && y0 <= y
            && y < y1
            && x1 - x0 < 32
            && y1 - y0 < 32
    })
}

/// A still picture for twelve frames, but for the seventh.
fn one_bad_frame() -> Vec<NormalisedFrame> {
    let frames = (0..12).map(|t| {
        if t == 6 {
            picture(patch)
        } else {
            picture(ground)
        }
    });
    frames.collect()
}

#[test]
fn a_single_bad_frame_is_found_at_itself_and_nowhere_else() {
    let clip = one_bad_frame();
    let series = still_clip(&clip, 1);
    let points = series.points(FaultKind::BadFrame);
    // Judged from the second frame to the last but one.
    assert_eq!(
        (points.first().unwrap().frame, points.last().unwrap().frame),
        (2, 11)
    );
    for point in points {
        assert_eq!(point.score > 1e-3, point.frame == 7, "{point:?}");
    }
    let worst = series.largest(FaultKind::BadFrame).unwrap();
    assert!(is_in_patch(worst.place));
    let map = series.peak_map(FaultKind::BadFrame).unwrap();
    assert_eq!((map.frame, map.score), (7, worst.score));
    // Into the bad frame and out of it something jumps.
    let jumps: Vec<usize> = series
        .points(FaultKind::Jump)
        .iter()
        .filter(|point| point.score > 1e-3)
        .map(|point| point.frame)
        .collect();
    assert_eq!(jumps, [7, 8]);
}

/// Maps that are asked for by kind and frame are kept, and only those.
#[test]
fn asked_maps_are_kept() {
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    stream.keep_maps(&[(FaultKind::Jump, 7), (FaultKind::Freeze, 7)]);
    let pictures = [picture(ground), picture(patch)];
    for frame in 0..12 {
        let current = &pictures[usize::from(frame >= 7)];
        let previous = &pictures[usize::from(frame > 7)];
        let adjacent = (frame > 0).then(|| pair(previous, current, [0.0; 2]));
        let input = FaultInput {
            frame,
            picture: current,
            adjacent: adjacent.as_ref(),
            skip: None,
            skip_ahead: None,
        };
        stream.push(input).unwrap();
    }
    let series = stream.finish(true);
    let [kept] = series.kept_maps() else {
        panic!("{:?}", series.kept_maps());
    };
    assert_eq!((kept.kind, kept.point.frame), (FaultKind::Jump, 7));
    let peak = series.peak_map(FaultKind::Jump).unwrap();
    assert_eq!((&kept.map, kept.point.score), (&peak.map, peak.score));
}

#[test]
fn appearing_and_vanishing_are_told_apart_and_dated_to_the_first_frame_after() {
    let frames = |first: fn(usize, usize) -> f32, then: fn(usize, usize) -> f32| {
        (0..14)
            .map(|t| picture(if t < 8 { first } else { then }))
            .collect::<Vec<_>>()
    };
    let flat: fn(usize, usize) -> f32 = |_, _| 90.0;
    let come = still_clip(&frames(ground, patch), 0);
    let worst = come.largest(FaultKind::Appear).unwrap();
    assert_eq!(worst.frame, 8);
    assert!(is_in_patch(worst.place));
    let gone = still_clip(&frames(patch, flat), 0);
    assert_eq!(gone.largest(FaultKind::Vanish).unwrap().frame, 8);
    // Texture that comes is no vanishing.
    let back = still_clip(&frames(flat, patch), 0);
    assert_eq!(back.largest(FaultKind::Vanish).unwrap().score, 0.0);
    assert_eq!(back.largest(FaultKind::Vanish).unwrap().place, None);
}

#[test]
fn a_moving_camera_leaves_out_what_compares_in_place() {
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    let still = picture(ground);
    for frame in 0..8 {
        let adjacent = pair(&still, &still, [0.0; 2]);
        let input = FaultInput {
            frame,
            picture: &still,
            adjacent: (frame > 0).then_some(&adjacent),
            skip: None,
            skip_ahead: None,
        };
        stream.push(input).unwrap();
    }
    let series = stream.clone().finish(false);
    assert!(series.points(FaultKind::Appear).is_empty());
    assert!(series.peak_map(FaultKind::Vanish).is_none());
    assert_eq!(series.points(FaultKind::Jump).len(), 7);
    assert_eq!(stream.finish(true).points(FaultKind::Appear).len(), 3);
    // Without pairs one frame apart no single frame is judged.
    assert!(series.points(FaultKind::BadFrame).is_empty());
    // Nothing ever moved, so nothing froze.
    assert!(series.points(FaultKind::Freeze).is_empty());
}

#[test]
fn flicker_needs_change_on_every_pair() {
    let boiling = |t: usize| {
        picture(move |x, y| {
            let inside = (40..56).contains(&x) && (60..76).contains(&y);
            let noise = ((x * 7919 + y * 104_729 + t * 1_299_709) % 251) as f32;
            if inside { noise } else { ground(x, y) }
        })
    };
    let clip: Vec<_> = (0..16)
        .map(|t| {
            if (5..10).contains(&t) {
                boiling(t)
            } else {
                picture(ground)
            }
        })
        .collect();
    let series = still_clip(&clip, 0);
    let worst = series.largest(FaultKind::Flicker).unwrap();
    // Six pairs differ, 4→5 … 9→10; windows of four are dated to their middle, 6, 7 and 8.
    assert!((6..=8).contains(&worst.frame), "{worst:?}");
    assert!(is_in_patch(worst.place));
    for point in series.points(FaultKind::Flicker) {
        // Outside, at least one of the four pairs has no difference at all; the patch's normalisation
        // spreads over the neighbours of a changing frame only.
        assert_eq!(point.score > 0.1, (6..=8).contains(&point.frame));
    }
}

#[test]
fn a_freeze_is_a_run_of_still_pairs_in_a_moving_clip() {
    let shifted = |t: usize| picture(move |x, y| ground(x + 3 * t, y));
    // Frames 6, 7 and 8 repeat frame 5; frame 11 repeats frame 10 alone.
    let shown = [0, 1, 2, 3, 4, 5, 5, 5, 5, 9, 10, 10, 12, 13, 14, 15];
    let series = still_clip(&shown.map(shifted), 0);
    let frozen: Vec<usize> = series
        .points(FaultKind::Freeze)
        .iter()
        .filter(|point| point.score > 0.88)
        .map(|point| point.frame)
        .collect();
    assert_eq!(frozen, [6, 7, 8]);
    let events = series.events(&FaultThresholds {
        bad_frame: None,
        jump: None,
        appear: None,
        vanish: None,
        flicker: None,
        freeze: Some(0.88),
    });
    assert_eq!(events.len(), 1);
    assert_eq!((events[0].first_frame, events[0].last_frame), (6, 8));
    assert_eq!((events[0].kind, events[0].place), (FaultKind::Freeze, None));
}

/// The vanish map of one cell from its definition, on sorted windows in f64.
#[test]
fn transition_maps_equal_their_definitions() {
    let params = FaultParams::default();
    let noise = |seed: usize| {
        Plane::from_fn(12, 9, move |x, y| {
            ((x * 31 + y * 17 + seed * 101 + x * y * seed) % 97) as f32 / 30.0
        })
    };
    let planes: Vec<Plane> = (1..=6).map(noise).collect();
    let shares: Vec<Plane> = (7..=10)
        .map(|seed| {
            let mut plane = noise(seed);
            plane.data.iter_mut().for_each(|v| *v /= 40.0);
            plane
        })
        .collect();
    let six = std::array::from_fn(|k| &planes[k]);
    let vanish = maps::vanish(six, std::array::from_fn(|k| &shares[k]), &params);
    let appear = maps::appear(six, &params);
    let mut step = noise(1);
    for cell in 0..step.data.len() {
        let window = |range: std::ops::Range<usize>| {
            let mut values: Vec<f64> = range.map(|k| f64::from(planes[k].data[cell])).collect();
            values.sort_by(f64::total_cmp);
            (values[1], values[2] - values[0])
        };
        let ((before, spread_before), (after, spread_after)) = (window(0..3), window(3..6));
        let spread = spread_before + spread_after;
        step.data[cell] = ((after - before).abs() - spread).max(0.0) as f32;
        let share = (0..4).fold(0.0f64, |most, k| most.max(f64::from(shares[k].data[cell])));
        let expected =
            (before - after - spread).max(0.0) * libm::exp(-share / f64::from(params.quiet_scale));
        // f32 differences of values up to 3.2, times at most 1.
        assert!((f64::from(vanish.data[cell]) - expected).abs() < 2e-6);
    }
    assert!(vanish.data.iter().any(|&v| v > 0.0));
    let expected = box_mean(&step, 1);
    for (found, expected) in appear.data.iter().zip(&expected.data) {
        assert!((found - expected).abs() < 1e-6);
    }
}

#[test]
fn what_drifts_does_not_flicker() {
    let params = FaultParams::default();
    let residual = Plane::from_fn(4, 3, |x, y| (x + y) as f32 / 2.0);
    let mut low = residual.clone();
    low.data[5] = 0.25;
    let drift = |vector: [f32; 2]| vector.map(|v| Plane::from_fn(4, 3, |_, _| v));
    let residuals = [&residual, &low, &residual, &residual];
    // To and fro: the mean drift is zero.
    let (to, fro) = (drift([3.0, -2.0]), drift([-3.0, 2.0]));
    let boiling = maps::flicker(residuals, [&to, &fro, &to, &fro], &params);
    assert_eq!(boiling, low);
    // 3, 4 on two of four pairs: a mean drift of 2.5 px.
    let (go, stay) = (drift([3.0, 4.0]), drift([0.0, 0.0]));
    let moving = maps::flicker(residuals, [&go, &go, &stay, &stay], &params);
    for (moving, boiling) in moving.data.iter().zip(&boiling.data) {
        let expected = f64::from(*boiling) * libm::exp(-2.5);
        assert!((f64::from(*moving) - expected).abs() < 1e-7);
    }
    // A camera that pans by 5 px while one corner of the picture keeps its place.
    let still = picture(ground);
    let mut pan = pair(&still, &still, [5.0, 0.0]).forward;
    for cell in 0..40 * SIDE {
        if cell % SIDE < 40 {
            pan.flow_px[cell] = [0.0; 2];
        }
    }
    let [x, y] = maps::drift_px(&pan, &params);
    assert_eq!((x.data[0], x.data[SIDE * SIDE - 1]), (-5.0, 0.0));
    assert!(y.data.iter().all(|&v| v == 0.0));
}

#[test]
fn texture_equals_the_plain_deviation_also_on_bright_flats() {
    let params = FaultParams::default();
    let bright = NormalisedFrame {
        grey: Plane::from_fn(20, 11, |_, _| 251.3),
        normalised: Plane::from_fn(20, 11, |_, _| 0.0),
    };
    let ln2 = std::f32::consts::LN_2;
    for value in maps::texture(&bright, &params).data {
        assert!((value - ln2).abs() < 1e-5);
    }
    let grey = Plane::from_fn(20, 11, |x, y| ((x * 37 + y * 91 + x * y * 7) % 251) as f32);
    let frame = NormalisedFrame {
        normalised: grey.clone(),
        grey,
    };
    let found = maps::texture(&frame, &params);
    let mirror = |i: i64, n: i64| {
        let i = i.abs();
        (if i >= n { 2 * n - 2 - i } else { i }) as usize
    };
    for y in 0..11i64 {
        for x in 0..20i64 {
            let mut window = Vec::new();
            for dy in -3..=3 {
                for dx in -3..=3 {
                    let cell = mirror(y + dy, 11) * 20 + mirror(x + dx, 20);
                    window.push(f64::from(frame.grey.data[cell]));
                }
            }
            let mean = window.iter().sum::<f64>() / 49.0;
            let variance = window.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 49.0;
            let expected = libm::log(2.0 + variance.sqrt());
            let value = f64::from(found.data[(y * 20 + x) as usize]);
            // One f32 rounding of a logarithm below 6.
            assert!((value - expected).abs() < 1e-6);
        }
    }
}

#[test]
fn a_peak_is_the_first_of_equals_and_its_bounds_are_connected() {
    let params = FaultParams {
        peak_radius_cells: 0,
        ..FaultParams::default()
    };
    let mut map = Plane::from_fn(30, 20, |_, _| 0.0);
    for (x, y, value) in [
        (10, 8, 4.0),
        (11, 8, 2.5),
        (11, 9, 2.0),
        (20, 8, 4.0),
        (1, 1, 9.0),
    ] {
        map.data[y * 30 + x] = value;
    }
    let found = peak(&map, &params);
    assert_eq!(found.value, 4.0);
    let place = found.place.unwrap();
    assert_eq!((place.peak, place.bounds), ([10, 8], [10, 8, 12, 10]));
    // A grid that is all margin has no peak.
    assert_eq!(peak(&Plane::from_fn(7, 7, |_, _| 1.0), &params).place, None);
}

#[test]
fn thresholds_are_percentiles_of_the_clips_largest_scores() {
    let clip = |scores: &[f64]| {
        let mut series = FaultSeries::default();
        for (frame, &score) in scores.iter().enumerate() {
            let point = FaultPoint {
                frame,
                score,
                place: None,
            };
            series.add(FaultKind::Jump, point, Plane::from_fn(1, 1, |_, _| 0.0));
        }
        series
    };
    let clean: Vec<FaultSeries> = (0..=100)
        .map(|k| clip(&[0.0, f64::from(k), 0.5 * f64::from(k)]))
        .collect();
    let fitted = fit_thresholds(&clean, 99.0).unwrap();
    assert_eq!(fitted.jump, Some(99.0));
    assert_eq!(fit_thresholds(&clean[..2], 50.0).unwrap().jump, Some(0.5));
    assert_eq!((fitted.bad_frame, fitted.vanish), (None, None));
    assert!(fit_thresholds(&clean, 101.0).is_err());
    assert!(fit_thresholds(&clean, f64::NAN).is_err());
    // Of the 101 clips one is above the 99th percentile.
    let flagged = clean.iter().filter(|c| !c.events(&fitted).is_empty());
    assert_eq!(flagged.count(), 1);
}

#[test]
fn events_are_runs_and_the_worst_comes_first() {
    let mut series = FaultSeries::default();
    let plane = || Plane::from_fn(1, 1, |_, _| 0.0);
    let mut add = |kind, scores: &[f64]| {
        for (frame, &score) in scores.iter().enumerate() {
            let point = FaultPoint {
                frame: frame + 3,
                score,
                place: None,
            };
            series.add(kind, point, plane());
        }
    };
    add(FaultKind::Jump, &[0.0, 2.0, 3.0, 1.5, 0.0, 4.0, 0.0]);
    add(FaultKind::Flicker, &[f64::NAN, 0.0, 9.0]);
    let thresholds = FaultThresholds {
        jump: Some(1.0),
        flicker: Some(1.0),
        ..FaultThresholds::UNCALIBRATED
    };
    let events = series.events(&thresholds);
    let seen: Vec<_> = events
        .iter()
        .map(|e| (e.kind, e.frame, e.first_frame, e.last_frame))
        .collect();
    assert_eq!(
        seen,
        [
            (FaultKind::Flicker, 5, 5, 5),
            (FaultKind::Jump, 8, 8, 8),
            (FaultKind::Jump, 5, 4, 6)
        ]
    );
    assert_eq!(events[0].severity(), 9.0);
}

#[test]
fn wrong_input_is_an_error_and_changes_nothing() {
    let frame = picture(ground);
    let fine = pair(&frame, &frame, [0.0; 2]);
    let small = NormalisedFrame {
        grey: Plane::from_fn(9, 9, |_, _| 0.0),
        normalised: Plane::from_fn(9, 9, |_, _| 0.0),
    };
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    let input = |frame, picture, adjacent| FaultInput {
        frame,
        picture,
        adjacent,
        skip: None,
        skip_ahead: None,
    };
    stream.push(input(4, &frame, None)).unwrap();
    assert!(matches!(
        stream.push(input(6, &frame, Some(&fine))),
        Err(FaultError::OutOfOrder {
            frame: 6,
            previous: 4
        })
    ));
    assert!(matches!(
        stream.push(input(5, &frame, None)),
        Err(FaultError::MissingPair { frame: 5 })
    ));
    assert!(matches!(
        stream.push(input(5, &small, Some(&fine))),
        Err(FaultError::SizeMismatch { .. })
    ));
    let mut broken = fine.clone();
    broken.backward_change.data.pop();
    assert!(matches!(
        stream.push(input(5, &frame, Some(&broken))),
        Err(FaultError::SizeMismatch { .. })
    ));
    stream.push(input(5, &frame, Some(&fine))).unwrap();
    assert_eq!(stream.finish(true).points(FaultKind::Jump).len(), 1);
    let params = FaultParams {
        quiet_scale: 0.0,
        ..FaultParams::default()
    };
    assert!(FaultStream::new(params).is_err());
    let empty = FaultStream::new(FaultParams::default()).unwrap();
    assert_eq!(empty.finish(true), FaultSeries::default());
}

#[test]
fn one_way_across_tells_that_a_lively_clip_has_no_bad_frame() {
    // Every frame is another texture: V is bounded by 1 without what lies across, and 0 with it.
    let clip = [0, 1, 2].map(|t| picture(|x, y| ((x * 37 + y * 91 + t * x * y) % 251) as f32));
    let least = 0.05;
    let mut stream = FaultStream::new(FaultParams::default()).unwrap();
    stream.leave_out_bad_frames_below(least);
    let pairs = [
        pair(&clip[0], &clip[1], [0.0; 2]),
        pair(&clip[1], &clip[2], [0.0; 2]),
    ];
    let across = pair(&clip[0], &clip[2], [0.0; 2]);
    let ahead = Some(&across.forward_change);
    for (t, picture) in clip.iter().enumerate() {
        if t == 2 {
            assert!(stream.may_be_bad(&pairs[1], None));
            assert!(!stream.may_be_bad(&pairs[1], ahead));
        }
        let input = FaultInput {
            frame: t,
            picture,
            adjacent: t.checked_sub(1).map(|pair| &pairs[pair]),
            skip: None,
            skip_ahead: ahead.filter(|_| t == 2),
        };
        stream.push(input).unwrap();
    }
    let series = stream.finish(true);
    let found = series.points(FaultKind::BadFrame);
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].frame, found[0].score), (1, 0.0));
}

#[test]
fn what_is_left_out_of_bad_frame_is_below_what_was_told() {
    let clip = one_bad_frame();
    let full = still_clip(&clip, 1);
    let full = full.points(FaultKind::BadFrame);
    let largest = full.iter().map(|point| point.score).fold(0.0, f64::max);
    assert!(largest > 0.0);
    for least in [0.5 * largest, 2.0 * largest] {
        let mut stream = FaultStream::new(FaultParams::default()).unwrap();
        stream.leave_out_bad_frames_below(least);
        let (mut looked_across, mut looked_back) = (0, 0);
        for (t, picture) in clip.iter().enumerate() {
            let adjacent = (t >= 1).then(|| pair(&clip[t - 1], picture, [0.0; 2]));
            let is_asked = |ahead| {
                let adjacent = adjacent.as_ref();
                adjacent.is_some_and(|pair| stream.may_be_bad(pair, ahead))
            };
            let across = is_asked(None).then(|| pair(&clip[t - 2], picture, [0.0; 2]));
            looked_across += usize::from(across.is_some());
            // One way may tell what the adjacent pairs do not.
            let ahead = across.as_ref().map(|across| &across.forward_change);
            let skip = across.as_ref().filter(|_| is_asked(ahead));
            looked_back += usize::from(skip.is_some());
            let input = FaultInput {
                frame: t + 1,
                picture,
                adjacent: adjacent.as_ref(),
                skip,
                skip_ahead: ahead,
            };
            stream.push(input).unwrap();
        }
        let series = stream.finish(true);
        let found = series.points(FaultKind::BadFrame);
        assert_eq!(found.len(), full.len());
        for (found, full) in found.iter().zip(full) {
            let is_same = found == full;
            let is_left_out = found.score == 0.0 && full.score < least;
            assert!(is_same || is_left_out, "{found:?} {full:?}");
            assert_eq!(found.frame, full.frame);
        }
        assert!(looked_across < full.len());
        assert_eq!(looked_back > 0, least < largest);
    }
}
