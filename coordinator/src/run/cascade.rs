//! Waves of a cascade: what [`crate::cascade`] asks for is measured, rung by rung, until it asks no more.
//!
//! Each rung has a journal of its own. A measurement counts from the wave on that asks for it, however long it
//! was in a journal, so that a run that was stopped goes through the same waves again and finds them answered.
//! On a fleet each rung is a run of its own (its name is a digest of the profile, too), so that no answer is
//! taken for one of another rung.

use plumbline_common::id::RunId;
use plumbline_common::row::Status;
use plumbline_worker::profile::{Profile, Rung};

use super::journals::{Cascaded, Journals};
use super::{RunError, ScoreOptions, Site, measure};
use crate::cascade::budget::Budget;
use crate::cascade::crossed::crossed;
use crate::cascade::goal::{Goal, spent_s};
use crate::cascade::record::{CascadeRecord, RungRecord};
use crate::cascade::sample::sample;
use crate::cascade::{Assessment, End, Seen, Step, Video, next};
use crate::collect::JournalError;
use crate::corpus::Entry;
use crate::keep::Keep;
use crate::measuring::is_readable;
use crate::progress::say;
use crate::reduce::ladder::RungOfRows;
use crate::reduce::recipe::BySignal;
use crate::reduce::reject::reject_non_finite;
use crate::stop::StopSignals;

/// A cascade as asked for.
#[derive(Debug, Clone)]
pub struct CascadeOptions {
    /// When it has done enough.
    pub budget: Budget,
    /// Profiles below the run's own, the cheapest first.
    pub below: Vec<Profile>,
}

impl CascadeOptions {
    /// The ladder up to `top`: every rung below its own, with what `top` says of cameras, limits and times.
    ///
    /// # Errors
    /// Where nothing is cheaper.
    pub fn up_to(top: &Profile, budget: Budget) -> Result<Self, String> {
        if top.rung == Rung::Draft {
            return Err(
                "--budget saves by measuring most videos at draft; with --profile draft there is nothing to save"
                    .to_owned(),
            );
        }
        let rungs = Rung::ALL.into_iter().take_while(|rung| *rung != top.rung);
        let below = rungs.map(|rung| Profile {
            intrinsics: top.intrinsics,
            conditioning_frames: top.conditioning_frames,
            warmup_frames: top.warmup_frames,
            sequence_fps: top.sequence_fps,
            limits: top.limits.clone(),
            ..Profile::new(rung)
        });
        Ok(Self {
            budget,
            below: below.collect(),
        })
    }
}

/// One rung at work.
struct RungAtWork {
    /// The run's options, with this rung's profile.
    options: ScoreOptions,
    keep: Keep,
    run: Option<RunId>,
}

/// What a cascade came to.
pub(super) struct Climbed {
    pub(super) measured: Journals,
    pub(super) measured_now: usize,
    pub(super) compute_s: f64,
    /// The run of the top rung on a fleet.
    pub(super) run: Option<RunId>,
}

/// Measures what a cascade asks for.
pub(super) async fn climb(
    site: &Site<'_>,
    cascade: &CascadeOptions,
    stop: &mut StopSignals,
) -> Result<Climbed, RunError> {
    let entries = &site.entries;
    let mut rungs = Vec::new();
    for profile in cascade.below.iter().chain([&site.options.profile]) {
        rungs.push(rung_at_work(site, profile)?);
    }
    let goal = cascade.budget.goal(entries.len());
    let sample = sample(entries.len(), corpus_digest(entries));
    let reduce = &site.options.reduce;
    let mut videos = unmeasured(entries, rungs.len());
    let before: usize = rungs.iter().map(|rung| rung.keep.journal.len()).sum();
    if before > 0 {
        say(&format!(
            "{before} measurements of an earlier run are taken over"
        ));
    }
    let (mut compute_s, mut measured_now) = (0.0, 0);
    let (assessment, end) = loop {
        let wave = match next(&videos, &sample, &goal, reduce) {
            Step::Measure(wave) => wave,
            Step::Done(assessment, end) => break (assessment, end),
        };
        let Some(rung) = rungs.get_mut(wave.rung) else {
            return Err(RunError::Ladder);
        };
        say(&format!(
            "{} of {} videos at {}",
            wave.videos.len(),
            entries.len(),
            rung.options.profile.name()
        ));
        let RungAtWork { options, keep, run } = rung;
        for &index in &wave.videos {
            look(&mut videos, entries, index, wave.rung, keep)?;
        }
        let most_cpu_s = match goal {
            // Every video has a row, whatever the budget.
            Goal::Cpu(budget_s) if wave.rung > 0 => budget_s - spent_s(&videos),
            _ => f64::INFINITY,
        };
        let asked: Vec<usize> = wave
            .videos
            .iter()
            .copied()
            .filter(|&index| {
                let entry = entries.get(index);
                entry.is_some_and(|entry| !keep.journal.contains(&entry.video))
            })
            .collect();
        if !asked.is_empty() {
            let known_before = keep.journal.len();
            let (more, answers) = measure(
                options,
                entries,
                asked,
                most_cpu_s,
                keep,
                run.as_ref(),
                stop,
            )
            .await?;
            answers.finished().await?;
            measured_now += keep.journal.len() - known_before;
            compute_s += more.compute_s;
        }
        for &index in &wave.videos {
            look(&mut videos, entries, index, wave.rung, keep)?;
        }
    };
    tell(end, &assessment, entries.len());
    let run = rungs.last().and_then(|rung| rung.run.clone());
    let measured = cascaded(cascade, rungs, &videos, &sample, &assessment, end)?;
    Ok(Climbed {
        measured,
        measured_now,
        compute_s,
        run,
    })
}

fn rung_at_work(site: &Site<'_>, profile: &Profile) -> Result<RungAtWork, RunError> {
    let mut options = site.options.clone();
    options.reduce.profile_digest = profile.digest().map_err(RunError::Profile)?;
    options.profile = profile.clone();
    let run = options.run_on_fleet(&site.entries)?;
    let is_top = *profile == site.options.profile;
    let keep = site.keep(&options, is_top)?;
    Ok(RungAtWork { options, keep, run })
}

/// Names and sizes of the videos: the same corpus has the same sample wherever it lies.
fn corpus_digest(entries: &[Entry]) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for entry in entries {
        let name = entry.video.as_str();
        hasher.update(&(name.len() as u64).to_le_bytes());
        hasher.update(name.as_bytes());
        hasher.update(&entry.bytes.unwrap_or(0).to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

/// The corpus before the first wave.
fn unmeasured(entries: &[Entry], rungs: usize) -> Vec<Video> {
    let videos = entries.iter().map(|entry| Video {
        group: entry.group.clone(),
        seen: vec![(!is_readable(entry)).then(unreadable); rungs],
    });
    videos.collect()
}

/// No rung can say more of what cannot be looked at.
fn unreadable() -> Seen {
    Seen {
        status: Status::Failed,
        values: BySignal::default(),
        frames: 0,
        cpu_s: 0.0,
    }
}

/// Takes what the journal says of one video at one rung.
fn look(
    videos: &mut [Video],
    entries: &[Entry],
    index: usize,
    rung: usize,
    keep: &Keep,
) -> Result<(), JournalError> {
    let (Some(entry), Some(video)) = (entries.get(index), videos.get_mut(index)) else {
        return Ok(());
    };
    let (Some(record), Some(seen)) = (keep.journal.read(&entry.video)?, video.seen.get_mut(rung))
    else {
        return Ok(());
    };
    let mut measurement = record.outcome.measurement;
    reject_non_finite(&mut measurement);
    *seen = Some(Seen::of(&measurement, record.outcome.cost.cpu_s));
    Ok(())
}

fn tell(end: End, assessment: &Assessment, videos: usize) {
    let flips = assessment.expected_flips();
    say(&match end {
        End::Reached => format!(
            "{flips:.1} of {videos} decisions are expected to differ from those of the top profile"
        ),
        End::Spent => format!(
            "the budget is spent; {flips:.1} of {videos} decisions are expected to differ from those of the top profile"
        ),
        End::AllAtTop | End::CheapestOnly => format!("note: {}", end.reason()),
    });
}

/// Rows, calibrations, and what is told of them.
fn cascaded(
    cascade: &CascadeOptions,
    rungs: Vec<RungAtWork>,
    videos: &[Video],
    sample: &[usize],
    assessment: &Assessment,
    end: End,
) -> Result<Journals, RunError> {
    let is_known = !matches!(end, End::CheapestOnly);
    let rows: Vec<(usize, Option<f64>)> = assessment
        .judged
        .iter()
        .map(|judged| {
            judged.map_or((0, None), |judged| {
                (judged.rung, is_known.then_some(judged.flip))
            })
        })
        .collect();
    let mut records = Vec::new();
    let mut of_rows = Vec::new();
    for (at, (rung, calibration)) in rungs.iter().zip(&assessment.calibrations).enumerate() {
        let profile = &rung.options.profile;
        let digest = &rung.options.reduce.profile_digest;
        let measured = || {
            videos
                .iter()
                .filter_map(move |video| video.seen.get(at)?.as_ref())
        };
        // Nothing is known of the way to a rung that nothing, or half a sample, was measured at.
        let is_scored_with = measured().next().is_some() && (is_known || at == 0);
        records.push(RungRecord {
            name: profile.name(),
            digest: digest.clone(),
            parameters: serde_json::to_value(profile).map_err(RunError::Profile)?,
            measured: measured().count() as u64,
            measured_frames: measured().map(|seen| u64::from(seen.frames)).sum(),
            rows: rows.iter().filter(|(rung, _)| *rung == at).count() as u64,
            calibration: is_scored_with.then(|| calibration.population.clone()),
        });
        if is_known || at == 0 {
            of_rows.push(RungOfRows {
                name: profile.name(),
                digest: digest.clone(),
                calibration: calibration.clone(),
            });
        }
    }
    let reduce = rungs.last().map(|rung| &rung.options.reduce);
    let sampled = matches!(end, End::Reached | End::Spent);
    let measured_agreement = reduce
        .filter(|_| sampled)
        .map(|reduce| crossed(videos, sample, assessment, reduce));
    let flips = assessment.expected_flips();
    let record = CascadeRecord {
        budget: cascade.budget.to_string(),
        reproducible: matches!(cascade.budget, Budget::Agreement(_)),
        ended: end.reason().to_owned(),
        sample: if sampled { sample.len() as u64 } else { 0 },
        expected_flips: is_known.then_some(flips),
        expected_agreement: is_known.then(|| 1.0 - flips / videos.len().max(1) as f64),
        measured_agreement,
        profiles: records,
    };
    Ok(Journals::Cascade(Box::new(Cascaded {
        journals: rungs.into_iter().map(|rung| rung.keep.journal).collect(),
        rungs: of_rows,
        rows,
        record,
    })))
}
