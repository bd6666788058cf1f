//! Procedural surface colour: value noise in three octaves, mixed with checks or stripes.
//!
//! Coordinates are metres on the surface at rest, so that a pattern moves and deforms with its body. Colours are RGB in
//! 0..=255, as displayed (no gamma is undone). The finest octave and the edges of the patterns are soft over several
//! millimetres: at the sizes and distances of the sample scenes that is more than one sub-sample, so that 3×3 samples
//! per pixel suffice against aliasing. Nothing fails.

/// A colour: red, green, blue in 0..=255.
pub type Rgb = [f64; 3];

/// How base and accent colour alternate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Blotches: the noise itself mixes the two colours.
    Blotches,
    /// A checkerboard.
    Checker {
        /// Side of two squares, metres.
        period_m: f64,
    },
    /// Stripes across the first surface coordinate.
    Stripes {
        /// Width of a base and an accent stripe together, metres.
        period_m: f64,
    },
}

/// A procedural texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texture {
    /// How the two colours alternate.
    pub pattern: Pattern,
    /// First colour.
    pub base: Rgb,
    /// Second colour.
    pub accent: Rgb,
    /// Wavelength of the coarsest octave of the noise, metres (> 0).
    pub wavelength_m: f64,
    /// Relative brightness swing of the noise on top of the pattern, 0..1.
    pub grain: f64,
    /// Which noise.
    pub seed: u32,
}

/// Octaves of noise; the finest has a quarter of the wavelength.
const OCTAVES: u32 = 3;
/// Slope of the pattern edges: the colours mix over 1/8 of a half period, which keeps edges band-limited.
const EDGE_SLOPE: f64 = 4.0;

impl Texture {
    /// The colour at surface coordinates (`u_m`, `v_m`) of a face; faces differ only in their noise.
    #[must_use]
    pub fn albedo(&self, u_m: f64, v_m: f64, face: u32) -> Rgb {
        let noise = fbm(
            u_m / self.wavelength_m,
            v_m / self.wavelength_m,
            self.seed.wrapping_add(face),
        );
        let mix = match self.pattern {
            // Twice the contrast: the sum of octaves rarely leaves the middle half of [0, 1].
            Pattern::Blotches => 0.5 + 2.0 * (noise - 0.5),
            Pattern::Checker { period_m } => {
                0.5 + EDGE_SLOPE * triangle(u_m / period_m) * triangle(v_m / period_m)
            }
            Pattern::Stripes { period_m } => 0.5 + EDGE_SLOPE * triangle(u_m / period_m),
        }
        .clamp(0.0, 1.0);
        // Darker where the accent is: in blotches, whose accents are dark, the two must not cancel.
        let light = 1.0 - self.grain * (2.0 * noise - 1.0);
        std::array::from_fn(|c| (self.base[c] + mix * (self.accent[c] - self.base[c])) * light)
    }
}

/// Triangle wave of period 1 with values in [−1, 1] and zeros at 0 and 1/2.
fn triangle(x: f64) -> f64 {
    let phase = x - 0.25 - f64::from(whole(x - 0.25));
    1.0 - 4.0 * (phase - 0.5).abs()
}

/// Floor as an integer. `f64::floor` is a library call on baseline x86-64, and this is the hottest line of a rendering;
/// coordinates are lattice cells or pattern periods of a scene, thousands at most.
fn whole(x: f64) -> i32 {
    let towards_zero = x as i32;
    towards_zero.wrapping_sub(i32::from(x < f64::from(towards_zero)))
}

/// Sum of octaves of value noise, in [0, 1].
fn fbm(x: f64, y: f64, seed: u32) -> f64 {
    let (mut sum, mut total, mut gain, mut frequency) = (0.0, 0.0, 1.0, 1.0);
    for octave in 0..OCTAVES {
        sum += gain
            * value_noise(
                x * frequency,
                y * frequency,
                seed.wrapping_mul(31).wrapping_add(octave),
            );
        total += gain;
        gain *= 0.5;
        frequency *= 2.0;
    }
    sum / total
}

/// Random values on the integer lattice, joined by smoothstep interpolation; in [0, 1].
fn value_noise(x: f64, y: f64, seed: u32) -> f64 {
    let (ix, iy) = (whole(x), whole(y));
    let (fx, fy) = (smoothstep(x - f64::from(ix)), smoothstep(y - f64::from(iy)));
    let (jx, jy) = (ix.wrapping_add(1), iy.wrapping_add(1));
    let top = lattice(ix, iy, seed) * (1.0 - fx) + lattice(jx, iy, seed) * fx;
    let bottom = lattice(ix, jy, seed) * (1.0 - fx) + lattice(jx, jy, seed) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// 3t² − 2t³: 0 at 0, 1 at 1, level at both ends.
pub(crate) fn smoothstep(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

/// A value in [0, 1) that depends on the lattice point and the seed only (integer mixing after Wellons' lowbias32).
fn lattice(x: i32, y: i32, seed: u32) -> f64 {
    let mut h = (x as u32)
        .wrapping_mul(0x9E37_79B1)
        .wrapping_add((y as u32).wrapping_mul(0x85EB_CA77))
        .wrapping_add(seed.wrapping_mul(0xC2B2_AE3D));
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    h ^= h >> 16;
    f64::from(h) * (1.0 / 4_294_967_296.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_continuous_bounded_and_not_constant() {
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for i in 0..5000 {
            let x = f64::from(i) * 0.013 - 30.0;
            let here = fbm(x, 0.7 * x, 5);
            let near = fbm(x + 1e-6, 0.7 * x, 5);
            // Slope of smoothstep is at most 1.5 per lattice cell, of the octaves together at most 1.5·3/1.75 ≈ 2.6.
            assert!((here - near).abs() < 3e-6);
            low = low.min(here);
            high = high.max(here);
        }
        assert!(
            low >= 0.0 && high <= 1.0 && high - low > 0.5,
            "{low} {high}"
        );
    }

    #[test]
    fn checker_alternates() {
        let texture = Texture {
            pattern: Pattern::Checker { period_m: 0.1 },
            base: [0.0; 3],
            accent: [200.0; 3],
            wavelength_m: 0.1,
            grain: 0.0,
            seed: 1,
        };
        assert_eq!(texture.albedo(0.025, 0.025, 0), [200.0; 3]);
        assert_eq!(texture.albedo(0.075, 0.025, 0), [0.0; 3]);
        assert_eq!(texture.albedo(0.075, -0.025, 0), [200.0; 3]);
    }
}
