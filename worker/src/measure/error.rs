//! What can be wrong with a clip that decodes.

use plumbline_common::row::Status;

/// Wider pictures would blow up at the working height; no camera makes them.
pub(super) const MAX_ASPECT: usize = 8;

/// Why a decoded clip cannot be measured.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ClipError {
    #[error("the picture is {width}×{height}, an aspect beyond {MAX_ASPECT}:1; crop it")]
    Aspect { width: usize, height: usize },
    #[error(
        "a {width}x{height} picture is too small for {stage}: {least} px are needed on each side; enlarge the video"
    )]
    TooSmall {
        stage: &'static str,
        width: usize,
        height: usize,
        least: usize,
    },
    #[error(
        "{frames} frames, more than the {most} that droid.most_frames of the profile allows; cut the clip into parts, or raise that and --memory by some 30 MiB for each frame"
    )]
    TooLong { frames: u32, most: u32 },
    #[error("{stage} at frame {frame}: {source}")]
    Stage {
        stage: &'static str,
        frame: u32,
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl ClipError {
    /// What becomes of the video.
    pub(super) fn status(&self) -> Status {
        match self {
            Self::Aspect { .. } | Self::TooLong { .. } => Status::OverLimit,
            Self::TooSmall { .. } | Self::Stage { .. } => Status::Failed,
        }
    }
}

/// Names the stage and frame of an error.
pub(super) fn at<E: std::error::Error + Send + Sync + 'static>(
    stage: &'static str,
    frame: u32,
) -> impl Fn(E) -> ClipError {
    move |source| ClipError::Stage {
        stage,
        frame,
        source: Box::new(source),
    }
}
