//! Separable smoothing of planes: Gaussian blur and box mean.
//!
//! Borders are reflected about the edge pixel's centre without repeating it (`dcb|abcd|cba`, OpenCV's
//! default `BORDER_REFLECT_101`), as often as needed for planes smaller than the kernel. Units are
//! those of the plane. Total functions: an invalid plane gives an empty one.

use super::Plane;
use crate::flow::simd::{Kernel, dispatch};

// Values summed at once: four registers of eight, which hides the latency of an addition.
const BLOCK: usize = 32;

// OpenCV cuts float Gaussians at four standard deviations; beyond lies 6e-5 of the mass.
const GAUSSIAN_REACH_SIGMAS: f64 = 4.0;

/// Gaussian blur with standard deviation `sigma_px`; a sigma that is not positive, or not finite,
/// returns the plane as it is.
#[must_use]
pub fn gaussian_blur(plane: &Plane, sigma_px: f64) -> Plane {
    if !(sigma_px.is_finite() && sigma_px > 0.0) {
        return convolve(plane, &[1.0]);
    }
    let radius = (sigma_px * GAUSSIAN_REACH_SIGMAS)
        .round_ties_even()
        .max(1.0) as i64;
    let kernel: Vec<f64> = (-radius..=radius)
        .map(|k| libm::exp(-0.5 * (k as f64 / sigma_px).powi(2)))
        .collect();
    let total: f64 = kernel.iter().sum();
    let kernel: Vec<f32> = kernel.iter().map(|k| (k / total) as f32).collect();
    convolve(plane, &kernel)
}

/// Mean over the `(2 radius + 1)²` box around each pixel.
#[must_use]
pub fn box_mean(plane: &Plane, radius: usize) -> Plane {
    let taps = 2 * radius + 1;
    convolve(plane, &vec![(1.0 / taps as f64) as f32; taps])
}

/// Applies an odd kernel along both axes.
fn convolve(plane: &Plane, kernel: &[f32]) -> Plane {
    if plane.validate().is_err() {
        return Plane::empty();
    }
    Plane {
        data: dispatch(Convolution { plane, kernel }),
        ..*plane
    }
}

struct Convolution<'a> {
    plane: &'a Plane,
    kernel: &'a [f32],
}

impl Kernel for Convolution<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run(self) -> Vec<f32> {
        if self.kernel.iter().all(|&weight| weight == self.kernel[0]) {
            self.weighed::<true>()
        } else {
            self.weighed::<false>()
        }
    }
}

impl Convolution<'_> {
    /// Each sum runs over the taps in order, whatever the width of the vectors. Where all weights are the same,
    /// values are multiplied before they are added, each once: the same products.
    #[inline(always)]
    fn weighed<const UNIFORM: bool>(self) -> Vec<f32> {
        let Self { plane, kernel } = self;
        let (width, height) = (plane.width, plane.height);
        let radius = kernel.len() / 2;
        let mut scaled = Vec::new();
        let source = if UNIFORM {
            scaled.extend_from_slice(&plane.data);
            scale(&mut scaled, kernel[0]);
            &scaled
        } else {
            &plane.data
        };
        // Where the rows begin that each row's taps read.
        let mut starts = Vec::with_capacity(height + 2 * radius);
        for row in 0..height + 2 * radius {
            starts.push(reflect(row as i64 - radius as i64, height) * width);
        }
        let mut data = Vec::with_capacity(plane.data.len());
        let mut padded = vec![0.0; width + 2 * radius];
        let mut out = vec![0.0; width];
        for near in starts.windows(kernel.len()) {
            let middle = &mut padded[radius..radius + width];
            weigh::<UNIFORM>(kernel, middle, |k| &source[near[k]..][..width]);
            if UNIFORM {
                scale(middle, kernel[0]);
            }
            for k in 1..=radius {
                padded[radius - k] = padded[radius + reflect(-(k as i64), width)];
                padded[radius + width - 1 + k] =
                    padded[radius + reflect((width - 1 + k) as i64, width)];
            }
            weigh::<UNIFORM>(kernel, &mut out, |k| &padded[k..k + width]);
            data.extend_from_slice(&out);
        }
        data
    }
}

#[inline(always)]
fn scale(values: &mut [f32], weight: f32) {
    for value in values {
        *value *= weight;
    }
}

/// `out[x] = Σ kernel[k] · line(k)[x]`, in blocks that stay in registers; without the weights where they are in
/// the lines already.
#[inline(always)]
fn weigh<'a, const UNIFORM: bool>(
    kernel: &[f32],
    out: &mut [f32],
    line: impl Fn(usize) -> &'a [f32],
) {
    let whole = out.len() - out.len() % BLOCK;
    let (blocks, rest) = out.split_at_mut(whole);
    for (number, block) in blocks.chunks_exact_mut(BLOCK).enumerate() {
        let mut sums = [0.0f32; BLOCK];
        for (k, &weight) in kernel.iter().enumerate() {
            let values = &line(k)[number * BLOCK..][..BLOCK];
            for (sum, &value) in sums.iter_mut().zip(values) {
                *sum += if UNIFORM { value } else { weight * value };
            }
        }
        block.copy_from_slice(&sums);
    }
    rest.fill(0.0);
    for (k, &weight) in kernel.iter().enumerate() {
        for (sum, &value) in rest.iter_mut().zip(&line(k)[whole..]) {
            *sum += if UNIFORM { value } else { weight * value };
        }
    }
}

/// The in-range index that `index` reflects to.
fn reflect(index: i64, length: usize) -> usize {
    if length <= 1 {
        return 0;
    }
    let period = 2 * (length as i64 - 1);
    let wrapped = index.rem_euclid(period);
    wrapped.min(period - wrapped) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: usize, height: usize) -> Plane {
        Plane::from_fn(width, height, |x, y| {
            ((x * 53 + y * 29 + x * y) % 256) as f32
        })
    }

    /// One axis after the other, tap by tap.
    fn twin(plane: &Plane, kernel: &[f32]) -> Plane {
        let radius = kernel.len() as i64 / 2;
        let along = |plane: &Plane, dx: i64, dy: i64| {
            Plane::from_fn(plane.width, plane.height, |x, y| {
                kernel.iter().enumerate().fold(0.0, |sum, (k, weight)| {
                    let reach = k as i64 - radius;
                    let column = reflect(x as i64 + reach * dx, plane.width);
                    let row = reflect(y as i64 + reach * dy, plane.height);
                    sum + weight * plane.data[row * plane.width + column]
                })
            })
        };
        along(&along(plane, 0, 1), 1, 0)
    }

    #[test]
    fn blocks_equal_single_values_bit_for_bit() {
        // The second's products are rounded.
        for kernel in [[0.1, -0.25, 0.7, 0.33, 0.013], [0.2; 5]] {
            for (w, h) in [(1, 1), (3, 2), (31, 5), (32, 4), (71, 9), (128, 3)] {
                let plane = texture(w, h);
                let expected = twin(&plane, &kernel);
                assert_eq!(convolve(&plane, &kernel), expected);
                let plain = Convolution {
                    plane: &plane,
                    kernel: &kernel,
                };
                assert_eq!(plain.run(), expected.data);
            }
        }
    }

    #[test]
    fn box_mean_equals_the_plain_double_loop() {
        for (w, h, radius) in [(9, 7, 1), (5, 4, 3), (1, 6, 2), (1, 1, 1)] {
            let plane = texture(w, h);
            let fast = box_mean(&plane, radius);
            for y in 0..h {
                for x in 0..w {
                    let mut sum = 0.0;
                    let r = radius as i64;
                    for dy in -r..=r {
                        for dx in -r..=r {
                            let (row, column) =
                                (reflect(y as i64 + dy, h), reflect(x as i64 + dx, w));
                            sum += f64::from(plane.data[row * w + column]);
                        }
                    }
                    let mean = sum / ((2 * r + 1) * (2 * r + 1)) as f64;
                    assert!((f64::from(fast.data[y * w + x]) - mean).abs() < 1e-3);
                }
            }
        }
    }

    #[test]
    fn gaussian_keeps_constants_and_spreads_an_impulse_by_its_variance() {
        let flat = gaussian_blur(&Plane::from_fn(7, 3, |_, _| 9.0), 4.0);
        assert!(flat.data.iter().all(|v| (v - 9.0).abs() < 1e-4));
        let impulse = Plane::from_fn(65, 65, |x, y| f32::from(u8::from((x, y) == (32, 32))));
        let blurred = gaussian_blur(&impulse, 2.0);
        let variance: f64 = (0..65 * 65)
            .map(|i| (i % 65) as f64 - 32.0)
            .zip(&blurred.data)
            .map(|(x, &v)| x * x * f64::from(v))
            .sum();
        // Cutting at 4 sigma removes 0.1% of the second moment.
        assert!((variance - 4.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn reflection_does_not_repeat_the_edge() {
        let seen: Vec<usize> = (-4..8).map(|i| reflect(i, 4)).collect();
        assert_eq!(seen, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert!((-3..3).all(|i| reflect(i, 1) == 0));
    }
}
