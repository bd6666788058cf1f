//! Pictures as the networks want them: planar floats `[3, H, W]`, RGB.

use super::CELL_PX;
use crate::image::{ImageError, Rgb8};

/// ImageNet's mean and standard deviation, RGB, of values in 0..=1.
const IMAGENET: [(f32, f32); 3] = [(0.485, 0.229), (0.456, 0.224), (0.406, 0.225)];

/// A picture of planar floats.
#[derive(Debug, Clone, PartialEq)]
pub struct Planar {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[3, H, W]`, RGB.
    pub data: Vec<f32>,
}

impl Planar {
    /// Every pixel through `value`, which is told the channel.
    fn mapped(picture: &Rgb8, value: impl Fn(usize, u8) -> f32) -> Result<Self, ImageError> {
        picture.validate()?;
        let data = (0..3)
            .flat_map(|channel| {
                let channels = picture.data.iter().skip(channel).step_by(3);
                channels.map(move |&byte| (channel, byte))
            })
            .map(|(channel, byte)| value(channel, byte))
            .collect();
        Ok(Self {
            width: picture.width,
            height: picture.height,
            data,
        })
    }

    /// The same values, 0..=255.
    ///
    /// # Errors
    /// [`ImageError`] where the picture is none.
    pub fn new(picture: &Rgb8) -> Result<Self, ImageError> {
        Self::mapped(picture, |_, byte| f32::from(byte))
    }

    /// DROID-SLAM's normalisation: (v/255 − mean) / deviation, per channel.
    ///
    /// # Errors
    /// [`ImageError`] where the picture is none.
    pub fn imagenet(picture: &Rgb8) -> Result<Self, ImageError> {
        Self::mapped(picture, |channel, byte| {
            let (mean, deviation) = IMAGENET[channel];
            (f32::from(byte) / 255.0 - mean) / deviation
        })
    }

    /// Means of blocks of 2 × 2: bilinear interpolation by the factor ½, half-pixel centres. An odd last
    /// row or column is not used.
    #[must_use]
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut data = Vec::with_capacity(3 * width * height);
        if width > 0 && height > 0 {
            for plane in self.data.chunks_exact(self.width * self.height) {
                for rows in plane.chunks_exact(2 * self.width) {
                    let (upper, lower) = rows.split_at(self.width);
                    for (a, b) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                        data.push(((a[0] + a[1]) + (b[0] + b[1])) * 0.25);
                    }
                }
            }
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// SEA-RAFT's normalisation of values 0..=255: 2 (v / 255) − 1.
    #[must_use]
    pub fn centred(mut self) -> Self {
        for value in &mut self.data {
            *value = 2.0 * (*value / 255.0) - 1.0;
        }
        self
    }

    /// Repeats the border until the sides are whole cells: half of what is missing, rounded down, at the
    /// top and left, the rest at the bottom and right.
    #[must_use]
    pub fn padded(&self) -> (Self, Padding) {
        let padding = Padding::of(self.width, self.height);
        let (width, height) = (padding.padded_width, padding.padded_height);
        let mut data = Vec::with_capacity(3 * width * height);
        for plane in self
            .data
            .chunks_exact((self.width * self.height).max(1))
            .take(3)
        {
            for y in 0..height {
                let row = y.saturating_sub(padding.top).min(self.height - 1);
                let row = &plane[row * self.width..(row + 1) * self.width];
                data.extend(
                    (0..width).map(|x| row[x.saturating_sub(padding.left).min(self.width - 1)]),
                );
            }
        }
        let padded = Self {
            width,
            height,
            data,
        };
        (padded, padding)
    }
}

/// Where a picture lies in its padded form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Padding {
    /// Columns and rows of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Columns before it.
    pub left: usize,
    /// Rows before it.
    pub top: usize,
    /// Columns of the padded form.
    pub padded_width: usize,
    /// Rows of the padded form.
    pub padded_height: usize,
}

impl Padding {
    fn of(width: usize, height: usize) -> Self {
        let missing = |side: usize| side.next_multiple_of(CELL_PX) - side;
        Self {
            width,
            height,
            left: missing(width) / 2,
            top: missing(height) / 2,
            padded_width: width + missing(width),
            padded_height: height + missing(height),
        }
    }

    /// The picture's part of planes of the padded size.
    #[must_use]
    pub fn crop(&self, planes: &[f32]) -> Vec<f32> {
        let rows = planes.chunks_exact(self.padded_width.max(1));
        rows.enumerate()
            .filter(|(row, _)| {
                let y = row % self.padded_height.max(1);
                (self.top..self.top + self.height).contains(&y)
            })
            .flat_map(|(_, row)| &row[self.left..self.left + self.width])
            .copied()
            .collect()
    }
}

/// One plane `[height, width]` at twice its size, bilinear with half-pixel centres and the border
/// repeated; values times `factor`.
#[must_use]
pub fn doubled(plane: &[f32], width: usize, height: usize, factor: f32) -> Vec<f32> {
    // Output 2i lies at i − ¼, output 2i + 1 at i + ¼; before the first sample the first is taken.
    let source = |at: usize, size: usize| {
        let position = ((at as f32 + 0.5) * 0.5 - 0.5).max(0.0);
        let low = position as usize;
        (low, (low + 1).min(size - 1), position - low as f32)
    };
    let mut out = Vec::with_capacity(4 * width * height);
    if width == 0 || plane.len() != width * height {
        return out;
    }
    for y in 0..2 * height {
        let (top, bottom, fy) = source(y, height);
        let (top, bottom) = (&plane[top * width..], &plane[bottom * width..]);
        for x in 0..2 * width {
            let (left, right, fx) = source(x, width);
            let upper = (1.0 - fx) * top[left] + fx * top[right];
            let lower = (1.0 - fx) * bottom[left] + fx * bottom[right];
            out.push(((1.0 - fy) * upper + fy * lower) * factor);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(width: usize, height: usize) -> Rgb8 {
        let data = (0..width * height * 3).map(|n| (n * 7 % 251) as u8);
        Rgb8::new(width, height, data.collect()).unwrap()
    }

    #[test]
    fn padding_repeats_the_border_and_crop_undoes_it() {
        for (width, height) in [(8, 16), (9, 15), (1, 1), (13, 8)] {
            let planar = Planar::new(&counted(width, height)).unwrap();
            let (padded, padding) = planar.padded();
            assert_eq!((padded.width % 8, padded.height % 8), (0, 0));
            assert_eq!(padding.crop(&padded.data), planar.data);
            for (n, &value) in padded.data.iter().enumerate() {
                let (x, y) = (n % padded.width, n / padded.width % padded.height);
                let channel = n / (padded.width * padded.height);
                let near = |at: usize, before: usize, size: usize| {
                    (at as isize - before as isize).clamp(0, size as isize - 1) as usize
                };
                let (x, y) = (near(x, padding.left, width), near(y, padding.top, height));
                assert_eq!(value, planar.data[(channel * height + y) * width + x]);
            }
        }
    }

    #[test]
    fn halving_ignores_an_odd_border_and_doubling_keeps_a_ramp() {
        let planar = Planar::new(&counted(5, 3)).unwrap();
        let half = planar.halved();
        assert_eq!((half.width, half.height, half.data.len()), (2, 1, 6));
        let block = |x: usize| (planar.data[x] + planar.data[x + 1]) / 4.0;
        assert_eq!(half.data[0], block(0) + block(5));
        assert_eq!(Planar::new(&counted(1, 1)).unwrap().halved().data, [0.0; 0]);

        // A ramp stays one away from the border, where the first and last samples are repeated.
        let ramp: Vec<f32> = (0..12).map(|n| (n % 4) as f32).collect();
        let up = doubled(&ramp, 4, 3, 2.0);
        assert_eq!(up.len(), 48);
        assert_eq!(up[..8], [0.0, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.0]);
        assert_eq!(doubled(&[], 0, 3, 1.0), [0.0; 0]);
    }

    #[test]
    fn a_picture_without_pixels_is_an_error() {
        let empty = Rgb8 {
            width: 0,
            height: 4,
            data: vec![],
        };
        assert!(Planar::new(&empty).is_err());
        assert!(Planar::imagenet(&empty).is_err());
    }
}
