//! RGB frames to a video file: H.264 in MP4 that every browser plays, the same bytes on every run.
//!
//! libx264 (constant rate factor 18, one thread, bit-exact headers) where the installed FFmpeg has it,
//! MPEG-4 Part 2 otherwise. Pictures are tagged BT.709 limited range and converted with that very matrix, so
//! that decoding gives the colours back. 4:2:0 needs even sizes: an odd width or height is padded by
//! repeating the last column or row, see [`Mp4Writer::written_size`].
//!
//! The file appears under its name only when it is complete (temporary file beside it, then rename). What may
//! fail: no encoder, a frame of another size, the disk.

use std::path::{Path, PathBuf};

use ffmpeg_next::codec::{self, encoder, threading};
use ffmpeg_next::color;
use ffmpeg_next::format::context::{Output, StreamIo};
use ffmpeg_next::format::{self, Pixel};
use ffmpeg_next::software::scaling;
use ffmpeg_next::{Dictionary, Error, Packet, Rational};
use plumbline_vision::image::Rgb8;

use crate::decode;
use crate::decode::ffi::{self, Range};

/// Why a video could not be written.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// Width, height or rate cannot be encoded.
    #[error(
        "a video of {width}x{height} at {fps} frames per second cannot be written; sizes must be 1 to 16384 and the rate above 0 and at most 1000"
    )]
    Shape {
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
        /// Frames per second asked for.
        fps: f64,
    },
    /// A frame does not have the video's size, or its data does not have its own.
    #[error(
        "frame {index} is {width}x{height}, but the video is {expected_width}x{expected_height}"
    )]
    FrameSize {
        /// Frames written before it.
        index: u32,
        /// Its columns.
        width: usize,
        /// Its rows.
        height: usize,
        /// The video's columns.
        expected_width: u32,
        /// The video's rows.
        expected_height: u32,
    },
    /// No frame was pushed.
    #[error("a video needs at least one frame")]
    NoFrames,
    /// The installed FFmpeg has none of the encoders.
    #[error(
        "the installed FFmpeg has no encoder for H.264 or MPEG-4; install one built with libx264"
    )]
    NoEncoder,
    /// The encoder or muxer failed.
    #[error("the video encoder failed while {doing}: {source}")]
    Encoder {
        /// Which step.
        doing: &'static str,
        /// As FFmpeg said.
        source: Error,
    },
    /// The file system refused.
    #[error("{}: {source}; check the directory and its free space", path.display())]
    Io {
        /// The video's path.
        path: PathBuf,
        /// As the system said.
        source: std::io::Error,
    },
}

/// Constant rate factor of libx264: visually lossless.
const X264_CRF: &str = "18";
/// Quantiser 2 in FFmpeg's lambda units (118 each): MPEG-4's counterpart of the above.
const MPEG4_QUALITY: &str = "236";
/// Largest side that H.264 levels and libx264 take.
const MAX_SIDE: u32 = 16_384;
const MAX_FPS: f64 = 1000.0;
/// Largest denominator and numerator of the rate: exact for 24000/1001 and its kin.
const RATE_PRECISION: i32 = 1_001_000;

/// How the name of an unfinished video begins; a killed writer leaves one.
pub const UNFINISHED_PREFIX: &str = ".plumbline-";
/// How it ends.
pub const UNFINISHED_SUFFIX: &str = ".mp4";

/// Writes one MP4 file, frame by frame.
pub struct Mp4Writer {
    clip: ClipWriter,
    file: tempfile::NamedTempFile,
    path: PathBuf,
}

impl Mp4Writer {
    /// Starts a video of `width` by `height` pixels at `fps` frames per second that will be at `path`.
    ///
    /// # Errors
    /// `Shape`, `NoEncoder`, `Encoder` or `Io`; nothing is left behind.
    pub fn create(path: &Path, width: u32, height: u32, fps: f64) -> Result<Self, EncodeError> {
        let valid_size = |side: u32| (1..=MAX_SIDE).contains(&side);
        if !(valid_size(width) && valid_size(height) && fps > 0.0 && fps <= MAX_FPS) {
            return Err(EncodeError::Shape { width, height, fps });
        }
        let io_error = |source| EncodeError::Io {
            path: path.to_owned(),
            source,
        };
        let directory = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        builder.prefix(UNFINISHED_PREFIX).suffix(UNFINISHED_SUFFIX);
        // Readable like any other file: temporary files are private by default.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let file = builder.tempfile_in(directory).map_err(io_error)?;
        let handle = file.as_file().try_clone().map_err(io_error)?;
        let io = StreamIo::from_write_seek(handle).map_err(step("opening"))?;
        let settings = Settings::h264_or_mpeg4().ok_or(EncodeError::NoEncoder)?;
        let clip = ClipWriter::new(io, &settings, width, height, rational_rate(fps))?;
        Ok(Self {
            clip,
            file,
            path: path.to_owned(),
        })
    }

    /// Appends a frame of the video's size.
    ///
    /// # Errors
    /// `FrameSize`, `Encoder`.
    pub fn push(&mut self, frame: &Rgb8) -> Result<(), EncodeError> {
        self.clip.push_at(frame, i64::from(self.clip.frames))
    }

    /// Columns and rows of the file's pictures: the size asked for, rounded up to even.
    pub fn written_size(&self) -> (u32, u32) {
        self.clip.written_size
    }

    /// Completes the file and puts it in place; a writer that is dropped instead leaves nothing.
    ///
    /// # Errors
    /// `NoFrames`, `Encoder`, `Io`.
    pub fn finish(self) -> Result<(), EncodeError> {
        self.clip.finish()?;
        let io_error = |source| EncodeError::Io {
            path: self.path.clone(),
            source,
        };
        self.file.as_file().sync_all().map_err(io_error)?;
        self.file
            .persist(&self.path)
            .map_err(|error| io_error(error.error))?;
        Ok(())
    }
}

/// Nearest simple fraction, so that the file states 30000/1001 rather than a rounded decimal.
fn rational_rate(fps: f64) -> Rational {
    // FFmpeg takes the simplest fraction that is the number; the limit keeps time bases small.
    let exact = Rational::from(fps);
    let (Ok(reduced) | Err(reduced)) = exact.reduce_with_limit(RATE_PRECISION);
    reduced
}

fn step(doing: &'static str) -> impl FnOnce(Error) -> EncodeError {
    move |source| EncodeError::Encoder { doing, source }
}

/// What to encode with; tests use it for the codecs that users bring.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) muxer: &'static str,
    pub(crate) encoder: &'static str,
    pub(crate) pixel_format: Pixel,
    /// YCbCr matrix by its H.273 code; BT.709 is tagged, others are left untagged.
    pub(crate) matrix: i32,
    pub(crate) encoder_options: Vec<(&'static str, &'static str)>,
    pub(crate) muxer_options: Vec<(&'static str, &'static str)>,
}

impl Settings {
    fn h264_or_mpeg4() -> Option<Self> {
        let mut settings = Self {
            muxer: "mp4",
            encoder: "libx264",
            pixel_format: Pixel::YUV420P,
            matrix: decode::BT709,
            encoder_options: vec![("crf", X264_CRF), ("preset", "medium")],
            muxer_options: Vec::new(),
        };
        if encoder::find_by_name(settings.encoder).is_some() {
            return Some(settings);
        }
        settings.encoder = "mpeg4";
        settings.encoder_options = vec![("flags", "+qscale"), ("global_quality", MPEG4_QUALITY)];
        encoder::find_by_name(settings.encoder)
            .is_some()
            .then_some(settings)
    }
}

/// One video track into any muxer. Time stamps are in ticks of one frame interval.
pub(crate) struct ClipWriter {
    output: Output,
    encoder: encoder::video::Encoder,
    scaler: scaling::Context,
    tick: Rational,
    size: (u32, u32),
    written_size: (u32, u32),
    frames: u32,
}

impl ClipWriter {
    pub(crate) fn new(
        io: StreamIo,
        settings: &Settings,
        width: u32,
        height: u32,
        rate: Rational,
    ) -> Result<Self, EncodeError> {
        ffi::silence();
        let codec = encoder::find_by_name(settings.encoder).ok_or(EncodeError::NoEncoder)?;
        let mut output =
            format::output_to_stream(io, None, Some(settings.muxer)).map_err(step("opening"))?;
        let format = settings.pixel_format;
        let subsampled = format
            .descriptor()
            .is_some_and(|d| d.log2_chroma_w() > 0 || d.log2_chroma_h() > 0);
        let even = |side: u32| {
            if subsampled {
                side.next_multiple_of(2)
            } else {
                side
            }
        };
        let written_size = (even(width), even(height));

        let mut context = codec::context::Context::new_with_codec(codec);
        let mut flags = codec::Flags::BITEXACT;
        if output
            .format()
            .flags()
            .contains(format::Flags::GLOBAL_HEADER)
        {
            flags |= codec::Flags::GLOBAL_HEADER;
        }
        context.set_flags(flags);
        context.set_threading(threading::Config::count(1));
        let mut video = context.encoder().video().map_err(step("opening"))?;
        let tick = rate.invert();
        video.set_width(written_size.0);
        video.set_height(written_size.1);
        video.set_format(format);
        video.set_time_base(tick);
        video.set_frame_rate(Some(rate));
        let is_ycbcr = is_ycbcr(format);
        if is_ycbcr && settings.matrix == decode::BT709 {
            video.set_colorspace(color::Space::BT709);
            video.set_color_range(color::Range::MPEG);
            video.set_color_primaries(color::Primaries::BT709);
            video.set_color_transfer_characteristic(color::TransferCharacteristic::BT709);
        }
        let options: Dictionary<'_> = settings.encoder_options.iter().copied().collect();
        let encoder = video
            .open_as_with(codec, options)
            .map_err(step("opening"))?;

        let mut stream = output.add_stream(codec).map_err(step("opening"))?;
        stream.set_parameters(codec::Parameters::from(&encoder));
        stream.set_time_base(tick);
        stream.set_avg_frame_rate(rate);
        let muxer_options: Dictionary<'_> = settings
            .muxer_options
            .iter()
            .copied()
            .chain([("fflags", "+bitexact")])
            .collect();
        drop(
            output
                .write_header_with(muxer_options)
                .map_err(step("writing the header"))?,
        );

        let (w, h) = written_size;
        let mut scaler =
            scaling::Context::get(Pixel::RGB24, w, h, format, w, h, decode::EXACT_BICUBIC)
                .map_err(step("preparing the colours"))?;
        if is_ycbcr {
            let range = if decode::is_full_range_format(format) {
                Range::Full
            } else {
                Range::Limited
            };
            ffi::set_colour(&mut scaler, settings.matrix, Range::OfFormat, range)
                .map_err(step("preparing the colours"))?;
        }
        Ok(Self {
            output,
            encoder,
            scaler,
            tick,
            size: (width, height),
            written_size,
            frames: 0,
        })
    }

    /// Appends a frame that is shown from `tick` on; ticks must increase.
    pub(crate) fn push_at(&mut self, frame: &Rgb8, tick: i64) -> Result<(), EncodeError> {
        let (width, height) = (self.size.0 as usize, self.size.1 as usize);
        if (frame.width, frame.height, frame.data.len()) != (width, height, width * height * 3) {
            return Err(EncodeError::FrameSize {
                index: self.frames,
                width: frame.width,
                height: frame.height,
                expected_width: self.size.0,
                expected_height: self.size.1,
            });
        }
        let (w, h) = self.written_size;
        let mut rgb = ffi::allocate(Pixel::RGB24, w, h).map_err(step("converting"))?;
        let stride = rgb.stride(0);
        for (y, row) in rgb
            .data_mut(0)
            .chunks_mut(stride)
            .take(h as usize)
            .enumerate()
        {
            let source = &frame.data[y.min(height - 1) * width * 3..][..width * 3];
            row[..width * 3].copy_from_slice(source);
            if w as usize > width {
                row[width * 3..][..3].copy_from_slice(&source[(width - 1) * 3..]);
            }
        }
        let mut picture = ffi::allocate(self.encoder.format(), w, h).map_err(step("converting"))?;
        ffi::scale(&mut self.scaler, &rgb, &mut picture).map_err(step("converting"))?;
        picture.set_pts(Some(tick));
        // Some encoders write the picture's tags, not the context's.
        picture.set_color_space(self.encoder.colorspace());
        picture.set_color_range(self.encoder.color_range());
        picture.set_color_primaries(self.encoder.color_primaries());
        picture.set_color_transfer_characteristic(self.encoder.color_transfer_characteristic());
        self.encoder
            .send_frame(&picture)
            .map_err(step("encoding a frame"))?;
        self.frames += 1;
        self.write_packets()
    }

    /// Completes the container.
    pub(crate) fn finish(mut self) -> Result<(), EncodeError> {
        if self.frames == 0 {
            return Err(EncodeError::NoFrames);
        }
        self.encoder
            .send_eof()
            .map_err(step("encoding the last frames"))?;
        self.write_packets()?;
        self.output
            .write_trailer()
            .map_err(step("completing the file"))
    }

    fn write_packets(&mut self) -> Result<(), EncodeError> {
        let stream_tick = self
            .output
            .stream(0)
            .map_or(self.tick, |stream| stream.time_base());
        loop {
            let mut packet = Packet::empty();
            match self.encoder.receive_packet(&mut packet) {
                Ok(()) => {}
                Err(
                    Error::Eof
                    | Error::Other {
                        errno: ffmpeg_next::ffi::EAGAIN,
                    },
                ) => return Ok(()),
                Err(source) => {
                    return Err(EncodeError::Encoder {
                        doing: "encoding",
                        source,
                    });
                }
            }
            packet.set_stream(0);
            // Gives the last frame its length in the container.
            if packet.duration() == 0 {
                packet.set_duration(1);
            }
            packet.rescale_ts(self.tick, stream_tick);
            packet
                .write_interleaved(&mut self.output)
                .map_err(step("writing"))?;
        }
    }
}

/// Luma and chroma planes, as opposed to RGB and palettes.
fn is_ycbcr(format: Pixel) -> bool {
    format
        .descriptor()
        .is_some_and(|descriptor| descriptor.name().starts_with("yuv"))
}
