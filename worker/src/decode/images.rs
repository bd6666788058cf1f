//! A directory of numbered images (png, jpeg) as a clip.
//!
//! Order is by the last number in the file's stem, so `f2` comes before `f10`; the time of frame i is
//! i / fps, with the rate given by the caller. The numbers must run in even steps: a missing one would be
//! scored as a jump. Hidden files, other files, sub-directories and images without a number are ignored.

use std::fs::{self, File};
use std::io::Cursor;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use plumbline_vision::image::Rgb8;

use super::header::{Shape, shape};
use super::{DecodeError, DecodeLimits, DecodedFrame, VideoInfo};

/// Fewest numbered images that make a directory a clip: one image is a picture.
const MIN_IMAGES: usize = 2;
/// Bytes of decoder memory per pixel of the limit: 16-bit RGBA and one working copy.
const BYTES_PER_PIXEL: u64 = 16;
/// Names that are looked at; the content decides whether it is an image.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct NumberedImage {
    number: u128,
    name: String,
    path: PathBuf,
}

/// Whether `dir` holds at least two numbered images. Reads names only; unreadable directories are no clip.
pub fn is_image_sequence(dir: &Path) -> bool {
    list(dir).is_ok_and(|images| images.len() >= MIN_IMAGES)
}

/// The numbered images of `dir`, in frame order; their sizes and times are what a corpus is frozen by.
///
/// # Errors
/// As the file system says.
pub fn image_files(dir: &Path) -> std::io::Result<Vec<PathBuf>> {
    Ok(list(dir)?.into_iter().map(|image| image.path).collect())
}

/// BLAKE3 over the images' names and bytes in frame order, each preceded by its length.
///
/// # Errors
/// [`DecodeError::Io`], [`DecodeError::Empty`], or `Undecodable` when the numbering is ambiguous.
pub fn digest_images(dir: &Path) -> Result<blake3::Hash, DecodeError> {
    let mut hasher = blake3::Hasher::new();
    for image in ordered(dir)? {
        let io = |source| DecodeError::Io {
            path: image.path.clone(),
            source,
        };
        let file = File::open(&image.path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        hasher.update(&(image.name.len() as u64).to_le_bytes());
        hasher.update(image.name.as_bytes());
        hasher.update(&length.to_le_bytes());
        hasher.update_reader(file).map_err(io)?;
    }
    Ok(hasher.finalize())
}

/// Decodes the numbered images of `dir` as a clip of `fps` frames per second.
///
/// # Errors
/// `InvalidRate`, `Empty`, `OverLimit`, `Io`, or `Undecodable` naming the file that cannot be read, has
/// another size than the first, or is missing from the numbering.
pub fn decode_images(
    dir: &Path,
    fps: f64,
    limits: &DecodeLimits,
    on_frame: &mut dyn FnMut(DecodedFrame) -> ControlFlow<()>,
) -> Result<VideoInfo, DecodeError> {
    let images = within_limits(dir, fps, limits)?;
    let mut first: Option<VideoInfo> = None;
    for (index, image) in images.iter().enumerate() {
        let (rgb, format, pixel_format) = read(image, limits)?;
        let index = index as u32;
        let info = first.get_or_insert_with(|| describe(&rgb, format, pixel_format));
        if (info.width as usize, info.height as usize) != (rgb.width, rgb.height) {
            return Err(DecodeError::undecodable(format!(
                "{} is {}x{} but the images before it are {}x{}; bring all images to one size",
                image.name, rgb.width, rgb.height, info.width, info.height
            )));
        }
        info.frames = index + 1;
        if on_frame(DecodedFrame {
            index,
            time_s: f64::from(index) / fps,
            rgb,
        })
        .is_break()
        {
            info.stopped_early = true;
            break;
        }
    }
    let mut info = first.ok_or_else(|| DecodeError::Empty {
        what: dir.display().to_string(),
    })?;
    if info.frames > 1 {
        info.fps = Some(fps);
        info.duration_s = Some(f64::from(info.frames) / fps);
    }
    Ok(info)
}

/// Number and size of the numbered images of `dir`, of which the first one's header alone is read.
///
/// # Errors
/// As [`decode_images`], before the first image is decoded.
pub fn images_shape(
    dir: &Path,
    fps: f64,
    limits: &DecodeLimits,
) -> Result<Option<Shape>, DecodeError> {
    let images = within_limits(dir, fps, limits)?;
    let Some(first) = images.first() else {
        return Ok(None);
    };
    let (mut decoder, _) = open(first, limits)?;
    let (mut width, mut height) = decoder.dimensions();
    let orientation = decoder.orientation().map_err(damaged(first))?;
    if is_on_its_side(orientation) {
        (width, height) = (height, width);
    }
    Ok(shape(images.len() as u64, width as usize, height as usize))
}

fn is_on_its_side(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(
        orientation,
        Rotate90 | Rotate90FlipH | Rotate270 | Rotate270FlipH
    )
}

/// The images in frame order, if they may be decoded.
fn within_limits(
    dir: &Path,
    fps: f64,
    limits: &DecodeLimits,
) -> Result<Vec<NumberedImage>, DecodeError> {
    if !(fps.is_finite() && fps > 0.0) {
        return Err(DecodeError::InvalidRate { fps });
    }
    let images = ordered(dir)?;
    check_steps(&images)?;
    limits.check_frames(images.len() as u64)?;
    limits.check_duration(images.len() as f64 / fps)?;
    limits.check_bytes(total_bytes(&images)?)?;
    Ok(images)
}

/// One png or jpeg file as presented (EXIF orientation applied), within the limits on bytes and size.
///
/// # Errors
/// `Io`, `OverLimit`, or `Undecodable` naming the file.
pub fn decode_image(path: &Path, limits: &DecodeLimits) -> Result<Rgb8, DecodeError> {
    let name = path.display().to_string();
    let metadata = fs::metadata(path).map_err(|source| DecodeError::Io {
        path: path.to_owned(),
        source,
    })?;
    // A pipe or a device has no length to hold against the limit.
    if !metadata.is_file() {
        return Err(DecodeError::undecodable(format!(
            "{name} is no regular file; give a png or jpeg image"
        )));
    }
    limits.check_bytes(metadata.len())?;
    let image = NumberedImage {
        number: 0,
        name,
        path: path.to_owned(),
    };
    read(&image, limits).map(|(rgb, _, _)| rgb)
}

fn describe(rgb: &Rgb8, format: ImageFormat, pixel_format: String) -> VideoInfo {
    let (width, height) = (rgb.width as u32, rgb.height as u32);
    VideoInfo {
        container: "images".into(),
        codec: if format == ImageFormat::Png {
            "png".into()
        } else {
            "jpeg".into()
        },
        pixel_format,
        width,
        height,
        coded_width: width,
        coded_height: height,
        sample_aspect_ratio: 1.0,
        rotation_deg: 0,
        mirrored: false,
        frames: 0,
        fps: None,
        duration_s: None,
        variable_frame_rate: false,
        dropped_frames: 0,
        damaged_frames: 0,
        rejected_packets: 0,
        silent_packets: 0,
        stopped_early: false,
    }
}

fn list(dir: &Path) -> std::io::Result<Vec<NumberedImage>> {
    let mut images = Vec::new();
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
            continue;
        };
        if name.starts_with('.') {
            continue;
        }
        let is_image = path
            .extension()
            .and_then(|extension| extension.to_str())
            .is_some_and(|extension| {
                EXTENSIONS
                    .iter()
                    .any(|known| extension.eq_ignore_ascii_case(known))
            });
        let number = path
            .file_stem()
            .and_then(|stem| stem.to_str())
            .and_then(last_number);
        if let Some(number) = number.filter(|_| is_image && path.is_file()) {
            images.push(NumberedImage {
                number,
                name: name.to_owned(),
                path,
            });
        }
    }
    images.sort();
    Ok(images)
}

/// The images in frame order.
fn ordered(dir: &Path) -> Result<Vec<NumberedImage>, DecodeError> {
    let images = list(dir).map_err(|source| DecodeError::Io {
        path: dir.to_owned(),
        source,
    })?;
    if images.is_empty() {
        return Err(DecodeError::Empty {
            what: format!("{} (no numbered png or jpeg)", dir.display()),
        });
    }
    if let Some(pair) = images
        .windows(2)
        .find(|pair| pair[0].number == pair[1].number)
    {
        return Err(DecodeError::undecodable(format!(
            "{} and {} have the same number; keep one sequence per directory",
            pair[0].name, pair[1].name
        )));
    }
    Ok(images)
}

/// The last run of digits in a stem; none when there is none or it does not fit.
fn last_number(stem: &str) -> Option<u128> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| {
            at + stem[at..].chars().next().map_or(1, char::len_utf8)
        });
    stem[start..end].parse().ok()
}

/// Numbers must run in even steps.
fn check_steps(images: &[NumberedImage]) -> Result<(), DecodeError> {
    let step = images
        .windows(2)
        .map(|pair| pair[1].number - pair[0].number)
        .min()
        .unwrap_or(1);
    match images
        .windows(2)
        .find(|pair| pair[1].number - pair[0].number != step)
    {
        Some(pair) => Err(DecodeError::undecodable(format!(
            "number {} is missing between {} and {}; add the image or renumber the rest",
            pair[0].number + step,
            pair[0].name,
            pair[1].name
        ))),
        None => Ok(()),
    }
}

fn total_bytes(images: &[NumberedImage]) -> Result<u64, DecodeError> {
    let mut total = 0_u64;
    for image in images {
        let metadata = fs::metadata(&image.path).map_err(|source| DecodeError::Io {
            path: image.path.clone(),
            source,
        })?;
        total = total.saturating_add(metadata.len());
    }
    Ok(total)
}

/// One image as presented (EXIF orientation applied), its format and its colour type.
fn read(
    image: &NumberedImage,
    limits: &DecodeLimits,
) -> Result<(Rgb8, ImageFormat, String), DecodeError> {
    let (mut decoder, format) = open(image, limits)?;
    let pixel_format = format!("{:?}", decoder.original_color_type()).to_lowercase();
    let orientation = decoder.orientation().map_err(damaged(image))?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(damaged(image))?;
    picture.apply_orientation(orientation);
    let rgb = picture.into_rgb8();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    Ok((
        Rgb8 {
            width,
            height,
            data: rgb.into_raw(),
        },
        format,
        pixel_format,
    ))
}

fn damaged(image: &NumberedImage) -> impl Fn(image::ImageError) -> DecodeError {
    |error| {
        DecodeError::undecodable(format!(
            "{} does not decode ({error}); copy or render it again",
            image.name
        ))
    }
}

/// A decoder of one image, whose size is checked before any pixel is decoded, and its format.
fn open(
    image: &NumberedImage,
    limits: &DecodeLimits,
) -> Result<(impl ImageDecoder + use<>, ImageFormat), DecodeError> {
    let bytes = fs::read(&image.path).map_err(|source| DecodeError::Io {
        path: image.path.clone(),
        source,
    })?;
    if bytes.is_empty() {
        return Err(DecodeError::undecodable(format!(
            "{} is empty; copy or render it again",
            image.name
        )));
    }
    let format = image::guess_format(&bytes)
        .ok()
        .filter(|f| matches!(f, ImageFormat::Png | ImageFormat::Jpeg));
    let Some(format) = format else {
        return Err(DecodeError::undecodable(format!(
            "{} is not a png or jpeg image; convert it",
            image.name
        )));
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut bounds = image::Limits::default();
    bounds.max_alloc = Some(limits.max_pixels_per_frame.saturating_mul(BYTES_PER_PIXEL));
    reader.limits(bounds);
    let decoder = reader.into_decoder().map_err(damaged(image))?;
    let (width, height) = decoder.dimensions();
    limits.check_size(width.into(), height.into())?;
    Ok((decoder, format))
}

#[cfg(test)]
mod unit_tests {
    use super::*;

    #[test]
    fn the_last_number_of_the_stem_counts() {
        for (stem, number) in [
            ("frame_0010", Some(10)),
            ("v2_shot3", Some(3)),
            ("7", Some(7)),
            ("é12é", Some(12)),
            ("cover", None),
            ("9999999999999999999999999999999999999999", None),
        ] {
            assert_eq!(last_number(stem), number, "{stem}");
        }
    }
}
