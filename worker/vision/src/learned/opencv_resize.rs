//! OpenCV's bilinear resize of 8-bit pictures (`cv2.resize` by default), with which WorldScore prepares
//! frames for DROID-SLAM: half-pixel centres, no antialiasing, weights in 2048ths; halves exactly are means
//! of 2 × 2. Integers throughout, hence the same everywhere. OpenCV 5.0's own instruction sets differ from it
//! by one grey level in at most 0.1% of the values of enlarged pictures, and not at all in reduced ones.

use crate::image::{ImageError, Rgb8};

/// Weights are whole numbers of this share.
const ONE: f32 = 2048.0;

/// The two samples that an output lies between, and their weights.
struct Tap {
    at: [usize; 2],
    weight: [i32; 2],
}

fn taps(from: usize, to: usize) -> Vec<Tap> {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|out| {
            let position = ((out as f64 + 0.5) * scale - 0.5) as f32;
            let low = position.floor();
            let (low, rest) = match low {
                low if low < 0.0 => (0, 0.0),
                low if low as usize >= from - 1 => (from - 1, 0.0),
                low => (low as usize, position - low),
            };
            let whole = |share: f32| (share * ONE).round_ties_even() as i32;
            Tap {
                at: [low, (low + 1).min(from - 1)],
                weight: [whole(1.0 - rest), whole(rest)],
            }
        })
        .collect()
}

/// `picture` at another size.
///
/// # Errors
/// [`ImageError`] where either is no picture.
pub fn resize(picture: &Rgb8, width: usize, height: usize) -> Result<Rgb8, ImageError> {
    picture.validate()?;
    let value = |x: usize, y: usize, channel: usize| {
        i32::from(picture.data[(y * picture.width + x) * 3 + channel])
    };
    let mut data = Vec::with_capacity(3 * width * height);
    if (picture.width, picture.height) == (2 * width, 2 * height) {
        for n in 0..width * height {
            let (x, y) = (2 * (n % width), 2 * (n / width));
            data.extend([0, 1, 2].map(|c| {
                let sum = value(x, y, c) + value(x + 1, y, c);
                ((sum + value(x, y + 1, c) + value(x + 1, y + 1, c) + 2) >> 2) as u8
            }));
        }
        return Rgb8::new(width, height, data);
    }
    let columns = taps(picture.width, width);
    for row in taps(picture.height, height) {
        for column in &columns {
            data.extend([0, 1, 2].map(|c| {
                let along = |y: usize| {
                    let [left, right] = column.at.map(|x| value(x, y, c));
                    (left * column.weight[0] + right * column.weight[1]) >> 4
                };
                let upper = (row.weight[0] * along(row.at[0])) >> 16;
                let lower = (row.weight[1] * along(row.at[1])) >> 16;
                ((upper + lower + 2) >> 2).clamp(0, 255) as u8
            }));
        }
    }
    Rgb8::new(width, height, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Channel `c` at (x, y) is (x (7 + c) + y (5 + 2c) + ⌊x y / (11 + c)⌋) mod 256.
    fn pattern(width: usize, height: usize) -> Rgb8 {
        let pixel = |n: usize| {
            let (x, y) = (n % width, n / width);
            [0, 1, 2].map(|c| ((x * (7 + c) + y * (5 + 2 * c) + x * y / (11 + c)) % 256) as u8)
        };
        Rgb8::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
    }

    /// What `cv2.resize` 5.0.0 gives, one channel.
    #[test]
    fn small_pictures_are_opencvs() {
        let channel = |picture: Rgb8, c: usize| -> Vec<u8> {
            picture.data.into_iter().skip(c).step_by(3).collect()
        };
        let larger = channel(resize(&pattern(5, 4), 7, 6).unwrap(), 0);
        let expected = [
            [0, 4, 9, 14, 19, 24, 28],
            [3, 6, 11, 17, 22, 27, 31],
            [6, 10, 15, 20, 25, 30, 34],
            [9, 13, 18, 23, 28, 33, 37],
            [13, 16, 21, 27, 32, 37, 41],
            [15, 19, 24, 29, 34, 39, 44],
        ];
        assert_eq!(larger, expected.concat());
        let smaller = channel(resize(&pattern(5, 4), 3, 2).unwrap(), 1);
        assert_eq!(smaller, [6, 20, 33, 20, 34, 47]);
    }

    #[test]
    fn the_same_size_is_the_same_picture_and_halves_are_means() {
        let picture = pattern(16, 9);
        assert_eq!(resize(&picture, 16, 9).unwrap(), picture);
        let data = [10, 11, 12, 14].map(|v| [v, v + 1, 255]).concat();
        let half = resize(&Rgb8::new(2, 2, data).unwrap(), 1, 1).unwrap();
        assert_eq!(half.data, [12, 13, 255]);
    }

    #[test]
    fn there_is_nothing_to_make_of_nothing() {
        assert!(resize(&pattern(4, 4), 0, 4).is_err());
        let empty = Rgb8 {
            width: 0,
            height: 0,
            data: vec![],
        };
        assert!(resize(&empty, 4, 4).is_err());
    }
}
