//! Plumbline: renders clips with exact flow, depth and pose, and known faults.
//!
//! A small software renderer of tabletop robot scenes, for the demo corpus and for tests. Everything is a pure function
//! of a [`ClipSpec`] and a frame number: no files, no clock, no threads; the same bits on every machine (trigonometry
//! from `libm`, no fused or reordered arithmetic). Pixel centres have whole-number coordinates; the world has z up, the
//! camera x right, y down, z forward; poses are `camera_from_world`; lengths are metres, flow is in pixels.
//!
//! [`sample_corpus`] lists the clips, [`ClipSpec::render_frame`] draws them, [`ClipSpec::truth`] gives flow, depth and
//! pose, [`ClipSpec::fault_truth`] and [`ClipSpec::fault_mask`] the faults.

pub mod arm;
pub mod body;
pub mod corpus;
pub mod fault;
pub mod geometry;
mod layout;
pub mod render;
pub mod scene;
mod task;
pub mod texture;
pub mod truth;

pub use corpus::{ClipSpec, FaultSpec, camera_corpus, sample_corpus};
pub use fault::{FAULT_KINDS, FaultKind, FaultTruth};
pub use geometry::Pose;
pub use render::{Antialias, Camera, RgbFrame};
pub use scene::Family;
pub use truth::{FlowTruth, FrameTruth};

/// Why a clip cannot be rendered as asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SampleError {
    /// A side of the picture is out of bounds.
    #[error(
        "picture of {width}x{height} pixels: each side must have {} to {}",
        render::MIN_SIDE_PX,
        render::MAX_SIDE_PX
    )]
    Size {
        /// Width asked for.
        width: usize,
        /// Height asked for.
        height: usize,
    },
    /// The clip's length is out of bounds.
    #[error(
        "clip of {frames} frames: must have {} to {}",
        corpus::MIN_FRAMES,
        corpus::MAX_FRAMES
    )]
    Frames {
        /// Length asked for.
        frames: usize,
    },
    /// There is no such frame.
    #[error("frame {frame} of a clip of {frames}")]
    FrameOutOfRange {
        /// Frame asked for.
        frame: usize,
        /// Length of the clip.
        frames: usize,
    },
    /// The sensor noise is negative or not a number.
    #[error("sensor noise of {noise_levels} levels")]
    Noise {
        /// Standard deviation asked for.
        noise_levels: f64,
    },
    /// The fault starts on frame 0 or does not end within the clip.
    #[error("{} at frame {frame} does not fit into frames 1 to {}", kind.as_str(), frames.saturating_sub(1))]
    FaultOutOfRange {
        /// The fault.
        kind: FaultKind,
        /// Its first frame.
        frame: usize,
        /// Length of the clip.
        frames: usize,
    },
    /// The fault's object is not in view on its first frame.
    #[error("{} at frame {frame} cannot be seen", kind.as_str())]
    FaultUnseen {
        /// The fault.
        kind: FaultKind,
        /// Its first frame.
        frame: usize,
    },
}
