//! Clips and the sample corpus: 12 clean clips and 12 faulty twins.
//!
//! A [`ClipSpec`] is plain data; frames, ground truth and fault masks are pure functions of it and a frame number, so
//! that no clip is ever held in memory. Clip `fault__<kind>_<nn>` shares scene, trajectory, camera and sensor noise with
//! `clean__<family>_<nn>` of the same number; grouping by the prefix before `__` gives the two sides. Progress runs from
//! 0 on the first frame to 1 on the last. Fails on a size, length, frame number or fault position out of bounds.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use crate::SampleError;
use crate::fault::{
    FaultKind, FaultTruth, blur_frame, flicker, flicker_weights, frame_rng, noise_frame, to_u8,
};
use crate::render::{Antialias, Camera, RgbFrame, Samples, render};
use crate::scene::{Family, Scene, SceneEdit, Snapshot};
use crate::texture::Rgb;
use crate::truth::{FrameTruth, truth};

/// Shortest clip.
pub const MIN_FRAMES: usize = 2;
/// Longest clip: beyond it motion per frame is below what a picture of any allowed size resolves.
pub const MAX_FRAMES: usize = 10_000;
/// Default picture width.
pub const WIDTH_PX: usize = 256;
/// Default picture height.
pub const HEIGHT_PX: usize = 192;
/// Default clip length.
pub const FRAMES: usize = 32;
/// Default frame rate.
pub const FPS: f64 = 10.0;
/// Default sensor noise: about a webcam in good light; a picture without any has no still-pixel floor to compare with.
pub const NOISE_LEVELS: f64 = 1.0;
/// Earliest faulty frame in the sample corpus: later than the warm-up of the assessed series.
pub const FIRST_FAULT_FRAME: usize = 9;
/// Frames left after the first faulty one, at least.
pub const FRAMES_AFTER_FAULT: usize = 7;

/// A fault of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultSpec {
    /// What goes wrong.
    pub kind: FaultKind,
    /// First faulty frame; at least 1, because frame 0 is always clean.
    pub first_frame: usize,
    /// Random numbers of the fault.
    pub seed: u64,
}

/// Everything that defines a clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClipSpec {
    /// Unique name, `clean__<family>_<nn>` or `fault__<kind>_<nn>` in the sample corpus.
    pub name: String,
    /// Number shared by a clean clip and its faulty twin.
    pub pair: u32,
    /// What happens and how the camera moves.
    pub family: Family,
    /// Random numbers of the scene.
    pub seed: u64,
    /// Picture width, pixels.
    pub width: usize,
    /// Picture height, pixels.
    pub height: usize,
    /// Number of frames.
    pub frames: usize,
    /// Frames per second (for whoever writes the video; the motion per frame follows from `frames`).
    pub fps: f64,
    /// Sub-samples per pixel.
    pub antialias: Antialias,
    /// Standard deviation of the sensor noise, 8-bit levels; 0 is none.
    pub noise_levels: f64,
    /// The fault, if any.
    pub fault: Option<FaultSpec>,
}

impl ClipSpec {
    /// A clean clip of the default size and length.
    #[must_use]
    pub fn clean(family: Family, pair: u32, seed: u64) -> Self {
        Self {
            name: format!("clean__{}_{pair:02}", family.as_str()),
            pair,
            family,
            seed,
            width: WIDTH_PX,
            height: HEIGHT_PX,
            frames: FRAMES,
            fps: FPS,
            antialias: Antialias::default(),
            noise_levels: NOISE_LEVELS,
            fault: None,
        }
    }

    /// The faulty twin of this clip.
    #[must_use]
    pub fn with_fault(&self, fault: FaultSpec) -> Self {
        Self {
            name: format!("fault__{}_{:02}", fault.kind.as_str(), self.pair),
            fault: Some(fault),
            ..self.clone()
        }
    }

    /// The same clip without its fault.
    #[must_use]
    pub fn clean_twin(&self) -> Self {
        Self {
            name: format!("clean__{}_{:02}", self.family.as_str(), self.pair),
            fault: None,
            ..self.clone()
        }
    }

    /// The same clip in another picture size.
    #[must_use]
    pub fn with_size(self, width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            ..self
        }
    }

    /// Picture `frame` of the clip, as a viewer of the video sees it.
    ///
    /// # Errors
    /// [`SampleError`] where the specification or the frame number is out of bounds.
    pub fn render_frame(&self, frame: usize) -> Result<RgbFrame, SampleError> {
        let stage = self.stage(frame)?;
        let Some((fault, elapsed)) = self.active(frame) else {
            return Ok(self.picture(&stage, frame));
        };
        let shown = match fault.kind {
            FaultKind::Freeze => fault.first_frame - 1,
            _ => frame,
        };
        let mut picture = self.picture(&stage, shown);
        let in_event = elapsed < fault.kind.event_frames();
        match fault.kind {
            FaultKind::NoiseFrame if in_event => {
                noise_frame(&mut picture, &mut frame_rng(fault.seed, frame));
            }
            FaultKind::BlurFrame if in_event => blur_frame(&mut picture),
            FaultKind::Flicker if in_event => {
                flicker(
                    &mut picture,
                    &self.flicker_weights(&stage, fault.first_frame),
                    &mut frame_rng(fault.seed, frame),
                );
            }
            _ => {}
        }
        Ok(picture)
    }

    /// All pictures in order, each rendered when asked for.
    pub fn render_frames(&self) -> impl Iterator<Item = Result<RgbFrame, SampleError>> + '_ {
        (0..self.frames).map(|frame| self.render_frame(frame))
    }

    /// Ground truth of the scene at `frame`; flow is `None` on the last frame.
    ///
    /// # Errors
    /// As [`Self::render_frame`].
    pub fn truth(&self, frame: usize) -> Result<FrameTruth, SampleError> {
        let stage = self.stage(frame)?;
        let next = (frame + 1 < self.frames).then(|| self.snapshot(&stage, frame + 1));
        Ok(truth(
            &stage.camera,
            &self.snapshot(&stage, frame),
            next.as_ref(),
        ))
    }

    /// Pixels that the fault touches at `frame`, `[height, width]`: outside them the picture equals the clean twin's.
    /// `None` where the clip is not faulty at that frame.
    ///
    /// # Errors
    /// As [`Self::render_frame`].
    pub fn fault_mask(&self, frame: usize) -> Result<Option<Vec<bool>>, SampleError> {
        let stage = self.stage(frame)?;
        let Some((fault, _)) = self.active(frame) else {
            return Ok(None);
        };
        Ok(Some(match fault.kind {
            FaultKind::NoiseFrame | FaultKind::BlurFrame | FaultKind::Freeze => {
                vec![true; self.width * self.height]
            }
            FaultKind::Flicker => self
                .flicker_weights(&stage, fault.first_frame)
                .iter()
                .map(|&w| w > 0.0)
                .collect(),
            FaultKind::Vanish | FaultKind::Appear | FaultKind::Morph | FaultKind::Teleport => {
                let faulty = self.snapshot(&stage, frame);
                let clean = stage.scene.snapshot(self.progress(frame), None);
                self.changed_pixels(&stage.camera, &clean, &faulty)
            }
        }))
    }

    /// When and where the clip is faulty; `None` for a clean one.
    ///
    /// # Errors
    /// As [`Self::render_frame`].
    pub fn fault_truth(&self) -> Result<Option<FaultTruth>, SampleError> {
        self.stage(0)?;
        let Some(fault) = self.fault else {
            return Ok(None);
        };
        let Some(mask) = self.fault_mask(fault.first_frame)? else {
            return Ok(None);
        };
        let last_frame = fault.first_frame + fault.kind.event_frames() - 1;
        let mut bbox_px = [self.width, self.height, 0, 0];
        let mut mask_pixels = 0;
        for (k, _) in mask.iter().enumerate().filter(|&(_, &inside)| inside) {
            let (x, y) = (k % self.width, k / self.width);
            bbox_px = [
                bbox_px[0].min(x),
                bbox_px[1].min(y),
                bbox_px[2].max(x + 1),
                bbox_px[3].max(y + 1),
            ];
            mask_pixels += 1;
        }
        if mask_pixels == 0 {
            return Err(SampleError::FaultUnseen {
                kind: fault.kind,
                frame: fault.first_frame,
            });
        }
        let last_changed_frame = if fault.kind.is_in_scene() {
            self.frames - 1
        } else {
            last_frame
        };
        Ok(Some(FaultTruth {
            kind: fault.kind,
            first_frame: fault.first_frame,
            last_frame,
            last_changed_frame,
            bbox_px,
            mask_pixels,
        }))
    }

    fn stage(&self, frame: usize) -> Result<Stage, SampleError> {
        let camera = Camera::new(self.width, self.height)?;
        if !(MIN_FRAMES..=MAX_FRAMES).contains(&self.frames) {
            return Err(SampleError::Frames {
                frames: self.frames,
            });
        }
        if frame >= self.frames {
            return Err(SampleError::FrameOutOfRange {
                frame,
                frames: self.frames,
            });
        }
        if !(self.noise_levels.is_finite() && self.noise_levels >= 0.0) {
            return Err(SampleError::Noise {
                noise_levels: self.noise_levels,
            });
        }
        if let Some(fault) = self.fault {
            let end = fault.first_frame.checked_add(fault.kind.event_frames());
            if fault.first_frame == 0 || end.is_none_or(|end| end > self.frames) {
                return Err(SampleError::FaultOutOfRange {
                    kind: fault.kind,
                    frame: fault.first_frame,
                    frames: self.frames,
                });
            }
        }
        Ok(Stage {
            camera,
            scene: Scene::new(self.family, self.seed),
        })
    }

    /// The fault and the frames since its start, where it changes `frame`.
    fn active(&self, frame: usize) -> Option<(FaultSpec, usize)> {
        let fault = self.fault?;
        let elapsed = frame.checked_sub(fault.first_frame)?;
        (fault.kind.is_in_scene() || elapsed < fault.kind.event_frames())
            .then_some((fault, elapsed))
    }

    fn progress(&self, frame: usize) -> f64 {
        frame as f64 / (self.frames - 1) as f64
    }

    fn snapshot(&self, stage: &Stage, frame: usize) -> Snapshot {
        let edit: Option<SceneEdit> = self.active(frame).and_then(|(fault, elapsed)| {
            fault
                .kind
                .scene_edit(elapsed, self.family, stage.scene.side())
        });
        stage.scene.snapshot(self.progress(frame), edit)
    }

    fn picture(&self, stage: &Stage, frame: usize) -> RgbFrame {
        let colours = render(&stage.camera, self.antialias, &self.snapshot(stage, frame));
        RgbFrame {
            width: self.width,
            height: self.height,
            rgb: self.expose(&colours, frame),
        }
    }

    /// Adds sensor noise and rounds to 8 bits.
    fn expose(&self, colours: &[Rgb], frame: usize) -> Vec<u8> {
        let mut rng = frame_rng(self.seed, frame);
        let mut rgb = Vec::with_capacity(colours.len() * 3);
        for value in colours.iter().flatten() {
            let noise = if self.noise_levels > 0.0 {
                self.noise_levels * nearly_normal(&mut rng)
            } else {
                0.0
            };
            rgb.push(to_u8(value + noise));
        }
        rgb
    }

    /// The flickering region lies on the bystander as the first faulty frame shows it, and stays in its place of the
    /// picture.
    fn flicker_weights(&self, stage: &Stage, first_frame: usize) -> Vec<f64> {
        let view = stage
            .scene
            .snapshot(self.progress(first_frame), None)
            .camera_from_world;
        let place = stage.camera.project(view.apply(stage.scene.bystander_m()));
        flicker_weights(
            self.width,
            self.height,
            place.unwrap_or((stage.camera.cx, stage.camera.cy)),
        )
    }

    /// Pixels of which a sub-sample meets a body that is not the same in both snapshots.
    fn changed_pixels(&self, camera: &Camera, clean: &Snapshot, faulty: &Snapshot) -> Vec<bool> {
        let mut mask = vec![false; self.width * self.height];
        for (shown, other) in [(clean, faulty), (faulty, clean)] {
            Samples::cast(camera, self.antialias, shown).for_each_body(|pixel, body| {
                if !other.bodies.contains(body) {
                    mask[pixel] = true;
                }
            });
        }
        mask
    }
}

/// A checked camera and the scene before it.
struct Stage {
    camera: Camera,
    scene: Scene,
}

/// Sum of the four bytes of a random word, standardised: mean 0, variance 1, bell-shaped; no logarithm needed.
fn nearly_normal(rng: &mut Pcg32) -> f64 {
    // A uniform byte has mean 127.5 and variance (256² − 1)/12; four of them 510 and 21845.
    const MEAN: f64 = 510.0;
    const DEVIATION: f64 = 147.800_541_271_004_53;
    let sum: u32 = rng
        .next_u32()
        .to_le_bytes()
        .iter()
        .map(|&b| u32::from(b))
        .sum();
    (f64::from(sum) - MEAN) / DEVIATION
}

/// Family and fault of each pair: all kinds, some twice; 8 pairs with a static camera, 4 with a moving one.
const PAIRS: [(Family, FaultKind); 12] = [
    (Family::Pick, FaultKind::NoiseFrame),
    (Family::Push, FaultKind::BlurFrame),
    (Family::Reach, FaultKind::Teleport),
    (Family::Pick, FaultKind::Vanish),
    (Family::Push, FaultKind::Appear),
    (Family::Reach, FaultKind::Freeze),
    (Family::Pick, FaultKind::Morph),
    (Family::Push, FaultKind::Morph),
    (Family::Pan, FaultKind::Flicker),
    (Family::Pan, FaultKind::Vanish),
    (Family::Dolly, FaultKind::Appear),
    (Family::Dolly, FaultKind::Teleport),
];

/// The sample corpus: the 12 clean clips, then their 12 faulty twins in the same order.
#[must_use]
pub fn sample_corpus(seed: u64) -> Vec<ClipSpec> {
    let mut rng = Pcg32::seed_from_u64(seed);
    let (mut clean, mut faulty) = (Vec::new(), Vec::new());
    for (pair, (family, kind)) in (0_u32..).zip(PAIRS) {
        let clip = ClipSpec::clean(family, pair, rng.next_u64());
        // The event ends, and something follows it, before the clip does.
        let after = FRAMES_AFTER_FAULT.max(kind.event_frames() + 1);
        let starts = (clip.frames - after - FIRST_FAULT_FRAME + 1) as u64;
        let first_frame = FIRST_FAULT_FRAME + ((u64::from(rng.next_u32()) * starts) >> 32) as usize;
        faulty.push(clip.with_fault(FaultSpec {
            kind,
            first_frame,
            seed: rng.next_u64(),
        }));
        clean.push(clip);
    }
    clean.append(&mut faulty);
    clean
}

/// Size and length of the clips of [`camera_corpus`]: what costs are compared on.
const CAMERA_SIDE_PX: usize = 256;
const CAMERA_FRAMES: usize = 60;
/// Clips of each camera.
const CAMERA_CLIPS: u32 = 3;

/// Clips of one size and length that differ in what the camera does: it stands, turns, or travels. Three of each, named
/// `static__<nn>`, `rotation__<nn>` and `parallax__<nn>`; those of one number share room, objects and task.
#[must_use]
pub fn camera_corpus(seed: u64) -> Vec<ClipSpec> {
    let mut rng = Pcg32::seed_from_u64(seed);
    let seeds: Vec<u64> = (0..CAMERA_CLIPS).map(|_| rng.next_u64()).collect();
    let mut clips = Vec::new();
    for (name, family) in [
        ("static", Family::Pick),
        ("rotation", Family::Pan),
        ("parallax", Family::Flyby),
    ] {
        for (pair, &seed) in (0..).zip(&seeds) {
            clips.push(ClipSpec {
                name: format!("{name}__{pair:02}"),
                width: CAMERA_SIDE_PX,
                height: CAMERA_SIDE_PX,
                frames: CAMERA_FRAMES,
                ..ClipSpec::clean(family, pair, seed)
            });
        }
    }
    clips
}
