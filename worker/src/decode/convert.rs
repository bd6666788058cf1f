//! A decoded picture to packed RGB: swscale, bit-exact, with the picture's own colour matrix and range.
//!
//! - Matrix as tagged; untagged pictures are BT.709 when wider than 1279 or taller than 576 pixels and
//!   BT.601 otherwise, which is the rule of players (mpv). Range as tagged, else as the pixel format says
//!   (`yuvj…` and grey full, other YCbCr limited). Transfer functions are left alone: HDR is not tone-mapped.
//! - Alpha is dropped: the stored colour is what is measured.
//! - Pixel shape: the width is multiplied by the declared ratio (as players do) in the same pass; ratios
//!   within half a percent of square are encoders' rounding and change nothing.
//! - Every bit depth that swscale reads is taken; without a change of size no picture is resampled, only
//!   its subsampled chroma is (bilinear).

use ffmpeg_next::format::Pixel;
use ffmpeg_next::software::scaling::{Context, Flags};
use ffmpeg_next::{Error, frame};

use super::ffi::{self, ColourTags, Range};

/// swscale flags under which its vector and plain code give the same bytes.
const EXACT: Flags = Flags::ACCURATE_RND
    .union(Flags::BITEXACT)
    .union(Flags::FULL_CHR_H_INT);
/// Where pictures are resized.
pub(crate) const EXACT_BICUBIC: Flags = EXACT.union(Flags::BICUBIC);
/// Where only subsampled chroma is brought to full size: half the time of bicubic.
const EXACT_BILINEAR: Flags = EXACT.union(Flags::BILINEAR);

/// Deviation of the pixel aspect from square that is taken as rounding.
const SQUARE_TOLERANCE: f64 = 0.005;
/// Above either, an untagged picture is high definition, hence BT.709.
const SD_MAX_WIDTH: u32 = 1279;
const SD_MAX_HEIGHT: u32 = 576;

/// Why a picture cannot become RGB.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum ConvertError {
    #[error("its colour matrix (code {0}) is not supported; re-encode it with BT.709")]
    Matrix(i32),
    #[error("its pixel format {0} cannot be converted; re-encode it as yuv420p")]
    Format(String),
    #[error("a picture could not be converted ({0}); re-encode the video")]
    Scale(Error),
}

/// Everything that a converter is made for; a change makes a new one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Key {
    format: Pixel,
    width: u32,
    height: u32,
    target_width: u32,
    tags: ColourTags,
}

/// Converts pictures to RGB, keeping its tables between pictures of one kind.
#[derive(Default)]
pub(super) struct Converter {
    ready: Option<(Key, Context, frame::Video)>,
}

impl Converter {
    /// `picture` as packed RGB of `target_width` columns, owned by the converter until the next call.
    pub(super) fn rgb(
        &mut self,
        picture: &frame::Video,
        target_width: u32,
    ) -> Result<&frame::Video, ConvertError> {
        let key = Key {
            format: picture.format(),
            width: picture.width(),
            height: picture.height(),
            target_width,
            tags: ffi::colour_tags(picture),
        };
        let ready = match self.ready.take() {
            Some(ready) if ready.0 == key => ready,
            _ => prepare(key)?,
        };
        let (_, scaler, target) = self.ready.insert(ready);
        ffi::scale(scaler, picture, target).map_err(ConvertError::Scale)?;
        Ok(target)
    }
}

fn prepare(key: Key) -> Result<(Key, Context, frame::Video), ConvertError> {
    let matrix = matrix(key.tags.matrix, key.width, key.height)
        .ok_or(ConvertError::Matrix(key.tags.matrix))?;
    let flags = if key.target_width == key.width {
        EXACT_BILINEAR
    } else {
        EXACT_BICUBIC
    };
    let mut scaler = Context::get(
        key.format,
        key.width,
        key.height,
        Pixel::RGB24,
        key.target_width,
        key.height,
        flags,
    )
    .map_err(|_| ConvertError::Format(format_name(key.format)))?;
    let range = match key.tags.range {
        _ if is_full_range_format(key.format) => Range::Full,
        AVCOL_RANGE_MPEG => Range::Limited,
        AVCOL_RANGE_JPEG => Range::Full,
        _ => Range::OfFormat,
    };
    ffi::set_colour(&mut scaler, matrix, range, Range::OfFormat).map_err(ConvertError::Scale)?;
    let target =
        ffi::allocate(Pixel::RGB24, key.target_width, key.height).map_err(ConvertError::Scale)?;
    Ok((key, scaler, target))
}

// Numbers of ITU-T H.273, which are FFmpeg's (`AVColorRange`, `AVColorSpace`) and swscale's (`SWS_CS_*`).
const AVCOL_RANGE_MPEG: i32 = 1;
const AVCOL_RANGE_JPEG: i32 = 2;
const RGB: i32 = 0;
pub(crate) const BT709: i32 = 1;
const UNSPECIFIED: i32 = 2;
const RESERVED: i32 = 3;
const FCC: i32 = 4;
pub(super) const BT470BG: i32 = 5;
const SMPTE170M: i32 = 6;
const SMPTE240M: i32 = 7;
const BT2020_NCL: i32 = 9;

fn matrix(tag: i32, width: u32, height: u32) -> Option<i32> {
    match tag {
        BT709 | FCC | SMPTE240M | BT2020_NCL => Some(tag),
        BT470BG | SMPTE170M => Some(BT470BG),
        // RGB-tagged pictures are RGB formats, for which the matrix is unused.
        UNSPECIFIED | RESERVED | RGB => Some(if width > SD_MAX_WIDTH || height > SD_MAX_HEIGHT {
            BT709
        } else {
            BT470BG
        }),
        _ => None,
    }
}

/// The `yuvj…` formats, full range by their name.
pub(crate) fn is_full_range_format(format: Pixel) -> bool {
    matches!(
        format,
        Pixel::YUVJ420P | Pixel::YUVJ422P | Pixel::YUVJ444P | Pixel::YUVJ440P | Pixel::YUVJ411P
    )
}

/// FFmpeg's name of a pixel format.
pub(super) fn format_name(format: Pixel) -> String {
    format.descriptor().map_or_else(
        || "unknown".to_owned(),
        |descriptor| descriptor.name().to_owned(),
    )
}

/// The declared pixel aspect as a number; 1 where undeclared or nonsensical.
pub(super) fn aspect(ratio: (i32, i32)) -> f64 {
    if ratio.0 > 0 && ratio.1 > 0 {
        f64::from(ratio.0) / f64::from(ratio.1)
    } else {
        1.0
    }
}

/// Columns after pixels are made square.
pub(super) fn square_width(width: u32, aspect: f64) -> u64 {
    if (aspect - 1.0).abs() <= SQUARE_TOLERANCE {
        return u64::from(width);
    }
    // Float to integer saturates; limits are checked on the result.
    ((f64::from(width) * aspect).round_ties_even() as u64).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_shape() {
        assert_eq!(square_width(720, aspect((64, 45))), 1024);
        assert_eq!(square_width(854, aspect((1280, 1281))), 854);
        assert_eq!(square_width(1, aspect((1, 100))), 1);
        assert_eq!(
            (aspect((0, 1)), aspect((-1, 2)), aspect((3, 0))),
            (1.0, 1.0, 1.0)
        );
    }

    #[test]
    fn untagged_matrix_follows_the_size() {
        assert_eq!(matrix(UNSPECIFIED, 256, 256), Some(BT470BG));
        assert_eq!(matrix(UNSPECIFIED, 1280, 720), Some(BT709));
        assert_eq!(matrix(BT709, 256, 256), Some(BT709));
        assert_eq!(matrix(14, 256, 256), None);
    }
}
