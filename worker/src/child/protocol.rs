//! What parent and child say to each other beside outcomes: requests, and pictures.
//!
//! One request, then its answer: an [`Outcome`](plumbline_common::message::Outcome) for `Measure`, a
//! [`Detailed`](crate::measure::Detailed) for `Detail`, a [`SlamOutcome`](crate::slam::SlamOutcome) for
//! `Track`, frames or the reason for none for `Frames`, for `Draw` any number of [`Drawn::Picture`] and one
//! [`Drawn::End`]. Both sides are the same binary, so the form may change with any version.

use plumbline_common::message::Job;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::explain::{DrawJob, Picture};
use crate::learned::ModelPlaces;
use crate::measure::frames::FramesJob;

/// What a child is asked for, and where it finds the bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Request {
    /// What.
    pub(super) ask: Ask,
    /// The copy of the job's object on this machine, the platform's path bytes.
    pub(super) copy: Option<ByteBuf>,
    /// Where the networks are that the job's profile needs.
    pub(super) models: Option<ModelPlaces>,
}

/// What a child is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Ask {
    /// The row.
    Measure(Job),
    /// The row and what is behind it.
    Detail(Job),
    /// The trajectory.
    Track(Job),
    /// Pictures of a video.
    Draw(DrawJob),
    /// Some of its frames.
    Frames(FramesJob),
    /// Whether the networks of a profile (in its canonical form) load: nothing, or why not.
    Load(ByteBuf),
}

/// One message of the answer to [`Ask::Draw`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Drawn {
    /// A picture.
    Picture(Picture),
    /// There is no more; the reason where some are missing.
    End(Option<String>),
}
