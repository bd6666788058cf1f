//! Episodes in a longer file: the same frames as decoding the whole and cutting, bit for bit. That is the slow
//! twin of everything here.

use std::fs::File;
use std::io::Write;
use std::ops::ControlFlow;

use ffmpeg_next::format::Pixel;

use super::super::{DecodeError, DecodeLimits, DecodedFrame, Interval, VideoInfo, decode_interval};
use super::{decode, encode, encode_at, index_first, scene, settings};

/// Of the clips here.
const FPS: i64 = 25;
const FRAMES: usize = 40;

/// Frames `from..to`, from half a frame before each.
pub(super) fn frames(from: i64, to: i64) -> Interval {
    let ns = |frame: i64| (2 * frame - 1) * 500_000_000 / FPS;
    Interval {
        from_ns: ns(from),
        to_ns: ns(to),
    }
}

fn file_of(bytes: &[u8]) -> File {
    let mut file = tempfile::NamedTempFile::new().expect("temporary file");
    file.write_all(bytes).expect("clip is written");
    file.reopen().expect("second handle")
}

fn cut_with(
    bytes: &[u8],
    interval: Interval,
    limits: &DecodeLimits,
) -> (Result<VideoInfo, DecodeError>, Vec<DecodedFrame>) {
    let mut delivered = Vec::new();
    let result = decode_interval(file_of(bytes), interval, limits, &mut |frame| {
        delivered.push(frame);
        ControlFlow::Continue(())
    });
    (result, delivered)
}

pub(super) fn cut(
    bytes: &[u8],
    interval: Interval,
) -> (Result<VideoInfo, DecodeError>, Vec<DecodedFrame>) {
    cut_with(bytes, interval, &DecodeLimits::default())
}

/// A clip of [`FRAMES`] frames whose keyframes are `group` frames apart.
fn clip(muxer: &'static str, encoder: &'static str, group: &'static str) -> Option<Vec<u8>> {
    let mut settings = settings(muxer, encoder, Pixel::YUV420P);
    settings.encoder_options.push(("g", group));
    // MPEG-4's encoder makes none by itself.
    if encoder == "mpeg4" {
        settings.encoder_options.push(("bf", "2"));
    }
    encode(&settings, FRAMES, 64, 48)
}

#[test]
fn an_interval_is_what_cutting_the_whole_gives() {
    for (muxer, encoder) in [
        ("mp4", "libx264"),
        ("mp4", "libx265"),
        ("mp4", "mpeg4"),
        ("mp4", "libaom-av1"),
        ("webm", "libvpx-vp9"),
        ("matroska", "libx264"),
    ] {
        // One keyframe for all, several per interval, and one every frame.
        for group in ["250", "7", "1"] {
            let Some(bytes) = clip(muxer, encoder, group) else {
                continue;
            };
            let what = format!("{muxer}/{encoder}, group {group}");
            let (whole, all) = decode(&bytes);
            let whole = whole.expect("decodes");
            assert_eq!(all.len(), FRAMES, "{what}");
            for (from, to) in [
                (0, 6),
                (6, 7),
                (7, 14),
                (9, 23),
                (20, 21),
                (23, 40),
                (0, 40),
                (39, 40),
            ] {
                let (info, episode) = cut(&bytes, frames(from, to));
                let info = info.unwrap_or_else(|error| panic!("{what}, {from}..{to}: {error}"));
                let expected = &all[from as usize..to as usize];
                assert_eq!(episode.len(), expected.len(), "{what}, {from}..{to}");
                for (index, (a, b)) in episode.iter().zip(expected).enumerate() {
                    assert_eq!(a.index as usize, index);
                    assert!(
                        a.rgb == b.rgb,
                        "{what}, {from}..{to}: frame {index} differs"
                    );
                    // The difference of two rounded times.
                    let time_s = b.time_s - expected[0].time_s;
                    assert!((a.time_s - time_s).abs() < 1e-9, "{what}");
                }
                assert_eq!(
                    (
                        info.width,
                        info.height,
                        info.frames as usize,
                        &info.pixel_format
                    ),
                    (64, 48, expected.len(), &whole.pixel_format)
                );
                assert_eq!(
                    (
                        info.rejected_packets,
                        info.damaged_frames,
                        info.silent_packets
                    ),
                    (0, 0, 0),
                    "{what}, {from}..{to}"
                );
                assert!(!info.stopped_early);
            }
        }
    }
}

#[test]
fn a_file_of_its_own_and_a_part_of_a_lossless_one_give_the_same_frames() {
    let mut lossless = settings("mp4", "libx264", Pixel::YUV420P);
    lossless.encoder_options = vec![("qp", "0"), ("preset", "veryfast"), ("g", "250")];
    let of = |range: std::ops::Range<usize>| {
        let pictures: Vec<_> = range.map(|index| scene(index, 64, 48)).collect();
        let ticks: Vec<i64> = (0..pictures.len() as i64).collect();
        encode_at(&lossless, &pictures, &ticks)
    };
    let Some(joined) = of(0..30) else { return };
    for (from, to) in [(0, 8), (8, 20), (20, 30)] {
        let alone = decode(&of(from..to).expect("the encoder is there")).1;
        let (info, part) = cut(&joined, frames(from as i64, to as i64));
        assert!(part == alone, "{from}..{to}");
        assert_eq!(info.expect("decodes").fps, Some(25.0));
    }
}

#[test]
fn times_that_are_half_a_frame_off_take_no_frame_of_a_neighbour() {
    let bytes = clip("mp4", "mpeg4", "12").expect("FFmpeg's own encoder");
    for off_ns in [-19_000_000, -1, 0, 1, 19_000_000] {
        let Interval { from_ns, to_ns } = frames(5, 15);
        let moved = Interval {
            from_ns: from_ns + off_ns,
            to_ns: to_ns + off_ns,
        };
        assert_eq!(cut(&bytes, moved).1.len(), 10, "{off_ns}");
    }
}

#[test]
fn limits_are_the_intervals_own() {
    let bytes = clip("mp4", "mpeg4", "250").expect("FFmpeg's own encoder");
    let limits = DecodeLimits {
        max_frames: 10,
        max_duration_s: 0.4,
        ..DecodeLimits::default()
    };
    let (info, episode) = cut_with(&bytes, frames(25, 35), &limits);
    assert_eq!((info.expect("within").frames, episode.len()), (10, 10));
    for interval in [frames(25, 36), frames(0, i64::from(u32::MAX))] {
        let refused = cut_with(&bytes, interval, &limits).0;
        assert!(
            matches!(refused, Err(DecodeError::OverLimit { .. })),
            "{refused:?}"
        );
    }
    let small = DecodeLimits {
        max_pixels_per_frame: 100,
        ..limits
    };
    let refused = cut_with(&bytes, frames(0, 1), &small).0;
    assert!(
        matches!(refused, Err(DecodeError::OverLimit { .. })),
        "{refused:?}"
    );
}

#[test]
fn what_lies_outside_of_the_file_or_is_cut_off_is_told() {
    let bytes = index_first(&clip("mp4", "mpeg4", "5").expect("FFmpeg's own encoder"));
    let reason = |bytes: &[u8], interval| {
        cut(bytes, interval)
            .0
            .expect_err("must be refused")
            .to_string()
    };
    for (interval, decoded) in [
        (frames(40, 50), 0),
        (frames(30, 60), 10),
        (frames(1000, 1001), 0),
    ] {
        let said = reason(&bytes, interval);
        assert!(
            said.contains(&format!("ends after {decoded} frames")),
            "{said}"
        );
    }
    // Nothing is wrong with an episode before the cut.
    let cut_off = &bytes[..bytes.len() - bytes.len() / 4];
    assert!(decode(cut_off).0.is_err());
    assert_eq!(cut(cut_off, frames(0, 20)).0.expect("is whole").frames, 20);
    assert!(reason(cut_off, frames(20, 40)).contains("truncated"));
    assert!(reason(b"", frames(0, 1)).contains("empty"));
    assert!(reason(b"#EXTM3U\n/etc/passwd\n", frames(0, 1)).contains("playlist"));
}

#[test]
fn a_pause_within_an_episode_is_no_end() {
    let settings = settings("mp4", "mpeg4", Pixel::YUV420P);
    let pictures: Vec<_> = (0..10).map(|index| scene(index, 64, 48)).collect();
    let ticks: Vec<i64> = (0..10)
        .map(|index| if index < 5 { index } else { index + 20 })
        .collect();
    let bytes = encode_at(&settings, &pictures, &ticks).expect("FFmpeg's own encoder");
    let (info, episode) = cut(&bytes, frames(2, 27));
    let info = info.expect("decodes");
    assert!(info.variable_frame_rate);
    assert_eq!(episode.len(), 5);
}

#[test]
fn damage_elsewhere_in_the_file_is_nothing_to_an_episode() {
    let mut bytes = clip("mp4", "mpeg4", "10").expect("FFmpeg's own encoder");
    let all = decode(&bytes).1;
    let at = super::find(&bytes, b"mdat") + 4;
    // The first group's pictures, mostly.
    for byte in &mut bytes[at + 40..at + 300] {
        *byte ^= 0x5a;
    }
    let (info, episode) = cut(&bytes, frames(20, 30));
    assert_eq!(info.expect("is whole").frames, 10);
    assert!(
        episode
            .iter()
            .zip(&all[20..30])
            .all(|(a, b)| a.rgb == b.rgb)
    );
}
