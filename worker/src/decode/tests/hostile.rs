//! Hostile and broken bytes: typed errors, no panic, nothing else opened.

use std::io::{Cursor, ErrorKind};
use std::net::TcpListener;

use super::super::{DecodeError, DecodeLimits, ffi, video_shape};
use super::intervals::{cut, frames};
use super::{boxes, decode, find, index_first, reason, settings, small};

/// A server on this machine that must not be asked for anything.
struct Bait {
    listener: TcpListener,
    url: String,
}

impl Bait {
    fn lay() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
        listener.set_nonblocking(true).expect("non-blocking");
        let url = format!("http://{}/a.ts", listener.local_addr().expect("address"));
        Self { listener, url }
    }

    fn was_taken(&self) -> bool {
        !matches!(self.listener.accept(), Err(error) if error.kind() == ErrorKind::WouldBlock)
    }
}

fn playlist(target: &str) -> Vec<u8> {
    format!("#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\n{target}\n#EXT-X-ENDLIST\n").into_bytes()
}

#[test]
fn playlists_and_scripts_open_nothing() {
    let bait = Bait::lay();
    for target in [bait.url.as_str(), "file:///etc/hostname", "/etc/hostname"] {
        let (result, frames) = decode(&playlist(target));
        assert!(
            matches!(&result, Err(DecodeError::NotAVideo { looks_like }) if looks_like.contains("HLS"))
        );
        assert!(frames.is_empty());
        assert!(matches!(
            decode(format!("ffconcat version 1.0\nfile '{target}'\n").as_bytes()).0,
            Err(DecodeError::NotAVideo { .. })
        ));
    }
    assert!(!bait.was_taken());
}

/// The second wall: even a demuxer that follows links gets nothing through our input.
#[test]
fn linking_demuxers_are_refused_behind_the_sniffer_too() {
    let bait = Bait::lay();
    // The concat demuxer takes relative names only, so the clip must lie below the working directory. Without
    // the refusals of `ffi::open` it reads all ten packets; HLS does not start on an input without a name.
    let dir = tempfile::Builder::new()
        .prefix("linked-")
        .tempdir_in(".")
        .expect("directory");
    std::fs::write(dir.path().join("a.mp4"), small("mp4")).expect("writes");
    let folder = dir
        .path()
        .file_name()
        .and_then(|name| name.to_str())
        .expect("name");
    for (bytes, demuxer) in [
        (playlist(&bait.url), c"hls"),
        (playlist(&format!("{folder}/a.mp4")), c"hls"),
        (
            format!("ffconcat version 1.0\nfile {folder}/a.mp4\n").into_bytes(),
            c"concat",
        ),
    ] {
        match ffi::open(Cursor::new(bytes), demuxer) {
            Ok(mut input) => assert_eq!(input.packets().count(), 0, "{demuxer:?} read something"),
            Err(error) => println!("{demuxer:?}: {error}"),
        }
    }
    assert!(!bait.was_taken());
}

/// An mp4 whose data is said to lie elsewhere: QuickTime's file alias and the ISO url box.
#[test]
fn external_media_references_are_not_followed() {
    let bait = Bait::lay();
    let dir = tempfile::tempdir().expect("directory");
    let clip = dir.path().join("other.mp4");
    let original = small("mp4");
    std::fs::write(&clip, &original).expect("writes");

    let (result, frames) = decode(&with_reference(
        &original,
        &alias(&clip.display().to_string()),
    ));
    assert!(frames.is_empty());
    assert!(reason(result).contains("0 of 10 frames decode"));

    let mut url = b"url \0\0\0\0".to_vec();
    url.extend_from_slice(bait.url.as_bytes());
    url.push(0);
    let (result, frames) = decode(&with_reference(&original, &url));
    // FFmpeg takes no notice of the url: what decodes is the data in this very file.
    assert!(result.is_err() || frames.len() == 10);
    assert!(!bait.was_taken());
}

/// QuickTime alias record (the fields that FFmpeg's mov demuxer reads), absolute path in extension 2.
fn alias(path: &str) -> Vec<u8> {
    let mut record = b"alis\0\0\0\0".to_vec();
    record.extend([0; 10]);
    record.push(3);
    record.extend_from_slice(b"vol");
    record.extend([0; 24 + 12]);
    record.push(9);
    record.extend_from_slice(b"other.mp4");
    record.extend([0; 54 + 16]);
    record.extend([0, 1, 0, 1]);
    record.extend([0; 16]);
    record.extend([0, 2]);
    record.extend_from_slice(&(path.len() as u16).to_be_bytes());
    record.extend_from_slice(path.as_bytes());
    if path.len() % 2 == 1 {
        record.push(0);
    }
    record.extend([0xff, 0xff, 0, 0]);
    record
}

/// Replaces the `url ` entry of an mp4 whose index comes last, and mends the sizes of the boxes around it.
fn with_reference(bytes: &[u8], entry: &[u8]) -> Vec<u8> {
    let own = b"\0\0\0\x0curl \0\0\0\x01";
    let at = find(bytes, own);
    let grown = (entry.len() + 4) as i64 - own.len() as i64;
    let mut out = bytes[..at].to_vec();
    out.extend_from_slice(&(entry.len() as u32 + 4).to_be_bytes());
    out.extend_from_slice(entry);
    out.extend_from_slice(&bytes[at + own.len()..]);
    for name in [b"moov", b"trak", b"mdia", b"minf", b"dinf", b"dref"] {
        let place = find(bytes, name) - 4;
        let size = u32::from_be_bytes(bytes[place..place + 4].try_into().expect("size"));
        out[place..place + 4].copy_from_slice(&((i64::from(size) + grown) as u32).to_be_bytes());
    }
    out
}

#[test]
fn empty_text_and_soundless_files_are_named() {
    assert!(matches!(decode(b"").0, Err(DecodeError::Empty { .. })));
    assert!(reason(decode(b"just some text\n").0).contains("text file"));
    // The same clips, said to be sound.
    for (muxer, pattern, with) in [("mp4", b"vide", b"soun"), ("avi", b"vids", b"auds")] {
        let mut bytes = small(muxer);
        let at = find(&bytes, pattern);
        bytes[at..at + 4].copy_from_slice(with);
        assert!(
            matches!(decode(&bytes).0, Err(DecodeError::NoVideoStream)),
            "{muxer}"
        );
    }
}

#[test]
fn a_missing_decoder_is_named() {
    let mut bytes = small("mp4");
    let at = find(&bytes, b"mp4v");
    bytes[at..at + 4].copy_from_slice(b"zzz9");
    let at = find(&bytes, b"esds");
    bytes[at..at + 4].copy_from_slice(b"free");
    assert!(reason(decode(&bytes).0).contains("no decoder for none (zzz9)"));
}

fn fragmented() -> Vec<u8> {
    let mut options = settings("mp4", "mpeg4", ffmpeg_next::format::Pixel::YUV420P);
    options
        .muxer_options
        .push(("movflags", "frag_every_frame+empty_moov"));
    super::encode(&options, 10, 64, 48).expect("own encoder")
}

/// FFmpeg would reserve gigabytes for what two kilobytes claim.
#[test]
fn tables_that_claim_more_samples_than_there_are_bytes_are_refused() {
    // Where the count stands after the table's name.
    for (mut bytes, table, count_at) in [(fragmented(), b"trun", 8), (small("mp4"), b"stsz", 12)] {
        let at = find(&bytes, table) + count_at;
        bytes[at..at + 4].copy_from_slice(&(5_u32 << 24).to_be_bytes());
        let limits = DecodeLimits::default();
        let header = video_shape(Cursor::new(bytes.clone()), None, &limits);
        for result in [
            decode(&bytes).0.map(drop),
            cut(&bytes, frames(2, 5)).0.map(drop),
            header.map(drop),
        ] {
            assert!(reason(result).contains("more pictures than the file has bytes"));
        }
    }
}

/// A cut clip is never scored, wherever the cut is.
#[test]
fn no_truncation_passes() {
    for (name, bytes) in [
        ("index last", small("mp4")),
        ("index first", index_first(&small("mp4"))),
        ("fragmented", fragmented()),
        ("matroska", small("matroska")),
        ("avi", small("avi")),
        ("gif", small("gif")),
    ] {
        assert_eq!(decode(&bytes).0.expect(name).frames, 10);
        let ends: Vec<usize> = (0..50)
            .map(|i| i * bytes.len() / 50)
            .chain([1, 2, 9, bytes.len() - 1])
            .collect();
        for end in ends {
            // A fragmented clip that ends between two fragments is a shorter clip: nothing in it says otherwise.
            if name == "fragmented" && boxes_end_at(&bytes, end) {
                continue;
            }
            let (result, frames) = decode(&bytes[..end]);
            assert!(
                result.is_err(),
                "{name} cut to {end} of {} bytes passes",
                bytes.len()
            );
            assert!(frames.len() <= 10);
        }
    }
}

fn boxes_end_at(bytes: &[u8], end: usize) -> bool {
    let mut at = 0;
    boxes(bytes).iter().any(|(_, part)| {
        at += part.len();
        at == end
    })
}

#[test]
fn truncation_says_how_much_is_left() {
    let whole = index_first(&small("mp4"));
    let message = reason(decode(&whole[..whole.len() - 1]).0);
    assert_eq!(
        message,
        "truncated: 9 of 10 frames decode; re-copy the file"
    );
    let whole = small("mp4");
    assert!(reason(decode(&whole[..whole.len() - 1]).0).contains("moov"));
}

/// 240 seeded mutations of up to 8 bytes: any outcome but a crash or an untyped one. Larger runs are done by hand.
#[test]
fn flipped_bytes_never_crash() {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let clips = [
        small("mp4"),
        fragmented(),
        small("matroska"),
        small("avi"),
        small("gif"),
    ];
    let mut refused = 0;
    for round in 0..240 {
        let mut bytes = clips[round % clips.len()].clone();
        for _ in 0..1 + random(8) {
            let at = random(bytes.len());
            bytes[at] ^= 1 << random(8);
        }
        let (result, frames) = decode(&bytes);
        match result {
            Ok(info) => assert_eq!(info.frames as usize, frames.len()),
            Err(error) => {
                refused += 1;
                assert!(!error.to_string().is_empty());
            }
        }
    }
    assert!(
        refused > 20,
        "mutations reach the decoder: {refused} refused"
    );
}
