//! The job's bytes: read once, checked against the frozen corpus, hashed, decoded.
//!
//! A whole file, a tar's member: into memory (their size is limited). An episode of a longer video: the file is
//! hashed and decoded where it lies, a buffer at a time.

use std::ffi::OsString;
use std::fs::File;
use std::io::Read;
use std::ops::{ControlFlow, Range};
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use plumbline_common::file_time::modified_ns;
use plumbline_common::message::{Job, Location, ObjectLocation, Part, PartLocation, Whole};

use crate::decode::{
    DecodeError, DecodeLimits, DecodedFrame, Interval, VideoInfo, decode_images, decode_interval,
    decode_video, digest_images,
};
use crate::profile::Profile;

/// A readable input.
pub(crate) struct Input {
    /// BLAKE3 of the bytes, hex; of an episode in a longer video that of the whole file's bytes and of the
    /// interval's two ends (little endian, nanoseconds).
    pub(crate) digest: String,
    content: Content,
}

enum Content {
    Bytes(Arc<[u8]>),
    Images(PathBuf),
    Episode {
        file: PathBuf,
        /// What the file is while it is read; a copy is ours alone.
        version: Option<Version>,
        interval: Interval,
    },
}

/// Size and modification time of a file.
type Version = (u64, i128);

/// Why an input cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReadError {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(
        "{path}: changed after the list of videos was made; run again to score what is there now"
    )]
    Changed { path: String },
    #[error("{path}: ends before the bytes that are to be read; copy the file again")]
    Outside { path: String },
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
    /// Reads what is measured, or hashes it where it lies. An object is read from its copy on this machine,
    /// which holds no more of it than the job asks for.
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
            Location::Object(object) => {
                limits.check_bytes(job.bytes)?;
                let copy = there(copy, object)?;
                Ok(Self::of_bytes(read_copy(copy, object, job)?))
            }
            Location::Part(PartLocation { whole, part }) => match (*part, whole) {
                (Part::Bytes { offset, bytes }, Whole::File(path)) => {
                    let path = path_of(path);
                    let range = byte_range(offset, bytes, job.bytes);
                    let range = range.ok_or_else(|| ReadError::Outside {
                        path: path.display().to_string(),
                    })?;
                    Ok(Self::of_bytes(read_member(&path, range, job, limits)?))
                }
                (Part::Bytes { .. }, Whole::Object(object)) => {
                    limits.check_bytes(job.bytes_read())?;
                    let copy = there(copy, object)?;
                    Ok(Self::of_bytes(read_copy(copy, object, job)?))
                }
                (Part::Interval { from_ns, to_ns }, whole) => {
                    let interval = Interval { from_ns, to_ns };
                    let (file, version) = match whole {
                        Whole::File(path) => {
                            let path = path_of(path);
                            open_unchanged(&path, job, limits)?;
                            (path, Some((job.bytes, job.modified_ns)))
                        }
                        Whole::Object(object) => {
                            limits.check_bytes(job.bytes)?;
                            (there(copy, object)?.to_path_buf(), None)
                        }
                    };
                    Ok(Self::of_episode(file, version, interval)?)
                }
            },
        }
    }

    fn of_bytes(bytes: Vec<u8>) -> Self {
        Self {
            digest: blake3::hash(&bytes).to_hex().to_string(),
            content: Content::Bytes(bytes.into()),
        }
    }

    fn of_episode(
        file: PathBuf,
        version: Option<Version>,
        interval: Interval,
    ) -> Result<Self, DecodeError> {
        let mut hasher = blake3::Hasher::new();
        let whole = File::open(&file).map_err(io_error(&file))?;
        hasher.update_reader(whole).map_err(io_error(&file))?;
        hasher.update(&interval.from_ns.to_le_bytes());
        hasher.update(&interval.to_ns.to_le_bytes());
        Ok(Self {
            digest: hasher.finalize().to_hex().to_string(),
            content: Content::Episode {
                file,
                version,
                interval,
            },
        })
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
            Content::Episode {
                file: path,
                version,
                interval,
            } => {
                let file = File::open(path).map_err(io_error(path))?;
                let handle = file.try_clone().map_err(io_error(path))?;
                let decoded = decode_interval(file, *interval, &profile.limits, on_frame)?;
                // Unlike bytes in memory, a file may be written while it is read.
                if version.is_some_and(|version| version_of(&handle).ok() != Some(version)) {
                    let changed = std::io::Error::other("it changed while it was read");
                    return Err(io_error(path)(changed));
                }
                Ok(decoded)
            }
        }
    }
}

fn path_of(bytes: &[u8]) -> PathBuf {
    PathBuf::from(OsString::from_vec(bytes.to_vec()))
}

fn io_error(path: &Path) -> impl Fn(std::io::Error) -> DecodeError {
    move |source| DecodeError::Io {
        path: path.to_path_buf(),
        source,
    }
}

fn version_of(file: &File) -> std::io::Result<Version> {
    let metadata = file.metadata()?;
    Ok((metadata.len(), modified_ns(&metadata)?))
}

/// So many bytes from `offset` on, where `whole` has them.
pub(crate) fn byte_range(offset: u64, bytes: u64, whole: u64) -> Option<Range<u64>> {
    let end = offset.checked_add(bytes).filter(|&end| end <= whole)?;
    Some(offset..end)
}

fn changed(path: impl std::fmt::Display) -> ReadError {
    ReadError::Changed {
        path: path.to_string(),
    }
}

/// The file of `job`, in the version that was listed; what is read of it is within the limit.
fn open_unchanged(path: &Path, job: &Job, limits: &DecodeLimits) -> Result<File, ReadError> {
    let file = File::open(path).map_err(io_error(path))?;
    let version = version_of(&file).map_err(io_error(path))?;
    if version != (job.bytes, job.modified_ns) {
        return Err(changed(path.display()));
    }
    limits.check_bytes(job.bytes_read())?;
    Ok(file)
}

fn read_file(path: &Path, job: &Job, limits: &DecodeLimits) -> Result<Vec<u8>, ReadError> {
    let file = open_unchanged(path, job, limits)?;
    let whole = read_whole(file, job.bytes).map_err(io_error(path))?;
    whole.ok_or_else(|| changed(path.display()))
}

fn read_member(
    path: &Path,
    range: Range<u64>,
    job: &Job,
    limits: &DecodeLimits,
) -> Result<Vec<u8>, ReadError> {
    let file = open_unchanged(path, job, limits)?;
    let mut member = vec![0; (range.end - range.start) as usize];
    file.read_exact_at(&mut member, range.start)
        .map_err(io_error(path))?;
    Ok(member)
}

fn there<'a>(copy: Option<&'a Path>, object: &ObjectLocation) -> Result<&'a Path, ReadError> {
    copy.ok_or_else(|| ReadError::NotRead {
        object: object.to_string(),
        why: "was not fetched before it was to be measured; report this defect".into(),
    })
}

/// The copy of an object; its version was checked when it was made.
fn read_copy(copy: &Path, object: &ObjectLocation, job: &Job) -> Result<Vec<u8>, ReadError> {
    let address = PathBuf::from(object.to_string());
    let file = File::open(copy).map_err(io_error(&address))?;
    let whole = read_whole(file, job.bytes_read()).map_err(io_error(&address))?;
    whole.ok_or_else(|| changed(object))
}

/// `None` where there are not exactly so many bytes.
fn read_whole(file: File, bytes: u64) -> std::io::Result<Option<Vec<u8>>> {
    let mut whole = Vec::with_capacity(bytes as usize);
    // One byte more than announced, so that a file that grows meanwhile is noticed.
    file.take(bytes.saturating_add(1)).read_to_end(&mut whole)?;
    Ok((whole.len() as u64 == bytes).then_some(whole))
}
