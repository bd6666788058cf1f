//! Faults injected into real clips: the kinds, shapes and strengths of `prototype/inject.py`, kind by
//! kind, not tuned. Pictures are 256 px high; lengths in pixels, frames 0-based in the clip given.
//!
//! Random numbers come from a seeded generator, so that a clip and a kind always give the same fault;
//! they are not NumPy's, so figures agree with the prototype's in distribution only.

#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "what cannot be read fails the test"
)]

pub(crate) mod evaluate;
pub(crate) mod inpaint;
pub(crate) mod picture;
pub(crate) mod real;
pub(crate) mod run;

use plumbline_vision::image::{Plane, Rgb8, gaussian_blur, resize_rgb};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use picture::{
    add_grey, bilateral, blend, blur, circle, closed, dilated, elastic, map_pixels, median_picture,
    normal_plane, opened, shift_mask, shift_picture, textured_point, warp,
};

/// The kinds, in the order of the evidence's table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Noise,
    Foreign,
    Blur,
    Regenerated,
    Appear,
    Flicker,
    Freeze,
    Teleport,
    Morph,
    Vanish,
}

pub(crate) const KINDS: [Kind; 10] = [
    Kind::Noise,
    Kind::Foreign,
    Kind::Blur,
    Kind::Regenerated,
    Kind::Appear,
    Kind::Flicker,
    Kind::Freeze,
    Kind::Teleport,
    Kind::Morph,
    Kind::Vanish,
];

/// A clip with a fault.
pub(crate) struct Injected {
    pub(crate) frames: Vec<Rgb8>,
    /// Frames that differ from the clean clip.
    pub(crate) changed: Vec<bool>,
    /// First and last frame of the fault.
    pub(crate) span: [usize; 2],
    /// Where, `[H, W]`; `None` for whole frames.
    pub(crate) mask: Option<Vec<bool>>,
}

/// Frames at the ends in which no fault starts.
const QUIET_ENDS: usize = 9;
const NOISE_LEVELS: f64 = 22.0;

/// The clip with one fault; `None` where the kind cannot be had (nothing moves that could jump).
/// `other` is a foreign clip.
pub(crate) fn inject(clean: &[Rgb8], kind: Kind, seed: u64, other: &[Rgb8]) -> Option<Injected> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (n, width, height) = (clean.len(), clean[0].width, clean[0].height);
    let start = random.random_range(QUIET_ENDS..n - QUIET_ENDS);
    let radius = random.random_range(14..26usize) as f64;
    let mut injected = Injected {
        frames: clean.to_vec(),
        changed: vec![false; n],
        span: [start, start],
        mask: None,
    };
    let disc = |random: &mut Pcg64Mcg, feather: f64| {
        let centre = textured_point(&clean[start], random);
        (centre, circle(width, height, centre, radius, feather))
    };
    let core = |mask: &Plane| Some(mask.data.iter().map(|&m| m > 0.3).collect());
    match kind {
        Kind::Noise => {
            let bytes = (0..width * height * 3).map(|_| random.random_range(0..=255u8));
            injected.set(start, Rgb8::new(width, height, bytes.collect()).unwrap());
        }
        Kind::Foreign => {
            let foreign = &other[other.len() / 2];
            injected.set(start, resize_rgb(foreign, width, height));
        }
        Kind::Blur => injected.set(start, blur(&clean[start], 2.5)),
        Kind::Regenerated => {
            let half = resize_rgb(&clean[start], width / 2, height / 2);
            let smooth = bilateral(&resize_rgb(&half, width, height), 3, 40.0, 5.0);
            let field = elastic(&mut random, width, height, 1.5, 12.0);
            injected.set(start, warp(&smooth, &field, 1.0));
        }
        Kind::Morph => {
            let (_, mask) = disc(&mut random, 4.0);
            let mut field = elastic(&mut random, width, height, 1.0, 0.45 * radius);
            let masked = |k: usize, v: f32| (v * mask.data[k]).abs();
            let largest = field.iter().fold(1e-6f32, |most, plane| {
                plane
                    .data
                    .iter()
                    .enumerate()
                    .fold(most, |m, (k, &v)| m.max(masked(k, v)))
            });
            for plane in &mut field {
                for (value, mask) in plane.data.iter_mut().zip(&mask.data) {
                    *value *= mask / largest * (0.55 * radius) as f32;
                }
            }
            for (t, frame) in clean.iter().enumerate().skip(start) {
                let share = ((t - start + 1) as f32 / 8.0).min(1.0);
                injected.set(t, warp(frame, &field, share));
            }
            injected.span[1] = start + 8;
            injected.mask = core(&mask);
        }
        Kind::Vanish => {
            let (_, mask) = disc(&mut random, 1.5);
            let hole: Vec<bool> = mask.data.iter().map(|&m| m > 0.2).collect();
            for (t, frame) in clean.iter().enumerate().skip(start) {
                let filled = inpaint::telea(frame, &hole, 3);
                injected.set(t, blend(frame, &filled, &mask));
            }
            injected.mask = core(&mask);
        }
        Kind::Appear => {
            let (centre, mask) = disc(&mut random, 1.5);
            let foreign = resize_rgb(&other[0], width, height);
            let from = textured_point(&foreign, &mut random);
            let rolled = map_pixels(width, height, |x, y| {
                let column = (x + width + from[0] - centre[0]) % width;
                let row = (y + height + from[1] - centre[1]) % height;
                picture::pixel(&foreign, column, row)
            });
            for (t, frame) in clean.iter().enumerate().skip(start) {
                injected.set(t, blend(frame, &rolled, &mask));
            }
            injected.mask = core(&mask);
        }
        Kind::Flicker => {
            let (_, mask) = disc(&mut random, 4.0);
            injected.span[1] = (start + 7).min(n - 1);
            let last = injected.span[1];
            for (t, frame) in clean.iter().enumerate().take(last + 1).skip(start) {
                let noise = gaussian_blur(&normal_plane(&mut random, width, height), 2.0);
                let gain = NOISE_LEVELS / picture::deviation(&noise);
                injected.set(t, add_grey(frame, &noise, &mask, gain as f32));
            }
            injected.mask = core(&mask);
        }
        Kind::Freeze => {
            for t in start..start + 4 {
                injected.set(t, clean[start - 1].clone());
            }
            injected.span[1] = start + 4;
        }
        Kind::Teleport => {
            let jumps = [[32i64, 0], [-32, 0], [0, 24], [-24, 16]];
            teleport(&mut injected, clean, jumps[random.random_range(0..4usize)]);
            let mask = injected.mask.as_ref()?;
            let share = mask.iter().filter(|&&m| m).count() as f64 / mask.len() as f64;
            if !(0.01..=0.4).contains(&share) {
                return None;
            }
        }
    }
    Some(injected)
}

/// What differs from the clip's median picture is cut out and put down elsewhere, from the start on.
fn teleport(injected: &mut Injected, clean: &[Rgb8], by: [i64; 2]) {
    let background = median_picture(clean);
    let (width, height) = (background.width, background.height);
    let start = injected.span[0];
    for (t, frame) in clean.iter().enumerate().skip(start) {
        let differs: Vec<bool> = frame
            .data
            .chunks_exact(3)
            .zip(background.data.chunks_exact(3))
            .map(|(a, b)| a.iter().zip(b).any(|(&a, &b)| a.abs_diff(b) > 25))
            .collect();
        let object = dilated(&closed(&opened(&differs, width, 1), width, 4), width, 2);
        let object = Plane {
            width,
            height,
            data: object.iter().map(|&m| f32::from(u8::from(m))).collect(),
        };
        let object = gaussian_blur(&object, 1.0);
        let moved = shift_mask(&object, by);
        let without = blend(frame, &background, &object);
        injected.set(t, blend(&without, &shift_picture(frame, by), &moved));
        if t == start {
            let touched = object.data.iter().zip(&moved.data);
            injected.mask = Some(touched.map(|(&a, &b)| a > 0.5 || b > 0.5).collect());
        }
    }
}

impl Injected {
    fn set(&mut self, frame: usize, picture: Rgb8) {
        self.frames[frame] = picture;
        self.changed[frame] = true;
    }
}
