//! What a point sees of faults that are known: rendered clips, each clean and with a fault.
//!
//! For each kind of fault the detector that is meant for it: how well the largest score of a clip tells
//! faulty clips from clean ones (area under the ROC curve; a clip that the detector cannot judge counts as
//! 0), and how often that score lies on the fault's frames or beside them (temporal hit). No threshold is
//! involved, so that points without calibrated ones compare.

use std::collections::{BTreeMap, HashMap};

use plumbline_common::id::VideoId;
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::fault::{FAULT_KINDS, FaultKind as Injected, FaultTruth};
use plumbline_vision::faults::{FaultKind, FaultPoint};
use plumbline_worker::profile::Profile;
use serde::{Deserialize, Serialize};

use super::rendered::{RenderedClip, profile_for};
use super::{TradeoffError, TradeoffOptions};
use crate::fanout::{Detail, Fanout};
use crate::measuring;
use crate::reduce::auroc::auroc;
use crate::run::RunError;

/// What was found of one kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct KindFound {
    /// Clips with the fault.
    pub clips: usize,
    /// Area under the ROC curve against the clean clips.
    pub auroc: f64,
    /// Share of them whose largest score is within a frame of the fault.
    pub temporal_hit: f64,
}

/// What a point found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FaultsFound {
    /// By the fault's name.
    pub kinds: BTreeMap<String, KindFound>,
    /// Mean AUROC over the kinds that a detector is meant for.
    pub auroc: Option<f64>,
    /// Mean temporal hit over them.
    pub temporal_hit: Option<f64>,
}

/// The detector meant for a fault. None finds morphs (`plumbline_vision::faults`); the nearest is held
/// against them, and they are left out of the means.
fn detector(kind: Injected) -> FaultKind {
    match kind {
        Injected::NoiseFrame | Injected::BlurFrame => FaultKind::BadFrame,
        Injected::Vanish => FaultKind::Vanish,
        Injected::Appear | Injected::Morph => FaultKind::Appear,
        Injected::Flicker => FaultKind::Flicker,
        Injected::Freeze => FaultKind::Freeze,
        Injected::Teleport => FaultKind::Jump,
    }
}

/// A clip's largest score of each kind.
type Largest = [Option<FaultPoint>; FaultKind::ALL.len()];

/// Measures the clips at a point.
///
/// # Errors
/// [`TradeoffError`].
pub(super) async fn find(
    clips: &[RenderedClip],
    profile: &Profile,
    options: &TradeoffOptions,
) -> Result<FaultsFound, TradeoffError> {
    let profile = profile_for(profile);
    let mut jobs = Vec::new();
    for clip in clips {
        let job = measuring::job(&clip.entry, &profile).map_err(RunError::Profile)?;
        jobs.extend(job.map(Detail));
    }
    let mut largest: HashMap<VideoId, Largest> = HashMap::new();
    let mut slots = Fanout::start(jobs, &options.slots);
    while let Some(detailed) = slots.next().await {
        let detailed = detailed.map_err(RunError::Slot)?;
        let scores = FaultKind::ALL.map(|kind| detailed.faults.largest(kind));
        largest.insert(detailed.outcome.video, scores);
    }
    let mut judged = Vec::new();
    for clip in clips {
        let scores = largest.get(&clip.entry.video).copied();
        judged.push(Judged {
            truth: truth(&clip.spec)?,
            largest: scores.unwrap_or_default(),
        });
    }
    Ok(rate(&judged))
}

fn truth(spec: &ClipSpec) -> Result<Option<FaultTruth>, TradeoffError> {
    Ok(spec.fault_truth()?)
}

/// A clip, what is wrong with it, and what was found.
struct Judged {
    truth: Option<FaultTruth>,
    largest: Largest,
}

impl Judged {
    fn score(&self, detector: FaultKind) -> f64 {
        self.largest[detector as usize].map_or(0.0, |point| point.score)
    }
}

fn rate(clips: &[Judged]) -> FaultsFound {
    let clean: Vec<&Judged> = clips.iter().filter(|clip| clip.truth.is_none()).collect();
    let mut kinds = BTreeMap::new();
    let (mut areas, mut hits) = (Vec::new(), Vec::new());
    for kind in FAULT_KINDS {
        let detector = detector(kind);
        let faulty: Vec<(&Judged, &FaultTruth)> = clips
            .iter()
            .filter_map(|clip| Some((clip, clip.truth.as_ref()?)))
            .filter(|(_, truth)| truth.kind == kind)
            .collect();
        let scores: Vec<f64> = faulty
            .iter()
            .map(|(clip, _)| clip.score(detector))
            .collect();
        let others: Vec<f64> = clean.iter().map(|clip| clip.score(detector)).collect();
        let Some(found) = auroc(&scores, &others, [0; 32]) else {
            continue;
        };
        let hit = |(clip, truth): &&(&Judged, &FaultTruth)| {
            let near = truth.first_frame.saturating_sub(1)..=truth.last_frame + 1;
            clip.largest[detector as usize].is_some_and(|point| near.contains(&point.frame))
        };
        let found = KindFound {
            clips: faulty.len(),
            auroc: found.area,
            temporal_hit: faulty.iter().filter(hit).count() as f64 / faulty.len() as f64,
        };
        kinds.insert(kind.as_str().to_owned(), found);
        if kind != Injected::Morph {
            areas.push(found.auroc);
            hits.push(found.temporal_hit);
        }
    }
    let mean = |of: &[f64]| (!of.is_empty()).then(|| of.iter().sum::<f64>() / of.len() as f64);
    FaultsFound {
        kinds,
        auroc: mean(&areas),
        temporal_hit: mean(&hits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(kind: Option<Injected>, of: FaultKind, score: f64, frame: usize) -> Judged {
        let mut largest = Largest::default();
        largest[of as usize] = Some(FaultPoint {
            frame,
            score,
            place: None,
        });
        let truth = kind.map(|kind| FaultTruth {
            kind,
            first_frame: 10,
            last_frame: 10,
            last_changed_frame: 10,
            bbox_px: [0, 0, 1, 1],
            mask_pixels: 1,
        });
        Judged { truth, largest }
    }

    #[test]
    fn areas_and_hits_by_hand() {
        use FaultKind::{BadFrame, Jump};
        let clips = [
            judged(None, Jump, 0.1, 3),
            judged(None, Jump, 0.3, 3),
            // Above one of two clean clips, and beside the fault.
            judged(Some(Injected::Teleport), Jump, 0.2, 11),
            // Above both, at another place of time.
            judged(Some(Injected::Teleport), Jump, 0.4, 13),
            // Not judged by its detector: 0, as are the clean ones.
            judged(Some(Injected::BlurFrame), Jump, 9.0, 10),
            judged(Some(Injected::Morph), BadFrame, 9.0, 10),
        ];
        let found = rate(&clips);
        let teleport = found.kinds["teleport"];
        assert_eq!(
            (teleport.clips, teleport.auroc, teleport.temporal_hit),
            (2, 0.75, 0.5)
        );
        let blur = found.kinds["blur_frame"];
        assert_eq!((blur.auroc, blur.temporal_hit), (0.5, 0.0));
        assert_eq!(found.kinds.len(), 3);
        assert_eq!(found.auroc, Some(0.625));
        assert_eq!(rate(&clips[..2]).auroc, None);
    }
}
