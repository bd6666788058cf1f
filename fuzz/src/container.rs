//! Videos and pictures: sniffing, structure, headers, and the first frames.

use std::ops::ControlFlow;

use plumbline_worker::decode::{self, DecodeLimits};

/// Small, so that most of the time goes into headers rather than into pictures.
const LIMITS: DecodeLimits = DecodeLimits {
    max_bytes: 1 << 20,
    max_pixels_per_frame: 256 * 256,
    max_frames: 16,
    max_duration_s: 60.0,
};

pub(crate) fn target(bytes: &[u8]) {
    let mut frames = 0;
    let mut last_s = f64::NEG_INFINITY;
    let decoded = decode::decode_video(bytes.into(), &LIMITS, &mut |frame| {
        assert_eq!(frame.index, frames);
        assert!(frame.time_s.is_finite() && frame.time_s > last_s);
        assert_eq!(frame.rgb.data.len(), frame.rgb.width * frame.rgb.height * 3);
        last_s = frame.time_s;
        frames += 1;
        match frames {
            4 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    });
    if let Ok(info) = decoded {
        assert_eq!(info.frames, frames);
        assert!(u64::from(info.width) * u64::from(info.height) <= LIMITS.max_pixels_per_frame);
    }
    let path = crate::as_file("0001.png", bytes);
    if let Ok(picture) = decode::decode_image(&path, &LIMITS) {
        assert_eq!(picture.data.len(), picture.width * picture.height * 3);
    }
}
