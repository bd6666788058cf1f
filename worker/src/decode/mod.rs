//! Videos in: hostile bytes (or a directory of numbered images) to a bounded stream of RGB frames.
//!
//! Frames are `[H, W, 3]` 8-bit sRGB as a player would show them (rotation and pixel shape applied),
//! times are seconds since the first frame. What is not decodable, not a video, or over a limit is a
//! typed [`DecodeError`] whose text is one sentence with the remedy. Nothing here opens a URL or any
//! file but the ones handed over (design, section 10); a crash or a hang of a codec is contained by the
//! compute child that calls this.
//!
//! Files: [`mod@sniff`] (container by magic bytes), `structure` (does the file hold what its headers promise),
//! `sample_tables` (do they promise more than it can hold), `ffi` (all unsafe code), `source` (an open
//! container), [`video`] (the decoding loop), `interval` (an episode of a longer video), `timeline`
//! (presentation times), `convert` and `orient` (pixels), `header` (length and size without decoding),
//! [`images`] (numbered images).

mod convert;
mod error;
pub(crate) mod ffi;
mod header;
pub mod images;
mod interval;
mod orient;
mod sample_tables;
pub mod sniff;
mod source;
mod structure;
#[cfg(test)]
mod tests;
mod timeline;
pub mod video;

use plumbline_vision::image::Rgb8;
use serde::{Deserialize, Serialize};

pub(crate) use convert::{BT709, EXACT_BICUBIC, is_full_range_format};
pub use error::{DecodeError, LimitKind};
pub use header::{Shape, video_shape};
pub use images::{
    decode_image, decode_images, digest_images, image_files, images_shape, is_image_sequence,
};
pub use interval::Interval;
pub use sniff::{Container, sniff};
pub use video::{decode_interval, decode_video};

/// Bounds on one video, checked from its header before any frame is decoded and again while decoding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DecodeLimits {
    /// Size of the file, or of all images of a directory together, bytes.
    pub max_bytes: u64,
    /// Width times height of one frame, pixels.
    pub max_pixels_per_frame: u64,
    /// Frames in presentation order.
    pub max_frames: u32,
    /// Presented time, seconds.
    pub max_duration_s: f64,
}

impl Default for DecodeLimits {
    /// Room for a ten-minute 4K clip: 4096×2304 covers DCI 4K (4096×2160), UHD and their portrait
    /// forms and refuses 8K; 2000 frames and 600 s are far above any rollout that was seen.
    fn default() -> Self {
        Self {
            max_bytes: 2 << 30,
            max_pixels_per_frame: 4096 * 2304,
            max_frames: 2000,
            max_duration_s: 600.0,
        }
    }
}

/// One frame, in presentation order.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedFrame {
    /// 0 for the first frame that is delivered, without gaps.
    pub index: u32,
    /// Presentation time in seconds since the first frame; strictly increasing.
    pub time_s: f64,
    /// The picture as presented, `[H, W, 3]`.
    pub rgb: Rgb8,
}

/// What was decoded. Sizes are in pixels, times in seconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VideoInfo {
    /// `mp4`, `matroska`, `avi`, `gif` or `images`.
    pub container: String,
    /// FFmpeg's name of the codec, such as `h264`; `png` or `jpeg` for images.
    pub codec: String,
    /// FFmpeg's name of the first frame's pixel format, such as `yuv420p10le`.
    pub pixel_format: String,
    /// Columns of the delivered frames.
    pub width: u32,
    /// Rows of the delivered frames.
    pub height: u32,
    /// Columns as coded, before pixel shape and rotation.
    pub coded_width: u32,
    /// Rows as coded.
    pub coded_height: u32,
    /// Width of a coded pixel over its height, as declared; 1 when undeclared. Already applied to `width`.
    pub sample_aspect_ratio: f64,
    /// Clockwise turn that the file asks for and that was applied: 0, 90, 180 or 270 degrees.
    pub rotation_deg: u16,
    /// The file also asks for a left-right mirror image before that turn; applied.
    pub mirrored: bool,
    /// Frames delivered.
    pub frames: u32,
    /// (n − 1) / (last − first presentation time); none for a single frame.
    pub fps: Option<f64>,
    /// From the first frame to the end of the last, whose length is taken as the mean interval; none for
    /// a single frame.
    pub duration_s: Option<f64>,
    /// Intervals differ by more than the clock's rounding.
    pub variable_frame_rate: bool,
    /// Frames left out because their time does not come after their predecessor's.
    pub dropped_frames: u32,
    /// Delivered frames in which the decoder concealed damage.
    pub damaged_frames: u32,
    /// Packets that the decoder refused although every declared frame came.
    pub rejected_packets: u32,
    /// Packets that gave no picture and no error: legal in some codecs, lost frames in others.
    pub silent_packets: u32,
    /// The callback asked to stop; the rest of the file was not examined.
    pub stopped_early: bool,
}
