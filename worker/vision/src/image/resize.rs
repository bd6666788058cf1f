//! Resizing, each axis on its own: exact box (area) weights where the axis shrinks, Keys' bicubic
//! with a = −0.75 where it grows, a copy where it stays.
//!
//! Geometry: half-pixel centres, so that picture borders map to picture borders; bicubic taps beyond
//! the border repeat the edge pixel. Sources: OpenCV `INTER_AREA`, `INTER_CUBIC`; R. Keys, "Cubic
//! convolution interpolation for digital image processing", 1981. Total functions: an invalid source
//! or an empty target gives an empty picture.

use super::{Plane, Rgb8};
use crate::flow::simd::{Kernel, dispatch};

// Keys' parameter. −0.75 is OpenCV's choice; −0.5 would be third-order exact but softer.
const CUBIC_A: f64 = -0.75;

/// Resizes a plane. Bicubic enlargement may overshoot the source's range.
#[must_use]
pub fn resize_plane(source: &Plane, width: usize, height: usize) -> Plane {
    if source.validate().is_err() || width == 0 || height == 0 {
        return Plane::empty();
    }
    if (width, height) == (source.width, source.height) {
        return source.clone();
    }
    Plane {
        width,
        height,
        data: dispatch(ResizePlane {
            source,
            rows: Axis::new(source.height, height),
            columns: Axis::new(source.width, width),
        }),
    }
}
/// Resizes an RGB picture; values are rounded to the nearest (ties to even) and clamped to 0..=255.
#[must_use]
pub fn resize_rgb(source: &Rgb8, width: usize, height: usize) -> Rgb8 {
    if source.validate().is_err() || width == 0 || height == 0 {
        return Rgb8 {
            width: 0,
            height: 0,
            data: Vec::new(),
        };
    }
    if (width, height) == (source.width, source.height) {
        return source.clone();
    }
    Rgb8 {
        width,
        height,
        data: dispatch(ResizeRgb {
            source,
            rows: Axis::new(source.height, height),
            columns: Axis::new(source.width, width),
        }),
    }
}

/// Resizes a field of vectors, `width` columns wide, after multiplying it by `scale`: as
/// [`resize_plane`] does with each component. Empty where nothing can be resized.
pub(crate) fn resize_vectors(
    source: &[[f32; 2]],
    width: usize,
    scale: f32,
    [columns, rows]: [usize; 2],
) -> Vec<[f32; 2]> {
    if width == 0 || source.is_empty() || !source.len().is_multiple_of(width) {
        return Vec::new();
    }
    if (width, rows) == (columns, source.len() / width) {
        return source.iter().map(|v| v.map(|c| c * scale)).collect();
    }
    dispatch(ResizeVectors {
        source,
        scale,
        rows: Axis::new(source.len() / width, rows),
        columns: Axis::new(width, columns),
        width,
    })
}

struct ResizeVectors<'a> {
    source: &'a [[f32; 2]],
    width: usize,
    scale: f32,
    rows: Axis,
    columns: Axis,
}

impl Kernel for ResizeVectors<'_> {
    type Output = Vec<[f32; 2]>;

    #[inline(always)]
    fn run(self) -> Vec<[f32; 2]> {
        let Self { rows, columns, .. } = &self;
        let (width, height) = (columns.starts.len(), rows.starts.len());
        let (source, stride) = (self.source.as_flattened(), 2 * self.width);
        let mut vectors = vec![[0.0; 2]; width * height];
        let mut blended = vec![0.0; stride];
        for y in 0..height {
            let out = &mut vectors[y * width..][..width];
            blended.fill(0.0);
            for (row, weight) in rows.taps(y) {
                let line = &source[row * stride..][..stride];
                for (sum, &value) in blended.iter_mut().zip(line) {
                    *sum += weight * (value * self.scale);
                }
            }
            if columns.is_halving {
                for (mean, pair) in out.iter_mut().zip(blended.as_chunks::<4>().0) {
                    *mean = [0, 1].map(|k| 0.5 * pair[k] + 0.5 * pair[k + 2]);
                }
            } else {
                columns.resample::<2>(&blended, |x, vector| out[x] = vector);
            }
        }
        vectors
    }
}

struct ResizePlane<'a> {
    source: &'a Plane,
    rows: Axis,
    columns: Axis,
}

impl Kernel for ResizePlane<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run(self) -> Vec<f32> {
        let Self {
            source,
            rows,
            columns,
        } = self;
        let (width, height) = (columns.starts.len(), rows.starts.len());
        let mut data = vec![0.0; width * height];
        let mut blended = vec![0.0; source.width];
        for (y, out) in data.chunks_exact_mut(width).enumerate() {
            blended.fill(0.0);
            for (row, weight) in rows.taps(y) {
                let line = &source.data[row * source.width..][..source.width];
                for (sum, &value) in blended.iter_mut().zip(line) {
                    *sum += weight * value;
                }
            }
            if columns.is_halving {
                halve(&blended, out);
            } else {
                columns.resample::<1>(&blended, |x, [value]| out[x] = value);
            }
        }
        data
    }
}

struct ResizeRgb<'a> {
    source: &'a Rgb8,
    rows: Axis,
    columns: Axis,
}

impl Kernel for ResizeRgb<'_> {
    type Output = Vec<u8>;

    #[inline(always)]
    fn run(self) -> Vec<u8> {
        let Self {
            source,
            rows,
            columns,
        } = self;
        let (width, height) = (columns.starts.len(), rows.starts.len());
        let stride = source.width * 3;
        let mut data = vec![0; width * height * 3];
        let mut blended = vec![0.0; stride];
        for (y, out) in data.chunks_exact_mut(width * 3).enumerate() {
            blended.fill(0.0);
            for (row, weight) in rows.taps(y) {
                let line = &source.data[row * stride..][..stride];
                for (sum, &value) in blended.iter_mut().zip(line) {
                    *sum += weight * f32::from(value);
                }
            }
            columns.resample::<3>(&blended, |x, pixel: [f32; 3]| {
                for (byte, value) in out[x * 3..].iter_mut().zip(pixel) {
                    // The cast saturates, which is the clamp.
                    *byte = value.round_ties_even() as u8;
                }
            });
        }
        data
    }
}

/// The mean of two neighbours, as the taps of a halving axis have it.
#[inline(always)]
fn halve(line: &[f32], out: &mut [f32]) {
    for (mean, pair) in out.iter_mut().zip(line.chunks_exact(2)) {
        *mean = 0.5 * pair[0] + 0.5 * pair[1];
    }
}

/// The taps of every output position along one axis.
struct Axis {
    /// Whether every output is the mean of its own two source pixels.
    is_halving: bool,
    /// First source index of each output's contiguous taps.
    starts: Vec<usize>,
    /// `offsets[i]..offsets[i + 1]` are output `i`'s weights.
    offsets: Vec<usize>,
    weights: Vec<f32>,
}

impl Axis {
    fn new(source: usize, target: usize) -> Self {
        let mut axis = Self {
            is_halving: source == 2 * target,
            starts: Vec::with_capacity(target),
            offsets: vec![0],
            weights: Vec::new(),
        };
        for position in 0..target {
            if target < source {
                axis.push_area(position, source, target);
            } else {
                axis.push_cubic(position, source, target);
            }
        }
        axis
    }

    /// Output cell `position` covers `[position, position + 1) * source / target` source pixels; in
    /// units of 1/target pixel the bounds are integers, so the overlaps are exact.
    fn push_area(&mut self, position: usize, source: usize, target: usize) {
        let (from, to) = (position * source, (position + 1) * source);
        let first = from / target;
        let last = (to - 1) / target;
        self.starts.push(first);
        for pixel in first..=last {
            let overlap = to.min((pixel + 1) * target) - from.max(pixel * target);
            self.weights.push((overlap as f64 / source as f64) as f32);
        }
        self.offsets.push(self.weights.len());
    }

    /// Four cubic taps around the half-pixel-centred source position; taps that fall outside are
    /// folded onto the edge pixel.
    fn push_cubic(&mut self, position: usize, source: usize, target: usize) {
        if source == target {
            self.starts.push(position);
            self.weights.push(1.0);
            self.offsets.push(self.weights.len());
            return;
        }
        let centre = (position as f64 + 0.5) * source as f64 / target as f64 - 0.5;
        let base = centre.floor();
        let clamp = |tap: i64| tap.clamp(0, source as i64 - 1) as usize;
        let first = clamp(base as i64 - 1);
        let last = clamp(base as i64 + 2);
        let mut folded = vec![0.0; last - first + 1];
        for tap in -1..=2 {
            folded[clamp(base as i64 + tap) - first] += cubic(centre - base - tap as f64);
        }
        self.starts.push(first);
        self.weights.extend(folded.into_iter().map(|w| w as f32));
        self.offsets.push(self.weights.len());
    }

    #[inline(always)]
    fn weights(&self, position: usize) -> &[f32] {
        &self.weights[self.offsets[position]..self.offsets[position + 1]]
    }

    #[inline(always)]
    fn taps(&self, position: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        (self.starts[position]..).zip(self.weights(position).iter().copied())
    }

    /// Applies the axis to a line of interleaved pixels.
    #[inline(always)]
    fn resample<const CHANNELS: usize>(
        &self,
        line: &[f32],
        mut put: impl FnMut(usize, [f32; CHANNELS]),
    ) {
        for (position, &start) in self.starts.iter().enumerate() {
            let pixels = line[start * CHANNELS..].chunks_exact(CHANNELS);
            let mut sum = [0.0; CHANNELS];
            for (&weight, pixel) in self.weights(position).iter().zip(pixels) {
                for (total, &value) in sum.iter_mut().zip(pixel) {
                    *total += weight * value;
                }
            }
            put(position, sum);
        }
    }
}

/// Keys' cubic convolution kernel.
fn cubic(distance: f64) -> f64 {
    let d = distance.abs();
    if d <= 1.0 {
        ((CUBIC_A + 2.0) * d - (CUBIC_A + 3.0)) * d * d + 1.0
    } else if d < 2.0 {
        (((d - 5.0) * d + 8.0) * d - 4.0) * CUBIC_A
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: usize, height: usize) -> Plane {
        Plane::from_fn(width, height, |x, y| {
            ((x * 37 + y * 91 + x * y * 7) % 251) as f32
        })
    }

    /// The mean of the source over the output cell, by integrating over the source's pixels.
    fn area_twin(source: &Plane, width: usize, height: usize) -> Plane {
        let (sx, sy) = (
            source.width as f64 / width as f64,
            source.height as f64 / height as f64,
        );
        Plane::from_fn(width, height, |x, y| {
            let (mut sum, mut area) = (0.0, 0.0);
            for row in 0..source.height {
                for column in 0..source.width {
                    let overlap = |from: f64, to: f64, pixel: usize| {
                        (to.min(pixel as f64 + 1.0) - from.max(pixel as f64)).max(0.0)
                    };
                    let weight = overlap(x as f64 * sx, (x + 1) as f64 * sx, column)
                        * overlap(y as f64 * sy, (y + 1) as f64 * sy, row);
                    sum += weight * f64::from(source.data[row * source.width + column]);
                    area += weight;
                }
            }
            (sum / area) as f32
        })
    }

    #[test]
    fn shrinking_equals_the_area_mean() {
        let source = texture(37, 23);
        for (w, h) in [(36, 22), (18, 11), (5, 7), (1, 1), (37, 9)] {
            let (fast, slow) = (resize_plane(&source, w, h), area_twin(&source, w, h));
            for (a, b) in fast.data.iter().zip(&slow.data) {
                // f32 weights and sums of values up to 250: some 20 roundings of 1.5e-5.
                assert!((a - b).abs() < 1e-3, "{w}x{h}: {a} vs {b}");
            }
        }
    }

    #[test]
    fn halving_equals_the_general_taps_bit_for_bit() {
        let source = Plane::from_fn(38, 10, |x, y| (x as f32 - 17.3) * 0.37 + y as f32 * 0.11);
        let fast = resize_plane(&source, 19, 5);
        let (rows, columns) = (Axis::new(10, 5), Axis::new(38, 19));
        for y in 0..5 {
            let mut blended = vec![0.0; 38];
            for (row, weight) in rows.taps(y) {
                for (sum, value) in blended.iter_mut().zip(&source.data[row * 38..]) {
                    *sum += weight * value;
                }
            }
            columns.resample::<1>(&blended, |x, [value]| {
                assert_eq!(fast.data[y * 19 + x].to_bits(), value.to_bits());
            });
        }
    }

    #[test]
    fn vectors_are_resized_like_their_components_bit_for_bit() {
        let source = texture(38, 30);
        let vectors: Vec<[f32; 2]> = source.data.iter().map(|v| [*v, -0.0 * v]).collect();
        for (w, h) in [(19, 15), (38, 30), (17, 4), (50, 40), (19, 7)] {
            let found = resize_vectors(&vectors, 38, 0.37, [w, h]);
            for axis in [0, 1] {
                let plane = Plane {
                    data: vectors.iter().map(|v| v[axis] * 0.37).collect(),
                    ..source
                };
                let expected = resize_plane(&plane, w, h);
                let bits = |value: &f32| value.to_bits();
                let found: Vec<u32> = found.iter().map(|v| bits(&v[axis])).collect();
                let expected: Vec<u32> = expected.data.iter().map(bits).collect();
                assert_eq!(found, expected, "{w}x{h}");
            }
        }
        assert!(resize_vectors(&vectors, 0, 1.0, [2, 2]).is_empty());
    }

    #[test]
    fn enlarging_keeps_constants_and_linear_ramps() {
        let ramp = Plane::from_fn(16, 12, |x, _| x as f32);
        let big = resize_plane(&ramp, 64, 48);
        for y in 0..48 {
            for x in 16..48 {
                let exact = (x as f32 + 0.5) / 4.0 - 0.5;
                // Cubic convolution with a = -0.75 reproduces a ramp to a tenth of a step.
                assert!((big.data[y * 64 + x] - exact).abs() < 0.1);
            }
        }
        let flat = resize_plane(&Plane::from_fn(3, 1, |_, _| 77.0), 10, 10);
        assert!(flat.data.iter().all(|v| (v - 77.0).abs() < 1e-4));
    }

    #[test]
    fn mixed_axes_odd_sizes_and_single_pixels_work() {
        let source = texture(9, 5);
        for (w, h) in [(4, 11), (13, 2), (1, 9), (9, 1), (1, 1)] {
            let out = resize_plane(&source, w, h);
            assert_eq!((out.width, out.height, out.data.len()), (w, h, w * h));
            assert!(out.data.iter().all(|v| v.is_finite()));
        }
        let one = resize_plane(&Plane::from_fn(1, 1, |_, _| 5.0), 7, 3);
        assert!(one.data.iter().all(|v| (v - 5.0).abs() < 1e-5));
        assert_eq!(resize_plane(&source, 0, 4), Plane::empty());
    }

    #[test]
    fn rgb_channels_are_resized_like_rounded_planes() {
        let planes = [texture(31, 17), texture(31, 17), texture(31, 17)];
        let data = (0..31 * 17)
            .flat_map(|i| {
                [
                    planes[0].data[i] as u8,
                    255 - planes[1].data[i] as u8,
                    planes[2].data[i] as u8 / 2,
                ]
            })
            .collect();
        let picture = Rgb8::new(31, 17, data).unwrap();
        for (w, h) in [(16, 9), (50, 40), (10, 33)] {
            let out = resize_rgb(&picture, w, h);
            for channel in 0..3 {
                let plane = Plane::from_fn(31, 17, |x, y| {
                    f32::from(picture.data[(y * 31 + x) * 3 + channel])
                });
                let expected = resize_plane(&plane, w, h);
                for (i, value) in expected.data.iter().enumerate() {
                    assert_eq!(out.data[i * 3 + channel], value.round_ties_even() as u8);
                }
            }
        }
    }
}
