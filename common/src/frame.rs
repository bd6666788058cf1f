//! Length-prefixed frames on a byte stream: the compute child's pipes and the run's journal.
//!
//! One frame: length (u32, little endian), the first 8 bytes of the payload's BLAKE3, payload.
//! A torn or damaged frame is told apart from the stream's clean end.

use std::io::{ErrorKind, Read, Write};

use crate::message::MAX_MESSAGE_BYTES;

/// Bytes before the payload.
pub const HEADER_BYTES: usize = 12;

/// Why no frame could be read.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// The stream ended inside a frame, or the payload does not match its checksum.
    #[error("a frame is torn or damaged")]
    Torn,
    /// The announced length cannot be right.
    #[error("a frame announces {0} bytes, more than the {MAX_MESSAGE_BYTES} allowed")]
    TooLarge(usize),
    /// The stream failed.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

/// The header of a payload.
///
/// # Errors
/// [`FrameError::TooLarge`].
pub fn header(payload: &[u8]) -> Result<[u8; HEADER_BYTES], FrameError> {
    if payload.len() > MAX_MESSAGE_BYTES {
        return Err(FrameError::TooLarge(payload.len()));
    }
    let mut header = [0; HEADER_BYTES];
    header[..4].copy_from_slice(&(payload.len() as u32).to_le_bytes());
    header[4..].copy_from_slice(&blake3::hash(payload).as_bytes()[..8]);
    Ok(header)
}

/// The payload length that a header announces.
///
/// # Errors
/// [`FrameError::TooLarge`].
pub fn payload_len(header: &[u8; HEADER_BYTES]) -> Result<usize, FrameError> {
    let len = u32::from_le_bytes([header[0], header[1], header[2], header[3]]) as usize;
    if len > MAX_MESSAGE_BYTES {
        return Err(FrameError::TooLarge(len));
    }
    Ok(len)
}

/// Checks a payload against its header.
///
/// # Errors
/// [`FrameError::Torn`].
pub fn verify(header: &[u8; HEADER_BYTES], payload: &[u8]) -> Result<(), FrameError> {
    if header[4..] == blake3::hash(payload).as_bytes()[..8] {
        Ok(())
    } else {
        Err(FrameError::Torn)
    }
}

/// Writes one frame.
///
/// # Errors
/// [`FrameError::TooLarge`], [`FrameError::Io`].
pub fn write(stream: &mut impl Write, payload: &[u8]) -> Result<(), FrameError> {
    let header = header(payload)?;
    stream.write_all(&header)?;
    stream.write_all(payload)?;
    Ok(())
}

/// Reads one frame; `None` at the clean end of the stream.
///
/// # Errors
/// [`FrameError::Torn`] where the stream ends inside a frame, [`FrameError::TooLarge`],
/// [`FrameError::Io`].
pub fn read(stream: &mut impl Read) -> Result<Option<Vec<u8>>, FrameError> {
    let mut header = [0; HEADER_BYTES];
    let mut filled = 0;
    while filled < HEADER_BYTES {
        match stream.read(&mut header[filled..]) {
            Ok(0) if filled == 0 => return Ok(None),
            Ok(0) => return Err(FrameError::Torn),
            Ok(n) => filled += n,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
    }
    let mut payload = vec![0; payload_len(&header)?];
    stream
        .read_exact(&mut payload)
        .map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => FrameError::Torn,
            _ => FrameError::Io(error),
        })?;
    verify(&header, &payload)?;
    Ok(Some(payload))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_back_in_order_and_the_end_is_clean() {
        let mut stream = Vec::new();
        for payload in [b"one".as_slice(), b"", b"three"] {
            write(&mut stream, payload).unwrap();
        }
        let mut reader = stream.as_slice();
        for payload in [b"one".as_slice(), b"", b"three"] {
            assert_eq!(read(&mut reader).unwrap().unwrap(), payload);
        }
        assert!(read(&mut reader).unwrap().is_none());
    }

    #[test]
    fn every_cut_and_every_flipped_bit_is_noticed() {
        let mut stream = Vec::new();
        write(&mut stream, b"payload").unwrap();
        for cut in 1..stream.len() {
            assert!(
                matches!(read(&mut &stream[..cut]), Err(FrameError::Torn)),
                "cut at {cut}"
            );
        }
        for bit in 0..stream.len() * 8 {
            let mut damaged = stream.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(read(&mut damaged.as_slice()).is_err(), "bit {bit}");
        }
    }
}
