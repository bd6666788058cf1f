//! Decoding, tested on clips that our own encoder makes at run time (no committed videos, no `ffmpeg` binary).

mod headers;
mod hostile;
mod image_dirs;
mod intervals;
mod limits;
mod round_trip;

use std::ops::ControlFlow;

use ffmpeg_next::format::Pixel;
use ffmpeg_next::format::context::StreamIo;
use ffmpeg_next::{Rational, encoder};
use plumbline_vision::image::Rgb8;

use super::convert::BT470BG;
use super::{BT709, DecodeError, DecodeLimits, DecodedFrame, VideoInfo, decode_video};
use crate::encode::{ClipWriter, Settings};

/// A smooth coloured background with a textured square that moves 2 px per frame.
pub(super) fn scene(index: usize, width: usize, height: usize) -> Rgb8 {
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let (left, top) = (4 + 2 * index, 8);
            let inside = x >= left && x < left + 16 && y >= top && y < top + 16;
            let texture = if inside {
                ((x - left) / 4 + (y - top) / 4) % 2 * 60
            } else {
                0
            };
            data.push((40 + 150 * x / width.max(2) + texture) as u8);
            data.push((60 + 120 * y / height.max(2)) as u8);
            data.push((90 + index % 32 + texture) as u8);
        }
    }
    Rgb8 {
        width,
        height,
        data,
    }
}

pub(super) fn settings(
    muxer: &'static str,
    encoder: &'static str,
    pixel_format: Pixel,
) -> Settings {
    // AVI carries no BT.709 tag, and untagged small pictures are BT.601; VP8 is BT.601 by its specification.
    let matrix = if muxer == "avi" || encoder == "libvpx" {
        BT470BG
    } else {
        BT709
    };
    let encoder_options = match encoder {
        "libx264" => vec![("crf", "14"), ("preset", "veryfast")],
        "libx265" => vec![
            ("crf", "14"),
            ("preset", "veryfast"),
            ("x265-params", "log-level=none:pools=1"),
        ],
        "libvpx" | "libvpx-vp9" => vec![
            ("qmax", "12"),
            ("b", "2000000"),
            ("cpu-used", "8"),
            ("deadline", "realtime"),
        ],
        "libaom-av1" => vec![("crf", "16"), ("cpu-used", "8"), ("usage", "realtime")],
        "mpeg4" | "mjpeg" => vec![("flags", "+qscale"), ("global_quality", "236")],
        _ => Vec::new(),
    };
    Settings {
        muxer,
        encoder,
        pixel_format,
        matrix,
        encoder_options,
        muxer_options: Vec::new(),
    }
}

/// The clip of `frames` shown from `ticks` (at 25 ticks per second), or nothing where FFmpeg lacks the encoder.
pub(super) fn encode_at(settings: &Settings, frames: &[Rgb8], ticks: &[i64]) -> Option<Vec<u8>> {
    if encoder::find_by_name(settings.encoder).is_none() {
        println!("skipped: no encoder {}", settings.encoder);
        return None;
    }
    let file = tempfile::NamedTempFile::new().expect("temporary file");
    let io =
        StreamIo::from_write_seek(file.reopen().expect("second handle")).expect("custom output");
    let (width, height) = (frames[0].width as u32, frames[0].height as u32);
    let mut clip =
        ClipWriter::new(io, settings, width, height, Rational(25, 1)).expect("encoder opens");
    for (frame, &tick) in frames.iter().zip(ticks) {
        clip.push_at(frame, tick).expect("frame encodes");
    }
    clip.finish().expect("clip completes");
    Some(std::fs::read(file.path()).expect("clip reads"))
}

pub(super) fn encode(
    settings: &Settings,
    count: usize,
    width: usize,
    height: usize,
) -> Option<Vec<u8>> {
    let frames: Vec<Rgb8> = (0..count)
        .map(|index| scene(index, width, height))
        .collect();
    let ticks: Vec<i64> = (0..count as i64).collect();
    encode_at(settings, &frames, &ticks)
}

/// A ten-frame 64×48 clip in a codec that every FFmpeg can write.
pub(super) fn small(muxer: &'static str) -> Vec<u8> {
    let settings = match muxer {
        "gif" => settings("gif", "gif", Pixel::RGB8),
        other => settings(other, "mpeg4", Pixel::YUV420P),
    };
    encode(&settings, 10, 64, 48).expect("FFmpeg's own encoders are always there")
}

pub(super) fn decode_with(
    bytes: &[u8],
    limits: &DecodeLimits,
) -> (Result<VideoInfo, DecodeError>, Vec<DecodedFrame>) {
    let mut frames = Vec::new();
    let result = decode_video(bytes.into(), limits, &mut |frame| {
        assert_eq!(frame.rgb.data.len(), frame.rgb.width * frame.rgb.height * 3);
        frames.push(frame);
        ControlFlow::Continue(())
    });
    (result, frames)
}

pub(super) fn decode(bytes: &[u8]) -> (Result<VideoInfo, DecodeError>, Vec<DecodedFrame>) {
    decode_with(bytes, &DecodeLimits::default())
}

pub(super) fn reason<T: std::fmt::Debug>(result: Result<T, DecodeError>) -> String {
    result.expect_err("must be refused").to_string()
}

/// Peak signal-to-noise ratio over all samples, dB.
pub(super) fn psnr_db(a: &Rgb8, b: &Rgb8) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let sum: f64 = a
        .data
        .iter()
        .zip(&b.data)
        .map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2))
        .sum();
    10.0 * (255.0 * 255.0 / (sum / a.data.len() as f64).max(1e-9)).log10()
}

/// Replaces the first occurrence of a pattern of equal length.
pub(super) fn patch(bytes: &mut [u8], pattern: &[u8], offset: usize, with: &[u8]) {
    let at = find(bytes, pattern) + offset;
    bytes[at..at + with.len()].copy_from_slice(with);
}

pub(super) fn find(bytes: &[u8], pattern: &[u8]) -> usize {
    bytes
        .windows(pattern.len())
        .position(|window| window == pattern)
        .expect("pattern is in the clip")
}

/// Top-level ISO boxes as (name, whole box).
pub(super) fn boxes(bytes: &[u8]) -> Vec<(&[u8], &[u8])> {
    let mut all = Vec::new();
    let mut at = 0;
    while at + 8 <= bytes.len() {
        let size = u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes")) as usize;
        all.push((&bytes[at + 4..at + 8], &bytes[at..at + size]));
        at += size;
    }
    all
}

/// The same mp4 with its index first, as web servers write it.
pub(super) fn index_first(bytes: &[u8]) -> Vec<u8> {
    let parts = boxes(bytes);
    let mut moov = parts
        .iter()
        .find(|(name, _)| name == b"moov")
        .expect("index")
        .1
        .to_vec();
    let shift = moov.len() as u32;
    let at = find(&moov, b"stco") + 8;
    let count = u32::from_be_bytes(moov[at..at + 4].try_into().expect("count")) as usize;
    for entry in 0..count {
        let place = at + 4 + 4 * entry;
        let old = u32::from_be_bytes(moov[place..place + 4].try_into().expect("offset"));
        moov[place..place + 4].copy_from_slice(&(old + shift).to_be_bytes());
    }
    let mut out = parts[0].1.to_vec();
    out.extend(moov);
    for (name, part) in &parts[1..] {
        if name != b"moov" {
            out.extend_from_slice(part);
        }
    }
    out
}
