//! Directories of numbered images.

use std::ops::ControlFlow;
use std::path::Path;

use image::{ImageFormat, RgbImage};
use plumbline_vision::image::Rgb8;

use super::super::{
    DecodeError, DecodeLimits, DecodedFrame, LimitKind, VideoInfo, decode_images, digest_images,
    is_image_sequence,
};
use super::{psnr_db, scene};

fn save(dir: &Path, name: &str, frame: &Rgb8) {
    let picture = RgbImage::from_raw(frame.width as u32, frame.height as u32, frame.data.clone())
        .expect("sizes agree");
    let format = if name.ends_with("png") {
        ImageFormat::Png
    } else {
        ImageFormat::Jpeg
    };
    picture
        .save_with_format(dir.join(name), format)
        .expect("saves");
}

fn decode(
    dir: &Path,
    limits: &DecodeLimits,
) -> (Result<VideoInfo, DecodeError>, Vec<DecodedFrame>) {
    let mut frames = Vec::new();
    let result = decode_images(dir, 8.0, limits, &mut |frame| {
        frames.push(frame);
        ControlFlow::Continue(())
    });
    (result, frames)
}

fn reason(dir: &Path) -> String {
    decode(dir, &DecodeLimits::default())
        .0
        .expect_err("must be refused")
        .to_string()
}

fn sequence(names: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("directory");
    for (index, name) in names.iter().enumerate() {
        save(dir.path(), name, &scene(index, 32, 24));
    }
    dir
}

#[test]
fn numbers_give_the_order_and_other_files_are_ignored() {
    let dir = sequence(&["v2_f8.png", "v2_f9.png", "v2_f10.png", "v2_f11.png"]);
    std::fs::write(dir.path().join(".hidden1.png"), b"x").expect("writes");
    std::fs::write(dir.path().join("notes1.txt"), b"x").expect("writes");
    std::fs::write(dir.path().join("cover.png"), b"x").expect("writes");
    std::fs::create_dir(dir.path().join("sub1.png")).expect("creates");
    assert!(is_image_sequence(dir.path()));
    let (result, frames) = decode(dir.path(), &DecodeLimits::default());
    let info = result.expect("decodes");
    assert_eq!(
        (info.frames, info.width, info.height, info.codec.as_str()),
        (4, 32, 24, "png")
    );
    assert_eq!((info.fps, info.duration_s), (Some(8.0), Some(0.5)));
    for (index, frame) in frames.iter().enumerate() {
        assert_eq!(
            (frame.index as usize, frame.time_s),
            (index, index as f64 / 8.0)
        );
        assert_eq!(frame.rgb, scene(index, 32, 24), "png is lossless");
    }
}

#[test]
fn jpeg_decodes() {
    let dir = sequence(&["1.jpg", "2.jpg"]);
    let (result, frames) = decode(dir.path(), &DecodeLimits::default());
    assert_eq!(result.expect("decodes").codec, "jpeg");
    // The encoder's default quality 75 with 4:2:0 or 4:4:4 chroma stays above 28 dB on this picture.
    assert!(psnr_db(&frames[1].rgb, &scene(1, 32, 24)) > 28.0);
}

#[test]
fn broken_sequences_name_the_file() {
    let dir = sequence(&["f1.png", "f2.png", "f3.png"]);
    save(dir.path(), "f2.png", &scene(1, 16, 24));
    assert!(reason(dir.path()).contains("f2.png is 16x24"));
    std::fs::write(dir.path().join("f2.png"), b"\x89PNG\r\n\x1a\nbroken").expect("writes");
    assert!(reason(dir.path()).contains("f2.png does not decode"));
    std::fs::write(dir.path().join("f2.png"), b"plain text").expect("writes");
    assert!(reason(dir.path()).contains("f2.png is not a png or jpeg"));
    std::fs::write(dir.path().join("f2.png"), b"").expect("writes");
    assert!(reason(dir.path()).contains("f2.png is empty"));
    let whole = std::fs::read(dir.path().join("f1.png")).expect("reads");
    for end in (1..whole.len()).step_by(1 + whole.len() / 40) {
        std::fs::write(dir.path().join("f2.png"), &whole[..end]).expect("writes");
        // Only the end mark may be missing: then every pixel is there.
        let (result, frames) = decode(dir.path(), &DecodeLimits::default());
        match result {
            Ok(_) => assert_eq!(frames[1].rgb, frames[0].rgb, "cut to {end}"),
            Err(error) => assert!(error.to_string().contains("f2.png"), "cut to {end}"),
        }
    }
}

#[test]
fn numbering_must_be_even_and_unique() {
    assert!(
        reason(sequence(&["f1.png", "f2.png", "f4.png"]).path()).contains("number 3 is missing")
    );
    assert!(reason(sequence(&["a1.png", "b01.png"]).path()).contains("same number"));
    let strided = sequence(&["f0.png", "f10.png", "f20.png"]);
    assert_eq!(
        decode(strided.path(), &DecodeLimits::default())
            .0
            .expect("decodes")
            .frames,
        3
    );
}

#[test]
fn limits_hold_before_pixels_are_decoded() {
    let dir = sequence(&["f1.png", "f2.png", "f3.png"]);
    for (limits, kind) in [
        (
            DecodeLimits {
                max_frames: 2,
                ..DecodeLimits::default()
            },
            LimitKind::Frames,
        ),
        (
            DecodeLimits {
                max_bytes: 100,
                ..DecodeLimits::default()
            },
            LimitKind::Bytes,
        ),
        (
            DecodeLimits {
                max_pixels_per_frame: 32 * 24 - 1,
                ..DecodeLimits::default()
            },
            LimitKind::PixelsPerFrame,
        ),
        (
            DecodeLimits {
                max_duration_s: 0.3,
                ..DecodeLimits::default()
            },
            LimitKind::DurationS,
        ),
    ] {
        let (result, frames) = decode(dir.path(), &limits);
        assert!(
            matches!(result, Err(DecodeError::OverLimit { what, .. }) if what == kind),
            "{kind:?}"
        );
        assert!(frames.is_empty());
    }
}

#[test]
fn what_is_no_sequence() {
    let dir = sequence(&["f1.png"]);
    assert!(!is_image_sequence(dir.path()));
    assert!(!is_image_sequence(&dir.path().join("none")));
    assert!(matches!(
        decode(&dir.path().join("none"), &DecodeLimits::default()).0,
        Err(DecodeError::Io { .. })
    ));
    let empty = tempfile::tempdir().expect("directory");
    assert!(matches!(
        decode(empty.path(), &DecodeLimits::default()).0,
        Err(DecodeError::Empty { .. })
    ));
    let mut never = |_| ControlFlow::Continue(());
    for fps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let result = decode_images(dir.path(), fps, &DecodeLimits::default(), &mut never);
        assert!(matches!(result, Err(DecodeError::InvalidRate { .. })));
    }
}

#[test]
fn the_digest_covers_names_bytes_and_order() {
    let dir = sequence(&["f1.png", "f2.png"]);
    let digest = || digest_images(dir.path()).expect("digests");
    let first = digest();
    assert_eq!(first, digest());
    std::fs::write(dir.path().join("notes.txt"), b"x").expect("writes");
    assert_eq!(first, digest(), "other files do not count");
    std::fs::rename(dir.path().join("f2.png"), dir.path().join("f3.png")).expect("renames");
    assert_ne!(first, digest());
    // Swapped contents under the same names.
    let swapped = sequence(&["f2.png", "f1.png"]);
    assert_ne!(first, digest_images(swapped.path()).expect("digests"));
}
