//! What goes in comes out: every codec that the linked FFmpeg can write, times, shapes, colours.

use std::ops::ControlFlow;

use ffmpeg_next::format::Pixel;
use plumbline_vision::image::Rgb8;

use super::super::orient::Orientation;
use super::super::{DecodeLimits, decode_video};
use super::{decode, encode, encode_at, patch, psnr_db, reason, scene, settings, small};
use crate::encode::{EncodeError, Mp4Writer};

/// 35 dB is what the codecs reach here at their near-transparent settings, 4:2:0 chroma included. GIF's 256
/// fixed colours give about 22 dB.
#[test]
fn every_codec_comes_back() {
    for (muxer, encoder, format, floor_db) in [
        ("mp4", "libx264", Pixel::YUV420P, 35.0),
        ("mp4", "libx264", Pixel::YUV420P10LE, 35.0),
        ("mp4", "libx265", Pixel::YUV420P, 35.0),
        ("mp4", "mpeg4", Pixel::YUV420P, 35.0),
        ("mp4", "libaom-av1", Pixel::YUV420P, 33.0),
        ("webm", "libvpx", Pixel::YUV420P, 33.0),
        ("webm", "libvpx-vp9", Pixel::YUV420P, 33.0),
        ("matroska", "ffv1", Pixel::YUV444P, 45.0),
        ("mov", "prores_ks", Pixel::YUVA444P10LE, 35.0),
        ("mov", "png", Pixel::RGB24, 90.0),
        ("avi", "mpeg4", Pixel::YUV420P, 35.0),
        ("avi", "mjpeg", Pixel::YUVJ420P, 33.0),
        ("gif", "gif", Pixel::RGB8, 18.0),
    ] {
        let Some(bytes) = encode(&settings(muxer, encoder, format), 10, 64, 48) else {
            continue;
        };
        let (result, frames) = decode(&bytes);
        let info = result.unwrap_or_else(|error| panic!("{muxer}/{encoder}: {error}"));
        assert_eq!(
            (info.frames, info.width, info.height),
            (10, 64, 48),
            "{muxer}/{encoder}"
        );
        assert_eq!(
            (
                info.dropped_frames,
                info.damaged_frames,
                info.rejected_packets,
                info.silent_packets
            ),
            (0, 0, 0, 0)
        );
        assert!(!info.variable_frame_rate, "{muxer}/{encoder}");
        // Millisecond clocks round each time by half a millisecond at most.
        assert!(
            (info.fps.expect("rate") - 25.0).abs() < 0.1,
            "{muxer}/{encoder}: {:?}",
            info.fps
        );
        assert!(
            (info.duration_s.expect("length") - 0.4).abs() < 2e-3,
            "{muxer}/{encoder}"
        );
        for (index, frame) in frames.iter().enumerate() {
            assert_eq!(frame.index as usize, index);
            assert!(
                (frame.time_s - index as f64 / 25.0).abs() < 1e-3,
                "{muxer}/{encoder} {}",
                frame.time_s
            );
            let db = psnr_db(&frame.rgb, &scene(index, 64, 48));
            assert!(
                db > floor_db,
                "{muxer}/{encoder} {format:?}, frame {index}: {db:.1} dB"
            );
        }
    }
}

#[test]
fn our_writer_round_trips_and_repeats_its_bytes() {
    let dir = tempfile::tempdir().expect("directory");
    let write = |name: &str| {
        let path = dir.path().join(name);
        let mut writer = Mp4Writer::create(&path, 128, 96, 30_000.0 / 1001.0).expect("creates");
        for index in 0..12 {
            writer.push(&scene(index, 128, 96)).expect("pushes");
        }
        assert!(!path.exists(), "nothing under the name before finish");
        writer.finish().expect("finishes");
        std::fs::read(path).expect("reads")
    };
    let bytes = write("a.mp4");
    assert!(bytes == write("b.mp4"), "two runs differ");
    assert_eq!(
        std::fs::read_dir(dir.path()).expect("lists").count(),
        2,
        "no temporary file is left"
    );
    let (result, frames) = decode(&bytes);
    let info = result.expect("decodes");
    assert_eq!((info.frames, info.container.as_str()), (12, "mp4"));
    assert!((info.fps.expect("rate") - 30_000.0 / 1001.0).abs() < 1e-6);
    for (index, frame) in frames.iter().enumerate() {
        assert!(psnr_db(&frame.rgb, &scene(index, 128, 96)) > 35.0);
    }
}

#[test]
fn our_writer_refuses_what_it_cannot_write() {
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("a.mp4");
    for (width, height, fps) in [
        (0, 4, 25.0),
        (4, 0, 25.0),
        (4, 4, 0.0),
        (4, 4, f64::NAN),
        (4, 4, -1.0),
        (1 << 20, 4, 25.0),
    ] {
        assert!(matches!(
            Mp4Writer::create(&path, width, height, fps),
            Err(EncodeError::Shape { .. })
        ));
    }
    let mut writer = Mp4Writer::create(&path, 8, 8, 25.0).expect("creates");
    assert!(matches!(
        writer.push(&scene(0, 8, 6)),
        Err(EncodeError::FrameSize { .. })
    ));
    assert!(matches!(writer.finish(), Err(EncodeError::NoFrames)));
    assert!(matches!(
        Mp4Writer::create(&dir.path().join("none/a.mp4"), 8, 8, 25.0),
        Err(EncodeError::Io { .. })
    ));
    assert_eq!(
        std::fs::read_dir(dir.path()).expect("lists").count(),
        0,
        "nothing is left behind"
    );
}

#[test]
fn tiny_and_odd_sizes_are_padded_by_repetition() {
    let dir = tempfile::tempdir().expect("directory");
    for (width, height, even) in [(1, 1, (2, 2)), (2, 2, (2, 2)), (33, 17, (34, 18))] {
        let path = dir.path().join("a.mp4");
        let mut writer =
            Mp4Writer::create(&path, width as u32, height as u32, 10.0).expect("creates");
        assert_eq!(writer.written_size(), even);
        for index in 0..3 {
            writer.push(&scene(index, width, height)).expect("pushes");
        }
        writer.finish().expect("finishes");
        let (result, frames) = decode(&std::fs::read(&path).expect("reads"));
        let info = result.expect("decodes");
        assert_eq!((info.width, info.height, info.frames), (even.0, even.1, 3));
        for frame in &frames {
            let pixel = |x: usize, y: usize| frame.rgb.data[(y * even.0 as usize + x) * 3 + 1];
            // The green ramp is smooth: the padded corner is its neighbour up to coding noise.
            assert!(pixel(even.0 as usize - 1, 0).abs_diff(pixel(width - 1, 0)) < 12);
        }
    }
}

#[test]
fn one_frame_has_neither_rate_nor_length() {
    for muxer in ["mp4", "avi", "matroska", "gif"] {
        let options = if muxer == "gif" {
            settings("gif", "gif", Pixel::RGB8)
        } else {
            settings(muxer, "mpeg4", Pixel::YUV420P)
        };
        let bytes = encode(&options, 1, 64, 48).expect("own encoder");
        let (result, frames) = decode(&bytes);
        let info = result.unwrap_or_else(|error| panic!("{muxer}: {error}"));
        assert_eq!(
            (info.frames, info.fps, info.duration_s, frames[0].time_s),
            (1, None, None, 0.0)
        );
    }
}

#[test]
fn variable_rate_keeps_its_times() {
    let ticks = [0_i64, 1, 2, 5, 6, 9, 14, 15];
    let frames: Vec<Rgb8> = (0..ticks.len()).map(|index| scene(index, 64, 48)).collect();
    for muxer in ["mp4", "matroska"] {
        let bytes = encode_at(&settings(muxer, "mpeg4", Pixel::YUV420P), &frames, &ticks)
            .expect("own encoder");
        let (result, decoded) = decode(&bytes);
        let info = result.expect("decodes");
        assert!(info.variable_frame_rate);
        let times: Vec<f64> = decoded.iter().map(|frame| frame.time_s).collect();
        for (time_s, tick) in times.iter().zip(ticks) {
            assert!(
                (time_s - tick as f64 / 25.0).abs() < 1e-3,
                "{muxer}: {times:?}"
            );
        }
        assert!((info.fps.expect("rate") - 7.0 * 25.0 / 15.0).abs() < 0.05);
    }
}

#[test]
fn colours_survive_both_matrices_and_ranges() {
    // Two codes per channel for 8-bit YCbCr rounding, and as much again for the coarse quantiser.
    for (muxer, encoder, format) in [
        ("mp4", "libx264", Pixel::YUV420P),
        ("avi", "mpeg4", Pixel::YUV420P),
        ("avi", "mjpeg", Pixel::YUVJ420P),
        ("mov", "prores_ks", Pixel::YUVA444P10LE),
    ] {
        for colour in [
            [200, 30, 40],
            [20, 180, 60],
            [30, 50, 220],
            [255, 255, 255],
            [0, 0, 0],
            [128, 128, 128],
        ] {
            let frame = Rgb8 {
                width: 32,
                height: 32,
                data: colour.repeat(32 * 32),
            };
            let Some(bytes) = encode_at(
                &settings(muxer, encoder, format),
                &[frame.clone(), frame],
                &[0, 1],
            ) else {
                continue;
            };
            let (result, frames) = decode(&bytes);
            result.expect("decodes");
            let middle = &frames[1].rgb.data[(16 * 32 + 16) * 3..][..3];
            let off = middle.iter().zip(colour).map(|(a, b)| a.abs_diff(b)).max();
            assert!(
                off <= Some(5),
                "{muxer}/{encoder}: {colour:?} came back as {middle:?}"
            );
        }
    }
}

#[test]
fn rotation_is_applied() {
    let upright = small("mp4");
    let (result, plain) = decode(&upright);
    assert_eq!(result.expect("decodes").rotation_deg, 0);
    for (a, b, c, d, degrees) in [(0, 1, -1, 0, 90), (-1, 0, 0, -1, 180), (0, -1, 1, 0, 270)] {
        let entries = [a, b, 0, c, d, 0, 0, 0, 1 << 14].map(|entry: i32| entry << 16);
        let big_endian: Vec<u8> = entries
            .iter()
            .flat_map(|entry| entry.to_be_bytes())
            .collect();
        let native: Vec<u8> = entries
            .iter()
            .flat_map(|entry| entry.to_ne_bytes())
            .collect();
        let mut turned = upright.clone();
        // ISO 14496-12: the matrix of a version-0 track header lies 44 bytes after the box's name begins.
        patch(&mut turned, b"tkhd", 44, &big_endian);
        let (result, frames) = decode(&turned);
        let info = result.expect("decodes");
        assert_eq!(info.rotation_deg, degrees);
        assert_eq!(
            (info.width, info.height),
            if degrees == 180 { (64, 48) } else { (48, 64) }
        );
        let expected = Orientation::from_display_matrix(&native);
        for (frame, plain) in frames.iter().zip(&plain) {
            assert_eq!(frame.rgb, expected.apply(&plain.rgb.data, 64 * 3, 64, 48));
        }
    }
}

#[test]
fn wide_pixels_become_square() {
    let mut options = settings("matroska", "mpeg4", Pixel::YUV420P);
    options.encoder_options.push(("aspect", "2:1"));
    let bytes = encode(&options, 3, 64, 48).expect("own encoder");
    let info = decode(&bytes).0.expect("decodes");
    assert_eq!(
        (
            info.width,
            info.height,
            info.coded_width,
            info.sample_aspect_ratio
        ),
        (128, 48, 64, 2.0)
    );
}

#[test]
fn a_change_of_size_is_refused() {
    let mut bytes =
        encode(&settings("avi", "mjpeg", Pixel::YUVJ420P), 6, 64, 48).expect("own encoder");
    let header: &[u8] = b"\xff\xc0\x00\x11\x08\x00\x30\x00\x40";
    let places: Vec<usize> = (0..bytes.len() - header.len())
        .filter(|&at| bytes[at..].starts_with(header))
        .collect();
    assert_eq!(places.len(), 6);
    bytes[places[4] + 6] = 0x20;
    let (result, frames) = decode(&bytes);
    assert_eq!(frames.len(), 4);
    assert!(reason(result).contains("changes from 64x48 to 64x32 at frame 4"));
}

#[test]
fn the_callback_may_stop() {
    let mut seen = 0;
    let info = decode_video(small("mp4").into(), &DecodeLimits::default(), &mut |_| {
        seen += 1;
        if seen == 3 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    let info = info.expect("stopping is not an error");
    assert_eq!((seen, info.frames, info.stopped_early), (3, 3, true));
}

#[test]
fn the_same_bytes_give_the_same_frames() {
    let bytes = small("mp4");
    assert_eq!(decode(&bytes).1, decode(&bytes).1);
}
