//! One video file, in memory (or where it lies, for an episode in it), to RGB frames in presentation order.
//!
//! FFmpeg's libraries run in process on one thread. Limits are checked from the header before a codec runs, and
//! again on every frame.
//!
//! A clip counts as decoded only in full, because a missing frame would be scored as a jump: a file that
//! ends early (fewer samples than its index, or cut containers) and packets that the decoder refuses give
//! `Undecodable`, after the frames that could be decoded have been delivered; callers discard them. A
//! change of picture size within a clip is refused too: frames of two sizes have no common flow. Packets
//! that give no picture without an error are legal (field pairs, invisible reference frames, references before
//! a cut), so they are only counted. Interlaced pictures are delivered as coded.
//!
//! Of an episode among others in one file, all of that is said of its own frames: limits are its own, and what
//! is wrong elsewhere in the file is nothing to it.

use std::fs::File;
use std::io::Cursor;
use std::ops::ControlFlow;
use std::sync::Arc;

use ffmpeg_next::codec::decoder;
use ffmpeg_next::{Error, Packet, frame};

use super::convert::{self, ConvertError, Converter};
use super::ffi;
use super::interval::{self, Place, Window};
use super::orient::Orientation;
use super::source::Source;
use super::structure;
use super::timeline::Timeline;
use super::{DecodeError, DecodeLimits, DecodedFrame, Interval, VideoInfo, sniff};

/// Decodes `bytes`, a whole file, and hands every frame to `on_frame` in presentation order.
///
/// Frames are streamed: memory is bounded by a few pictures beside the bytes. `on_frame` may stop the
/// decoding by `ControlFlow::Break`, which is not an error.
///
/// # Errors
/// See [`DecodeError`]; frames may have been delivered before an error is found.
pub fn decode_video(
    bytes: Arc<[u8]>,
    limits: &DecodeLimits,
    on_frame: &mut dyn FnMut(DecodedFrame) -> ControlFlow<()>,
) -> Result<VideoInfo, DecodeError> {
    limits.check_bytes(bytes.len() as u64)?;
    let container = sniff(&bytes)?;
    let structure = structure::examine(container, &bytes);
    let source = Source::open(Cursor::new(bytes), container, structure)?;
    source.check_header(limits)?;
    let mut run = Run::new(source, limits, Window::WHOLE)?;
    let ended = run.all_packets(None, on_frame)?;
    run.finish(ended)
}

/// Decodes the frames of `interval`, with times from 0, and the packets before them back to a keyframe; of the
/// file no more than a buffer is in memory.
///
/// # Errors
/// As [`decode_video`], of the frames of the interval alone; also where the file ends before it does.
pub fn decode_interval(
    file: File,
    interval: Interval,
    limits: &DecodeLimits,
    on_frame: &mut dyn FnMut(DecodedFrame) -> ControlFlow<()>,
) -> Result<VideoInfo, DecodeError> {
    let source = Source::of_unread(file)?;
    source.check_size(limits)?;
    limits.check_duration(interval.length_s())?;
    let window = Window::of(interval, source.time_base);
    let mut run = Run::new(source, limits, window)?;
    let stream = run.source.stream;
    let first = interval::go_to(&mut run.source.input, stream, interval, window);
    let first = first.map_err(|_| {
        DecodeError::undecodable(
            "a time in the file cannot be gone to; remux the episode to a file of its own",
        )
    })?;
    let ended = run.all_packets(first, on_frame)?;
    run.finish(ended)
}

/// Size and naming of the delivered frames, fixed by the first one.
#[derive(Debug, Clone, PartialEq)]
struct Shape {
    coded: (u32, u32),
    square_width: u32,
    aspect: f64,
    orientation: Orientation,
    pixel_format: String,
}

#[derive(Debug, Default)]
struct Counts {
    /// Packets that arrived whole.
    packets: u64,
    /// Of those, packets that are to be shown.
    presentable: u64,
    /// Packets that the decoder refused.
    rejected: u32,
    /// Pictures that came out of the decoder.
    pictures: u64,
    dropped: u32,
    damaged: u32,
    /// The container ended in an error or in the middle of a sample.
    read_failed: bool,
}

/// Why there are no more frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ended {
    /// `on_frame` said so.
    AsAsked,
    /// Those that follow come after the window.
    WindowPassed,
    /// The file ends, or cannot be read on.
    FileEnds,
}

struct Run<'a> {
    source: Source,
    window: Window,
    decoder: decoder::Video,
    limits: &'a DecodeLimits,
    timeline: Timeline,
    converter: Converter,
    shape: Option<Shape>,
    counts: Counts,
}

type OnFrame<'f> = dyn FnMut(DecodedFrame) -> ControlFlow<()> + 'f;

impl<'a> Run<'a> {
    fn new(source: Source, limits: &'a DecodeLimits, window: Window) -> Result<Self, DecodeError> {
        Ok(Self {
            timeline: Timeline::new(source.tick_s()),
            decoder: source.decoder(limits)?,
            source,
            window,
            limits,
            converter: Converter::default(),
            shape: None,
            counts: Counts::default(),
        })
    }

    /// Decodes `first`, where a packet was read already, and all that follow.
    fn all_packets(
        &mut self,
        mut first: Option<Packet>,
        on_frame: &mut OnFrame<'_>,
    ) -> Result<Ended, DecodeError> {
        loop {
            let packet = match first.take() {
                Some(packet) => packet,
                None => {
                    let mut packet = Packet::empty();
                    match packet.read(&mut self.source.input) {
                        Ok(()) => packet,
                        Err(Error::Eof) => break,
                        Err(_) => {
                            self.counts.read_failed = true;
                            break;
                        }
                    }
                }
            };
            if packet.stream() != self.source.stream {
                continue;
            }
            if packet.is_corrupt() {
                self.counts.read_failed = true;
                break;
            }
            self.counts.packets += 1;
            // Samples before an edit list's start are decoded for reference only.
            let is_inside = match packet.pts() {
                Some(pts) => self.window.place(pts) == Place::Inside,
                None => self.window == Window::WHOLE,
            };
            if !ffi::is_hidden(&packet) && is_inside {
                self.counts.presentable += 1;
            }
            if let Err(error) = self.decoder.send_packet(&packet) {
                self.refused(&error)?;
            }
            if let ControlFlow::Break(ended) = self.all_pictures(on_frame)? {
                return Ok(ended);
            }
        }
        // A refused flush means that the decoder has nothing more to give.
        if self.decoder.send_eof().is_ok()
            && let ControlFlow::Break(ended) = self.all_pictures(on_frame)?
        {
            return Ok(ended);
        }
        Ok(Ended::FileEnds)
    }

    /// Delivers every picture that is ready.
    fn all_pictures(
        &mut self,
        on_frame: &mut OnFrame<'_>,
    ) -> Result<ControlFlow<Ended>, DecodeError> {
        loop {
            let mut picture = frame::Video::empty();
            match self.decoder.receive_frame(&mut picture) {
                Ok(()) => {}
                Err(
                    Error::Eof
                    | Error::Other {
                        errno: ffmpeg_next::ffi::EAGAIN,
                    },
                ) => break,
                Err(error) => {
                    self.refused(&error)?;
                    break;
                }
            }
            let ticks = self.ticks_of(&picture)?;
            match self.window.place(ticks) {
                Place::Before => continue,
                Place::Inside => {}
                Place::After => return Ok(ControlFlow::Break(Ended::WindowPassed)),
            }
            self.counts.pictures += 1;
            if let Some(decoded) = self.present(&picture, ticks)?
                && on_frame(decoded).is_break()
            {
                return Ok(ControlFlow::Break(Ended::AsAsked));
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Counts a packet that the decoder refused.
    fn refused(&mut self, error: &Error) -> Result<(), DecodeError> {
        if DecodeError::is_out_of_memory(error) {
            return Err(DecodeError::OutOfMemory);
        }
        self.counts.rejected = self.counts.rejected.saturating_add(1);
        Ok(())
    }

    /// The frame as a player shows it; nothing when its time does not advance.
    fn present(
        &mut self,
        picture: &frame::Video,
        ticks: i64,
    ) -> Result<Option<DecodedFrame>, DecodeError> {
        let square_width = self.shape_of(picture)?.square_width;
        let orientation = self
            .shape
            .as_ref()
            .map_or(Orientation::UPRIGHT, |shape| shape.orientation);
        let Some((index, time_s)) = self.timeline.push(ticks) else {
            self.counts.dropped = self.counts.dropped.saturating_add(1);
            return Ok(None);
        };
        self.limits.check_frames(u64::from(index) + 1)?;
        self.limits.check_duration(time_s)?;
        if picture.is_corrupt() || picture.has_decode_errors() {
            self.counts.damaged = self.counts.damaged.saturating_add(1);
        }
        let rgb = self
            .converter
            .rgb(picture, square_width)
            .map_err(|error| match error {
                ConvertError::Scale(error) if DecodeError::is_out_of_memory(&error) => {
                    DecodeError::OutOfMemory
                }
                error => {
                    DecodeError::undecodable(format!("frame {index} does not convert: {error}"))
                }
            })?;
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let rgb = orientation.apply(rgb.data(0), rgb.stride(0), width, height);
        Ok(Some(DecodedFrame { index, time_s, rgb }))
    }

    /// The shape fixed by the first picture; an error when this one differs.
    fn shape_of(&mut self, picture: &frame::Video) -> Result<&Shape, DecodeError> {
        let coded = (picture.width(), picture.height());
        if let Some(shape) = self.shape.as_ref().filter(|shape| shape.coded != coded) {
            return Err(DecodeError::undecodable(format!(
                "the picture size changes from {}x{} to {}x{} at frame {}; split the clip there or re-encode it",
                shape.coded.0,
                shape.coded.1,
                coded.0,
                coded.1,
                self.timeline.frames(),
            )));
        }
        if self.shape.is_none() {
            self.limits.check_size(coded.0.into(), coded.1.into())?;
            let of_frame = picture.aspect_ratio();
            let declared = match self.source.header.pixel_aspect {
                (num, den) if num > 0 && den > 0 => (num, den),
                _ => (of_frame.numerator(), of_frame.denominator()),
            };
            let aspect = convert::aspect(declared);
            let square_width = convert::square_width(coded.0, aspect);
            self.limits.check_size(square_width, coded.1.into())?;
            let orientation = self.source.orientation.or_else(|| {
                let matrix = picture.side_data(frame::side_data::Type::DisplayMatrix)?;
                Some(Orientation::from_display_matrix(matrix.data()))
            });
            self.shape = Some(Shape {
                coded,
                square_width: u32::try_from(square_width).unwrap_or(u32::MAX),
                aspect,
                orientation: orientation.unwrap_or(Orientation::UPRIGHT),
                pixel_format: convert::format_name(picture.format()),
            });
        }
        self.shape
            .as_ref()
            .ok_or_else(|| DecodeError::undecodable(NOTHING_DECODES))
    }

    /// FFmpeg's best estimate of the presentation time; where the file has none, one nominal frame on.
    fn ticks_of(&self, picture: &frame::Video) -> Result<i64, DecodeError> {
        if let Some(ticks) = picture.timestamp() {
            return Ok(ticks);
        }
        let Some(last) = self.timeline.last() else {
            return Ok(0);
        };
        let interval = self.nominal_interval().map(f64::round_ties_even);
        match interval.filter(|&interval| interval >= 1.0) {
            Some(interval) => Ok(last.saturating_add(interval as i64)),
            None => Err(DecodeError::undecodable(
                "its frames carry no presentation times and it states no frame rate; remux it to mp4",
            )),
        }
    }

    /// Ticks between frames at the rate that the file states.
    fn nominal_interval(&self) -> Option<f64> {
        let rate = self.source.header_rate()?;
        Some(1.0 / (rate * self.source.tick_s()))
    }

    /// Whether the clip came in full, and what it was.
    fn finish(self, ended: Ended) -> Result<VideoInfo, DecodeError> {
        let counts = &self.counts;
        let stopped_early = ended == Ended::AsAsked;
        if !stopped_early {
            self.check_complete(ended)?;
        }
        let silent = counts.presentable.saturating_sub(counts.pictures);
        let shape = self
            .shape
            .ok_or_else(|| DecodeError::undecodable(NOTHING_DECODES))?;
        let (width, height) = shape
            .orientation
            .presented_size(shape.square_width as usize, shape.coded.1 as usize);
        let (rotation_deg, mirrored) = shape.orientation.turn_and_mirror();
        Ok(VideoInfo {
            container: self.source.container.name().into(),
            codec: self.decoder.id().name().into(),
            pixel_format: shape.pixel_format,
            width: width as u32,
            height: height as u32,
            coded_width: shape.coded.0,
            coded_height: shape.coded.1,
            sample_aspect_ratio: shape.aspect,
            rotation_deg,
            mirrored,
            frames: self.timeline.frames(),
            fps: self.timeline.fps(),
            duration_s: self.timeline.duration_s(),
            variable_frame_rate: self.timeline.is_variable(),
            dropped_frames: counts.dropped,
            damaged_frames: counts.damaged,
            rejected_packets: counts.rejected,
            silent_packets: if stopped_early {
                0
            } else {
                silent.try_into().unwrap_or(u32::MAX)
            },
            stopped_early,
        })
    }

    fn check_complete(&self, ended: Ended) -> Result<(), DecodeError> {
        let counts = &self.counts;
        if self.window != Window::WHOLE {
            if ended == Ended::FileEnds {
                self.check_window()?;
            }
            return self.check_refused();
        }
        let declared = self.source.declared.or(self.source.structure.frames);
        // Containers with an index are judged by it, so that a padded or trimmed tail is no fault.
        let is_cut = match self.source.declared {
            Some(samples) => counts.packets < samples,
            None => self.source.structure.is_cut,
        };
        let of =
            |total: Option<u64>| total.map_or_else(String::new, |total| format!(" of {total}"));
        if is_cut || counts.read_failed {
            let decoded = self.timeline.frames();
            return Err(DecodeError::undecodable(format!(
                "truncated: {decoded}{} frames decode; re-copy the file",
                of(declared.filter(|&total| total >= u64::from(decoded))),
            )));
        }
        self.check_refused()
    }

    /// Whether the frames that came before the file's end are all that the window can have.
    fn check_window(&self) -> Result<(), DecodeError> {
        let frames = self.timeline.frames();
        let interval = self.timeline.interval().or_else(|| self.nominal_interval());
        let filled = match (self.timeline.last(), interval) {
            (Some(last), Some(interval)) => self.window.is_filled(last, interval),
            (Some(_), None) => true,
            (None, _) => false,
        };
        if filled && !self.counts.read_failed {
            return Ok(());
        }
        Err(DecodeError::undecodable(format!(
            "truncated: the file ends after {frames} frames of the episode; copy the file again, or mend its time in the dataset's meta/episodes",
        )))
    }

    fn check_refused(&self) -> Result<(), DecodeError> {
        let counts = &self.counts;
        let expected = counts.presentable;
        if counts.rejected > 0 && counts.pictures < expected {
            return Err(DecodeError::undecodable(format!(
                "damaged: {} of {expected} frames decode; re-copy the file or re-encode it",
                counts.pictures,
            )));
        }
        Ok(())
    }
}

const NOTHING_DECODES: &str =
    "no frame decodes; the file is damaged, so re-copy it or re-encode it";
