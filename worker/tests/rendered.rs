//! Rendered clips from picture files to a row: a frame that is broken collapses the clip whatever it was
//! replaced by, and rigid layers explain what moves where nothing is wrong.

#![allow(
    clippy::unwrap_used,
    reason = "what cannot be rendered or measured fails the test"
)]

mod row;

use plumbline_common::row::{Measurement, Status};
use plumbline_sample::corpus::FaultSpec;
use plumbline_sample::{ClipSpec, Family, FaultKind, RgbFrame};
use plumbline_worker::profile::Rung;

fn frames(clip: &ClipSpec) -> Vec<RgbFrame> {
    clip.render_frames().map(Result::unwrap).collect()
}

fn row(frames: &[RgbFrame], rung: Rung) -> Measurement {
    let directory = tempfile::tempdir().unwrap();
    for (number, frame) in frames.iter().enumerate() {
        let (width, height) = (frame.width as u32, frame.height as u32);
        let picture = image::RgbImage::from_raw(width, height, frame.rgb.clone()).unwrap();
        picture
            .save(directory.path().join(format!("{number:02}.png")))
            .unwrap();
    }
    row::of_pictures(directory.path(), rung)
}

/// A byte of noise, by place.
fn noise(place: usize) -> u8 {
    let mixed = (place as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 56) as u8
}

/// Byte `i` of a picture that is `width` bytes wide.
type Replacement = fn(usize, usize) -> u8;

/// What a frame is replaced by.
const REPLACEMENTS: [(&str, Replacement); 5] = [
    ("noise", |i, _| noise(i)),
    ("blocks", |i, width| {
        noise(i % width / 36 + 1000 * (i / width / 12))
    }),
    ("black", |_, _| 0),
    ("white", |_, _| 255),
    ("grey", |_, _| 128),
];

#[test]
fn a_broken_frame_collapses_the_clip() {
    let clip = ClipSpec {
        frames: 12,
        ..ClipSpec::clean(Family::Reach, 0, 3)
    };
    let clean = frames(&clip);
    for rung in [Rung::Draft, Rung::Standard] {
        assert_eq!(row(&clean, rung).status, Status::Scored, "{rung:?}");
    }
    // Inside, first measured and last: each kind at one of them, all places with some kind.
    let places = [6, 1, 11, 8, 3];
    for (k, (name, byte)) in REPLACEMENTS.into_iter().enumerate() {
        for (rung, at) in [
            (Rung::Standard, places[k]),
            (Rung::Draft, places[(k + 1) % 5]),
        ] {
            let mut broken = clean.clone();
            let width = 3 * broken[at].width;
            for (i, value) in broken[at].rgb.iter_mut().enumerate() {
                *value = byte(i, width);
            }
            let row = row(&broken, rung);
            let case = format!("{name} at {at}, {rung:?}: {:?}", row.status_reason);
            assert_eq!(row.status, Status::Collapsed, "{case}");
            let reason = row.status_reason.clone().unwrap();
            let named = (at..=at + 1).any(|frame| reason.contains(&format!("frame {frame} ")));
            assert!(named, "{case}");
            if rung == Rung::Standard {
                let peak = row.peak_frame.unwrap() as usize;
                assert!(peak.abs_diff(at) <= 1, "{case}: {peak}");
            }
        }
    }
}

#[test]
fn rigid_layers_explain_a_clean_arm_and_not_a_broken_frame() {
    let clip = ClipSpec {
        frames: 16,
        ..ClipSpec::clean(Family::Reach, 0, 3)
    };
    let at = 10;
    let faulty = clip.with_fault(FaultSpec {
        kind: FaultKind::NoiseFrame,
        first_frame: at,
        seed: 1,
    });
    let clean = row(&frames(&clip), Rung::Standard);
    let broken = row(&frames(&faulty), Rung::Standard);
    // The arm moves by some 2 px; what is left is the flow's own error at its joints and rim.
    let residual_px = clean.layer_residual_px.unwrap();
    assert!((0.1..1.0).contains(&residual_px), "{residual_px}");
    let of = |row: &Measurement| {
        let place = at - row.series.first_frame as usize;
        row.series.layer_residual_px[place]
    };
    // A clip pools its cells by weight, and few of a broken frame's agree; its own pair shows it.
    let usual = of(&clean).unwrap_or(residual_px);
    assert!(
        of(&broken).unwrap() > 2.0 * usual,
        "{:?} {usual}",
        of(&broken)
    );
    assert!(broken.layer_residual_px.unwrap() > residual_px);
    // Nothing moves: no value, not 0.
    let first = clip.render_frame(0).unwrap();
    let still = row(&vec![first; 6], Rung::Standard);
    assert_eq!(
        (still.status, still.layer_residual_px),
        (Status::Static, None)
    );
}
