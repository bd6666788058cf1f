//! Faults with a known time and place, as generated videos show them.
//!
//! Edits of the picture: a frame of noise, a blurred frame, a region that flickers, a frozen stretch (strengths follow
//! the injected faults of the evidence this project rests on, given there for 256 rows). Failures of the scene, drawn by
//! the renderer: an object vanishes, appears, morphs; the arm or an object teleports. Frame numbers are 0-based. Random
//! numbers come from the fault's seed and the frame number only. Nothing here fails; `corpus` checks the frame numbers.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use crate::geometry::vec3;
use crate::render::RgbFrame;
use crate::scene::{Family, SceneEdit};

/// The kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// One frame is uniform noise.
    NoiseFrame,
    /// One frame is blurred.
    BlurFrame,
    /// An object is gone from the frame on.
    Vanish,
    /// An object is there from the frame on.
    Appear,
    /// An object changes shape and paint over [`MORPH_FRAMES`] frames and stays so.
    Morph,
    /// A region's texture boils for [`FLICKER_FRAMES`] frames.
    Flicker,
    /// The picture stands still for [`FREEZE_FRAMES`] frames, then goes on as if it had not.
    Freeze,
    /// The arm (in `Reach` scenes) or an object jumps and stays there.
    Teleport,
}

/// All kinds.
pub const FAULT_KINDS: [FaultKind; 8] = [
    FaultKind::NoiseFrame,
    FaultKind::BlurFrame,
    FaultKind::Vanish,
    FaultKind::Appear,
    FaultKind::Morph,
    FaultKind::Flicker,
    FaultKind::Freeze,
    FaultKind::Teleport,
];

/// Frames until a morph is complete.
pub const MORPH_FRAMES: usize = 8;
/// Frames a flicker lasts.
pub const FLICKER_FRAMES: usize = 8;
/// Frames that repeat the one before a freeze.
pub const FREEZE_FRAMES: usize = 4;
/// Gaussian of a blurred frame, pixels.
const BLUR_SIGMA_PX: f64 = 2.5;
/// Standard deviation of a flicker's grey-level noise.
const FLICKER_LEVELS: f64 = 22.0;
/// Gaussian that makes the flicker's noise blotchy, pixels.
const FLICKER_SIGMA_PX: f64 = 2.0;
/// Radius of the flickering region over picture height (20 px at 256).
const FLICKER_RADIUS: f64 = 20.0 / 256.0;
/// Width of its soft border over its radius.
const FLICKER_FEATHER: f64 = 0.3;
/// Turn of a teleported arm: about 0.2 m at the hand.
const JUMP_ARM_RAD: f64 = 0.45;
/// Displacement of a teleported object.
const JUMP_OBJECT_M: f64 = 0.17;
/// Kernels are cut off at this many standard deviations.
const CUT_OFF_SIGMAS: f64 = 3.0;

impl FaultKind {
    /// The name used in clip names and labels.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NoiseFrame => "noise_frame",
            Self::BlurFrame => "blur_frame",
            Self::Vanish => "vanish",
            Self::Appear => "appear",
            Self::Morph => "morph",
            Self::Flicker => "flicker",
            Self::Freeze => "freeze",
            Self::Teleport => "teleport",
        }
    }

    /// Whether the scene itself fails (and not only its picture).
    #[must_use]
    pub const fn is_in_scene(self) -> bool {
        matches!(
            self,
            Self::Vanish | Self::Appear | Self::Morph | Self::Teleport
        )
    }

    /// How many frames the faulty event lasts; a vanished, new or displaced object is wrong at one transition.
    #[must_use]
    pub const fn event_frames(self) -> usize {
        match self {
            Self::Morph => MORPH_FRAMES,
            Self::Flicker => FLICKER_FRAMES,
            Self::Freeze => FREEZE_FRAMES,
            Self::NoiseFrame | Self::BlurFrame | Self::Vanish | Self::Appear | Self::Teleport => 1,
        }
    }

    /// The failure of the scene `elapsed` frames after the first faulty one; `side` is the scene's (±1).
    pub(crate) fn scene_edit(self, elapsed: usize, family: Family, side: f64) -> Option<SceneEdit> {
        match self {
            Self::Vanish => Some(SceneEdit::Vanish),
            Self::Appear => Some(SceneEdit::Appear),
            Self::Morph => Some(SceneEdit::Morph(
                ((elapsed + 1) as f64 / MORPH_FRAMES as f64).min(1.0),
            )),
            Self::Teleport if family == Family::Reach => {
                Some(SceneEdit::JumpArm(side * JUMP_ARM_RAD))
            }
            Self::Teleport => Some(SceneEdit::JumpBystander(vec3(
                side * JUMP_OBJECT_M,
                0.04,
                0.0,
            ))),
            Self::NoiseFrame | Self::BlurFrame | Self::Flicker | Self::Freeze => None,
        }
    }
}

/// When and where a clip is faulty.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultTruth {
    /// What is wrong.
    pub kind: FaultKind,
    /// First faulty frame.
    pub first_frame: usize,
    /// Last frame of the faulty event (inclusive): the jump itself, the morph's end, the last frozen frame.
    pub last_frame: usize,
    /// Last frame (inclusive) that differs from the clean twin.
    pub last_changed_frame: usize,
    /// Bounding box of the mask on the first faulty frame: [x0, y0, x1, y1], whole pixels, x1 and y1 exclusive.
    pub bbox_px: [usize; 4],
    /// Number of pixels in that mask.
    pub mask_pixels: usize,
}

/// Replaces the picture by uniform noise.
pub(crate) fn noise_frame(frame: &mut RgbFrame, rng: &mut Pcg32) {
    for value in &mut frame.rgb {
        *value = (rng.next_u32() >> 24) as u8;
    }
}

/// Gaussian blur of the whole picture, borders replicated.
pub(crate) fn blur_frame(frame: &mut RgbFrame) {
    for channel in 0..3 {
        let plane: Vec<f64> = frame.rgb[channel..]
            .iter()
            .step_by(3)
            .map(|&v| f64::from(v))
            .collect();
        let blurred = gaussian(&plane, frame.width, frame.height, BLUR_SIGMA_PX);
        for (pixel, value) in frame.rgb.chunks_exact_mut(3).zip(&blurred) {
            pixel[channel] = to_u8(*value);
        }
    }
}

/// Weight 0..=1 of the flicker at every pixel: 1 around `centre_px`, soft border, 0 outside the radius.
pub(crate) fn flicker_weights(width: usize, height: usize, centre_px: (f64, f64)) -> Vec<f64> {
    let radius = FLICKER_RADIUS * height as f64;
    let mut weights = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let (dx, dy) = (x as f64 - centre_px.0, y as f64 - centre_px.1);
            let inside = 1.0 - (dx * dx + dy * dy).sqrt() / radius;
            weights.push((inside / FLICKER_FEATHER).clamp(0.0, 1.0));
        }
    }
    weights
}

/// Adds blotchy grey noise under the weights.
pub(crate) fn flicker(frame: &mut RgbFrame, weights: &[f64], rng: &mut Pcg32) {
    let white: Vec<f64> = weights
        .iter()
        .map(|_| f64::from(rng.next_u32()) / 4_294_967_296.0 - 0.5)
        .collect();
    let field = gaussian(&white, frame.width, frame.height, FLICKER_SIGMA_PX);
    let count = field.len() as f64;
    let mean = field.iter().sum::<f64>() / count;
    let spread = (field.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count).sqrt();
    if spread > 0.0 {
        let gain = FLICKER_LEVELS / spread;
        for ((pixel, value), weight) in frame.rgb.chunks_exact_mut(3).zip(&field).zip(weights) {
            for v in pixel {
                *v = to_u8(f64::from(*v) + weight * gain * (value - mean));
            }
        }
    }
}

/// A generator for one purpose at one frame: streams of different frames are unrelated.
pub(crate) fn frame_rng(seed: u64, frame: usize) -> Pcg32 {
    // Steele and Vigna's golden-ratio step keeps neighbouring frames' seeds far apart.
    Pcg32::seed_from_u64(seed.wrapping_add((frame as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)))
}

/// Rounds half to even and clips to 0..=255.
pub(crate) fn to_u8(value: f64) -> u8 {
    value.round_ties_even().clamp(0.0, 255.0) as u8
}

/// Separable Gaussian of a `[height, width]` plane, borders replicated.
fn gaussian(plane: &[f64], width: usize, height: usize, sigma_px: f64) -> Vec<f64> {
    let reach = (CUT_OFF_SIGMAS * sigma_px).ceil() as usize;
    let weight = |d: usize| libm::exp(-0.5 * (d as f64 / sigma_px) * (d as f64 / sigma_px));
    let half: Vec<f64> = (0..=reach).map(weight).collect();
    let total = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    let smooth = |at: &dyn Fn(usize) -> f64, i: usize, length: usize| {
        let mut sum = half[0] * at(i);
        for (d, w) in half.iter().enumerate().skip(1) {
            sum += w * (at(i.saturating_sub(d)) + at((i + d).min(length - 1)));
        }
        sum / total
    };
    let mut across = Vec::with_capacity(plane.len());
    for y in 0..height {
        for x in 0..width {
            across.push(smooth(&|k| plane[y * width + k], x, width));
        }
    }
    let mut both = Vec::with_capacity(plane.len());
    for y in 0..height {
        for x in 0..width {
            both.push(smooth(&|k| across[k * width + x], y, height));
        }
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_keeps_constants_and_has_the_right_width() {
        let flat = gaussian(&[7.0; 20 * 12], 20, 12, 2.5);
        assert!(flat.iter().all(|v| (v - 7.0).abs() < 1e-12));
        let mut point = vec![0.0; 41 * 41];
        point[20 * 41 + 20] = 1.0;
        let spread = gaussian(&point, 41, 41, 2.5);
        let variance: f64 = spread
            .iter()
            .enumerate()
            .map(|(k, v)| v * ((k % 41) as f64 - 20.0).powi(2))
            .sum();
        // 2.5² = 6.25, less what the cut-off at 3 sigma (and the rounding up to 8 px) removes: under 3%.
        assert!((variance - 6.25).abs() < 0.19, "{variance}");
    }

    #[test]
    fn frame_rngs_differ_and_repeat() {
        assert_ne!(frame_rng(1, 2).next_u32(), frame_rng(1, 3).next_u32());
        assert_eq!(frame_rng(1, 2).next_u32(), frame_rng(1, 2).next_u32());
    }
}
