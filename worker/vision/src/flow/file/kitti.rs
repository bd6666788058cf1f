//! KITTI's flow png (M. Menze, A. Geiger, "Object Scene Flow for Autonomous Vehicles", CVPR 2015; format
//! of the KITTI 2012/2015 development kits): 16-bit RGB, red = 64 u + 2^15, green = 64 v + 2^15, blue =
//! 1 where the vector is known and 0 elsewhere.
//!
//! Resolution 1/64 px, range −512 to 511.98 px. Writing rounds to the nearest step (the kit truncates);
//! what is read is exact. Readers take every blue above 0 as known.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageDecoder, ImageFormat, Rgb};

use super::{FlowFileError, KnownFlow, MAX_PIXELS, check_size};
use crate::flow::Flow;

const STEPS_PER_PX: f32 = 64.0;
const ZERO: f32 = 32_768.0;
const FORMAT: &str = "KITTI flow";
/// Bytes of decoder memory for the largest field: 16-bit RGB and one working copy.
const MAX_DECODER_BYTES: u64 = MAX_PIXELS * 12;

/// Reads a flow png's bytes.
///
/// # Errors
/// [`FlowFileError`] on another format (8-bit or grey pictures too), an absurd size, or damage.
pub fn decode(bytes: &[u8]) -> Result<KnownFlow, FlowFileError> {
    let wrong = |reason: &str| FlowFileError::WrongFormat {
        format: FORMAT,
        reason: reason.to_owned(),
    };
    let damaged = |error: image::ImageError| FlowFileError::Damaged {
        reason: error.to_string(),
    };
    if !matches!(image::guess_format(bytes), Ok(ImageFormat::Png)) {
        return Err(wrong("it is no png"));
    }
    let mut decoder = image::codecs::png::PngDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    if decoder.color_type() != image::ColorType::Rgb16 {
        return Err(wrong("its pixels are not 16-bit RGB"));
    }
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    decoder.set_limits(limits).map_err(damaged)?;
    let DynamicImage::ImageRgb16(picture) = DynamicImage::from_decoder(decoder).map_err(damaged)?
    else {
        return Err(wrong("its pixels are not 16-bit RGB"));
    };
    let (data, known) = picture
        .pixels()
        .map(|&Rgb([u, v, known])| {
            let component = |value: u16| (f32::from(value) - ZERO) / STEPS_PER_PX;
            match known {
                0 => ([0.0; 2], false),
                _ => ([component(u), component(v)], true),
            }
        })
        .unzip();
    Ok(KnownFlow {
        flow: Flow {
            width: width as usize,
            height: height as usize,
            data,
        },
        known,
    })
}

/// The bytes of a flow png.
///
/// # Errors
/// [`FlowFileError`] when the field is empty or incomplete, or a known vector is out of range.
pub fn encode(field: &KnownFlow) -> Result<Vec<u8>, FlowFileError> {
    field.validate()?;
    let flow = &field.flow;
    let mut values = Vec::with_capacity(flow.data.len() * 3);
    for (index, (&vector, &known)) in flow.data.iter().zip(&field.known).enumerate() {
        let steps = vector.map(|c| (c * STEPS_PER_PX + ZERO).round());
        values.extend(match (known, steps) {
            (false, _) => [0; 3],
            // NaN is in no range.
            (true, [u, v]) if [u, v].iter().all(|c| (0.0..=65_535.0).contains(c)) => {
                [u as u16, v as u16, 1]
            }
            (true, _) => {
                return Err(FlowFileError::OutOfRange {
                    index,
                    vector,
                    range: "-512 to 511.98 px",
                });
            }
        });
    }
    let incomplete = || FlowFileError::Incomplete {
        width: flow.width,
        height: flow.height,
        vectors: flow.data.len(),
    };
    // `validate` admits no side that does not fit.
    let picture =
        ImageBuffer::<Rgb<u16>, _>::from_raw(flow.width as u32, flow.height as u32, values)
            .ok_or_else(incomplete)?;
    let mut png = Cursor::new(Vec::new());
    picture
        .write_to(&mut png, ImageFormat::Png)
        .map_err(|error| FlowFileError::Damaged {
            reason: error.to_string(),
        })?;
    Ok(png.into_inner())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn whole_steps_come_back_exactly_and_others_within_half_a_step(
            (width, raw) in (1_usize..7).prop_flat_map(|w| {
                let vector = ([0.0_f32..65_535.0, 0.0_f32..65_535.0], any::<bool>(), any::<bool>());
                (Just(w), prop::collection::vec(vector, w * 3..=w * 3))
            })
        ) {
            let (data, known): (Vec<_>, Vec<_>) = raw
                .into_iter()
                .map(|(steps, whole, known)| {
                    let px = steps.map(|s| ((if whole { s.round() } else { s }) - ZERO) / STEPS_PER_PX);
                    (if known { px } else { [0.0; 2] }, known)
                })
                .unzip();
            let field = KnownFlow { flow: Flow { width, height: 3, data }, known };
            let again = decode(&encode(&field).unwrap()).unwrap();
            prop_assert_eq!(&again.known, &field.known);
            for (a, b) in again.flow.data.iter().flatten().zip(field.flow.data.iter().flatten()) {
                prop_assert!((a - b).abs() <= 0.5 / STEPS_PER_PX, "{} {}", a, b);
                if (b * STEPS_PER_PX).fract() == 0.0 {
                    prop_assert_eq!(a, b);
                }
            }
            // What was read is whole steps: a second trip changes nothing.
            prop_assert_eq!(decode(&encode(&again).unwrap()).unwrap(), again);
        }
    }

    #[test]
    fn the_channels_are_those_of_the_development_kit() {
        let field = KnownFlow {
            flow: Flow {
                width: 2,
                height: 1,
                data: vec![[1.0, -2.5], [0.0, 0.0]],
            },
            known: vec![true, false],
        };
        let png = encode(&field).unwrap();
        let picture = image::load_from_memory(&png).unwrap().into_rgb16();
        assert_eq!(picture.as_raw(), &[32_832, 32_608, 1, 0, 0, 0]);
        assert_eq!(decode(&png).unwrap(), field);
    }

    #[test]
    fn other_pictures_and_damage_are_typed_errors() {
        let grey = image::DynamicImage::new_luma8(9, 9);
        let mut png = Cursor::new(Vec::new());
        grey.write_to(&mut png, ImageFormat::Png).unwrap();
        for bytes in [png.get_ref().as_slice(), b"PIEH", b""] {
            assert!(matches!(
                decode(bytes),
                Err(FlowFileError::WrongFormat { .. })
            ));
        }
        let whole = encode(&KnownFlow::dense(Flow {
            width: 40,
            height: 30,
            data: (0..1200)
                .map(|i| [(i % 37) as f32, (i % 11) as f32])
                .collect(),
        }))
        .unwrap();
        assert!(matches!(
            decode(&whole[..whole.len() / 2]),
            Err(FlowFileError::Damaged { .. })
        ));
        for bad in [f32::NAN, f32::INFINITY, 512.0, -512.1] {
            let field = KnownFlow::dense(Flow {
                width: 1,
                height: 1,
                data: vec![[bad, 0.0]],
            });
            assert!(matches!(
                encode(&field),
                Err(FlowFileError::OutOfRange { index: 0, .. })
            ));
        }
    }

    /// A png header that promises 2^31 − 1 pixels on each side, with valid checksums.
    #[test]
    fn an_absurd_size_in_the_header_is_refused() {
        let mut png =
            b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x10\x02\0\0\0".to_vec();
        let crc = crc32(&png[12..]);
        png.extend_from_slice(&crc.to_be_bytes());
        let empty_data = b"\0\0\0\0IDAT";
        png.extend_from_slice(empty_data);
        png.extend_from_slice(&crc32(&empty_data[4..]).to_be_bytes());
        let error = decode(&png).unwrap_err();
        assert!(
            matches!(
                error,
                FlowFileError::Size { .. } | FlowFileError::Damaged { .. }
            ),
            "{error}"
        );
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
            })
        })
    }
}
