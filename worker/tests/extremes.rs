//! The hard frames of the flow tests as whole clips, from image files to a row: every clip gets a typed
//! status, and no number in its row is NaN or infinite.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "what cannot be built or measured fails the test"
)]

mod row;

use std::path::Path;

use plumbline_common::row::{Measurement, Status};
use plumbline_worker::profile::Rung;

/// Enough for every statistic: past the conditioning frame and the paper's warm-up.
const FRAMES: usize = 10;

/// Grey level of column x, row y of frame t.
type Scene = fn(usize, usize, usize) -> u8;

/// Name, width and height, pictures, statuses that may come of them.
type Case = (&'static str, (u32, u32), Scene, &'static [Status]);

fn write_frames(directory: &Path, (width, height): (u32, u32), scene: Scene) {
    for frame in 0..FRAMES {
        let picture = image::GrayImage::from_fn(width, height, |x, y| {
            image::Luma([scene(x as usize, y as usize, frame)])
        });
        picture
            .save(directory.join(format!("{frame:02}.png")))
            .unwrap();
    }
}

fn row(size: (u32, u32), scene: Scene, rung: Rung) -> Measurement {
    let directory = tempfile::tempdir().unwrap();
    write_frames(directory.path(), size, scene);
    row::of_pictures(directory.path(), rung)
}

/// JSON writes NaN as null, so the row is looked at as Rust prints it.
fn assert_finite(row: &Measurement, name: &str) {
    let text = format!("{row:?}");
    let words: Vec<&str> = text.split(|c: char| !c.is_alphanumeric()).collect();
    for bad in ["NaN", "inf"] {
        assert!(!words.contains(&bad), "{name}: {text}");
    }
}

fn noise(x: usize, y: usize, t: usize) -> u8 {
    let mixed = (x * 7919 + 13) ^ (y * 104_729 + 7) ^ (t * 1_299_709 + 3);
    (mixed.wrapping_mul(2_654_435_761) >> 16) as u8
}

#[test]
fn degenerate_clips_get_a_typed_row_without_a_nan() {
    let small = (48, 32);
    let cases: [Case; 9] = [
        ("all black", small, |_, _, _| 0, &[Status::Static]),
        ("all white", small, |_, _, _| 255, &[Status::Static]),
        (
            "black and white in turn",
            small,
            |_, _, t| if t % 2 == 0 { 0 } else { 255 },
            &[Status::Static],
        ),
        (
            "half black, half white",
            small,
            |x, _, _| if x < 24 { 0 } else { 255 },
            &[Status::Static],
        ),
        (
            "halves that swap",
            small,
            |x, _, t| if (x < 24) == (t % 2 == 0) { 0 } else { 255 },
            &[Status::Static, Status::Collapsed, Status::Scored],
        ),
        (
            "16x16",
            (16, 16),
            |x, y, t| noise((x + t) / 4, y / 4, 0),
            &[Status::Static, Status::Collapsed, Status::Scored],
        ),
        (
            "moves by more than its width",
            small,
            |x, y, t| noise((x + 61 * t) / 5, y / 5, 0),
            &[Status::Collapsed, Status::Scored],
        ),
        (
            "another noise in every frame",
            small,
            noise,
            &[Status::Collapsed, Status::Scored],
        ),
        ("1x64", (1, 64), |_, y, _| y as u8, &[Status::OverLimit]),
    ];
    for (name, size, scene, expected) in cases {
        for rung in [Rung::Draft, Rung::Standard] {
            let row = row(size, scene, rung);
            assert!(
                expected.contains(&row.status),
                "{name} at {rung:?}: {:?} {:?}",
                row.status,
                row.status_reason
            );
            assert_finite(&row, name);
            let says_why = row.status_reason.is_some();
            assert_eq!(says_why, row.status != Status::Scored, "{name}");
        }
    }
}

#[test]
fn a_line_of_pixels_is_refused_with_its_remedy() {
    let row = row((64, 1), |x, _, _| x as u8, Rung::Draft);
    assert_eq!(row.status, Status::OverLimit);
    let reason = row.status_reason.unwrap();
    assert!(
        reason.contains("64×1") && reason.contains("crop it"),
        "{reason}"
    );
}

/// The largest frames that the limits let through, in motion: by 34 px per frame, 4 px at the working size.
#[test]
fn frames_of_4096_by_2160_are_scored() {
    let scene: Scene = |x, y, t| noise((x + 34 * t) / 96, y / 96, 0);
    let row = row((4096, 2160), scene, Rung::Standard);
    assert_eq!(row.status, Status::Scored, "{:?}", row.status_reason);
    assert_finite(&row, "4096x2160");
    // The whole picture slides: one homography explains it.
    let moved_px = row.motion_px.unwrap();
    assert!((moved_px - 34.0 * 256.0 / 2160.0).abs() < 0.4, "{moved_px}");
    assert!(row.reproj_px.unwrap() < 0.5, "{:?}", row.reproj_px);
}
