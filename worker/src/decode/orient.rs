//! The turn and mirroring that a file asks for (its display matrix), applied while pixels are copied.
//!
//! A display matrix maps a coded pixel (p, q), top-left origin, to (a·p + c·q, b·p + d·q) up to a shift
//! (FFmpeg `libavutil/display.h`, ISO 14496-12 `tkhd`). Only the eight axis-aligned cases exist in
//! practice; any other matrix is taken as the nearest of them.

use plumbline_vision::image::Rgb8;

/// One of the eight axis-aligned turns and mirror images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Orientation {
    /// Presented rows are coded columns.
    transposed: bool,
    /// Presented columns run against their coded axis.
    flip_x: bool,
    /// Presented rows run against their coded axis.
    flip_y: bool,
}

impl Orientation {
    pub(super) const UPRIGHT: Self = Self {
        transposed: false,
        flip_x: false,
        flip_y: false,
    };

    /// From a display matrix in FFmpeg's order (a, b, u, c, d, v, x, y, w), native-endian 32-bit.
    pub(super) fn from_display_matrix(bytes: &[u8]) -> Self {
        let entry = |index: usize| -> i64 {
            let four = bytes
                .get(4 * index..4 * index + 4)
                .and_then(|four| <[u8; 4]>::try_from(four).ok());
            four.map_or(0, |four| i64::from(i32::from_ne_bytes(four)))
        };
        let (a, b, c, d) = (entry(0), entry(1), entry(3), entry(4));
        if b.abs() + c.abs() > a.abs() + d.abs() {
            Self {
                transposed: true,
                flip_x: c < 0,
                flip_y: b < 0,
            }
        } else {
            Self {
                transposed: false,
                flip_x: a < 0,
                flip_y: d < 0,
            }
        }
    }

    /// Clockwise turn in degrees after an optional left-right mirroring.
    pub(super) fn turn_and_mirror(self) -> (u16, bool) {
        match (self.transposed, self.flip_x, self.flip_y) {
            (false, false, false) => (0, false),
            (false, true, true) => (180, false),
            (false, true, false) => (0, true),
            (false, false, true) => (180, true),
            (true, true, false) => (90, false),
            (true, false, true) => (270, false),
            (true, false, false) => (270, true),
            (true, true, true) => (90, true),
        }
    }

    pub(super) fn presented_size(self, width: usize, height: usize) -> (usize, usize) {
        if self.transposed {
            (height, width)
        } else {
            (width, height)
        }
    }

    /// Copies a `[height, width, 3]` picture whose rows are `stride` bytes apart into its presented form.
    pub(super) fn apply(self, pixels: &[u8], stride: usize, width: usize, height: usize) -> Rgb8 {
        let (out_width, out_height) = self.presented_size(width, height);
        let mut data = Vec::with_capacity(out_width * out_height * 3);
        if self == Self::UPRIGHT {
            for row in pixels.chunks(stride).take(height) {
                data.extend_from_slice(&row[..width * 3]);
            }
            return Rgb8 {
                width,
                height,
                data,
            };
        }
        for y in 0..out_height {
            let along_y = if self.flip_y { out_height - 1 - y } else { y };
            for x in 0..out_width {
                let along_x = if self.flip_x { out_width - 1 - x } else { x };
                let (p, q) = if self.transposed {
                    (along_y, along_x)
                } else {
                    (along_x, along_y)
                };
                data.extend_from_slice(&pixels[q * stride + p * 3..][..3]);
            }
        }
        Rgb8 {
            width: out_width,
            height: out_height,
            data,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(a: i32, b: i32, c: i32, d: i32) -> Vec<u8> {
        [a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30]
            .iter()
            .flat_map(|v| v.to_ne_bytes())
            .collect()
    }

    /// Slow twin: moves every coded pixel forward through the matrix, then shifts to a zero origin.
    fn forward(entries: (i32, i32, i32, i32), pixels: &[u8], width: usize, height: usize) -> Rgb8 {
        let (a, b, c, d) = entries;
        let place = |p: usize, q: usize| {
            let (p, q) = (p as i32, q as i32);
            (a * p + c * q, b * p + d * q)
        };
        let all: Vec<_> = (0..height)
            .flat_map(|q| (0..width).map(move |p| (p, q)))
            .collect();
        let moved: Vec<_> = all.iter().map(|&(p, q)| place(p, q)).collect();
        let x0 = moved.iter().map(|m| m.0).min().unwrap_or(0);
        let y0 = moved.iter().map(|m| m.1).min().unwrap_or(0);
        let out_width = (moved.iter().map(|m| m.0).max().unwrap_or(0) - x0 + 1) as usize;
        let out_height = (moved.iter().map(|m| m.1).max().unwrap_or(0) - y0 + 1) as usize;
        let mut data = vec![0; pixels.len()];
        for (&(p, q), &(x, y)) in all.iter().zip(&moved) {
            let to = ((y - y0) as usize * out_width + (x - x0) as usize) * 3;
            data[to..to + 3].copy_from_slice(&pixels[(q * width + p) * 3..][..3]);
        }
        Rgb8 {
            width: out_width,
            height: out_height,
            data,
        }
    }

    #[test]
    fn all_eight_agree_with_the_matrix() {
        let (width, height) = (3, 2);
        let pixels: Vec<u8> = (0..18).collect();
        let mut seen = std::collections::BTreeSet::new();
        for (s, t) in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
            for entries in [(s, 0, 0, t), (0, s, t, 0)] {
                let orientation = Orientation::from_display_matrix(&matrix(
                    entries.0, entries.1, entries.2, entries.3,
                ));
                assert_eq!(
                    orientation.apply(&pixels, width * 3, width, height),
                    forward(entries, &pixels, width, height)
                );
                seen.insert(orientation.turn_and_mirror());
            }
        }
        assert_eq!(seen.len(), 8);
    }

    #[test]
    fn phones_portrait_matrix_is_a_quarter_turn_clockwise() {
        let orientation = Orientation::from_display_matrix(&matrix(0, 1, -1, 0));
        assert_eq!(orientation.turn_and_mirror(), (90, false));
        let turned = orientation.apply(&[1, 1, 1, 2, 2, 2], 6, 2, 1);
        assert_eq!(
            (turned.width, turned.height, turned.data),
            (1, 2, vec![1, 1, 1, 2, 2, 2])
        );
        let column = orientation.apply(&[1, 1, 1, 2, 2, 2], 3, 1, 2);
        assert_eq!((column.width, column.data), (2, vec![2, 2, 2, 1, 1, 1]));
        assert_eq!(Orientation::from_display_matrix(&[]), Orientation::UPRIGHT);
    }
}
