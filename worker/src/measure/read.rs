//! The job's bytes: read once, checked against the frozen corpus, hashed, decoded.

use std::ffi::OsString;
use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use plumbline_common::file_time::modified_ns;
use plumbline_common::message::{Job, Location};

use crate::decode::{
    DecodeError, DecodeLimits, DecodedFrame, VideoInfo, decode_images, decode_video, digest_images,
};
use crate::profile::Profile;

/// A readable input.
pub(crate) struct Input {
    /// BLAKE3 of the bytes, hex.
    pub(crate) digest: String,
    content: Content,
}

enum Content {
    Bytes(Arc<[u8]>),
    Images(PathBuf),
}

/// Why an input cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReadError {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(
        "{path}: changed after the list of videos was made; run again to score what is there now"
    )]
    Changed { path: String },
    #[error("{object}: {why}")]
    NotRead { object: String, why: String },
    #[error(
        "the job's profile does not decode: {0}; coordinator and worker must be of one version"
    )]
    Profile(serde_json::Error),
    #[error("{0}")]
    Models(String),
}

impl Input {
    /// Reads a file whole (its size is limited), or hashes a directory of images. An object is read from
    /// its copy on this machine.
    pub(crate) fn open(
        job: &Job,
        copy: Option<&Path>,
        limits: &DecodeLimits,
    ) -> Result<Self, ReadError> {
        match &job.location {
            Location::File(path) => {
                let path = path_of(path);
                Ok(Self::of_bytes(read_file(&path, job, limits)?))
            }
            Location::ImageSequence(path) => {
                let path = path_of(path);
                limits.check_bytes(job.bytes)?;
                Ok(Self {
                    digest: digest_images(&path)?.to_hex().to_string(),
                    content: Content::Images(path),
                })
            }
            Location::Object(object) => match copy {
                Some(copy) => {
                    limits.check_bytes(job.bytes)?;
                    let address = PathBuf::from(object.to_string());
                    Ok(Self::of_bytes(read_copy(copy, &address, job)?))
                }
                None => Err(ReadError::NotRead {
                    object: object.to_string(),
                    why: "was not fetched before it was to be measured; report this defect".into(),
                }),
            },
        }
    }

    fn of_bytes(bytes: Vec<u8>) -> Self {
        Self {
            digest: blake3::hash(&bytes).to_hex().to_string(),
            content: Content::Bytes(bytes.into()),
        }
    }

    /// Streams its frames.
    pub(crate) fn decode(
        &self,
        profile: &Profile,
        on_frame: &mut dyn FnMut(DecodedFrame) -> ControlFlow<()>,
    ) -> Result<VideoInfo, DecodeError> {
        match &self.content {
            Content::Bytes(bytes) => decode_video(Arc::clone(bytes), &profile.limits, on_frame),
            Content::Images(path) => {
                decode_images(path, profile.sequence_fps, &profile.limits, on_frame)
            }
        }
    }
}

fn path_of(bytes: &[u8]) -> PathBuf {
    PathBuf::from(OsString::from_vec(bytes.to_vec()))
}

fn read_file(path: &Path, job: &Job, limits: &DecodeLimits) -> Result<Vec<u8>, ReadError> {
    let io = |source| DecodeError::Io {
        path: path.to_path_buf(),
        source,
    };
    let file = File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    let modified_ns = modified_ns(&metadata).map_err(io)?;
    let changed = || ReadError::Changed {
        path: path.display().to_string(),
    };
    if (metadata.len(), modified_ns) != (job.bytes, job.modified_ns) {
        return Err(changed());
    }
    limits.check_bytes(job.bytes)?;
    read_whole(file, job.bytes).map_err(io)?.ok_or_else(changed)
}

/// The copy of the object at `address`; its version was checked when it was made.
fn read_copy(copy: &Path, address: &Path, job: &Job) -> Result<Vec<u8>, ReadError> {
    let io = |source| DecodeError::Io {
        path: address.to_path_buf(),
        source,
    };
    let file = File::open(copy).map_err(io)?;
    let whole = read_whole(file, job.bytes).map_err(io)?;
    whole.ok_or_else(|| ReadError::Changed {
        path: address.display().to_string(),
    })
}

/// `None` where there are not exactly so many bytes.
fn read_whole(file: File, bytes: u64) -> std::io::Result<Option<Vec<u8>>> {
    let mut whole = Vec::with_capacity(bytes as usize);
    // One byte more than announced, so that a file that grows meanwhile is noticed.
    file.take(bytes.saturating_add(1)).read_to_end(&mut whole)?;
    Ok((whole.len() as u64 == bytes).then_some(whole))
}
