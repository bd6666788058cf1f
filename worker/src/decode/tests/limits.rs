//! Limits are enforced from the header, and again where the header is silent or lies.

use ffmpeg_next::format::Pixel;

use super::super::{DecodeError, DecodeLimits, LimitKind};
use super::{decode, decode_with, encode, patch, settings, small};

fn refused(bytes: &[u8], limits: &DecodeLimits) -> (LimitKind, f64, usize) {
    let (result, frames) = decode_with(bytes, limits);
    match result {
        Err(DecodeError::OverLimit { what, value, .. }) => (what, value, frames.len()),
        other => panic!("expected a limit, got {other:?}"),
    }
}

#[test]
fn defaults_pass_4k_and_refuse_8k() {
    let limits = DecodeLimits::default();
    assert!(limits.check_size(4096, 2160).is_ok() && limits.check_size(2160, 3840).is_ok());
    assert!(limits.check_size(8192, 8192).is_err() && limits.check_size(u64::MAX, 2).is_err());
    let json = serde_json::to_string(&limits).expect("serialises");
    assert_eq!(
        serde_json::from_str::<DecodeLimits>(&json).expect("parses"),
        limits
    );
    assert_eq!(
        serde_json::from_str::<DecodeLimits>("{}").expect("parses"),
        limits
    );
}

/// A track whose container header alone gives the size.
fn png_movie() -> Vec<u8> {
    encode(&settings("mov", "png", Pixel::RGB24), 10, 64, 48).expect("own encoder")
}

#[test]
fn a_header_that_claims_8k_is_refused_before_any_frame() {
    let mut bytes = png_movie();
    // ISO 14496-12 VisualSampleEntry: width and height lie 28 bytes after the entry's name begins.
    patch(&mut bytes, b"png ", 28, &[0x20, 0, 0x20, 0]);
    let (what, value, frames) = refused(&bytes, &DecodeLimits::default());
    assert_eq!(
        (what, value, frames),
        (LimitKind::PixelsPerFrame, 8192.0 * 8192.0, 0)
    );
}

#[test]
fn headers_give_frames_bytes_and_duration() {
    for muxer in ["mp4", "avi", "gif"] {
        let limits = DecodeLimits {
            max_frames: 9,
            ..DecodeLimits::default()
        };
        assert_eq!(
            refused(&small(muxer), &limits),
            (LimitKind::Frames, 10.0, 0),
            "{muxer}"
        );
    }
    for muxer in ["mp4", "matroska", "avi"] {
        let limits = DecodeLimits {
            max_duration_s: 0.3,
            ..DecodeLimits::default()
        };
        let (what, value, frames) = refused(&small(muxer), &limits);
        assert_eq!((what, frames), (LimitKind::DurationS, 0), "{muxer}");
        assert!((value - 0.4).abs() < 0.05, "{muxer}: {value}");
    }
    let bytes = small("mp4");
    let limits = DecodeLimits {
        max_bytes: bytes.len() as u64 - 1,
        ..DecodeLimits::default()
    };
    assert_eq!(refused(&bytes, &limits).0, LimitKind::Bytes);
    let exact = DecodeLimits {
        max_bytes: bytes.len() as u64,
        max_frames: 10,
        max_pixels_per_frame: 64 * 48,
        max_duration_s: 0.4,
    };
    assert!(
        decode_with(&bytes, &exact).0.is_ok(),
        "limits are inclusive"
    );
}

#[test]
fn silent_headers_are_limited_while_decoding() {
    // Matroska does not count its frames.
    let limits = DecodeLimits {
        max_frames: 6,
        ..DecodeLimits::default()
    };
    assert_eq!(
        refused(&small("matroska"), &limits),
        (LimitKind::Frames, 7.0, 6)
    );
    // A piped AVI states placeholders.
    let mut piped = small("avi");
    patch(&mut piped, b"RIFF", 4, &[0xff; 4]);
    assert_eq!(refused(&piped, &limits), (LimitKind::Frames, 7.0, 6));
    let limits = DecodeLimits {
        max_duration_s: 0.19,
        ..DecodeLimits::default()
    };
    assert_eq!(refused(&piped, &limits).2, 5);
    assert!(decode(&piped).0.is_ok());
}

#[test]
fn a_header_that_lies_small_delivers_no_large_picture() {
    let mut bytes = png_movie();
    patch(&mut bytes, b"png ", 28, &[0, 16, 0, 16]);
    let limits = DecodeLimits {
        max_pixels_per_frame: 32 * 32,
        ..DecodeLimits::default()
    };
    let (result, frames) = decode_with(&bytes, &limits);
    assert!(result.is_err() && frames.is_empty());
}

#[test]
fn stretched_pixels_count_as_presented() {
    let mut options = settings("matroska", "mpeg4", Pixel::YUV420P);
    options.encoder_options.push(("aspect", "8:1"));
    let bytes = encode(&options, 2, 64, 48).expect("own encoder");
    let limits = DecodeLimits {
        max_pixels_per_frame: 64 * 48 * 4,
        ..DecodeLimits::default()
    };
    assert_eq!(
        refused(&bytes, &limits),
        (LimitKind::PixelsPerFrame, 512.0 * 48.0, 0)
    );
    assert!(decode(&bytes).0.is_ok());
}
