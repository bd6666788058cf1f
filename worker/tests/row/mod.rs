//! The row of a directory of numbered pictures.

use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use plumbline_common::id::VideoId;
use plumbline_common::message::{Job, Location};
use plumbline_common::row::Measurement;
use plumbline_worker::measure::measure;
use plumbline_worker::profile::{Profile, Rung};

pub(crate) fn of_pictures(directory: &Path, rung: Rung) -> Measurement {
    let job = Job {
        video: VideoId::new("clip").unwrap(),
        location: Location::ImageSequence(directory.as_os_str().as_bytes().to_vec()),
        bytes: 1,
        modified_ns: 0,
        profile: Profile::new(rung).canonical().unwrap(),
    };
    measure(&job).unwrap().measurement
}
