//! Heat maps as files: their names, their bytes, and which frame they show.

use std::io;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use plumbline_common::row::Measurement;
use plumbline_vision::image::Rgb8;
use plumbline_worker::encode::{UNFINISHED_PREFIX, UNFINISHED_SUFFIX};

use crate::explain::HEAT_MAP_DIRECTORY;
use crate::publish::{OutDir, PublishError};

/// A picture does not encode.
#[derive(Debug, thiserror::Error)]
#[error("a picture cannot be encoded: {0}")]
pub struct PngError(#[from] image::ImageError);

/// A picture as PNG, the same bytes every time.
pub(crate) fn png(picture: &Rgb8) -> Result<Vec<u8>, PngError> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
        .write_image(
            &picture.data,
            picture.width as u32,
            picture.height as u32,
            ExtendedColorType::Rgb8,
        )?;
    Ok(bytes)
}

/// `heatmaps/01-jump-0009.png`.
pub(crate) fn heat_map_name(place: usize, subject: &str, frame: u32) -> String {
    format!("{HEAT_MAP_DIRECTORY}/{place:02}-{subject}-{frame:04}.png")
}

/// The pictures in the directory of heat maps.
pub(crate) fn heat_maps_in(out: &OutDir) -> Result<Vec<String>, PublishError> {
    let directory = out.root().join(HEAT_MAP_DIRECTORY);
    let io_error = |source| PublishError::from_io(HEAT_MAP_DIRECTORY, source);
    let entries = match std::fs::read_dir(directory) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(io_error(error)),
    };
    let mut names = Vec::new();
    for entry in entries {
        let name = entry.map_err(io_error)?.file_name();
        if let Some(name) = name.to_str().filter(|name| name.ends_with(".png")) {
            names.push(format!("{HEAT_MAP_DIRECTORY}/{name}"));
        }
    }
    names.sort();
    Ok(names)
}

/// Unfinished videos that a killed explanation left.
pub(crate) fn videos_left_in(out: &OutDir) -> Result<Vec<String>, PublishError> {
    let io_error = |source| PublishError::from_io(&out.root().to_string_lossy(), source);
    let mut names = Vec::new();
    for entry in std::fs::read_dir(out.root()).map_err(io_error)? {
        let name = entry.map_err(io_error)?.file_name();
        let unfinished =
            |name: &&str| name.starts_with(UNFINISHED_PREFIX) && name.ends_with(UNFINISHED_SUFFIX);
        names.extend(name.to_str().filter(unfinished).map(str::to_owned));
    }
    Ok(names)
}

/// Frame and mean end-point error of the worst pair, the first of equals.
pub(crate) fn worst_pair(measured: &Measurement) -> Option<(u32, f64)> {
    let series = &measured.series;
    let frames = series.first_frame..;
    let defined = frames
        .zip(&series.aepe_px)
        .filter_map(|(frame, error)| Some((frame, (*error)?)));
    defined.reduce(|worst, pair| if pair.1 > worst.1 { pair } else { worst })
}
