//! A frame as WorldScore gives it to DROID-SLAM: scaled to an area of 512² px, cropped to whole cells, with
//! a camera that is the same whatever the video.

use super::CELL_PX;
use super::opencv_resize::resize;
use crate::image::{ImageError, Rgb8};
use crate::slam::camera::Pinhole;

/// WorldScore's focal length and principal point, px of the frame as given, along either side.
const FOCAL_PX: f64 = 500.0;
const CENTRE_PX: f64 = 256.0;

/// Such a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackingPicture {
    /// Scaled, and cropped at the right and bottom.
    pub picture: Rgb8,
    /// The camera, in cells.
    pub camera: Pinhole,
}

impl TrackingPicture {
    /// Makes one of about `area_px` pixels; the reference's area is 512².
    ///
    /// # Errors
    /// [`ImageError`] where the frame is no picture, or nothing is left of it.
    pub fn new(frame: &Rgb8, area_px: u32) -> Result<Self, ImageError> {
        frame.validate()?;
        let (width, height) = (frame.width as f64, frame.height as f64);
        let scale = (f64::from(area_px) / (height * width)).sqrt();
        // Truncated, as in the reference: 512 × 512 stays, since its scale is 1.
        let scaled = [width, height].map(|side| (side * scale) as usize);
        let whole = scaled.map(|side| side - side % CELL_PX);
        let picture = cropped(&resize(frame, scaled[0], scaled[1])?, whole)?;
        let [x, y] = [scaled[0] as f64 / width, scaled[1] as f64 / height]
            .map(|stretch| stretch / CELL_PX as f64);
        let single = |value: f64| f64::from(value as f32);
        Ok(Self {
            picture,
            camera: Pinhole {
                fx: single(FOCAL_PX * x),
                fy: single(FOCAL_PX * y),
                cx: single(CENTRE_PX * x),
                cy: single(CENTRE_PX * y),
            },
        })
    }
}

fn cropped(picture: &Rgb8, [width, height]: [usize; 2]) -> Result<Rgb8, ImageError> {
    let rows = picture.data.chunks_exact(3 * picture.width).take(height);
    let data = rows.flat_map(|row| &row[..3 * width]).copied().collect();
    Rgb8::new(width, height, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: usize, height: usize) -> Rgb8 {
        Rgb8::new(width, height, vec![90; 3 * width * height]).unwrap()
    }

    /// The worked example of the reference: 832 × 480 becomes 674 × 388, of which 672 × 384 is used.
    #[test]
    fn sizes_and_cameras_are_worldscores() {
        let made = TrackingPicture::new(&grey(832, 480), 512 * 512).unwrap();
        assert_eq!((made.picture.width, made.picture.height), (672, 384));
        let (x, y) = (674.0 / 832.0 / 8.0, 388.0 / 480.0 / 8.0);
        let camera = made.camera;
        let found = [camera.fx, camera.fy, camera.cx, camera.cy];
        let expected = [500.0 * x, 500.0 * y, 256.0 * x, 256.0 * y];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        let same = TrackingPicture::new(&grey(512, 512), 512 * 512).unwrap();
        assert_eq!(same.picture, grey(512, 512));
        assert_eq!((same.camera.fx, same.camera.cx), (62.5, 32.0));
    }

    #[test]
    fn what_is_too_thin_to_crop_is_an_error() {
        assert!(TrackingPicture::new(&grey(5000, 2), 64 * 64).is_err());
    }
}
