//! Do the tables of an ISO base media file claim more samples than the file can hold? FFmpeg reserves memory
//! for each of them before it sees that they are not there.
//!
//! Source: ISO/IEC 14496-12, `stsz` (8.7.3) and `trun` (8.8.8). Only headers of boxes and counts are read, so
//! that a long file costs little; what is not understood claims nothing.

use std::io::{BufReader, Read, Result, Seek};
use std::ops::Range;

/// Boxes within boxes down to a track's tables: `moov`, `trak`, `mdia`, `minf`, `stbl`.
const DEPTH: usize = 5;

/// Whether one table claims more samples than `file` has bytes. Leaves the file at its start.
pub(super) fn are_overstated(file: &mut (impl Read + Seek)) -> Result<bool> {
    let bytes = file.seek(std::io::SeekFrom::End(0))?;
    file.rewind()?;
    let most = most_samples(&mut BufReader::new(&mut *file), 0..bytes, DEPTH)?;
    file.rewind()?;
    Ok(most > bytes)
}

/// The most samples that one table in the `boxes` claims; those nested deeper than `depth` claim nothing.
fn most_samples(
    file: &mut BufReader<impl Read + Seek>,
    boxes: Range<u64>,
    depth: usize,
) -> Result<u64> {
    let mut most = 0;
    let mut at = boxes.start;
    while boxes.end - at >= 8 {
        let [a, b, c, d, name @ ..] = read_at::<8>(file, at)?;
        let rest = boxes.end - at;
        let (size, header_bytes) = match u32::from_be_bytes([a, b, c, d]) {
            0 => (rest, 8),
            1 if rest >= 16 => (u64::from_be_bytes(read_at(file, at + 8)?), 16),
            short => (short.into(), 8),
        };
        if size < header_bytes {
            break;
        }
        // A box that is cut claims as much as a whole one.
        let body = at + header_bytes..at + size.min(rest);
        let has = |bytes: u64| body.end - body.start >= bytes;
        let claimed = match &name {
            b"moov" | b"trak" | b"mdia" | b"minf" | b"stbl" | b"moof" | b"traf" if depth > 0 => {
                most_samples(file, body.clone(), depth - 1)?
            }
            // Version and flags, the size of all samples, their number.
            b"stsz" if has(12) => u32::from_be_bytes(read_at(file, body.start + 8)?).into(),
            // Version and flags, the number of samples.
            b"trun" if has(8) => u32::from_be_bytes(read_at(file, body.start + 4)?).into(),
            _ => 0,
        };
        most = most.max(claimed);
        at = body.end;
    }
    Ok(most)
}

fn read_at<const BYTES: usize>(
    file: &mut BufReader<impl Read + Seek>,
    at: u64,
) -> Result<[u8; BYTES]> {
    let here = file.stream_position()?;
    // Keeps the buffer where it can.
    file.seek_relative(at.wrapping_sub(here) as i64)?;
    let mut bytes = [0; BYTES];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn a_box(name: &[u8; 4], body: &[u8]) -> Vec<u8> {
        let size = u32::try_from(8 + body.len()).unwrap();
        [&size.to_be_bytes(), name.as_slice(), body].concat()
    }

    fn are_too_many(file: &[u8]) -> bool {
        are_overstated(&mut Cursor::new(file)).unwrap()
    }

    #[test]
    fn tables_are_found_where_they_belong() {
        let stsz = a_box(b"stsz", b"\0\0\0\0\0\0\0\0\0\x01\0\0");
        let track = |table: &[u8]| {
            let names = [b"stbl", b"minf", b"mdia", b"trak", b"moov"];
            let moov = names
                .iter()
                .fold(table.to_vec(), |body, name| a_box(name, &body));
            [a_box(b"ftyp", b"isom"), a_box(b"mdat", &[0; 20_000]), moov].concat()
        };
        assert!(are_too_many(&track(&stsz)));
        // As many samples as bytes, or a table where none belongs.
        let mut enough = track(&stsz);
        enough.resize(0x1_0000, 0);
        assert!(!are_too_many(&enough));
        assert!(!are_too_many(&track(&a_box(b"stbl", &stsz))));
        let trun = a_box(b"trun", b"\0\0\0\0\0\x01\0\0");
        assert!(are_too_many(&a_box(b"moof", &a_box(b"traf", &trun))));
        assert!(!are_too_many(&trun[..12]));
    }

    #[test]
    fn sizes_of_64_bits_to_the_end_and_cut() {
        let moof = a_box(
            b"moof",
            &a_box(b"traf", &a_box(b"trun", &[0, 0, 0, 0, 9, 0, 0, 0])),
        );
        let long = [b"\0\0\0\x01mdat\0\0\0\0\0\0\0\x11x".as_slice(), &moof].concat();
        assert!(are_too_many(&long));
        let mut to_the_end = moof.clone();
        to_the_end[..4].fill(0);
        assert!(are_too_many(&to_the_end));
        let mut cut = moof;
        cut[..4].fill(0xff);
        assert!(are_too_many(&cut));
        for n in 0..long.len() {
            are_too_many(&long[..n]);
        }
    }
}
