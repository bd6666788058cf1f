//! What a message is worth before anything is done for it. Messages come from outside: none of them may end
//! a worker, and none may ask for more than a job.

use std::path::{Path, PathBuf};

use plumbline_common::id::{RunId, VideoId};
use plumbline_common::message::{self, FleetJob, MAX_MESSAGE_BYTES};
use serde::Deserialize;

use super::MAX_REDELIVERIES;
use super::files::is_below;
use crate::profile::Profile;

/// What to do with a message.
#[derive(Debug, PartialEq)]
pub(super) enum Judged {
    /// Its job.
    Work(FleetJob),
    /// Nothing, ever.
    Refuse {
        /// Whose video it is, where that can be told: its run is owed a row.
        owed: Option<(RunId, VideoId)>,
        /// One sentence, with the remedy.
        reason: String,
    },
}

/// Judges a message's body. `files` is the directory below which a job may name files of this machine.
pub(super) fn judge(body: &[u8], redeliveries: u32, files: Option<&Path>) -> Judged {
    let job: FleetJob = match message::decode(body) {
        Ok(job) => job,
        Err(error) => {
            return Judged::Refuse {
                owed: owed(body),
                reason: format!("the job cannot be read: {error}"),
            };
        }
    };
    match objection(&job, redeliveries, files) {
        None => Judged::Work(job),
        Some(reason) => Judged::Refuse {
            owed: Some((job.run, job.job.video)),
            reason,
        },
    }
}

fn objection(job: &FleetJob, redeliveries: u32, files: Option<&Path>) -> Option<String> {
    if redeliveries >= MAX_REDELIVERIES {
        return Some(format!(
            "{MAX_REDELIVERIES} workers died with it, or lost their connection to the broker: see their logs, then score it again"
        ));
    }
    if let Err(error) = serde_json::from_slice::<Profile>(&job.job.profile) {
        return Some(format!(
            "the job's profile does not decode: {error}; coordinator and worker must be of one version"
        ));
    }
    let path = job.job.location.path()?;
    let path = PathBuf::from(<std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(path));
    match files {
        Some(root) if is_below(&path, root) => None,
        Some(_) => Some(format!(
            "{}: lies outside of the directory that the worker reads (--files)",
            path.display()
        )),
        None => Some(format!(
            "{}: the worker reads no files of its machine; start it with --files DIR, the directory of the videos, or put them into an object store",
            path.display()
        )),
    }
}

/// The part of a job that all versions share, so that a message of another one still finds its run.
#[derive(Deserialize)]
struct AnyJob {
    run: RunId,
    job: AnyVideo,
}

#[derive(Deserialize)]
struct AnyVideo {
    video: VideoId,
}

fn owed(body: &[u8]) -> Option<(RunId, VideoId)> {
    let (_any_version, fields) = body.split_first()?;
    if fields.len() >= MAX_MESSAGE_BYTES {
        return None;
    }
    let AnyJob { run, job } = rmp_serde::from_slice(fields).ok()?;
    (!job.video.as_str().is_empty()).then_some((run, job.video))
}
