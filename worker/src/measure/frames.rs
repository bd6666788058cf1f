//! Frames of a video as pictures, spread evenly over it: what a judge that looks at pictures is shown.
//!
//! The video is decoded twice, first to count its frames, so that memory holds a few small pictures
//! whatever its length.

use std::ops::ControlFlow;
use std::path::Path;

use plumbline_common::message::Job;
use plumbline_vision::image::resize_rgb;
use serde::{Deserialize, Serialize};

use super::MeasureError;
use super::read::{Input, ReadError};
use super::thumbnail::jpeg;
use crate::decode::DecodeError;
use crate::profile::Profile;

/// Which pictures of which video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FramesJob {
    /// The video.
    pub job: Job,
    /// How many frames, the first and the last among them; all where the video has fewer.
    pub frames: u32,
    /// Larger pictures are scaled down to this many pixels on their longer side.
    pub max_side_px: u32,
}

/// The pictures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampledFrames {
    /// BLAKE3 of the video's bytes, hex.
    pub digest: String,
    /// Frames of the video.
    pub of: u32,
    /// In the order of time.
    pub frames: Vec<SampledFrame>,
}

/// One picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampledFrame {
    /// Its frame.
    pub index: u32,
    /// JPEG.
    #[serde(with = "serde_bytes")]
    pub jpeg: Vec<u8>,
}

/// Samples a video, an object by its copy on this machine; a text says why there are no pictures.
///
/// # Errors
/// [`MeasureError`], when the job is wrong.
pub(crate) fn sample(
    request: &FramesJob,
    copy: Option<&Path>,
) -> Result<Result<SampledFrames, String>, MeasureError> {
    let profile: Profile = serde_json::from_slice(&request.job.profile)?;
    let sampled = Input::open(&request.job, copy, &profile.limits)
        .and_then(|input| sample_input(request, &input, &profile));
    Ok(sampled.map_err(|error: ReadError| error.to_string()))
}

fn sample_input(
    request: &FramesJob,
    input: &Input,
    profile: &Profile,
) -> Result<SampledFrames, ReadError> {
    let of = input
        .decode(profile, &mut |_| ControlFlow::Continue(()))?
        .frames;
    let wanted = evenly(request.frames, of);
    let (mut frames, mut failure) = (Vec::new(), None);
    input.decode(profile, &mut |frame| {
        if wanted.contains(&frame.index) {
            let (width, height) = (frame.rgb.width, frame.rgb.height);
            let longer = width.max(height).max(1);
            let side = (request.max_side_px as usize).clamp(1, longer);
            let scaled = |length: usize| (length * side).div_ceil(longer).max(1);
            let (width, height) = (scaled(width), scaled(height));
            let small = resize_rgb(&frame.rgb, width, height);
            match jpeg(&small.data, width, height) {
                Ok(jpeg) => frames.push(SampledFrame {
                    index: frame.index,
                    jpeg,
                }),
                Err(error) => {
                    failure = Some(error);
                    return ControlFlow::Break(());
                }
            }
        }
        if wanted.last() == Some(&frame.index) {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    })?;
    if let Some(error) = failure {
        return Err(ReadError::Decode(DecodeError::Undecodable {
            reason: format!("a frame does not encode as JPEG ({error})"),
        }));
    }
    Ok(SampledFrames {
        digest: input.digest.clone(),
        of,
        frames,
    })
}

/// `k` of `n` frames, ascending, the first and the last among them; the middle one for k = 1.
fn evenly(k: u32, n: u32) -> Vec<u32> {
    let (k, last) = (k.min(n), n.saturating_sub(1));
    match k {
        0 => Vec::new(),
        1 => vec![last / 2],
        // Rounded to the nearest; distinct, since steps are at least 1.
        _ => (0..k)
            .map(|i| {
                ((u64::from(i) * u64::from(last) * 2 + u64::from(k - 1)) / (2 * u64::from(k - 1)))
                    as u32
            })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_evenly() {
        assert_eq!(evenly(3, 11), [0, 5, 10]);
        assert_eq!(evenly(4, 11), [0, 3, 7, 10]);
        assert_eq!(evenly(8, 3), [0, 1, 2]);
        assert_eq!((evenly(1, 11), evenly(1, 1)), (vec![5], vec![0]));
        assert!(evenly(3, 0).is_empty() && evenly(0, 3).is_empty());
        for n in 1..40 {
            for k in 1..=n {
                let found = evenly(k, n);
                assert!(found.windows(2).all(|w| w[0] < w[1]) && found.len() == k as usize);
            }
        }
    }
}
