//! The networks of one compute child: loaded when a job first needs them, kept for the next.

use plumbline_vision::learned::droid::DroidNetworks;
use plumbline_vision::learned::sea_raft::SeaRaft;

use super::model_set::{ModelError, ModelSet};
use super::runtime::{Runtime, RuntimeError};
use super::session::Threads;
use super::source::ModelPlaces;
use crate::profile::Profile;

/// Networks are not to be had.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LoadError {
    /// Nobody said where they are.
    #[error("the profile names no model sets, or they were not brought here; report this defect")]
    NoPlaces,
    /// The library.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A set.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A set is another than the job names.
    #[error("the model set at {place} has the digest {found}, not {wanted}")]
    Another {
        /// Where it lies.
        place: String,
        /// Its digest.
        found: String,
        /// The job's.
        wanted: String,
    },
}

/// What a child has loaded; one set of either network at a time.
#[derive(Default)]
pub struct Loaded {
    sea_raft: Option<LoadedSeaRaft>,
    droid: Option<(String, DroidNetworks)>,
}

/// SEA-RAFT as a child keeps it.
pub struct LoadedSeaRaft {
    digest: String,
    /// Set up as the profile of the clip wants it.
    pub network: SeaRaft,
    /// Of the weights' size.
    iterations: usize,
}

/// What one clip is measured with: taken and put back; what is not put back is loaded anew for the next clip.
#[derive(Default)]
pub struct Networks<'a> {
    /// Flow.
    pub sea_raft: Option<&'a mut Option<LoadedSeaRaft>>,
    /// Tracking.
    pub droid: Option<&'a mut Option<(String, DroidNetworks)>>,
}

impl Loaded {
    /// The networks of a profile, used as it says; none for a classical one.
    ///
    /// # Errors
    /// [`LoadError`].
    pub fn networks(
        &mut self,
        profile: &Profile,
        places: Option<&ModelPlaces>,
    ) -> Result<Networks<'_>, LoadError> {
        let mut networks = Networks::default();
        if !profile.is_learned() {
            return Ok(networks);
        }
        let places = places.ok_or(LoadError::NoPlaces)?;
        let runtime = Runtime::load(&places.runtime)?;
        if let Some(used) = &profile.sea_raft {
            let digest = used.model.as_deref().ok_or(LoadError::NoPlaces)?;
            let kept = self.sea_raft.take().filter(|kept| kept.digest == digest);
            let kept = match kept {
                Some(kept) => kept,
                None => {
                    let set = set(places.sea_raft.as_deref(), digest)?;
                    let network = set.sea_raft(runtime, Threads::ONE)?;
                    LoadedSeaRaft {
                        digest: digest.to_owned(),
                        iterations: network.params().iterations,
                        network,
                    }
                }
            };
            let home = &mut self.sea_raft;
            let kept = home.insert(kept);
            let params = kept.network.params_mut();
            params.half_resolution = used.half_resolution;
            params.iterations = used.iterations.map_or(kept.iterations, |n| n as usize);
            params.stop_below_px = used.stop_below_px.map(|px| px as f32);
            networks.sea_raft = Some(home);
        }
        if let Some(used) = &profile.droid {
            let digest = used.model.as_deref().ok_or(LoadError::NoPlaces)?;
            self.droid = self.droid.take().filter(|(known, _)| known == digest);
            if self.droid.is_none() {
                let set = set(places.droid.as_deref(), digest)?;
                self.droid = Some((digest.to_owned(), set.droid(runtime, Threads::ONE)?));
            }
            networks.droid = Some(&mut self.droid);
        }
        Ok(networks)
    }
}

fn set(directory: Option<&std::path::Path>, digest: &str) -> Result<ModelSet, LoadError> {
    let set = ModelSet::read(directory.ok_or(LoadError::NoPlaces)?)?;
    if set.digest() == digest {
        return Ok(set);
    }
    Err(LoadError::Another {
        place: set.directory().display().to_string(),
        found: set.digest().to_owned(),
        wanted: digest.to_owned(),
    })
}
