//! What rendered clips say of a point: they are the same for every corpus, and what was found is kept.

use std::sync::Arc;

use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::scene::Family;
use serde::{Deserialize, Serialize};

use super::injected::{self, FaultsFound};
use super::rendered::{self, RenderedClip, Rendering};
use super::truth::{self, FlowPair, TruthErrors};
use super::{GridPoint, TradeoffError, TradeoffOptions, measure};
use crate::progress::say;
use crate::publish::OutDir;
use crate::run::RunError;

/// What rendered clips say of a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Known {
    pub(super) truth: TruthErrors,
    pub(super) faults: FaultsFound,
}

/// Rendered clips and pairs.
pub(super) struct Rendered {
    pub(super) with_faults: Vec<RenderedClip>,
    /// Scenes with a travelling camera.
    pub(super) travelling: Vec<RenderedClip>,
    /// Pairs of pictures of all scenes.
    pub(super) pairs: Vec<FlowPair>,
    /// Of all specifications.
    digest: String,
}

/// Renders what is not there yet.
///
/// # Errors
/// [`TradeoffError`].
pub(super) async fn render(
    rendering: &Rendering,
    state: &OutDir,
) -> Result<Rendered, TradeoffError> {
    say("rendering clips whose truth is known");
    let (rendering, root) = (*rendering, state.root().to_path_buf());
    tokio::task::spawn_blocking(move || {
        let (with_faults, scenes) = (rendering.with_faults(), rendering.scenes());
        let specs = serde_json::to_vec(&(&with_faults, &scenes)).map_err(RunError::Profile)?;
        Ok(Rendered {
            pairs: truth::flow_pairs(&scenes)?,
            with_faults: rendered::write(with_faults, &root)?,
            travelling: rendered::write(travelling(scenes), &root)?,
            digest: blake3::hash(&specs).to_hex().to_string(),
        })
    })
    .await?
}

/// The scenes that are tracked; of the others only some pictures are looked at.
fn travelling(mut scenes: Vec<ClipSpec>) -> Vec<ClipSpec> {
    scenes.retain(|scene| scene.family == Family::Dolly);
    scenes
}

/// What rendered clips say of a point: taken over from an earlier run, or found and kept.
///
/// # Errors
/// [`TradeoffError`].
pub(super) async fn known(
    point: &GridPoint,
    rendered: &Arc<Rendered>,
    options: &TradeoffOptions,
    state: &OutDir,
) -> Result<Known, TradeoffError> {
    let profile = rendered::profile_for(&point.profile);
    let digest = profile.digest().map_err(RunError::Profile)?;
    let name = format!(
        "known/{}-{}-{}.json",
        env!("CARGO_PKG_VERSION"),
        measure::short(&rendered.digest),
        measure::short(&digest)
    );
    if options.resume {
        let kept = std::fs::read(state.root().join(&name)).ok();
        if let Some(known) = kept.and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
            return Ok(known);
        }
    }
    say(&format!("{}: clips whose truth is known", point.name));
    let known = Known {
        truth: truth::errors(rendered, &profile, options).await?,
        faults: injected::find(&rendered.with_faults, &profile, options).await?,
    };
    let bytes = serde_json::to_vec(&known).map_err(RunError::Profile)?;
    state.put_atomic(&name, &bytes)?;
    Ok(known)
}
