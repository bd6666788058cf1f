//! Length and size of a video without decoding it: what planning a run needs to know of its videos.

use std::fs::File;
use std::io::Cursor;
use std::path::Path;

use plumbline_common::message::{Job, Location, Part, PartLocation, Whole};
use serde::{Deserialize, Serialize};

use super::MeasureError;
use super::read::{ReadError, io_error, open_unchanged, path_of, read_member, there};
use crate::decode::{DecodeError, Interval, Shape, images_shape, video_shape};
use crate::profile::Profile;

/// What a video's header says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Told {
    /// Its length and size.
    Shape(Shape),
    /// Nothing is measured of it: it is no video, damaged, or over a limit.
    Refused,
    /// Not its length, or not its size.
    Silent,
}

/// Reads the header of a video; of an object that of its copy, of which only the ends may be there.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub(crate) fn told(job: &Job, copy: Option<&Path>) -> Result<Told, MeasureError> {
    let profile: Profile = serde_json::from_slice(&job.profile)?;
    Ok(match shape(job, copy, &profile) {
        Ok(Some(shape)) => Told::Shape(shape),
        Ok(None) | Err(ReadError::Decode(DecodeError::OutOfMemory)) => Told::Silent,
        // What is missing there may be what is not in the copy.
        Err(ReadError::Decode(DecodeError::Undecodable { .. })) if copy.is_some() => Told::Silent,
        Err(_) => Told::Refused,
    })
}

fn shape(job: &Job, copy: Option<&Path>, profile: &Profile) -> Result<Option<Shape>, ReadError> {
    let limits = &profile.limits;
    limits.check_bytes(job.bytes_read())?;
    let interval = match job.location.part() {
        Some(Part::Interval { from_ns, to_ns }) => Some(Interval { from_ns, to_ns }),
        Some(Part::Bytes { .. }) | None => None,
    };
    let found = match &job.location {
        Location::ImageSequence(path) => images_shape(&path_of(path), profile.sequence_fps, limits),
        Location::Part(PartLocation {
            whole: Whole::File(path),
            part: Part::Bytes { offset, bytes },
        }) => {
            let member = read_member(&path_of(path), *offset, *bytes, job, limits)?;
            video_shape(Cursor::new(member), interval, limits)
        }
        Location::File(path)
        | Location::Part(PartLocation {
            whole: Whole::File(path),
            ..
        }) => {
            let file = open_unchanged(&path_of(path), job, limits)?;
            video_shape(file, interval, limits)
        }
        Location::Object(object)
        | Location::Part(PartLocation {
            whole: Whole::Object(object),
            ..
        }) => {
            let copy = there(copy, object)?;
            let file = File::open(copy).map_err(io_error(copy))?;
            video_shape(file, interval, limits)
        }
    };
    Ok(found?)
}
