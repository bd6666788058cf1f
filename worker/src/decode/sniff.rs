//! What a file is, from its first bytes: never from its name.
//!
//! Four containers are decoded (ISO base media: mp4 and mov; Matroska and WebM; AVI; GIF). Everything else
//! is refused by name, above all text that *points* at other files or hosts (HLS, DASH, concat scripts):
//! choosing FFmpeg's demuxer ourselves is what keeps those out (design, section 10).

use super::DecodeError;

/// A container that is decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Container {
    /// ISO base media file (MP4, QuickTime, 3GP), fragmented or not.
    Mp4,
    /// Matroska or WebM.
    Matroska,
    /// RIFF AVI.
    Avi,
    /// GIF87a or GIF89a.
    Gif,
}

impl Container {
    /// Short name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mp4 => "mp4",
            Self::Matroska => "matroska",
            Self::Avi => "avi",
            Self::Gif => "gif",
        }
    }
}

/// As much of the file as is looked at, bytes.
pub(super) const SNIFF_BYTES: usize = 4096;

/// Top-level boxes with which an ISO base media file may begin.
const ISO_FIRST_BOXES: [&[u8; 4]; 11] = [
    b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot", b"styp", b"moof", b"sidx",
    b"uuid",
];

/// `ftyp` brands of still pictures (HEIF, AVIF).
const STILL_BRANDS: [&[u8; 4]; 6] = [b"avif", b"heic", b"heix", b"mif1", b"heim", b"heis"];

/// Signatures at offset 0 that are named in the error, with the remedy.
const OTHERS: [(&[u8], &str); 22] = [
    (b"\x89PNG\r\n\x1a\n", SINGLE_IMAGE),
    (b"\xff\xd8\xff", SINGLE_IMAGE),
    (b"BM", SINGLE_IMAGE),
    (b"II*\0", SINGLE_IMAGE),
    (b"MM\0*", SINGLE_IMAGE),
    (
        b"#EXTM3U",
        "a playlist (HLS); playlists are never followed, so download the video itself",
    ),
    (
        b"<MPD",
        "a playlist (DASH); playlists are never followed, so download the video itself",
    ),
    (
        b"[playlist]",
        "a playlist; playlists are never followed, so give the video itself",
    ),
    (b"ffconcat", CONCAT),
    (b"file '", CONCAT),
    (
        b"v=0",
        "a session description (SDP); streams are never opened, so give a recorded file",
    ),
    (b"OggS", "an Ogg file; remux it to mp4, mkv or webm"),
    (b"FLV", "a Flash video; remux it to mp4 or mkv"),
    (
        b"\x30\x26\xb2\x75",
        "a Windows Media file; re-encode it to mp4 or webm",
    ),
    (
        b"\0\0\x01\xba",
        "an MPEG program stream; remux it to mp4 or mkv",
    ),
    (
        b"\0\0\x01\xb3",
        "a bare MPEG video stream; remux it to mp4 or mkv",
    ),
    (
        b"\0\0\0\x01",
        "a bare H.264 or H.265 stream without times; remux it to mp4 or mkv",
    ),
    (b"ID3", "an audio file (MP3); give a file with pictures"),
    (b"fLaC", "an audio file (FLAC); give a file with pictures"),
    (b"PK\x03\x04", "a zip archive; unpack it first"),
    (b"\x1f\x8b", "a gzip archive; unpack it first"),
    (
        b"version https://git-lfs",
        "a git-lfs pointer; run `git lfs pull` to get the video itself",
    ),
];

const SINGLE_IMAGE: &str = "a single image; put numbered images in a directory";
const CONCAT: &str = "a concat script; scripts are never followed, so join the clips into one file";
const MPEG_TS_PACKET_BYTES: usize = 188;
const EBML_MAGIC: &[u8] = b"\x1a\x45\xdf\xa3";

/// The container of `bytes` by its magic bytes.
///
/// # Errors
/// [`DecodeError::Empty`] for no bytes, [`DecodeError::NotAVideo`] naming what the bytes look like.
pub fn sniff(bytes: &[u8]) -> Result<Container, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty {
            what: "the file".into(),
        });
    }
    let head = &bytes[..bytes.len().min(SNIFF_BYTES)];
    if let Some(first_box) = head.get(4..8)
        && ISO_FIRST_BOXES
            .iter()
            .any(|known| known.as_slice() == first_box)
    {
        if first_box == b"ftyp"
            && head
                .get(8..12)
                .is_some_and(|brand| STILL_BRANDS.iter().any(|still| still.as_slice() == brand))
        {
            return not_a_video(SINGLE_IMAGE);
        }
        return Ok(Container::Mp4);
    }
    if head.starts_with(EBML_MAGIC) {
        return sniff_ebml(head);
    }
    if head.starts_with(b"GIF87a") || head.starts_with(b"GIF89a") {
        return Ok(Container::Gif);
    }
    if head.starts_with(b"RIFF") {
        return match head.get(8..12) {
            Some(b"AVI ") => Ok(Container::Avi),
            Some(b"WAVE") => not_a_video("an audio file (WAV); give a file with pictures"),
            Some(b"WEBP") => {
                not_a_video("a WebP picture; convert it to gif, mp4 or numbered images")
            }
            _ => not_a_video("a RIFF file of another kind; convert it to mp4, mkv, avi or gif"),
        };
    }
    not_a_video(name_other(head))
}

/// Matroska's EBML header states its document type within the first few dozen bytes.
fn sniff_ebml(head: &[u8]) -> Result<Container, DecodeError> {
    let contains = |word: &[u8]| head.windows(word.len()).any(|window| window == word);
    if contains(b"matroska") || contains(b"webm") {
        Ok(Container::Matroska)
    } else {
        not_a_video("an EBML file that is neither Matroska nor WebM; remux it to mp4, mkv or webm")
    }
}

fn name_other(head: &[u8]) -> &'static str {
    let text = head
        .strip_prefix(b"\xef\xbb\xbf")
        .unwrap_or(head)
        .trim_ascii_start();
    if let Some((_, name)) = OTHERS
        .iter()
        .find(|(magic, _)| head.starts_with(magic) || text.starts_with(magic))
    {
        return name;
    }
    if head[0] == 0x47
        && head
            .get(MPEG_TS_PACKET_BYTES)
            .is_none_or(|&sync| sync == 0x47)
        && !text_like(head)
    {
        return "an MPEG transport stream; remux it to mp4 or mkv";
    }
    if head.iter().all(|&byte| byte == 0) {
        return "only zero bytes; the download or copy failed, so copy it again";
    }
    if text_like(head) {
        let contains = |word: &[u8]| {
            text.windows(word.len())
                .any(|window| window.eq_ignore_ascii_case(word))
        };
        return if contains(b"<mpd") {
            "a playlist (DASH); playlists are never followed, so download the video itself"
        } else if contains(b"<html") {
            "a web page; the download gave a page instead of the video, so download it again"
        } else if text.starts_with(b"<") {
            "an XML document, perhaps a store's error message; download the video again"
        } else {
            "a text file; give a video (mp4, mov, mkv, webm, avi, gif)"
        };
    }
    "unknown bytes; supported are mp4, mov, mkv, webm, avi, gif and directories of numbered png or jpeg images"
}

/// No control bytes but white space; bytes from 128 may be UTF-8.
fn text_like(head: &[u8]) -> bool {
    head.iter()
        .all(|&byte| byte >= 0x20 && byte != 0x7f || matches!(byte, b'\t' | b'\n' | b'\r'))
}

fn not_a_video<T>(looks_like: &str) -> Result<T, DecodeError> {
    Err(DecodeError::NotAVideo {
        looks_like: looks_like.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(bytes: &[u8]) -> String {
        sniff(bytes).expect_err("must be refused").to_string()
    }

    #[test]
    fn containers_are_known_by_magic_bytes() {
        assert_eq!(sniff(b"\0\0\0\x18ftypmp42").ok(), Some(Container::Mp4));
        assert_eq!(sniff(b"\0\0\0\x08wide").ok(), Some(Container::Mp4));
        assert_eq!(
            sniff(b"\x1a\x45\xdf\xa3\x9f\x42\x82\x84webm").ok(),
            Some(Container::Matroska)
        );
        assert_eq!(sniff(b"RIFF\0\0\0\0AVI LIST").ok(), Some(Container::Avi));
        assert_eq!(sniff(b"GIF89a").ok(), Some(Container::Gif));
    }

    #[test]
    fn everything_else_is_named() {
        for (bytes, word) in [
            (b"#EXTM3U\n#EXT-X-VERSION:3\n".as_slice(), "HLS"),
            (b"\xef\xbb\xbf\n #EXTM3U", "HLS"),
            (b"ffconcat version 1.0\nfile a.mp4", "concat"),
            (b"file 'a.mp4'\n", "concat"),
            (b"<?xml version=\"1.0\"?>\n<MPD>", "DASH"),
            (b"<!DOCTYPE html><HTML>", "web page"),
            (b"\x89PNG\r\n\x1a\n\0\0", "numbered images"),
            (b"\xff\xd8\xff\xe0", "numbered images"),
            (b"\0\0\0\x1cftypavif", "numbered images"),
            (b"RIFF\0\0\0\0WAVE", "audio"),
            (b"\x1a\x45\xdf\xa3\x01\x02", "EBML"),
            (b"hello\n", "text file"),
            (b"Great news", "text file"),
            (b"\0\0\0\0\0\0\0\0\0\0", "zero bytes"),
            (b"\x01\x02\x03\x04\x05", "unknown"),
            (b"\x01", "unknown"),
        ] {
            let message = refusal(bytes);
            assert!(message.contains(word), "{message:?} should name {word:?}");
        }
        assert!(matches!(sniff(b""), Err(DecodeError::Empty { .. })));
    }
}
