//! Why a video gives no frames: one clear sentence each, with the remedy.

use std::path::PathBuf;

use super::DecodeLimits;

/// Why a video (or a directory of images) could not be decoded in full.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The bytes are a known container, or an image, but do not decode in full.
    #[error("{reason}")]
    Undecodable {
        /// One sentence with the remedy.
        reason: String,
    },
    /// A limit of [`DecodeLimits`] is exceeded.
    #[error("the video has {value} {}, over the limit of {limit}; {}", what.unit(), what.remedy())]
    OverLimit {
        /// Which limit.
        what: LimitKind,
        /// What the video has, in the limit's unit.
        value: f64,
        /// What is allowed.
        limit: f64,
    },
    /// The container holds no picture track (audio only, or only a cover picture).
    #[error("the file has no video track (audio only?); give a file with pictures")]
    NoVideoStream,
    /// The bytes are something else than a supported container.
    #[error("not a video: {looks_like}")]
    NotAVideo {
        /// What the bytes look like, and what to do about it.
        looks_like: String,
    },
    /// No bytes, or a directory without numbered images.
    #[error("{what} is empty; copy or render it again")]
    Empty {
        /// `the file`, or the directory.
        what: String,
    },
    /// The decoder asked for memory that there is not; with more, the same video may decode.
    #[error("not enough memory to decode it; raise --memory or scale the video down")]
    OutOfMemory,
    /// The frame rate given for images cannot be used.
    #[error("the frame rate {fps} is not a positive number; give frames per second, such as 10")]
    InvalidRate {
        /// As given.
        fps: f64,
    },
    /// The file system refused.
    #[error("{}: {source}; check that the file exists and may be read", path.display())]
    Io {
        /// File or directory.
        path: PathBuf,
        /// As the system said.
        source: std::io::Error,
    },
}

/// The bounds of [`DecodeLimits`], by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitKind {
    /// `max_bytes`
    Bytes,
    /// `max_pixels_per_frame`
    PixelsPerFrame,
    /// `max_frames`
    Frames,
    /// `max_duration_s`
    DurationS,
}

impl LimitKind {
    fn unit(self) -> &'static str {
        match self {
            Self::Bytes => "bytes",
            Self::PixelsPerFrame => "pixels per frame",
            Self::Frames => "frames",
            Self::DurationS => "seconds",
        }
    }

    fn remedy(self) -> &'static str {
        match self {
            Self::Bytes => "re-encode it smaller or raise max_bytes",
            Self::PixelsPerFrame => "scale it down or raise max_pixels_per_frame",
            Self::Frames => "cut it into clips or raise max_frames",
            Self::DurationS => "cut it into clips or raise max_duration_s",
        }
    }
}

impl DecodeError {
    /// Whether FFmpeg ran out of memory, which says nothing about the video.
    pub(super) fn is_out_of_memory(error: &ffmpeg_next::Error) -> bool {
        matches!(error, ffmpeg_next::Error::Other { errno } if *errno == ffmpeg_next::ffi::ENOMEM)
    }

    pub(super) fn undecodable(reason: impl Into<String>) -> Self {
        Self::Undecodable {
            reason: reason.into(),
        }
    }
}

impl DecodeLimits {
    pub(crate) fn check_bytes(&self, bytes: u64) -> Result<(), DecodeError> {
        within(LimitKind::Bytes, bytes as f64, self.max_bytes as f64)
    }

    pub(super) fn check_size(&self, width: u64, height: u64) -> Result<(), DecodeError> {
        let pixels = width.saturating_mul(height) as f64;
        within(
            LimitKind::PixelsPerFrame,
            pixels,
            self.max_pixels_per_frame as f64,
        )
    }

    pub(super) fn check_frames(&self, frames: u64) -> Result<(), DecodeError> {
        within(LimitKind::Frames, frames as f64, f64::from(self.max_frames))
    }

    pub(super) fn check_duration(&self, duration_s: f64) -> Result<(), DecodeError> {
        within(LimitKind::DurationS, duration_s, self.max_duration_s)
    }
}

fn within(what: LimitKind, value: f64, limit: f64) -> Result<(), DecodeError> {
    if value > limit {
        return Err(DecodeError::OverLimit { what, value, limit });
    }
    Ok(())
}
