//! All unsafe code of this crate: the few calls into FFmpeg's C libraries that `ffmpeg-next` has no safe
//! form for. Every resource is owned by one of its wrappers (`Input`, `Context`, frames, scalers), which
//! free it on drop, so nothing leaks on an error path.
//!
//! Colour and range tags are read as plain integers: files choose them, and a value outside the C
//! enumeration must not become a Rust `enum`.

use std::ffi::{CStr, c_char, c_int};
use std::io::{Read, Seek};
use std::ptr;
use std::sync::Once;

use ffmpeg_next::format::context::{Input, StreamIo};
use ffmpeg_next::format::stream::Stream;
use ffmpeg_next::packet::Ref;
use ffmpeg_next::software::scaling;
use ffmpeg_next::{Dictionary, Error, Packet, codec, ffi, frame};

/// Streams of one container; a file with more is not a video clip.
const MAX_STREAMS: &str = "64";

/// Silences FFmpeg's own log, once per process: errors are returned, never printed.
pub(crate) fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| ffmpeg_next::log::set_level(ffmpeg_next::log::Level::Quiet));
}

/// FFmpeg asks here before it opens anything but the bytes it was given: always refused.
#[expect(unsafe_code, reason = "C callback type; touches none of its pointers")]
unsafe extern "C" fn refuse_to_open(
    _context: *mut ffi::AVFormatContext,
    _io: *mut *mut ffi::AVIOContext,
    _url: *const c_char,
    _flags: c_int,
    _options: *mut *mut ffi::AVDictionary,
) -> c_int {
    ffi::AVERROR(ffi::EPERM)
}

/// Opens `bytes` with the demuxer of that name and no other, without probing, without any protocol.
///
/// Stream parameters come from the container's header alone: no codec runs here.
#[expect(
    unsafe_code,
    reason = "ffmpeg-next cannot force a demuxer on custom input, nor skip its probing"
)]
pub(super) fn open(
    bytes: impl Read + Seek + Send + 'static,
    demuxer: &CStr,
) -> Result<Input, Error> {
    silence();
    let mut io = StreamIo::from_read_seek(bytes)?;
    let only_this = demuxer.to_str().map_err(|_| Error::DemuxerNotFound)?;
    let options: Dictionary<'_> = [
        ("format_whitelist", only_this),
        ("protocol_whitelist", ""),
        ("max_streams", MAX_STREAMS),
    ]
    .into_iter()
    .collect();
    // SAFETY: `demuxer` is a valid C string for the call; the result is static data or null.
    let format = unsafe { ffi::av_find_input_format(demuxer.as_ptr()) };
    if format.is_null() {
        return Err(Error::DemuxerNotFound);
    }
    // SAFETY: the context is freshly allocated and checked; `io` outlives it (on success the returned
    // `Input` owns it, on failure `avformat_open_input` frees the context and leaves custom I/O alone);
    // the dictionary that the call leaves behind is owned again and freed.
    unsafe {
        let mut context = ffi::avformat_alloc_context();
        if context.is_null() {
            return Err(Error::Other { errno: ffi::ENOMEM });
        }
        (*context).pb = io.as_mut_ptr();
        (*context).flags |= ffi::AVFMT_FLAG_CUSTOM_IO as c_int;
        (*context).io_open = Some(refuse_to_open);
        let mut options = options.disown();
        let status =
            ffi::avformat_open_input(&mut context, ptr::null(), format.cast_mut(), &mut options);
        drop(Dictionary::own(options));
        if status < 0 {
            return Err(Error::from(status));
        }
        Ok(Input::wrap_with_custom_io(context, io))
    }
}

/// What the container's header says of one stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StreamHeader {
    /// Coded size as declared; 0 when the header is silent.
    pub(super) width: u64,
    pub(super) height: u64,
    /// The codec's four-character code in the container.
    pub(super) codec_tag: [u8; 4],
    /// Samples in the container's index: those that a reader will be given.
    pub(super) index_entries: u64,
    /// Width over height of a pixel; 0/x when undeclared.
    pub(super) pixel_aspect: (i32, i32),
}

#[expect(unsafe_code, reason = "these fields have no safe accessor")]
pub(super) fn stream_header(stream: &Stream<'_>) -> StreamHeader {
    // SAFETY: `stream` borrows an open input, so the stream and its codec parameters are live; the index
    // count is a plain read.
    unsafe {
        let raw = stream.as_ptr();
        let parameters = (*raw).codecpar;
        let size = |value: c_int| u64::try_from(value).unwrap_or(0);
        StreamHeader {
            width: size((*parameters).width),
            height: size((*parameters).height),
            codec_tag: (*parameters).codec_tag.to_le_bytes(),
            index_entries: size(ffi::avformat_index_get_entries_count(raw)),
            pixel_aspect: (
                (*raw).sample_aspect_ratio.num,
                (*raw).sample_aspect_ratio.den,
            ),
        }
    }
}

/// Lets the demuxer skip every stream but one (sound, subtitles, covers).
#[expect(
    unsafe_code,
    reason = "the discard flag of a stream has no safe setter"
)]
pub(super) fn keep_only(input: &mut Input, index: usize) {
    let streams = input.nb_streams() as usize;
    // SAFETY: `streams` holds `nb_streams` live stream pointers, and `input` is borrowed mutably.
    unsafe {
        let all = (*input.as_mut_ptr()).streams;
        for other in (0..streams).filter(|&other| other != index) {
            (**all.add(other)).discard = ffi::AVDiscard::AVDISCARD_ALL;
        }
    }
}

/// Whether the container says that the packet is decoded but not shown (an edit list's lead-in).
#[expect(unsafe_code, reason = "the safe flags leave this one out")]
pub(super) fn is_hidden(packet: &Packet) -> bool {
    // SAFETY: reads a plain field of a live packet.
    unsafe { (*packet.as_ptr()).flags & ffi::AV_PKT_FLAG_DISCARD as c_int != 0 }
}

/// One thread, bit-exact transforms, and no picture above `max_pixels` is ever allocated.
#[expect(unsafe_code, reason = "max_pixels has no safe setter")]
pub(super) fn constrain_decoder(decoder: &mut codec::Context, max_pixels: u64) {
    decoder.set_threading(codec::threading::Config::count(1));
    // SAFETY: the context is owned by `decoder` and not opened yet; both are plain fields.
    unsafe {
        let raw = decoder.as_mut_ptr();
        (*raw).flags |= ffi::AV_CODEC_FLAG_BITEXACT as c_int;
        (*raw).max_pixels = i64::try_from(max_pixels).unwrap_or(i64::MAX);
    }
}

/// A frame's colour matrix (`AVColorSpace`) and range (`AVColorRange`) by number, and its pixel shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ColourTags {
    pub(super) matrix: i32,
    pub(super) range: i32,
}

#[expect(
    unsafe_code,
    reason = "the safe accessors would make a Rust enum of a number that the file chose"
)]
pub(super) fn colour_tags(frame: &frame::Video) -> ColourTags {
    // SAFETY: the frame is live; both fields are C enumerations, that is 32-bit integers, read as such.
    unsafe {
        let raw = frame.as_ptr();
        ColourTags {
            matrix: (&raw const (*raw).colorspace).cast::<i32>().read(),
            range: (&raw const (*raw).color_range).cast::<i32>().read(),
        }
    }
}

/// Range of luma and chroma codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Range {
    /// 16–235 (and its 10-bit form).
    Limited,
    /// 0–255.
    Full,
    /// What swscale takes from the pixel format (`yuvj…`, grey and RGB are full).
    OfFormat,
}

/// Sets the YCbCr matrix (`SWS_CS_*`) on both sides; `range` is that of the YCbCr side, of `source` or target.
#[expect(unsafe_code, reason = "swscale's colour details have no safe form")]
pub(crate) fn set_colour(
    scaler: &mut scaling::Context,
    matrix: i32,
    source: Range,
    target: Range,
) -> Result<(), Error> {
    // SAFETY: the scaler is live; the tables that are read and set are static data of swscale (or the
    // scaler's own), and every out-pointer is a local that outlives the call.
    unsafe {
        let raw = scaler.as_mut_ptr();
        let (mut source_table, mut target_table) = (ptr::null_mut(), ptr::null_mut());
        let (mut source_full, mut target_full, mut brightness, mut contrast, mut saturation) =
            (0, 0, 0, 0, 0);
        let status = ffi::sws_getColorspaceDetails(
            raw,
            &mut source_table,
            &mut source_full,
            &mut target_table,
            &mut target_full,
            &mut brightness,
            &mut contrast,
            &mut saturation,
        );
        // RGB to RGB has no colour details: nothing to set.
        if status < 0 {
            return Ok(());
        }
        let table = ffi::sws_getCoefficients(matrix);
        let full = |range: Range, of_format: c_int| match range {
            Range::Limited => 0,
            Range::Full => 1,
            Range::OfFormat => of_format,
        };
        let status = ffi::sws_setColorspaceDetails(
            raw,
            table,
            full(source, source_full),
            table,
            full(target, target_full),
            brightness,
            contrast,
            saturation,
        );
        if status < 0 {
            Err(Error::from(status))
        } else {
            Ok(())
        }
    }
}

/// A picture with memory of its own.
#[expect(
    unsafe_code,
    reason = "the safe constructor ignores a failed allocation"
)]
pub(crate) fn allocate(
    format: ffmpeg_next::format::Pixel,
    width: u32,
    height: u32,
) -> Result<frame::Video, Error> {
    let picture = frame::Video::new(format, width, height);
    // SAFETY: only checks whether the frame holds a buffer.
    if unsafe { picture.is_empty() } {
        return Err(Error::Other { errno: ffi::ENOMEM });
    }
    Ok(picture)
}

/// Converts a whole picture; unlike the safe form it reports swscale's failures.
#[expect(unsafe_code, reason = "the safe form ignores swscale's status")]
pub(crate) fn scale(
    scaler: &mut scaling::Context,
    source: &frame::Video,
    target: &mut frame::Video,
) -> Result<(), Error> {
    let agrees = |definition: &scaling::context::Definition, picture: &frame::Video| {
        definition.format == picture.format()
            && definition.width == picture.width()
            && definition.height == picture.height()
    };
    if !agrees(scaler.input(), source) {
        return Err(Error::InputChanged);
    }
    if !agrees(scaler.output(), target) {
        return Err(Error::OutputChanged);
    }
    // SAFETY: both frames are live, hold buffers of the very sizes and formats the scaler was made for
    // (checked above), and do not overlap; `target` is borrowed mutably.
    let rows = unsafe {
        let (source, target) = (source.as_ptr(), target.as_mut_ptr());
        ffi::sws_scale(
            scaler.as_mut_ptr(),
            (*source).data.as_ptr().cast(),
            (*source).linesize.as_ptr(),
            0,
            (*source).height,
            (*target).data.as_ptr(),
            (*target).linesize.as_ptr(),
        )
    };
    if i64::from(rows) == i64::from(target.height()) {
        Ok(())
    } else {
        Err(Error::InvalidData)
    }
}
