//! How well the flip model does, on videos that it was not fitted to.
//!
//! The sample is known at every rung. A fifth of it at a time is judged as if its dearer measurements had
//! not been made, by residuals of all other known videos: whoever is less certain than the least certain
//! row of the run would have moved up, the others keep the decision of their rung, which is the top's or
//! not.

use plumbline_common::row::{Decision, Status};
use serde::{Deserialize, Serialize};

use super::flip::{Residuals, decide};
use super::{Assessment, Video, anomaly};
use crate::reduce::ReduceOptions;

/// Parts that the sample is judged in.
const FOLDS: usize = 5;

/// Agreement with the top rung that was measured.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crossed {
    /// Videos of the sample that were judged.
    pub videos: u64,
    /// Those whose decision would have been the top's.
    pub agreed: u64,
}

/// Judges the sample by a finished assessment.
#[must_use]
pub fn crossed(
    videos: &[Video],
    sample: &[usize],
    assessment: &Assessment,
    options: &ReduceOptions,
) -> Crossed {
    let top = assessment.calibrations.len().saturating_sub(1);
    let calibrations = &assessment.calibrations;
    let anomaly = |video: &Video, rung: usize| anomaly(video, rung, calibrations, options);
    let judged = assessment.judged.iter().flatten();
    let stayed = judged.filter(|judged| judged.rung < top);
    let least_certain = stayed.map(|judged| judged.flip).fold(0.0, f64::max);
    let placed: Vec<_> = assessment
        .judged
        .iter()
        .map(|judged| judged.map(|judged| (judged.rung, judged.anomaly)))
        .collect();
    let cuts = decide(videos, &placed, options).cuts;

    let mut found = Crossed::default();
    for fold in 0..FOLDS {
        let members: Vec<usize> = sample.iter().copied().skip(fold).step_by(FOLDS).collect();
        let others = || {
            let others = videos.iter().enumerate();
            others
                .filter(|(index, _)| !members.contains(index))
                .map(|(_, video)| video)
        };
        let residuals: Vec<Residuals> = (0..top)
            .map(|rung| Residuals::of(others(), rung, top, &anomaly))
            .collect();
        for &index in &members {
            let (Some(video), Some(Some(at_top))) =
                (videos.get(index), assessment.judged.get(index))
            else {
                continue;
            };
            if at_top.rung != top {
                continue;
            }
            let cut = cuts.cut(&video.group.as_deref(), &options.keep);
            let stays = residuals.iter().enumerate().find_map(|(rung, residuals)| {
                let seen = video.at(rung)?;
                let anomaly = anomaly(video, rung);
                let decision = match (seen.status, anomaly, cut) {
                    (Status::Scored, Some(anomaly), Some(cut)) if anomaly <= cut => Decision::Keep,
                    (Status::Scored, Some(_), Some(_)) => Decision::Drop,
                    // All of the group has one decision.
                    (Status::Scored, Some(_), None) => at_top.decision,
                    _ => Decision::Review,
                };
                let flip = residuals.flip(seen.status, anomaly, decision, cut);
                (flip <= least_certain).then_some(decision)
            });
            found.videos += 1;
            found.agreed += u64::from(stays.is_none_or(|decision| decision == at_top.decision));
        }
    }
    found
}
