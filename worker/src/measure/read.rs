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
    #[error("{object}: was not fetched before it was to be measured; report this defect")]
    NotFetched { object: String },
}

impl Input {
    /// Reads a file whole (its size is limited), or hashes a directory of images.
    pub(crate) fn open(job: &Job, limits: &DecodeLimits) -> Result<Self, ReadError> {
        match &job.location {
            Location::File(path) => {
                let path = path_of(path);
                let bytes = read_file(&path, job, limits)?;
                Ok(Self {
                    digest: blake3::hash(&bytes).to_hex().to_string(),
                    content: Content::Bytes(bytes.into()),
                })
            }
            Location::ImageSequence(path) => {
                let path = path_of(path);
                limits.check_bytes(job.bytes)?;
                Ok(Self {
                    digest: digest_images(&path)?.to_hex().to_string(),
                    content: Content::Images(path),
                })
            }
            Location::Object(object) => Err(ReadError::NotFetched {
                object: object.to_string(),
            }),
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
    let mut bytes = Vec::with_capacity(job.bytes as usize);
    // One byte more than announced, so that a file that grows meanwhile is noticed.
    file.take(job.bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if bytes.len() as u64 != job.bytes {
        return Err(changed());
    }
    Ok(bytes)
}
