//! Does the file hold the bytes that its own headers promise? A walk over the outermost elements only.
//!
//! Sources: ISO/IEC 14496-12 boxes, RFC 9559 (Matroska) and RFC 8794 (EBML sizes), the RIFF chunk layout,
//! the GIF89a block grammar. This says *cut or not* where FFmpeg would end quietly; whether the frames
//! decode is for the decoder. Reads no byte out of range, never fails: what is not understood is unknown.

use super::Container;

/// What the outermost elements say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Structure {
    /// The file ends before its headers say.
    pub(super) is_cut: bool,
    /// ISO base media without its whole index (`moov`), so that nothing can be decoded.
    pub(super) lacks_index: bool,
    /// AVI whose writer could not seek back: its counts and lengths are placeholders.
    pub(super) has_placeholders: bool,
    /// Pictures counted, where walking gives it (GIF).
    pub(super) frames: Option<u64>,
}

/// Examines `bytes`, known to be `container`.
pub(super) fn examine(container: Container, bytes: &[u8]) -> Structure {
    match container {
        Container::Mp4 => iso_boxes(bytes),
        Container::Matroska => Structure {
            is_cut: matroska_is_cut(bytes),
            ..Structure::default()
        },
        Container::Avi => riff_chunks(bytes),
        Container::Gif => gif_blocks(bytes),
    }
}

/// What the first bytes alone say: whether counts and lengths are placeholders.
pub(super) fn of_head(container: Container, head: &[u8]) -> Structure {
    Structure {
        has_placeholders: container == Container::Avi && riff_chunks(head).has_placeholders,
        ..Structure::default()
    }
}

fn big_endian(bytes: &[u8]) -> u64 {
    bytes
        .iter()
        .fold(0, |value, &byte| value << 8 | u64::from(byte))
}

fn iso_boxes(bytes: &[u8]) -> Structure {
    let mut structure = Structure {
        lacks_index: true,
        ..Structure::default()
    };
    let mut at = 0_usize;
    while at < bytes.len() {
        let Some(header) = bytes.get(at..at + 8) else {
            structure.is_cut = true;
            break;
        };
        let (size, header_bytes) = match big_endian(&header[..4]) {
            0 => ((bytes.len() - at) as u64, 8),
            1 => match bytes.get(at + 8..at + 16) {
                Some(long) => (big_endian(long), 16),
                None => (u64::MAX, 16),
            },
            short => (short, 8),
        };
        // Not a box: trailing bytes of another kind, which players ignore.
        if size < header_bytes {
            break;
        }
        match usize::try_from(size)
            .ok()
            .and_then(|size| at.checked_add(size))
            .filter(|&end| end <= bytes.len())
        {
            Some(end) => {
                // A cut index counts as none: its sample tables would end early without a word.
                structure.lacks_index &= &header[4..] != b"moov";
                at = end;
            }
            None => {
                structure.is_cut = true;
                break;
            }
        }
    }
    structure
}

/// An EBML size at the start of `bytes`: its value (none when declared unknown) and its length.
fn ebml_size(bytes: &[u8]) -> Option<(Option<u64>, usize)> {
    let length = bytes.first()?.leading_zeros() as usize + 1;
    let field = bytes.get(..length).filter(|_| length <= 8)?;
    let mask = (1_u64 << (7 * length)) - 1;
    let value = big_endian(field) & mask;
    Some(((value != mask).then_some(value), length))
}

const EBML_HEADER_ID: &[u8] = b"\x1a\x45\xdf\xa3";
/// RFC 9559: element identifiers have at most four bytes.
const MAX_ID_BYTES: usize = 4;
const SEGMENT_ID: &[u8] = b"\x18\x53\x80\x67";

/// A segment of unknown size (a live recording) is judged by its elements: cut between two, it is not told.
fn matroska_is_cut(bytes: &[u8]) -> bool {
    let after_header = bytes.strip_prefix(EBML_HEADER_ID).and_then(|rest| {
        let (size, length) = ebml_size(rest)?;
        rest.get(length..)?.get(usize::try_from(size?).ok()?..)
    });
    let Some(rest) = after_header.filter(|rest| !rest.is_empty()) else {
        return true;
    };
    // Void elements may stand between; then nothing is claimed.
    let Some(segment) = rest.strip_prefix(SEGMENT_ID) else {
        return rest.len() < SEGMENT_ID.len();
    };
    match ebml_size(segment) {
        Some((Some(size), length)) => size > (segment.len() - length) as u64,
        Some((None, length)) => !elements_fit(&segment[length..]),
        None => true,
    }
}

/// Whether consecutive elements end with the bytes; clusters of unknown size are entered.
fn elements_fit(mut rest: &[u8]) -> bool {
    while let Some(&first) = rest.first() {
        let id_bytes = first.leading_zeros() as usize + 1;
        // Not an element: nothing is claimed of what follows.
        if id_bytes > MAX_ID_BYTES {
            return true;
        }
        let Some(after_id) = rest.get(id_bytes..) else {
            return false;
        };
        if after_id.first() == Some(&0) {
            return true;
        }
        let Some((size, length)) = ebml_size(after_id) else {
            return false;
        };
        let body = &after_id[length..];
        let next = match size {
            Some(size) => usize::try_from(size).ok().and_then(|size| body.get(size..)),
            None => Some(body),
        };
        match next {
            Some(next) => rest = next,
            None => return false,
        }
    }
    true
}

/// Sizes of 0 or all ones are left by writers that could not seek back: no cut is claimed then.
fn riff_chunks(bytes: &[u8]) -> Structure {
    let mut structure = Structure::default();
    let mut rest = bytes;
    while rest.starts_with(b"RIFF") {
        let size = rest.get(4..8).map_or(u32::MAX - 1, |f| {
            u32::from_le_bytes([f[0], f[1], f[2], f[3]])
        });
        if size == 0 || size == u32::MAX {
            structure.has_placeholders = true;
            break;
        }
        let end = 8 + size as usize;
        structure.is_cut = end > rest.len();
        rest = rest.get(end + (end & 1)..).unwrap_or_default();
    }
    structure
}

fn gif_blocks(bytes: &[u8]) -> Structure {
    let mut frames = 0;
    let whole = walk_gif(bytes, &mut frames).is_some();
    Structure {
        is_cut: !whole,
        frames: whole.then_some(frames),
        ..Structure::default()
    }
}

/// Walks to the trailer; none when the bytes end or break the grammar before it.
fn walk_gif(bytes: &[u8], frames: &mut u64) -> Option<()> {
    let mut at = 13 + gif_colour_table_bytes(*bytes.get(10)?);
    loop {
        match *bytes.get(at)? {
            0x3b => return Some(()),
            0x21 => at = skip_sub_blocks(bytes, at + 2)?,
            0x2c => {
                let colours = gif_colour_table_bytes(*bytes.get(at + 9)?);
                at = skip_sub_blocks(bytes, at + 10 + colours + 1)?;
                *frames += 1;
            }
            _ => return None,
        }
    }
}

fn gif_colour_table_bytes(packed: u8) -> usize {
    if packed & 0x80 == 0 {
        0
    } else {
        3 << ((packed & 7) + 1)
    }
}

fn skip_sub_blocks(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        let length = usize::from(*bytes.get(at)?);
        at += 1 + length;
        if length == 0 {
            return Some(at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iso_boxes_cut_and_without_index() {
        let whole = b"\0\0\0\x0cftypisom\0\0\0\x08moov\0\0\0\x0amdat12";
        let at = |n: usize| examine(Container::Mp4, &whole[..n]);
        assert_eq!(at(whole.len()), Structure::default());
        assert!(at(whole.len() - 1).is_cut && !at(whole.len() - 1).lacks_index);
        assert!(at(12).lacks_index && !at(12).is_cut);
        assert!(at(15).is_cut);
        // 64-bit size, and a size that runs to the end of the file.
        let long = b"\0\0\0\x01mdat\0\0\0\0\0\0\0\x11x\0\0\0\0moov";
        assert_eq!(examine(Container::Mp4, long), Structure::default());
        assert!(examine(Container::Mp4, &long[..12]).is_cut);
    }

    #[test]
    fn matroska_sizes() {
        let whole = b"\x1a\x45\xdf\xa3\x82hi\x18\x53\x80\x67\x83abc";
        assert!(!matroska_is_cut(whole));
        for n in 4..whole.len() {
            assert!(matroska_is_cut(&whole[..n]), "{n}");
        }
        assert!(!matroska_is_cut(
            b"\x1a\x45\xdf\xa3\x82hi\x18\x53\x80\x67\xff"
        ));
        assert!(!matroska_is_cut(
            b"\x1a\x45\xdf\xa3\x82hi\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xff"
        ));
    }

    #[test]
    fn live_recordings_are_judged_by_their_elements() {
        let live = b"\x1a\x45\xdf\xa3\x82hi\x18\x53\x80\x67\xff\x15\x49\xa9\x66\x81i\x1f\x43\xb6\x75\xff\xe7\x81\x00\xa3\x84abcd";
        assert!(!matroska_is_cut(live));
        assert!(matroska_is_cut(&live[..live.len() - 1]));
        assert!(matroska_is_cut(&live[..live.len() - 5]));
        assert!(
            !matroska_is_cut(&live[..live.len() - 6]),
            "a cut between elements leaves no trace"
        );
    }

    #[test]
    fn riff_sizes() {
        let cut = Structure {
            is_cut: true,
            ..Structure::default()
        };
        assert_eq!(riff_chunks(b"RIFF\x04\0\0\0AVI "), Structure::default());
        assert_eq!(riff_chunks(b"RIFF\x06\0\0\0AVI "), cut);
        assert_eq!(riff_chunks(b"RIFF\x04\0\0\0AVI RIFF\x40\0\0\0AVIX"), cut);
        assert_eq!(riff_chunks(b"RIFF\x04\0\0\0AVI RIFF\x40"), cut);
        let piped = riff_chunks(b"RIFF\xff\xff\xff\xffAVI ");
        assert!(piped.has_placeholders && !piped.is_cut);
    }

    #[test]
    fn gif_needs_its_trailer() {
        let whole = b"GIF89a\x01\0\x01\0\x80\0\0\0\0\0\xff\xff\xff\x21\xf9\x04\0\x0a\0\0\0\x2c\0\0\0\0\x01\0\x01\0\0\x02\x02\x44\x01\0\x3b";
        assert_eq!(
            gif_blocks(whole),
            Structure {
                frames: Some(1),
                ..Structure::default()
            }
        );
        for n in 0..whole.len() {
            assert!(gif_blocks(&whole[..n]).is_cut, "{n}");
        }
    }
}
