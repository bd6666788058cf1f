//! An open container and what its header says, before any picture is decoded.
//!
//! The demuxer is chosen by [`super::sniff()`] and may open nothing else.

use std::io::{Read, Seek};

use ffmpeg_next::codec::{self, decoder};
use ffmpeg_next::format::context::Input;
use ffmpeg_next::format::stream::{Disposition, Stream};
use ffmpeg_next::{Error, Rational, media};

use super::ffi::{self, StreamHeader};
use super::orient::Orientation;
use super::structure::{self, Structure};
use super::{Container, DecodeError, DecodeLimits, sample_tables, sniff};

impl Container {
    fn demuxer(self) -> &'static std::ffi::CStr {
        match self {
            Self::Mp4 => c"mov",
            Self::Matroska => c"matroska",
            Self::Avi => c"avi",
            Self::Gif => c"gif",
        }
    }
}

fn unread(error: std::io::Error) -> DecodeError {
    DecodeError::undecodable(format!("the file does not read ({error}); copy it again"))
}

/// An open container and its chosen picture track.
pub(super) struct Source {
    pub(super) input: Input,
    pub(super) container: Container,
    pub(super) structure: Structure,
    /// Index of the track.
    pub(super) stream: usize,
    pub(super) header: StreamHeader,
    pub(super) time_base: Rational,
    /// Samples that the container's index promises; none where it has no such count.
    pub(super) declared: Option<u64>,
    pub(super) orientation: Option<Orientation>,
}

impl Source {
    /// Opens a file of which no more is read than its header: whether it is cut is not told.
    pub(super) fn of_unread(
        mut file: impl Read + Seek + Send + 'static,
    ) -> Result<Self, DecodeError> {
        let mut head = Vec::new();
        let mut few = (&mut file).take(sniff::SNIFF_BYTES as u64);
        few.read_to_end(&mut head).map_err(unread)?;
        file.rewind().map_err(unread)?;
        let container = sniff(&head)?;
        Self::open(file, container, structure::of_head(container, &head))
    }

    /// Opens a container of which `structure` is known.
    pub(super) fn open(
        mut bytes: impl Read + Seek + Send + 'static,
        container: Container,
        structure: Structure,
    ) -> Result<Self, DecodeError> {
        if structure.lacks_index {
            return Err(DecodeError::undecodable(
                "the index (moov box) is missing or cut: the recording or the copy stopped early; re-copy the file",
            ));
        }
        if container == Container::Mp4
            && sample_tables::are_overstated(&mut bytes).map_err(unread)?
        {
            return Err(DecodeError::undecodable(
                "its tables claim more pictures than the file has bytes: damaged; re-copy the file",
            ));
        }
        let mut input = ffi::open(bytes, container.demuxer())
            .map_err(|error| DecodeError::undecodable(explain_open(error, container, structure)))?;
        let stream = choose_stream(&input).ok_or(DecodeError::NoVideoStream)?;
        ffi::keep_only(&mut input, stream);
        let (header, time_base, declared, orientation) = {
            let stream = input.stream(stream).ok_or(DecodeError::NoVideoStream)?;
            let header = ffi::stream_header(&stream);
            // A fragmented mp4 declares no samples up front, and AVI's count is often left wrong.
            let declared = (container == Container::Mp4 && stream.frames() > 0)
                .then_some(header.index_entries);
            let orientation = stream
                .side_data()
                .find(|data| data.kind() == codec::packet::side_data::Type::DisplayMatrix)
                .map(|data| Orientation::from_display_matrix(data.data()));
            (header, stream.time_base(), declared, orientation)
        };
        Ok(Self {
            input,
            container,
            structure,
            stream,
            header,
            time_base,
            declared,
            orientation,
        })
    }

    /// Seconds per tick of the track's clock.
    pub(super) fn tick_s(&self) -> f64 {
        f64::from(self.time_base.numerator()) / f64::from(self.time_base.denominator().max(1))
    }

    pub(super) fn check_size(&self, limits: &DecodeLimits) -> Result<(), DecodeError> {
        limits.check_size(self.header.width, self.header.height)
    }

    /// The limits of a whole video, from the header alone.
    pub(super) fn check_header(&self, limits: &DecodeLimits) -> Result<(), DecodeError> {
        self.check_size(limits)?;
        limits.check_frames(self.stated_frames(self.declared).unwrap_or(0))?;
        limits.check_duration(self.header_duration_s().unwrap_or(0.0))
    }

    /// Frames that are to be shown, where the header counts them.
    pub(super) fn header_frames(&self) -> Option<u64> {
        self.stated_frames(self.declared.map(|_| self.header.shown_entries))
    }

    /// Frames, `in_index` where there is one with a count.
    fn stated_frames(&self, in_index: Option<u64>) -> Option<u64> {
        if self.structure.has_placeholders {
            return None;
        }
        let stated = || u64::try_from(self.input.stream(self.stream)?.frames()).ok();
        let frames = self.structure.frames.or(in_index).or_else(stated);
        frames.filter(|&frames| frames > 0)
    }

    pub(super) fn header_duration_s(&self) -> Option<f64> {
        if self.structure.has_placeholders {
            return None;
        }
        let stream_ticks = self.input.stream(self.stream)?.duration();
        if stream_ticks > 0 {
            return Some(stream_ticks as f64 * self.tick_s());
        }
        let whole = self.input.duration();
        (whole > 0).then(|| whole as f64 / f64::from(ffmpeg_next::ffi::AV_TIME_BASE))
    }

    /// Frames per second, where the header states them.
    pub(super) fn header_rate(&self) -> Option<f64> {
        let rate = f64::from(self.input.stream(self.stream)?.avg_frame_rate());
        (rate > 0.0).then_some(rate)
    }

    pub(super) fn decoder(&self, limits: &DecodeLimits) -> Result<decoder::Video, DecodeError> {
        let stream = self
            .input
            .stream(self.stream)
            .ok_or(DecodeError::NoVideoStream)?;
        let parameters = stream.parameters();
        let name = parameters.id().name();
        let failed = |error: Error| {
            if DecodeError::is_out_of_memory(&error) {
                return DecodeError::OutOfMemory;
            }
            DecodeError::undecodable(explain_codec(error, name, self.header.codec_tag))
        };
        let mut context = codec::Context::from_parameters(parameters).map_err(failed)?;
        ffi::constrain_decoder(
            &mut context,
            ALLOCATION_SLACK.saturating_add(limits.max_pixels_per_frame.saturating_mul(2)),
        );
        let mut decoder = context.decoder();
        decoder.set_packet_time_base(self.time_base);
        let decoder = decoder.video().map_err(failed)?;
        // Some codecs state the size in their own header only (MPEG-4), which opening has read.
        limits.check_size(decoder.width().into(), decoder.height().into())?;
        Ok(decoder)
    }
}

/// Codecs allocate whole blocks and borders, so their own bound is looser than the limit (twice, plus this
/// many pixels for tiny pictures); the limit itself is checked on every picture.
const ALLOCATION_SLACK: u64 = 1 << 16;

/// The picture track that players show: the default one, then the largest, then the first; never a cover.
fn choose_stream(input: &Input) -> Option<usize> {
    let rank = |stream: &Stream<'_>| {
        let header = ffi::stream_header(stream);
        let is_default = stream.disposition().contains(Disposition::DEFAULT);
        (
            is_default,
            header.width.saturating_mul(header.height),
            std::cmp::Reverse(stream.index()),
        )
    };
    input
        .streams()
        .filter(|stream| stream.parameters().medium() == media::Type::Video)
        .filter(|stream| !stream.disposition().contains(Disposition::ATTACHED_PIC))
        .max_by_key(rank)
        .map(|stream| stream.index())
}

fn explain_open(error: Error, container: Container, structure: Structure) -> String {
    let name = container.name();
    if structure.is_cut {
        return format!("truncated: the {name} file ends within its header; re-copy the file");
    }
    match error {
        Error::DemuxerNotFound => {
            format!("the installed FFmpeg cannot read {name}; install one built with it")
        }
        Error::Other { errno } if errno == ffmpeg_next::ffi::ENOMEM => {
            format!(
                "the {name} header asks for more memory than there is; the file is damaged, so re-copy it"
            )
        }
        _ => format!("the {name} header is damaged; re-copy the file or re-encode it"),
    }
}

fn explain_codec(error: Error, name: &str, tag: [u8; 4]) -> String {
    let tag: String = tag
        .iter()
        .filter(|byte| byte.is_ascii_graphic())
        .map(|&byte| char::from(byte))
        .collect();
    match error {
        Error::DecoderNotFound => {
            format!(
                "the installed FFmpeg has no decoder for {name} ({tag}); install one or re-encode as H.264"
            )
        }
        _ => format!(
            "the {name} decoder refuses the stream's header; re-copy the file or re-encode it"
        ),
    }
}
