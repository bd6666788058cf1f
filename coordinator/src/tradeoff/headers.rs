//! The headers of the videos to plan for: all of them or, of many, a seeded sample.

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::message::Job;
use plumbline_worker::child::{ComputeSlot, SlotError};
use plumbline_worker::measure::shape::Told;
use plumbline_worker::profile::Profile;

use super::plan::Listed;
use super::sample::Sampled;
use crate::fanout::{Fanout, Slots, Work};
use crate::measuring;
use crate::run::RunError;

/// Headers that are read: those of more videos would make a plan better by less than what the costs of the sample
/// leave uncertain.
pub(super) const MOST_HEADERS: usize = 1000;

/// What the header of a video says.
#[derive(Debug, Clone)]
struct Header(Job);

impl Work for Header {
    type Answer = (VideoId, Told);

    async fn ask(&self, slot: &mut ComputeSlot) -> Result<Self::Answer, SlotError> {
        Ok((self.0.video.clone(), slot.shape(&self.0).await?))
    }
}

/// Reads the headers of `videos`, within the limits of `profile`; in their order.
///
/// # Errors
/// [`RunError`], where no compute process can be started or a store is out of reach.
pub(super) async fn read(
    videos: &[Sampled],
    profile: &Profile,
    slots: &Slots,
) -> Result<Vec<Listed>, RunError> {
    let jobs = videos
        .iter()
        .filter_map(|video| measuring::job(&video.entry, profile).transpose())
        .map(|job| job.map(Header))
        .collect::<Result<Vec<_>, _>>()
        .map_err(RunError::Profile)?;
    let mut told = BTreeMap::new();
    let mut fanout = Fanout::start(jobs, slots);
    while let Some(answer) = fanout.next().await {
        let (video, header) = answer?;
        told.insert(video, header);
    }
    let listed = videos.iter().map(|video| Listed {
        told: *told.get(&video.entry.video).unwrap_or(&Told::Silent),
        weight: video.weight,
    });
    Ok(listed.collect())
}
