//! The cascade: everything at the cheapest rung of a ladder of profiles, and only videos whose keep/drop
//! decision is uncertain at dearer ones (design section 6).
//!
//! Pure: in go measurements, out comes what to measure next ([`next`]) or what is known ([`assess`]). The
//! run asks again after each wave: a wave depends on the waves before it alone (and on their costs, where the goal is
//! a budget in seconds), so that a run that was killed, or another order of answers, comes to the same. A seeded sample of the corpus is measured at every rung; from it come
//! - the calibration of each rung ([`calibration`]), against which its rows alone are scored,
//! - what a decision is worth before the top has been asked ([`flip`]), and what the calibration's own
//!   error makes of it ([`resample`]),
//! - and how well all that does, on videos that it was not fitted to ([`crossed`]).

pub mod budget;
pub mod calibration;
pub mod crossed;
pub mod flip;
pub mod goal;
pub mod record;
pub mod resample;
pub mod sample;
#[cfg(test)]
mod tests;

use plumbline_common::row::{Decision, Measurement, Status};

use crate::reduce::ReduceOptions;
use crate::reduce::population::Surveyed;
use crate::reduce::recipe::BySignal;
use calibration::calibrate;
use flip::Residuals;
pub use goal::{End, Goal, Step, Wave, next};

/// What one measurement of a video says, as far as decisions depend on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// What became of it.
    pub status: Status,
    /// Its signals; none unless `scored`.
    pub values: BySignal<Option<f64>>,
    /// Frames decoded; what cannot be decoded has none.
    pub frames: u32,
    /// Processor time it took, seconds.
    pub cpu_s: f64,
}

impl Seen {
    /// What a measurement says.
    #[must_use]
    pub fn of(measured: &Measurement, cpu_s: f64) -> Self {
        let values = match measured.status {
            Status::Scored => BySignal::of(measured),
            _ => BySignal::default(),
        };
        Self {
            status: measured.status,
            values,
            frames: measured.frames.unwrap_or(0),
            cpu_s,
        }
    }

    fn is_scored(&self) -> bool {
        self.status == Status::Scored
    }

    /// Whether a dearer rung may say something else: what cannot be decoded, is too short or too large, or
    /// breaks the measurement is so at every rung.
    #[must_use]
    pub fn may_change(&self) -> bool {
        matches!(
            self.status,
            Status::Scored | Status::Static | Status::Collapsed
        )
    }
}

/// One video of the corpus.
#[derive(Debug, Clone, PartialEq)]
pub struct Video {
    /// The group that the keep rule is applied within.
    pub group: Option<String>,
    /// By rung, the cheapest first; one per rung of the ladder.
    pub seen: Vec<Option<Seen>>,
}

impl Video {
    /// The dearest rung at which it was measured.
    #[must_use]
    pub fn rung(&self) -> Option<usize> {
        self.seen.iter().rposition(Option::is_some)
    }

    fn at(&self, rung: usize) -> Option<&Seen> {
        self.seen.get(rung)?.as_ref()
    }

    /// Its values at a rung, where it is scored there.
    fn values(&self, rung: usize) -> Option<&BySignal<Option<f64>>> {
        self.at(rung)
            .filter(|seen| seen.is_scored())
            .map(|seen| &seen.values)
    }
}

/// What is known of a video's decision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// The rung of its row.
    pub rung: usize,
    /// S_r at that rung, by that rung's calibration.
    pub anomaly: Option<f64>,
    /// What the keep rule makes of it.
    pub decision: Decision,
    /// The probability that measuring the whole corpus at the top decides otherwise: of a row from below by
    /// the residuals of others, of one from the top by what the calibration does not know; 0 of a video of
    /// which no rung can say more.
    pub flip: f64,
}

/// What all measurements so far come to.
#[derive(Debug, Clone)]
pub struct Assessment {
    /// By rung.
    pub calibrations: Vec<Surveyed>,
    /// One per video, in the order given; `None` where a video is not measured at all.
    pub judged: Vec<Option<Judged>>,
}

impl Assessment {
    /// Decisions that would be others if the whole corpus were measured at the top, on average.
    #[must_use]
    pub fn expected_flips(&self) -> f64 {
        self.judged.iter().flatten().map(|judged| judged.flip).sum()
    }
}

/// What is known of each video: the dearest rung at which it was measured, and its anomaly there.
type Placed = Vec<Option<(usize, Option<f64>)>>;

fn anomaly(
    video: &Video,
    rung: usize,
    calibrations: &[Surveyed],
    options: &ReduceOptions,
) -> Option<f64> {
    let values = video.values(rung)?;
    let yardstick = &calibrations.get(rung)?.yardstick;
    yardstick.anomaly(options.recipe, values)
}

fn place(videos: &[Video], calibrations: &[Surveyed], options: &ReduceOptions) -> Placed {
    let placed = videos.iter().map(|video| {
        let rung = video.rung()?;
        Some((rung, anomaly(video, rung, calibrations, options)))
    });
    placed.collect()
}

/// Scores, decides, and says how sure that is. `videos` are in the order of their names, by which ties are
/// broken, all with as many rungs; `sample` are those measured at every rung, by index.
#[must_use]
pub fn assess(videos: &[Video], sample: &[usize], options: &ReduceOptions) -> Assessment {
    let rungs = videos.first().map_or(0, |video| video.seen.len());
    let calibrations: Vec<Surveyed> = (0..rungs)
        .map(|rung| calibrate(videos, sample, rung, options))
        .collect();
    let placed = place(videos, &calibrations, options);
    let decided = flip::decide(videos, &placed, options);
    let top = rungs.saturating_sub(1);
    let anomaly = |video: &Video, rung: usize| anomaly(video, rung, &calibrations, options);
    let residuals: Vec<Residuals> = (0..top)
        .map(|rung| Residuals::of(videos.iter(), rung, top, &anomaly))
        .collect();
    let recalibrated = resample::flips(videos, sample, &calibrations, &decided.decisions, options);
    let known = videos.iter().zip(&placed).zip(&decided.decisions);
    let judged = known
        .zip(recalibrated)
        .map(|(((video, placed), &decision), recalibrated)| {
            let (rung, anomaly) = (*placed)?;
            let seen = video.at(rung)?;
            let cut = decided.cuts.cut(&video.group.as_deref(), &options.keep);
            let flip = match residuals.get(rung) {
                Some(residuals) => residuals.flip(seen.status, anomaly, decision, cut),
                None => recalibrated,
            };
            Some(Judged {
                rung,
                anomaly,
                decision,
                flip,
            })
        })
        .collect();
    Assessment {
        calibrations,
        judged,
    }
}
