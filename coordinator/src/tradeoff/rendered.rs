//! Rendered clips, whose truth is known: what the user's own videos cannot tell of a point.
//!
//! Two sets, both from the sample's renderer and encoded as videos, so that they pass through everything a
//! user's video passes through: the sample corpus at its own size (clean clips and their faulty twins), and
//! clean scenes at a camera's size. A clip is rendered once per OUT and version.

use std::ops::RangeFrom;
use std::path::Path;

use plumbline_common::id::VideoId;
use plumbline_common::message::Location;
use plumbline_sample::corpus::{ClipSpec, HEIGHT_PX, WIDTH_PX, sample_corpus};
use plumbline_sample::scene::Family;
use plumbline_worker::profile::Profile;

use super::TradeoffError;
use crate::corpus::Entry;
use crate::publish::OutDir;
use crate::run::RunError;
use crate::sample::{WriteSampleError, write_video};

/// How much is rendered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rendering {
    /// Sample corpora (24 clips each) with faults.
    pub corpora: u64,
    /// Scenes of each family for the errors of flow, pose and depth.
    pub scenes: u64,
    /// Columns and rows of the corpora.
    pub corpus_size_px: (usize, usize),
    /// Columns and rows of the scenes.
    pub scene_size_px: (usize, usize),
}

/// A camera's usual size, above what every rung but `accurate` works at.
const SCENE_SIZE_PX: (usize, usize) = (640, 480);
/// Seeds of the scenes; far from the corpora's.
const SCENE_SEEDS: RangeFrom<u64> = 1_000..;

impl Default for Rendering {
    fn default() -> Self {
        Self {
            corpora: 2,
            scenes: 2,
            corpus_size_px: (WIDTH_PX, HEIGHT_PX),
            scene_size_px: SCENE_SIZE_PX,
        }
    }
}

/// A clip, and the video it is in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RenderedClip {
    pub(super) spec: ClipSpec,
    pub(super) entry: Entry,
}

impl Rendering {
    /// Clips with faults, and their clean twins.
    pub(super) fn with_faults(&self) -> Vec<ClipSpec> {
        let corpora = (0..self.corpora).flat_map(|seed| {
            sample_corpus(seed).into_iter().map(move |clip| ClipSpec {
                name: format!("{seed}-{}", clip.name),
                ..clip.with_size(self.corpus_size_px.0, self.corpus_size_px.1)
            })
        });
        corpora.collect()
    }

    /// Clean scenes.
    pub(super) fn scenes(&self) -> Vec<ClipSpec> {
        let families = [
            Family::Pick,
            Family::Push,
            Family::Reach,
            Family::Pan,
            Family::Dolly,
        ];
        let (width, height) = self.scene_size_px;
        let scenes = families.into_iter().flat_map(|family| {
            SCENE_SEEDS
                .take(self.scenes as usize)
                .map(move |seed| ClipSpec {
                    name: format!("{}-{seed}", family.as_str()),
                    ..ClipSpec::clean(family, 0, seed).with_size(width, height)
                })
        });
        scenes.collect()
    }
}

/// Writes the clips that are not there yet.
///
/// # Errors
/// [`TradeoffError`] where a clip cannot be written.
pub(super) fn write(
    specs: Vec<ClipSpec>,
    state: &Path,
) -> Result<Vec<RenderedClip>, TradeoffError> {
    let place = OutDir::create(state.join("rendered").join(env!("CARGO_PKG_VERSION")))?;
    let clip = |spec: ClipSpec| {
        let key = blake3::hash(&serde_json::to_vec(&spec).map_err(RunError::Profile)?);
        let name = format!("{}-{}.mp4", spec.name, &key.to_hex()[..8]);
        let path = place.root().join(&name);
        if !path.exists() {
            write_video(&spec, &path).map_err(TradeoffError::Render)?;
        }
        let entry = entry(&path, &name)?;
        Ok(RenderedClip { spec, entry })
    };
    specs.into_iter().map(clip).collect()
}

fn entry(path: &Path, name: &str) -> Result<Entry, TradeoffError> {
    use std::os::unix::ffi::OsStrExt;
    let io = |source| {
        TradeoffError::Render(WriteSampleError::Io {
            path: path.to_path_buf(),
            source,
        })
    };
    let metadata = path.metadata().map_err(io)?;
    let modified_ns = plumbline_common::file_time::modified_ns(&metadata).map_err(io)?;
    let video = VideoId::new(name).map_err(|error| io(std::io::Error::other(error)))?;
    Ok(Entry {
        video,
        location: Location::File(path.as_os_str().as_bytes().to_vec()),
        bytes: Some(metadata.len()),
        modified_ns: Some(modified_ns),
        problem: None,
        group: None,
        carried: serde_json::Map::new(),
    })
}

/// What a point does with rendered clips does not depend on the user's camera, conditioning frames or limits.
pub(super) fn profile_for(point: &Profile) -> Profile {
    Profile {
        intrinsics: None,
        conditioning_frames: 1,
        ..point.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_are_named_apart_and_written_once() {
        let rendering = Rendering {
            corpora: 2,
            scenes: 1,
            corpus_size_px: (32, 24),
            scene_size_px: (32, 24),
        };
        let specs = [rendering.with_faults(), rendering.scenes()].concat();
        let names: std::collections::BTreeSet<_> = specs.iter().map(|spec| &spec.name).collect();
        assert_eq!((names.len(), specs.len()), (53, 53));
        let state = tempfile::tempdir().unwrap();
        let scenes: Vec<ClipSpec> = rendering
            .scenes()
            .into_iter()
            .take(1)
            .map(|scene| ClipSpec { frames: 3, ..scene })
            .collect();
        let first = write(scenes.clone(), state.path()).unwrap();
        assert_eq!(write(scenes, state.path()).unwrap(), first);
    }
}
