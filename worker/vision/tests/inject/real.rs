//! Real clips of static cameras from `../shared/data`, decoded by the `ffmpeg` command.

use std::path::{Path, PathBuf};
use std::process::Command;

use plumbline_vision::image::{Rgb8, resize_rgb};

/// Frames of a clip, from its middle, as in the evidence.
pub(crate) const FRAMES: usize = 26;
/// Height of the pictures that faults are injected into, pixels.
pub(crate) const HEIGHT_PX: usize = 256;

/// Real clips but those of wrist cameras, in order of their names; `None` without `../shared` beside
/// the repository or without ffmpeg.
pub(crate) fn static_clips() -> Option<Vec<PathBuf>> {
    Command::new("ffmpeg").arg("-version").output().ok()?;
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|folder| folder.join("shared/data/rollouts/real"))
        .find(|folder| folder.is_dir())?;
    let mut clips: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| !path.to_string_lossy().contains("wrist"))
        .collect();
    clips.sort();
    Some(clips)
}

/// Recorded clips that are not clean themselves, seen in their frames, and why: no threshold is fitted on
/// them.
pub(crate) const NOT_CLEAN: [(&str, &str); 2] = [
    (
        "worldgymnast__close_drawer__real.mp4",
        "frames were lost: the arm leaps in one frame, two frames repeat",
    ),
    (
        "worldeval__bussing_table_fail__brown_bowl_dex_real_13.mp4",
        "sped up: a hand and the bin come and go within two frames",
    ),
];

/// Whether a clip is not in [`NOT_CLEAN`].
pub(crate) fn is_clean(path: &Path) -> bool {
    let name = path.file_name().unwrap().to_string_lossy();
    NOT_CLEAN.iter().all(|&(dirty, _)| name != dirty)
}

/// FNV-1a of a clip's file name: which half it belongs to and the seed of its injections, whatever other
/// clips there are.
pub(crate) fn name_hash(path: &Path) -> u64 {
    let name = path.file_name().unwrap().to_string_lossy();
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The two halves of the clips: everything is chosen and fitted on the first, the table is of the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Half {
    Fit,
    HeldOut,
}

impl Half {
    /// By a bit of the name's hash: the top one, since the low bits of FNV-1a follow the last letters.
    pub(crate) fn of(path: &Path) -> Self {
        if name_hash(path) >> 63 == 0 {
            Self::Fit
        } else {
            Self::HeldOut
        }
    }
}

/// The middle [`FRAMES`] frames, [`HEIGHT_PX`] high; `None` of a shorter clip.
pub(crate) fn load(path: &Path) -> Option<Vec<Rgb8>> {
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-threads", "1", "-i"])
        .arg(path)
        .args([
            "-fps_mode",
            "passthrough",
            "-f",
            "image2pipe",
            "-c:v",
            "ppm",
            "-",
        ])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{path:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let (mut rest, mut frames) = (output.stdout.as_slice(), Vec::new());
    while !rest.is_empty() {
        let (frame, after) = ppm(rest);
        frames.push(frame);
        rest = after;
    }
    let first = frames.len().checked_sub(FRAMES)? / 2;
    let resized = frames[first..first + FRAMES].iter().map(|frame| {
        let width = (frame.width * HEIGHT_PX + frame.height / 2) / frame.height;
        resize_rgb(frame, width, HEIGHT_PX)
    });
    Some(resized.collect())
}

/// The first picture of a PPM stream ("P6", width, height, 255, each followed by one white space) and
/// what follows it.
fn ppm(bytes: &[u8]) -> (Rgb8, &[u8]) {
    let mut rest = bytes;
    let mut word = || {
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap();
        let word = std::str::from_utf8(&rest[..end]).unwrap();
        rest = &rest[end + 1..];
        word
    };
    assert_eq!(word(), "P6");
    let (width, height): (usize, usize) = (word().parse().unwrap(), word().parse().unwrap());
    assert_eq!(word(), "255");
    let (pixels, after) = rest.split_at(width * height * 3);
    (Rgb8::new(width, height, pixels.to_vec()).unwrap(), after)
}
