//! What headers say, against decoding the same: the slow twin.

use std::fs::File;
use std::io::{Cursor, Write};

use ffmpeg_next::format::Pixel;
use image::{ExtendedColorType, ImageEncoder};

use super::super::{
    DecodeError, DecodeLimits, Interval, LimitKind, Shape, decode_images, decode_interval,
    images_shape, video_shape,
};
use super::{boxes, decode, encode, index_first, patch, scene, settings, small};

fn told(bytes: &[u8]) -> Result<Option<Shape>, DecodeError> {
    video_shape(Cursor::new(bytes.to_vec()), None, &DecodeLimits::default())
}

/// Ten frames whose size the container states.
fn sized() -> Vec<u8> {
    encode(&settings("mov", "png", Pixel::RGB24), 10, 64, 48).expect("own encoder")
}

/// As it is decoded.
fn decoded(bytes: &[u8]) -> Option<Shape> {
    let info = decode(bytes).0.ok()?;
    Some(Shape {
        frames: info.frames,
        width: info.width,
        height: info.height,
    })
}

#[test]
fn headers_say_what_decoding_gives() {
    let mut fragments = settings("mp4", "mpeg4", Pixel::YUV420P);
    fragments
        .muxer_options
        .push(("movflags", "frag_keyframe+empty_moov"));
    for (of, settings) in [
        ("mp4", settings("mp4", "libx264", Pixel::YUV420P)),
        ("mov", settings("mov", "png", Pixel::RGB24)),
        ("mkv", settings("matroska", "mpeg4", Pixel::YUV420P)),
        ("webm", settings("webm", "libvpx", Pixel::YUV420P)),
        ("avi", settings("avi", "mpeg4", Pixel::YUV420P)),
        ("gif", settings("gif", "gif", Pixel::RGB8)),
    ] {
        let Some(bytes) = encode(&settings, 23, 64, 48) else {
            continue;
        };
        let shape = decoded(&bytes).unwrap_or_else(|| panic!("{of} decodes"));
        assert_eq!(shape.frames, 23, "{of}");
        assert_eq!(told(&bytes).expect(of), Some(shape), "{of}");
    }
    // Turned by 90°, as in the test of decoding.
    let mut turned = sized();
    let entries = [0, 1, 0, -1, 0, 0, 0, 0, 1 << 14].map(|entry: i32| entry << 16);
    let matrix: Vec<u8> = entries.iter().flat_map(|e| e.to_be_bytes()).collect();
    patch(&mut turned, b"tkhd", 44, &matrix);
    let shape = told(&turned).expect("turned");
    assert_eq!(shape, decoded(&turned));
    assert_eq!(shape.map(|s| (s.width, s.height)), Some((48, 64)));
    // Without a count or a length up front nothing is made up.
    let bytes = encode(&fragments, 23, 64, 48).expect("own encoder");
    assert!(matches!(told(&bytes), Ok(None)), "{:?}", told(&bytes));
    // Of MPEG-4 the container's size is not trusted, and this one states its own between its pictures.
    assert!(matches!(told(&small("mp4")), Ok(None)));
    let mut piped = small("avi");
    patch(&mut piped, b"RIFF", 4, &[0xff; 4]);
    assert!(matches!(told(&piped), Ok(None)), "{:?}", told(&piped));
}

/// Of an mp4 nothing but its boxes' headers and its index is needed, wherever that is.
#[test]
fn pictures_are_not_read() {
    let last = sized();
    for bytes in [index_first(&last), last] {
        let expected = decoded(&bytes);
        assert!(expected.is_some());
        let mut emptied = Vec::new();
        for (name, whole) in boxes(&bytes) {
            if name == b"mdat" {
                emptied.extend(&whole[..8]);
                emptied.resize(emptied.len() + whole.len() - 8, 0);
            } else {
                emptied.extend(whole);
            }
        }
        assert_eq!(decoded(&emptied), None, "nothing is left to decode");
        assert_eq!(told(&emptied).expect("header"), expected);
    }
}

#[test]
fn what_decoding_refuses_by_the_header_is_refused() {
    let bytes = small("mp4");
    let limits = DecodeLimits {
        max_frames: 9,
        ..DecodeLimits::default()
    };
    assert!(matches!(
        video_shape(Cursor::new(bytes.clone()), None, &limits),
        Err(DecodeError::OverLimit {
            what: LimitKind::Frames,
            ..
        })
    ));
    // Where frames are not counted, a video over the limit is decoded up to it.
    let counted = video_shape(Cursor::new(small("matroska")), None, &limits);
    assert_eq!(counted.expect("header").map(|s| s.frames), Some(9));
    for not_a_video in [&b""[..], b"text", &bytes[..bytes.len() / 2]] {
        assert!(told(not_a_video).is_err());
    }
}

#[test]
fn episodes_are_as_long_as_their_time() {
    let bytes = sized();
    let mut file = tempfile::NamedTempFile::new().expect("temporary file");
    file.write_all(&bytes).expect("clip is written");
    let open = || File::open(file.path()).expect("clip opens");
    // 25 frames per second: frames 3 to 7, from half a frame before each.
    let interval = Interval {
        from_ns: 100_000_000,
        to_ns: 300_000_000,
    };
    let limits = DecodeLimits::default();
    let shape = video_shape(open(), Some(interval), &limits).expect("header");
    let info = decode_interval(open(), interval, &limits, &mut |_| {
        std::ops::ControlFlow::Continue(())
    });
    let info = info.expect("decodes");
    assert_eq!(
        shape.map(|s| (s.frames, s.width, s.height)),
        Some((info.frames, info.width, info.height))
    );
    assert_eq!(info.frames, 5);
}

#[test]
fn images_are_counted() {
    let dir = tempfile::tempdir().expect("directory");
    // An EXIF block that turns the picture by 90°: TIFF header, one entry, orientation 6.
    let turn = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    for turned in [false, true] {
        for index in 0..4 {
            let frame = scene(index, 32, 24);
            let path = dir.path().join(format!("{index}.png"));
            let file = File::create(path).expect("creates");
            let mut encoder = image::codecs::png::PngEncoder::new(file);
            if turned {
                encoder.set_exif_metadata(turn.to_vec()).expect("metadata");
            }
            encoder
                .write_image(&frame.data, 32, 24, ExtendedColorType::Rgb8)
                .expect("encodes");
        }
        let limits = DecodeLimits::default();
        let shape = images_shape(dir.path(), 8.0, &limits).expect("header");
        let info = decode_images(dir.path(), 8.0, &limits, &mut |_| {
            std::ops::ControlFlow::Continue(())
        });
        let info = info.expect("decodes");
        assert_eq!(info.width, if turned { 24 } else { 32 });
        assert_eq!(
            shape.map(|s| (s.frames, s.width, s.height)),
            Some((info.frames, info.width, info.height))
        );
        let few = DecodeLimits {
            max_frames: 3,
            ..limits
        };
        assert!(images_shape(dir.path(), 8.0, &few).is_err());
    }
}
