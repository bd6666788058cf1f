//! The rendered sample corpus on disk.
//!
//! `videos/<name>.mp4` (H.264), `truth/<name>.npz` (the exact truth of every frame), `labels.csv`
//! (what is wrong with which video, when and where). Equal seeds give equal files.
//!
//! In an `.npz`, T frames of H × W pixels: `camera_from_world` `[T, 7]` (t xyz in metres, q xyzw),
//! `intrinsics_px` `[4]` (fx, fy, cx, cy), and unless left out `flow_px` `[T−1, H, W, 2]` (x, y; frame
//! t to t + 1), `flow_valid` and `flow_visible` `[T−1, H, W]`, `depth_m` and `body_id` `[T, H, W]`.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use plumbline_sample::SampleError;
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::truth::FrameTruth;
use plumbline_vision::image::Rgb8;
use plumbline_worker::encode::{EncodeError, Mp4Writer};

use crate::in_parallel::{BrokenThread, in_parallel};
use crate::npz::Npz;

/// How much truth is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Truth {
    /// Poses and intrinsics.
    Poses,
    /// Flow, depth and bodies too.
    Dense,
}

/// Why the sample could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteSampleError {
    /// A clip does not render.
    #[error("{clip}: {source}")]
    Render {
        /// The clip.
        clip: String,
        /// Why.
        source: SampleError,
    },
    /// A clip does not encode.
    #[error("{clip}: {source}")]
    Encode {
        /// The clip.
        clip: String,
        /// Why.
        source: EncodeError,
    },
    /// A defect of the program.
    #[error(transparent)]
    Thread(#[from] BrokenThread),
    /// The disk said no.
    #[error("{path}: {source}; make room or choose another --out")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// A directory that the sample is written into.
#[derive(Debug)]
pub struct SampleDir {
    root: PathBuf,
}

impl SampleDir {
    /// Makes the directories.
    ///
    /// # Errors
    /// [`WriteSampleError::Io`].
    pub fn create(root: &Path) -> Result<Self, WriteSampleError> {
        let sample = Self {
            root: root.to_path_buf(),
        };
        for directory in [sample.videos(), sample.truth()] {
            fs::create_dir_all(&directory).map_err(|source| WriteSampleError::Io {
                path: directory,
                source,
            })?;
        }
        Ok(sample)
    }

    /// Where the videos are.
    #[must_use]
    pub fn videos(&self) -> PathBuf {
        self.root.join("videos")
    }

    /// Where the labels are.
    #[must_use]
    pub fn labels(&self) -> PathBuf {
        self.root.join("labels.csv")
    }

    fn truth(&self) -> PathBuf {
        self.root.join("truth")
    }

    /// Renders and writes clips and their truth, one on each core at a time; `on_written` is told of each.
    ///
    /// # Errors
    /// The first [`WriteSampleError`]; clips that were begun are written still.
    pub fn write_clips(
        &self,
        clips: &[ClipSpec],
        truth: Truth,
        on_written: impl FnMut() + Send,
    ) -> Result<(), WriteSampleError> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let on_written = Mutex::new(on_written);
        let write = |(): &mut (), clip| {
            self.write_clip(clip, truth)?;
            on_written.lock().map_err(|_| BrokenThread)?();
            Ok(())
        };
        in_parallel(clips.iter().collect(), cores, || (), write, |()| Ok(()))
    }

    fn write_clip(&self, clip: &ClipSpec, truth: Truth) -> Result<(), WriteSampleError> {
        let video = self.videos().join(format!("{}.mp4", clip.name));
        write_video(clip, &video)?;
        let path = self.truth().join(format!("{}.npz", clip.name));
        let frames = (0..clip.frames)
            .map(|frame| clip.truth(frame))
            .collect::<Result<Vec<_>, _>>();
        let frames = frames.map_err(|source| render_error(clip, source))?;
        write_truth(&path, clip, &frames, truth)
            .map_err(|source| WriteSampleError::Io { path, source })
    }

    /// Writes what is wrong with which clip: a list that `plumbline score` and `evaluate` read too.
    ///
    /// # Errors
    /// [`WriteSampleError`].
    pub fn write_labels(&self, clips: &[ClipSpec]) -> Result<(), WriteSampleError> {
        let path = self.labels();
        let write = || -> Result<(), csv::Error> {
            let mut table = csv::Writer::from_path(&path)?;
            table.write_record([
                "video",
                "family",
                "pair",
                "fault",
                "first_frame",
                "last_frame",
                "x0",
                "y0",
                "x1",
                "y1",
            ])?;
            for clip in clips {
                let mut record = vec![
                    format!("videos/{}.mp4", clip.name),
                    clip.family.as_str().to_owned(),
                    clip.pair.to_string(),
                ];
                // Frame number and place are checked when the clip is made; an error means no fault.
                match clip.fault_truth().ok().flatten() {
                    None => record.extend(std::iter::repeat_n(String::new(), 7)),
                    Some(fault) => {
                        record.push(fault.kind.as_str().to_owned());
                        record.extend(
                            [fault.first_frame, fault.last_frame].map(|frame| frame.to_string()),
                        );
                        record.extend(fault.bbox_px.map(|px| px.to_string()));
                    }
                }
                table.write_record(&record)?;
            }
            table.flush()?;
            Ok(())
        };
        write().map_err(|error| WriteSampleError::Io {
            path: self.labels(),
            source: io::Error::other(error),
        })
    }
}

/// Renders a clip into an mp4 file, whole or not at all.
///
/// # Errors
/// [`WriteSampleError`].
pub(crate) fn write_video(clip: &ClipSpec, path: &Path) -> Result<(), WriteSampleError> {
    let encode_error = |source| WriteSampleError::Encode {
        clip: clip.name.clone(),
        source,
    };
    let (width, height) = (clip.width as u32, clip.height as u32);
    let mut writer = Mp4Writer::create(path, width, height, clip.fps).map_err(encode_error)?;
    for frame in clip.render_frames() {
        let frame = frame.map_err(|source| render_error(clip, source))?;
        let picture = Rgb8 {
            width: frame.width,
            height: frame.height,
            data: frame.rgb,
        };
        writer.push(&picture).map_err(encode_error)?;
    }
    writer.finish().map_err(encode_error)
}

fn render_error(clip: &ClipSpec, source: SampleError) -> WriteSampleError {
    WriteSampleError::Render {
        clip: clip.name.clone(),
        source,
    }
}

fn write_truth(
    path: &Path,
    clip: &ClipSpec,
    frames: &[FrameTruth],
    truth: Truth,
) -> io::Result<()> {
    let mut npz = Npz::new(BufWriter::new(File::create(path)?));
    let (t, h, w) = (frames.len() as u64, clip.height as u64, clip.width as u64);
    let poses = frames.iter().flat_map(|frame| {
        let pose = &frame.camera_from_world;
        pose.translation_m.into_iter().chain(pose.quaternion_xyzw())
    });
    npz.array("camera_from_world", &[t, 7], poses)?;
    if let Some(first) = frames.first() {
        let camera = &first.camera;
        npz.array(
            "intrinsics_px",
            &[4],
            [camera.fx, camera.fy, camera.cx, camera.cy],
        )?;
    }
    if truth == Truth::Dense {
        let flows = || frames.iter().filter_map(|frame| frame.flow.as_ref());
        let pairs = flows().count() as u64;
        npz.array(
            "flow_px",
            &[pairs, h, w, 2],
            flows().flat_map(|flow| flow.flow_px.iter().copied().flatten()),
        )?;
        let flags = |flags: &[bool]| {
            flags
                .iter()
                .map(|&flag| u8::from(flag))
                .collect::<Vec<u8>>()
        };
        npz.array(
            "flow_valid",
            &[pairs, h, w],
            flows().flat_map(|flow| flags(&flow.valid)),
        )?;
        npz.array(
            "flow_visible",
            &[pairs, h, w],
            flows().flat_map(|flow| flags(&flow.visible)),
        )?;
        npz.array(
            "depth_m",
            &[t, h, w],
            frames
                .iter()
                .flat_map(|frame| frame.depth_m.iter().copied()),
        )?;
        npz.array(
            "body_id",
            &[t, h, w],
            frames
                .iter()
                .flat_map(|frame| frame.body_id.iter().copied()),
        )?;
    }
    npz.finish()?.flush()
}
