//! Small pictures of the worst frame for the report: the frame, and its end-point error as heat.

use colorous::INFERNO;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageError};
use plumbline_common::message::Thumbnails;
use plumbline_vision::image::{Plane, Rgb8, resize_plane, resize_rgb};

/// Rows of a thumbnail.
const HEIGHT_PX: usize = 144;

/// End-point error at the bright end of the colour map, px of a 256-px-high picture: WorldScore's
/// failure threshold. Fixed, so that pictures of different videos compare.
const FULL_SCALE_PX: f32 = 5.0;

/// JPEG quality: artefacts must not look like the video's own.
const QUALITY: u8 = 88;

/// Encodes a frame and its error map (both of the working size; 0 where out of frame).
pub(super) fn thumbnails(frame: &Rgb8, error_px: &Plane) -> Result<Thumbnails, ImageError> {
    let width = (frame.width * HEIGHT_PX)
        .div_ceil(frame.height.max(1))
        .max(1);
    let small = resize_rgb(frame, width, HEIGHT_PX);
    let heat = resize_plane(error_px, width, HEIGHT_PX);
    let colours = heat.data.iter().flat_map(|error| {
        let share = (error / FULL_SCALE_PX).clamp(0.0, 1.0);
        INFERNO.eval_continuous(f64::from(share)).as_array()
    });
    Ok(Thumbnails {
        frame_jpeg: jpeg(&small.data, width, HEIGHT_PX)?,
        heat_jpeg: jpeg(&colours.collect::<Vec<u8>>(), width, HEIGHT_PX)?,
    })
}

/// `[height, width, 3]` as JPEG.
pub(super) fn jpeg(rgb: &[u8], width: usize, height: usize) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode(
        rgb,
        width as u32,
        height as u32,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heat_is_bright_where_the_error_is() {
        let frame = Rgb8 {
            width: 64,
            height: 32,
            data: vec![128; 64 * 32 * 3],
        };
        let mut error_px = Plane {
            width: 64,
            height: 32,
            data: vec![0.0; 64 * 32],
        };
        for row in error_px.data.chunks_mut(64) {
            row[32..].fill(50.0);
        }
        let pictures = thumbnails(&frame, &error_px).unwrap();
        let heat = image::load_from_memory(&pictures.heat_jpeg)
            .unwrap()
            .to_rgb8();
        assert_eq!(heat.dimensions(), (288, 144));
        let light = |x: u32| {
            heat.get_pixel(x, 72)
                .0
                .iter()
                .map(|&c| u32::from(c))
                .sum::<u32>()
        };
        assert!(
            light(20) < 60 && light(260) > 500,
            "{} {}",
            light(20),
            light(260)
        );
        assert!(image::load_from_memory(&pictures.frame_jpeg).is_ok());
    }
}
