//! What is measured becomes what is published.

use std::collections::HashMap;
use std::sync::Arc;

use plumbline_common::id::VideoId;

use super::{Journals, RunError, STATE_DIRECTORY, ScoreOptions};
use crate::cascade::record::CascadeRecord;
use crate::corpus::Entry;
use crate::heat_maps::{self, HeatMaps};
use crate::publish::{self, CorpusFile, CostRow, OutDir, ProfileRecord, Publication};
use crate::reduce::Reduced;
use crate::reduce::reference::Reference;
use crate::report::beside;
use crate::report::player::Viewpoint;
use crate::report::state::ReportState;
use crate::report::{self, CostSummary, DEFAULT_RANKED, ReportInput};

/// What is published.
pub(crate) struct Published {
    pub(crate) reduced: Reduced,
    pub(crate) cascade: Option<CascadeRecord>,
    pub(crate) files: Vec<String>,
}

/// Reduces what is measured, draws heat maps where asked, and publishes.
pub(crate) async fn finish(
    options: &ScoreOptions,
    entries: Arc<Vec<Entry>>,
    measured: Journals,
    out: OutDir,
) -> Result<Published, RunError> {
    let reduce_options = options.reduce.clone();
    let reducing = tokio::task::spawn_blocking(move || -> Result<_, RunError> {
        let (reduced, costs) = measured.reduce(&entries, &reduce_options)?;
        Ok((entries, measured, costs, reduced))
    });
    let (entries, measured, costs, reduced) = reducing.await.map_err(RunError::Finishing)??;
    let profile = &options.profile;
    let (most, slots) = (options.heat_maps, &options.slots);
    let heat_maps = heat_maps::draw(most, &reduced.rows, &entries, profile, slots, &out).await?;
    let options = options.clone();
    let publishing = tokio::task::spawn_blocking(move || -> Result<_, RunError> {
        let mut files = publish_run(
            &options, &out, &entries, &measured, &costs, &reduced, &heat_maps,
        )?;
        files.extend(heat_maps.into_values());
        Ok(Published {
            cascade: measured.record().cloned(),
            reduced,
            files,
        })
    });
    publishing.await.map_err(RunError::Finishing)?
}

fn publish_run(
    options: &ScoreOptions,
    out: &OutDir,
    entries: &[Entry],
    measured: &Journals,
    costs: &[CostRow],
    reduced: &Reduced,
    heat_maps: &HeatMaps,
) -> Result<Vec<String>, RunError> {
    let parameters = serde_json::to_value(&options.profile).map_err(RunError::Profile)?;
    let corpus = CorpusFile {
        plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
        source: options.sources.clone(),
        profile: Some(ProfileRecord {
            name: Some(options.profile.name()),
            digest: options.reduce.profile_digest.clone(),
            parameters,
        }),
        conditioning_frames: Some(options.profile.conditioning_frames),
        fault_calibration: options.fault_calibration.clone(),
        cascade: measured.record().cloned(),
        statistics: reduced.statistics.clone(),
    };
    let locations: Vec<String> = entries.iter().map(Entry::address).collect();
    let thumbnails = |video: &VideoId| measured.thumbnails(video);
    let state = ReportState {
        options: options.told(),
        reference: options
            .reduce
            .reference
            .as_deref()
            .map(Reference::frozen)
            .cloned(),
    };
    state.write(&OutDir::create(out.root().join(STATE_DIRECTORY))?)?;
    let (beside, mut files) = beside::write(out, &reduced.rows, &thumbnails)?;
    let entry_of: HashMap<&VideoId, &Entry> =
        entries.iter().map(|entry| (&entry.video, entry)).collect();
    let viewpoint = Viewpoint::of(&options.out.to_string_lossy());
    let report = report::render(&ReportInput {
        title: &options.sources.join(", "),
        corpus: &corpus,
        rows: &reduced.rows,
        thumbnails: &thumbnails,
        heat_maps,
        beside: &beside,
        player: &|video| viewpoint.address(&entry_of.get(video)?.location),
        reference: state.reference.as_ref(),
        costs: Some(CostSummary::of(costs)),
        options: &state.options,
        ranked: DEFAULT_RANKED,
    });
    let publication = Publication {
        rows: &reduced.rows,
        locations: &locations,
        costs,
        rewards: &reduced.rewards,
        report_html: Some(&report),
        corpus: &corpus,
    };
    files.extend(publish::publish(out, &publication, &options.formats)?);
    Ok(files)
}
