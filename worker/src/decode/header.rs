//! Length and size of a video from its header alone: no picture is read.
//!
//! A header may be wrong where decoding would tell; this is for planning, not for measuring. What it claims is
//! bounded by the compute child's memory, as everything here is.

use std::io::{Read, Seek};

use serde::{Deserialize, Serialize};

use super::convert::{aspect, square_width};
use super::orient::Orientation;
use super::source::Source;
use super::{DecodeError, DecodeLimits, Interval};

/// Length and size of a video.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shape {
    /// Frames.
    pub frames: u32,
    /// Columns, as presented.
    pub width: u32,
    /// Rows, as presented.
    pub height: u32,
}

/// The shape of a video file, or of an episode in it; `None` where the header does not tell it. What a header
/// does not count is its length times its rate, and no more than the limit.
///
/// # Errors
/// [`DecodeError`], where decoding would refuse the video before its first frame.
pub fn video_shape(
    file: impl Read + Seek + Send + 'static,
    interval: Option<Interval>,
    limits: &DecodeLimits,
) -> Result<Option<Shape>, DecodeError> {
    let source = Source::of_unread(file)?;
    let by_time = |length_s: f64| {
        let frames = (length_s * source.header_rate()?).round_ties_even();
        Some((frames as u64).min(limits.max_frames.into()))
    };
    let frames = match interval {
        Some(interval) => {
            source.check_size(limits)?;
            limits.check_duration(interval.length_s())?;
            by_time(interval.length_s())
        }
        None => {
            source.check_header(limits)?;
            let frames = source.header_frames();
            frames.or_else(|| by_time(source.header_duration_s()?))
        }
    };
    let header = source.header;
    let orientation = source.orientation.unwrap_or(Orientation::UPRIGHT);
    let (coded_width, height) = match (header.width, header.height) {
        // Some codecs state the size in their own header only (MPEG-4).
        (0, _) | (_, 0) => {
            let opened = source.decoder(limits)?;
            (opened.width(), opened.height().into())
        }
        (width, height) => (u32::try_from(width).unwrap_or(u32::MAX), height),
    };
    let width = square_width(coded_width, aspect(header.pixel_aspect));
    limits.check_size(width, height)?;
    let (width, height) = orientation.presented_size(width as usize, height as usize);
    Ok(frames.and_then(|frames| shape(frames, width, height)))
}

/// `None` where anything is 0.
pub(super) fn shape(frames: u64, width: usize, height: usize) -> Option<Shape> {
    let shape = Shape {
        frames: frames.try_into().ok()?,
        width: width.try_into().ok()?,
        height: height.try_into().ok()?,
    };
    (shape.frames > 0 && shape.width > 0 && shape.height > 0).then_some(shape)
}
