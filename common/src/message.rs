//! What travels between coordinator, worker and compute child: jobs and outcomes.
//!
//! Wire form: one version byte, then MessagePack with named fields (rmp-serde), so that a field
//! added later is ignored by an older reader and defaulted by a newer one. A profile travels as
//! canonical bytes plus digest and is opaque here.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::id::{RunId, VideoId};
use crate::row::{Cost, Measurement};

/// The version this build writes and reads.
pub const WIRE_VERSION: u8 = 1;

/// Longest message accepted, in bytes: far above any outcome (two thumbnails and a few series),
/// far below what would hurt.
pub const MAX_MESSAGE_BYTES: usize = 16 << 20;

/// Where the bytes of a video are.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Location {
    /// One file; the platform's path bytes.
    File(#[serde(with = "serde_bytes")] Vec<u8>),
    /// A directory of numbered images; the platform's path bytes.
    ImageSequence(#[serde(with = "serde_bytes")] Vec<u8>),
    /// One object of an object store.
    Object(ObjectLocation),
    /// A part of a file or an object. A variant and no field beside the others, so that a reader that knows
    /// no parts refuses the job instead of scoring the whole.
    Part(PartLocation),
}

/// Some of a file or an object that holds several videos.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartLocation {
    /// What it is a part of.
    pub whole: Whole,
    /// Which part.
    pub part: Part,
}

/// What can have parts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Whole {
    /// One file; the platform's path bytes.
    File(#[serde(with = "serde_bytes")] Vec<u8>),
    /// One object of an object store.
    Object(ObjectLocation),
}

/// Which part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// A run of bytes that is a video file of its own: a member of a tar.
    Bytes {
        /// The first of them.
        offset: u64,
        /// How many.
        bytes: u64,
    },
    /// The frames of a longer video whose presentation times t are `from_ns` ≤ t < `to_ns`, nanoseconds on
    /// that video's clock: an episode among others.
    Interval {
        /// The earliest time that belongs to it; before 0 is the video's start.
        from_ns: i64,
        /// The earliest time after it.
        to_ns: i64,
    },
}

impl Location {
    /// The path bytes of the file or directory of this machine that is read, if one is.
    #[must_use]
    pub fn path(&self) -> Option<&[u8]> {
        match self {
            Self::File(path) | Self::ImageSequence(path) => Some(path),
            Self::Part(PartLocation { whole, .. }) => match whole {
                Whole::File(path) => Some(path),
                Whole::Object(_) => None,
            },
            Self::Object(_) => None,
        }
    }

    /// The object that is read, if one is.
    #[must_use]
    pub fn object(&self) -> Option<&ObjectLocation> {
        match self {
            Self::Object(object) => Some(object),
            Self::Part(PartLocation { whole, .. }) => match whole {
                Whole::Object(object) => Some(object),
                Whole::File(_) => None,
            },
            Self::File(_) | Self::ImageSequence(_) => None,
        }
    }

    /// Which part of it, if not the whole.
    #[must_use]
    pub fn part(&self) -> Option<Part> {
        match self {
            Self::Part(PartLocation { part, .. }) => Some(*part),
            Self::File(_) | Self::ImageSequence(_) | Self::Object(_) => None,
        }
    }
}

/// The path or address, of a part that of the whole.
impl std::fmt::Display for Location {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.path(), self.object()) {
            (Some(path), _) => f.write_str(&String::from_utf8_lossy(path)),
            (None, Some(object)) => object.fmt(f),
            (None, None) => Ok(()),
        }
    }
}

/// An object of an S3-compatible store, in the version that was listed. Which service is meant is the
/// reader's configuration: coordinator and workers may reach it by different addresses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObjectLocation {
    /// The bucket.
    pub bucket: String,
    /// The object's whole key in it.
    pub key: String,
    /// The store's mark of this version; not every service lists it.
    #[serde(default)]
    pub etag: Option<String>,
    /// When it was last written, seconds since the epoch.
    #[serde(default)]
    pub modified_s: Option<i64>,
}

impl std::fmt::Display for ObjectLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "s3://{}/{}", self.bucket, self.key)
    }
}

/// One video to measure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Job {
    /// Its name in the run.
    pub video: VideoId,
    /// Its bytes.
    pub location: Location,
    /// Size when the corpus was frozen, of the whole where the video is a part; a video that changed since is
    /// not scored silently.
    pub bytes: u64,
    /// Modification time when the corpus was frozen, nanoseconds since the epoch.
    pub modified_ns: i128,
    /// The profile's canonical form.
    #[serde(with = "serde_bytes")]
    pub profile: Vec<u8>,
}

impl Job {
    /// Bytes that are read for it: a part may be fewer than the file.
    #[must_use]
    pub fn bytes_read(&self) -> u64 {
        match self.location.part() {
            Some(Part::Bytes { bytes, .. }) => bytes,
            Some(Part::Interval { .. }) | None => self.bytes,
        }
    }
}

/// One job of a run on a fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FleetJob {
    /// The run, whose results queue gets what comes of it.
    pub run: RunId,
    /// What to measure.
    pub job: Job,
}

impl FleetJob {
    /// The name of this work, the same whenever and by whomever it is published: the run and a digest of
    /// the video's name.
    #[must_use]
    pub fn message_id(&self) -> String {
        work_id(&self.run, &self.job.video)
    }
}

/// What came of a [`FleetJob`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FleetResult {
    /// The job's run.
    pub run: RunId,
    /// What came of it; always a row.
    pub outcome: Outcome,
    /// How often it was tried in all: settled retries, and compute processes that died.
    pub attempts: u32,
    /// The worker's name.
    pub worker: String,
}

impl FleetResult {
    /// The same as its job's.
    #[must_use]
    pub fn message_id(&self) -> String {
        work_id(&self.run, &self.outcome.video)
    }
}

fn work_id(run: &RunId, video: &VideoId) -> String {
    format!("{run}/{}", blake3::hash(video.as_str().as_bytes()).to_hex())
}

/// Two small JPEG pictures of the frame at which a video is worst.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Thumbnails {
    /// The frame.
    #[serde(with = "serde_bytes")]
    pub frame_jpeg: Vec<u8>,
    /// Its end-point error as a heat map.
    #[serde(with = "serde_bytes")]
    pub heat_jpeg: Vec<u8>,
}

/// What came of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The job's video.
    pub video: VideoId,
    /// What was measured, or why not.
    pub measurement: Measurement,
    /// What it cost.
    pub cost: Cost,
    /// Pictures for the report; absent where no pair was measured.
    pub thumbnails: Option<Thumbnails>,
}

/// Why bytes are no message.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Nothing there.
    #[error("the message is empty")]
    Empty,
    /// Written by another version.
    #[error(
        "the message has wire version {found}; this build reads version {WIRE_VERSION}: upgrade the older side"
    )]
    Version {
        /// The version byte found.
        found: u8,
    },
    /// Too large to be one.
    #[error("the message has {bytes} bytes, more than the {MAX_MESSAGE_BYTES} allowed")]
    TooLarge {
        /// Its size.
        bytes: usize,
    },
    /// Not decodable.
    #[error("the message does not decode: {0}")]
    Decode(#[from] rmp_serde::decode::Error),
    /// Not encodable.
    #[error("the message does not encode: {0}")]
    Encode(#[from] rmp_serde::encode::Error),
}

/// Encodes a message.
///
/// # Errors
/// [`MessageError::Encode`], [`MessageError::TooLarge`].
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, MessageError> {
    let mut bytes = vec![WIRE_VERSION];
    rmp_serde::encode::write_named(&mut bytes, message)?;
    check_size(bytes.len())?;
    Ok(bytes)
}

/// Decodes a message.
///
/// # Errors
/// Every variant of [`MessageError`] but `Encode`.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, MessageError> {
    check_size(bytes.len())?;
    match bytes.split_first() {
        None => Err(MessageError::Empty),
        Some((&WIRE_VERSION, body)) => Ok(rmp_serde::from_slice(body)?),
        Some((&found, _)) => Err(MessageError::Version { found }),
    }
}

fn check_size(bytes: usize) -> Result<(), MessageError> {
    if bytes > MAX_MESSAGE_BYTES {
        return Err(MessageError::TooLarge { bytes });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::Status;

    fn job() -> Job {
        Job {
            video: VideoId::new("a b/ünï\n.mp4").unwrap(),
            location: Location::File(b"/data/\xff.mp4".to_vec()),
            bytes: 12,
            modified_ns: 1_700_000_000_123_456_789,
            profile: b"{}".to_vec(),
        }
    }

    #[test]
    fn a_job_survives_the_wire() {
        let bytes = encode(&job()).unwrap();
        assert_eq!(decode::<Job>(&bytes).unwrap(), job());
    }

    #[test]
    fn an_outcome_survives_the_wire_bit_for_bit() {
        let mut measurement = Measurement::without_score(Status::Static, "too little motion");
        measurement.aepe_px = Some(0.1 + 0.2);
        measurement.series.aepe_px = vec![Some(f64::MIN_POSITIVE), None];
        let outcome = Outcome {
            video: job().video,
            measurement,
            cost: Cost::default(),
            thumbnails: Some(Thumbnails {
                frame_jpeg: vec![0, 255],
                heat_jpeg: vec![],
            }),
        };
        assert_eq!(
            decode::<Outcome>(&encode(&outcome).unwrap()).unwrap(),
            outcome
        );
    }

    #[test]
    fn other_versions_and_garbage_are_named() {
        let mut future = encode(&job()).unwrap();
        future[0] = 9;
        assert!(matches!(
            decode::<Job>(&future),
            Err(MessageError::Version { found: 9 })
        ));
        assert!(matches!(decode::<Job>(&[]), Err(MessageError::Empty)));
        assert!(matches!(
            decode::<Job>(&[WIRE_VERSION, 0xc1]),
            Err(MessageError::Decode(_))
        ));
        let huge = vec![WIRE_VERSION; MAX_MESSAGE_BYTES + 1];
        assert!(matches!(
            decode::<Job>(&huge),
            Err(MessageError::TooLarge { .. })
        ));
    }
}
