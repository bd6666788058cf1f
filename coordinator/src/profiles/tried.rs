//! A changed profile tried on one small rendered clip, in a compute child as every video is: knobs that
//! contradict each other, a panic or a blown limit are found before the corpus is.

use plumbline_common::id::VideoId;
use plumbline_common::message::{Job, Location};
use plumbline_common::row::Status;
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::scene::Family;
use plumbline_vision::image::Rgb8;
use plumbline_worker::child::ComputeSlot;
use plumbline_worker::profile::Profile;

use super::ProfileError;
use crate::fanout::Slots;
use crate::picture::png;

/// Frames of the clip: enough for every signal and for the dense adjustment to be asked.
const FRAMES: usize = 12;

/// Measures the clip with `profile`, without what takes minutes for each frame. A profile that finds too
/// little in it (too small a picture, too few frames) is none to refuse; one whose row is `failed` is.
///
/// # Errors
/// [`ProfileError::Unusable`] with the row's reason; [`ProfileError::NotTried`] where the clip cannot be
/// made or no child starts.
pub async fn tried(profile: &Profile, slots: &Slots) -> Result<(), ProfileError> {
    if profile.edge_spans.is_empty() {
        return Err(ProfileError::Unusable {
            reason: "edge_spans is empty; name at least 1, the distance of adjacent frames"
                .to_owned(),
        });
    }
    let not_tried = |error: &dyn std::fmt::Display| ProfileError::NotTried(error.to_string());
    let place = tempfile::tempdir().map_err(|error| not_tried(&error))?;
    let spec = ClipSpec {
        frames: FRAMES,
        ..ClipSpec::clean(Family::Dolly, 0, 0)
    };
    let mut bytes = 0;
    for (index, frame) in spec.render_frames().enumerate() {
        let frame = frame.map_err(|error| not_tried(&error))?;
        let picture = Rgb8 {
            width: frame.width,
            height: frame.height,
            data: frame.rgb,
        };
        let encoded = png(&picture).map_err(|error| not_tried(&error))?;
        bytes += encoded.len() as u64;
        let path = place.path().join(format!("{index:04}.png"));
        std::fs::write(path, encoded).map_err(|error| not_tried(&error))?;
    }
    use std::os::unix::ffi::OsStrExt;
    let job = Job {
        video: VideoId::new("trial").map_err(|error| not_tried(&error))?,
        location: Location::ImageSequence(place.path().as_os_str().as_bytes().to_vec()),
        bytes,
        modified_ns: 0,
        profile: Profile {
            sea_raft: None,
            droid: None,
            ..profile.clone()
        }
        .canonical()?,
    };
    let mut slot = ComputeSlot::new(slots.program.clone(), slots.limits, slots.fetcher.clone());
    let row = slot
        .measure(&job)
        .await
        .map_err(|error| not_tried(&error))?;
    let row = row.outcome.measurement;
    match row.status {
        Status::Failed => Err(ProfileError::Unusable {
            reason: row.status_reason.unwrap_or_default(),
        }),
        _ => Ok(()),
    }
}
