//! Middlebury's `.flo` (S. Baker et al., "A Database and Evaluation Methodology for Optical Flow", IJCV
//! 2011; format of its C++ code): the tag "PIEH" (202021.25 as a float), width and height as 32-bit
//! integers, then interleaved 32-bit floats, u then v, row by row; all little-endian.
//!
//! A vector with a component above 1e9 in magnitude, or NaN, is unknown; unknown ones are written as
//! 1e10 twice. Everything else is kept to the bit.

use super::{FlowFileError, KnownFlow, check_size};
use crate::flow::Flow;

const TAG: &[u8; 4] = b"PIEH";
const HEADER_BYTES: usize = 12;
const VECTOR_BYTES: u64 = 8;
/// Above this a component is unknown.
const UNKNOWN_ABOVE: f32 = 1e9;
/// What unknown components are written as.
const UNKNOWN: f32 = 1e10;

/// Reads a `.flo` file's bytes.
///
/// # Errors
/// [`FlowFileError`] on another format, an absurd size, missing or surplus bytes.
pub fn decode(bytes: &[u8]) -> Result<KnownFlow, FlowFileError> {
    let Some((header, vectors)) = bytes.split_at_checked(HEADER_BYTES) else {
        return Err(wrong_format(format!("it has {} bytes", bytes.len())));
    };
    if !header.starts_with(TAG) {
        return Err(wrong_format("it does not begin with PIEH".to_owned()));
    }
    let side = |at: usize| i64::from(i32::from_le_bytes(word(&header[at..])));
    let (width, height) = (side(4), side(8));
    let [Ok(columns), Ok(rows)] = [width, height].map(u64::try_from) else {
        return Err(FlowFileError::Size { width, height });
    };
    check_size(columns, rows)?;
    let expected = columns * rows * VECTOR_BYTES;
    if vectors.len() as u64 != expected {
        return Err(FlowFileError::Length {
            width: columns,
            height: rows,
            expected: expected + HEADER_BYTES as u64,
            found: bytes.len() as u64,
        });
    }
    let vectors = vectors.chunks_exact(VECTOR_BYTES as usize).map(|v| {
        [
            f32::from_le_bytes(word(v)),
            f32::from_le_bytes(word(&v[4..])),
        ]
    });
    let (data, known) = vectors
        .map(|vector| {
            let known = is_known(vector);
            (if known { vector } else { [0.0; 2] }, known)
        })
        .unzip();
    Ok(KnownFlow {
        flow: Flow {
            width: columns as usize,
            height: rows as usize,
            data,
        },
        known,
    })
}

/// The bytes of a `.flo` file.
///
/// # Errors
/// [`FlowFileError`] when the field is empty or incomplete, or a known vector would read as unknown.
pub fn encode(field: &KnownFlow) -> Result<Vec<u8>, FlowFileError> {
    field.validate()?;
    let flow = &field.flow;
    let mut bytes = Vec::with_capacity(HEADER_BYTES + flow.data.len() * VECTOR_BYTES as usize);
    bytes.extend_from_slice(TAG);
    for side in [flow.width, flow.height] {
        // `validate` admits no side that does not fit.
        bytes.extend_from_slice(&(side as i32).to_le_bytes());
    }
    for (index, (&vector, &known)) in flow.data.iter().zip(&field.known).enumerate() {
        if known && !is_known(vector) {
            return Err(FlowFileError::OutOfRange {
                index,
                vector,
                range: "±1e9 px",
            });
        }
        for component in if known { vector } else { [UNKNOWN; 2] } {
            bytes.extend_from_slice(&component.to_le_bytes());
        }
    }
    Ok(bytes)
}

/// NaN compares false.
fn is_known(vector: [f32; 2]) -> bool {
    vector.iter().all(|c| c.abs() <= UNKNOWN_ABOVE)
}

/// The first four bytes of `bytes`, which must have as many.
fn word(bytes: &[u8]) -> [u8; 4] {
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

fn wrong_format(reason: String) -> FlowFileError {
    FlowFileError::WrongFormat {
        format: "Middlebury .flo",
        reason,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Any bits that are a known vector, and whether it is known.
    fn vectors(count: usize) -> impl Strategy<Value = Vec<([f32; 2], bool)>> {
        let component = any::<u32>()
            .prop_map(f32::from_bits)
            .prop_map(|c| if is_known([c, 0.0]) { c } else { 1.5 });
        prop::collection::vec(
            ([component.clone(), component], prop::bool::weighted(0.9)),
            count..=count,
        )
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back_to_the_bit(
            (width, vectors) in (1_usize..7).prop_flat_map(|w| (Just(w), vectors(w * 3)))
        ) {
            let (data, known): (Vec<_>, Vec<_>) = vectors
                .into_iter()
                .map(|(vector, known)| (if known { vector } else { [0.0; 2] }, known))
                .unzip();
            let field = KnownFlow { flow: Flow { width, height: 3, data }, known };
            let bytes = encode(&field).unwrap();
            prop_assert_eq!(bytes.len(), 12 + width * 3 * 8);
            let again = decode(&bytes).unwrap();
            prop_assert_eq!(&again.known, &field.known);
            let bits = |f: &KnownFlow| -> Vec<u32> {
                f.flow.data.iter().flatten().map(|c| c.to_bits()).collect()
            };
            prop_assert_eq!(bits(&again), bits(&field));
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..64), tagged: bool) {
            let mut bytes = bytes;
            if tagged {
                bytes.splice(0..0, *TAG);
            }
            let _result = decode(&bytes);
        }
    }

    #[test]
    fn a_known_file_is_read() {
        // 2 × 1: (1.5, −2) and an unknown one, byte by byte as the format has it.
        let mut bytes = b"PIEH\x02\0\0\0\x01\0\0\0".to_vec();
        assert_eq!(f32::from_le_bytes(*TAG), 202_021.25);
        bytes.extend_from_slice(b"\0\0\xc0\x3f\0\0\0\xc0");
        bytes.extend_from_slice(&1.666_666_8e9_f32.to_le_bytes());
        bytes.extend_from_slice(&0.0_f32.to_le_bytes());
        let field = decode(&bytes).unwrap();
        assert_eq!((field.flow.width, field.flow.height), (2, 1));
        assert_eq!(field.flow.data, [[1.5, -2.0], [0.0, 0.0]]);
        assert_eq!(field.known, [true, false]);
    }

    #[test]
    fn hostile_headers_cost_nothing_and_say_what_is_wrong() {
        let header = |width: i32, height: i32| {
            let mut bytes = TAG.to_vec();
            bytes.extend_from_slice(&width.to_le_bytes());
            bytes.extend_from_slice(&height.to_le_bytes());
            bytes
        };
        // With a size taken on trust, the first of these would ask for 2^65 bytes.
        for (width, height) in [
            (i32::MAX, i32::MAX),
            (0, 5),
            (-3, 5),
            (8193, 8192),
            (5, i32::MIN),
        ] {
            let error = decode(&header(width, height)).unwrap_err();
            assert!(matches!(error, FlowFileError::Size { .. }), "{error}");
        }
        let mut short = header(4, 3);
        short.extend_from_slice(&[0; 95]);
        let mut long = short.clone();
        long.extend_from_slice(&[0; 2]);
        for bytes in [header(4, 3), short, long] {
            let error = decode(&bytes).unwrap_err();
            assert!(matches!(error, FlowFileError::Length { expected: 108, .. }));
        }
        for bytes in [&b""[..], b"PIEH\x02\0\0", b"just some text\n"] {
            let error = decode(bytes).unwrap_err();
            assert!(matches!(error, FlowFileError::WrongFormat { .. }));
        }
    }

    #[test]
    fn what_would_read_as_unknown_is_not_written() {
        for bad in [f32::NAN, f32::INFINITY, -2e9] {
            let field = KnownFlow::dense(Flow {
                width: 1,
                height: 1,
                data: vec![[0.0, bad]],
            });
            assert!(matches!(
                encode(&field),
                Err(FlowFileError::OutOfRange { index: 0, .. })
            ));
        }
        assert!(matches!(
            encode(&KnownFlow::default()),
            Err(FlowFileError::Size { .. })
        ));
        let mut short = KnownFlow::dense(Flow {
            width: 2,
            height: 2,
            data: vec![[0.0; 2]; 4],
        });
        short.known.pop();
        assert!(matches!(
            encode(&short),
            Err(FlowFileError::Incomplete { vectors: 3, .. })
        ));
    }
}
