//! The parent's side: one child per slot, started when needed, replaced when it dies.

use std::ops::ControlFlow;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;
use std::time::Duration;

use plumbline_common::message::{self, Job, MessageError, Outcome};
use plumbline_common::row::{Cost, Measurement, Status};
use plumbline_vision::faults::FaultSeries;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use super::protocol::{Ask, Request};
use super::running::{Drawing, Running};
use crate::explain::{DrawJob, Picture};
use crate::fetch::{FetchError, FetchFailure, Fetched, Fetcher};
use crate::measure::Detailed;
use crate::measure::frames::{FramesJob, SampledFrames};
use crate::measure::shape::Told;
use crate::slam::SlamOutcome;

/// A crashed job is tried once more in a fresh child: the crash may have been the machine's, but a
/// video that kills two children is the cause.
pub(crate) const MAX_ATTEMPTS: u32 = 2;

/// What one video may cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ComputeLimits {
    /// Wall time for one video, seconds.
    pub deadline_s: f64,
    /// The same where the profile runs learned networks.
    pub learned_deadline_s: f64,
    /// Address space of one compute child, MiB.
    pub memory_mib: u64,
}

impl Default for ComputeLimits {
    /// Ten minutes: a 600 s clip at `standard` needs about five on a slow core. 4 GiB: the largest
    /// object allowed is held in memory once, beside a few decoded 4K frames.
    fn default() -> Self {
        Self {
            deadline_s: 600.0,
            // `reference` takes up to a minute for each frame.
            learned_deadline_s: 14_400.0,
            memory_mib: 4096,
        }
    }
}

impl ComputeLimits {
    /// The deadline; a time beyond all clocks is none.
    pub(crate) fn deadline(&self) -> Duration {
        duration(self.deadline_s)
    }

    /// The deadline, seconds, of what was fetched.
    fn deadline_of(&self, fetched: &Fetched) -> f64 {
        match fetched.models {
            Some(_) => self.learned_deadline_s,
            None => self.deadline_s,
        }
    }
}

/// A job's outcome and how often it was tried.
#[derive(Debug)]
pub struct Measured {
    /// What came of it; always a row, whatever happened to the child.
    pub outcome: Outcome,
    /// 1, or 2 after a crash.
    pub attempts: u32,
    /// Whether a child has answered: not where each died, or passed its deadline.
    pub answered: bool,
}

/// What ends the run, since no work can be done.
#[derive(Debug, thiserror::Error)]
pub enum SlotError {
    /// The child does not start.
    #[error("cannot start the compute process {program}: {source}")]
    Spawn {
        /// The program.
        program: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The job is no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The store is out of reach, or there is no room for a copy of an object.
    #[error(transparent)]
    Fetch(Box<FetchError>),
}

/// One compute slot: at most one child, at most one job at a time.
#[derive(Debug)]
pub struct ComputeSlot {
    program: PathBuf,
    limits: ComputeLimits,
    fetcher: Fetcher,
    running: Option<Running>,
    children_lost: u64,
}

impl ComputeSlot {
    /// A slot whose children run `program` (a Plumbline binary) on what `fetcher` brings.
    #[must_use]
    pub fn new(program: PathBuf, limits: ComputeLimits, fetcher: Fetcher) -> Self {
        Self {
            program,
            limits,
            fetcher,
            running: None,
            children_lost: 0,
        }
    }

    /// Children that died or were ended for their deadline, so far.
    #[must_use]
    pub fn children_lost(&self) -> u64 {
        self.children_lost
    }

    /// Measures one video; a crash, a passed deadline or an object that cannot be had becomes a row.
    /// Dropping the future ends the child.
    ///
    /// # Errors
    /// [`SlotError`], when no child can be started at all, or objects are out of reach for now.
    pub async fn measure(&mut self, job: &Job) -> Result<Measured, SlotError> {
        match self.fetch(job).await? {
            Ok(fetched) => self.measure_fetched(job, &fetched).await,
            Err(row) => Ok(Measured {
                outcome: answered_by(job, *row),
                attempts: 1,
                answered: true,
            }),
        }
    }

    /// The same for a job that was fetched already.
    ///
    /// # Errors
    /// [`SlotError`], when no child can be started at all.
    pub async fn measure_fetched(
        &mut self,
        job: &Job,
        fetched: &Fetched,
    ) -> Result<Measured, SlotError> {
        let (answer, attempts) = self.ask(Ask::Measure(job.clone()), fetched).await?;
        let answered = answer.is_ok();
        let mut outcome = answer.unwrap_or_else(|reason| failed(job, reason));
        outcome.cost.fetch_s = fetched.took.as_secs_f64();
        Ok(Measured {
            outcome,
            attempts,
            answered,
        })
    }

    /// The job's bytes on this machine, or the row that says why they cannot be had.
    async fn fetch(&self, job: &Job) -> Result<Result<Fetched, Box<Measurement>>, SlotError> {
        match self.fetcher.fetch(job).await {
            Ok(fetched) => Ok(Ok(fetched)),
            Err(error) if error.failure == FetchFailure::Passing => {
                Err(SlotError::Fetch(Box::new(error)))
            }
            Err(error) => {
                tracing::warn!(video = %job.video, %error, "not fetched");
                Ok(Err(error.row))
            }
        }
    }

    /// Whether a child can run the networks of a profile: they are found, and loaded. `None`, or why not.
    ///
    /// # Errors
    /// [`SlotError`], when no child can be started at all.
    pub async fn load(&mut self, profile: &[u8]) -> Result<Option<String>, SlotError> {
        let models = match self.fetcher.models(profile).await {
            Ok(models) => models,
            Err(error) => return Ok(Some(error.to_string())),
        };
        let fetched = Fetched::of_models(models);
        let ask = Ask::Load(ByteBuf::from(profile.to_vec()));
        let (answer, _attempts) = self.ask(ask, &fetched).await?;
        Ok(answer.unwrap_or_else(Some))
    }

    /// The same with what is behind the row.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn measure_in_detail(&mut self, job: &Job) -> Result<Detailed, SlotError> {
        let without = |outcome| Detailed {
            outcome,
            times_s: Vec::new(),
            faults: FaultSeries::default(),
            worst_edge: None,
        };
        let fetched = match self.fetch(job).await? {
            Ok(fetched) => fetched,
            Err(row) => return Ok(without(answered_by(job, *row))),
        };
        let (answer, _attempts) = self.ask(Ask::Detail(job.clone()), &fetched).await?;
        Ok(answer.unwrap_or_else(|reason| without(failed(job, reason))))
    }

    /// Tracks the camera of one video; a crash or a passed deadline is a refusal.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn track(&mut self, job: &Job) -> Result<SlamOutcome, SlotError> {
        let fetched = match self.fetch(job).await? {
            Ok(fetched) => fetched,
            Err(row) => {
                return Ok(SlamOutcome::Refused {
                    status: row.status,
                    reason: reason_of(*row),
                });
            }
        };
        let (answer, _attempts) = self.ask(Ask::Track(job.clone()), &fetched).await?;
        Ok(answer.unwrap_or_else(|reason| SlamOutcome::Refused {
            status: Status::Failed,
            reason,
        }))
    }

    /// Some frames of one video as JPEG, or the reason for none.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn frames(
        &mut self,
        job: &FramesJob,
    ) -> Result<Result<SampledFrames, String>, SlotError> {
        let fetched = match self.fetch(&job.job).await? {
            Ok(fetched) => fetched,
            Err(row) => return Ok(Err(reason_of(*row))),
        };
        let (answer, _attempts) = self.ask(Ask::Frames(job.clone()), &fetched).await?;
        Ok(answer.and_then(|sampled| sampled))
    }

    /// What the header of one video says; of an object only its ends are read.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn shape(&mut self, job: &Job) -> Result<Told, SlotError> {
        let fetched = match self.fetcher.fetch_ends(job).await {
            Ok(fetched) => fetched,
            Err(error) if error.failure == FetchFailure::Passing => {
                return Err(SlotError::Fetch(Box::new(error)));
            }
            Err(_) => return Ok(Told::Refused),
        };
        let (answer, _attempts) = self.ask(Ask::Shape(job.clone()), &fetched).await?;
        // A header that ends two children says as little as one that says nothing.
        Ok(answer.unwrap_or(Told::Silent))
    }

    /// Draws pictures of one video and hands each to `take`, which says whether to go on. Tried once,
    /// since what was taken cannot be taken back. Dropping the future ends the child.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn draw<F: FnMut(Picture) -> ControlFlow<()>>(
        &mut self,
        job: &DrawJob,
        take: &mut F,
    ) -> Result<Drawing, SlotError> {
        let fetched = match self.fetch(&job.job).await? {
            Ok(fetched) => fetched,
            Err(row) => return Ok(Drawing::Missing(reason_of(*row))),
        };
        let request = encode(Ask::Draw(job.clone()), &fetched)?;
        let mut running = match self.running.take() {
            Some(running) => running,
            None => self.start()?,
        };
        let deadline_s = self.limits.deadline_of(&fetched);
        match tokio::time::timeout(duration(deadline_s), running.draw(&request, take)).await {
            Ok(Ok(drawing)) => {
                // Whoever stopped taking left pictures in the pipe: that child is of no more use.
                if drawing != Drawing::Stopped {
                    self.running = Some(running);
                }
                Ok(drawing)
            }
            Err(_elapsed) => {
                self.children_lost += 1;
                Ok(Drawing::Missing(too_slow(deadline_s)))
            }
            Ok(Err(broken)) => {
                self.children_lost += 1;
                Ok(Drawing::Missing(format!(
                    "the compute process died while drawing ({}); its memory limit is {} MiB (--memory)",
                    running.obituary(broken).await,
                    self.limits.memory_mib
                )))
            }
        }
    }

    fn start(&self) -> Result<Running, SlotError> {
        let started = Running::start(&self.program, self.limits.memory_mib);
        started.map_err(|source| SlotError::Spawn {
            program: self.program.clone(),
            source,
        })
    }

    /// One request and its answer, or the reason for none, and the number of attempts.
    async fn ask<T: DeserializeOwned>(
        &mut self,
        ask: Ask,
        fetched: &Fetched,
    ) -> Result<(Result<T, String>, u32), SlotError> {
        let request = encode(ask, fetched)?;
        let deadline_s = self.limits.deadline_of(fetched);
        let mut reason = String::new();
        for attempts in 1..=MAX_ATTEMPTS {
            let mut running = match self.running.take() {
                Some(running) => running,
                None => self.start()?,
            };
            match tokio::time::timeout(duration(deadline_s), running.exchange(&request)).await {
                Ok(Ok(answer)) => {
                    self.running = Some(running);
                    return Ok((Ok(answer), attempts));
                }
                Err(_elapsed) => {
                    self.children_lost += 1;
                    return Ok((Err(too_slow(deadline_s)), attempts));
                }
                Ok(Err(broken)) => {
                    self.children_lost += 1;
                    reason = running.obituary(broken).await;
                    tracing::warn!(attempts, reason, "compute child lost");
                }
            }
        }
        let reason = format!(
            "the compute process died {MAX_ATTEMPTS} times ({reason}); its memory limit is {} MiB (--memory)",
            self.limits.memory_mib
        );
        Ok((Err(reason), MAX_ATTEMPTS))
    }
}

fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

fn too_slow(deadline_s: f64) -> String {
    format!("not measured within {deadline_s} s: shorten the clip or raise --deadline")
}

fn encode(ask: Ask, fetched: &Fetched) -> Result<Vec<u8>, MessageError> {
    let path = fetched.path().map(|path| path.as_os_str().as_bytes());
    message::encode(&Request {
        ask,
        copy: path.map(|path| ByteBuf::from(path.to_vec())),
        models: fetched.models.clone(),
    })
}

fn failed(job: &Job, reason: String) -> Outcome {
    answered_by(job, Measurement::without_score(Status::Failed, reason))
}

fn answered_by(job: &Job, row: Measurement) -> Outcome {
    Outcome {
        video: job.video.clone(),
        measurement: row,
        cost: Cost::default(),
        thumbnails: None,
    }
}

fn reason_of(row: Measurement) -> String {
    row.status_reason.unwrap_or_default()
}
