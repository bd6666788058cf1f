//! A rendered clip as a file, and a file measured in this process.

use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use plumbline_common::file_time::modified_ns;
use plumbline_common::id::VideoId;
use plumbline_common::message::{Job, Location, Outcome};
use plumbline_sample::ClipSpec;
use plumbline_vision::image::Rgb8;
use plumbline_worker::encode::Mp4Writer;
use plumbline_worker::measure::measure;
use plumbline_worker::profile::Profile;

pub(crate) fn measured(path: &Path, profile: &Profile) -> Outcome {
    let metadata = std::fs::metadata(path).unwrap();
    let job = Job {
        video: VideoId::new("clip").unwrap(),
        location: Location::File(path.as_os_str().as_bytes().to_vec()),
        bytes: metadata.len(),
        modified_ns: modified_ns(&metadata).unwrap(),
        profile: profile.canonical().unwrap(),
    };
    measure(&job).unwrap()
}

pub(crate) fn write(clip: &ClipSpec, path: &Path) {
    let (width, height) = (clip.width as u32, clip.height as u32);
    let mut writer = Mp4Writer::create(path, width, height, clip.fps).unwrap();
    for frame in clip.render_frames() {
        let frame = frame.unwrap();
        writer
            .push(&Rgb8::new(frame.width, frame.height, frame.rgb).unwrap())
            .unwrap();
    }
    writer.finish().unwrap();
}
