//! One delivery, from its judgement to its settlement.

use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_common::id::RunId;
use plumbline_common::message::{self, FleetJob, FleetResult, Job, Outcome};
use plumbline_common::queue::{Broker, Delivery, Message, Queue, QueueError, Settlement};
use plumbline_common::row::{Measurement, Status};
use plumbline_common::trace::TraceContext;
use tokio::sync::watch;
use tracing::{Instrument, info_span};

use super::judge::{Judged, judge};
use super::metrics::Metrics;
use super::recent::{Answered, Runs};
use super::serve::ServeError;
use super::verdict::{Happened, Verdict, refused, row, verdict};
use super::{Compute, WorkerOptions};
use crate::child::{ComputeSlot, Measured, SlotError};

/// When a job that a stopping worker hands back may go to another.
const HAND_BACK_AFTER: Duration = Duration::from_secs(1);

/// What every job of a worker shares.
#[derive(Debug)]
pub(super) struct Worker {
    pub(super) broker: Arc<dyn Broker>,
    pub(super) options: WorkerOptions,
    pub(super) metrics: Metrics,
    runs: Runs,
    answered: Answered,
}

/// Computes one job at a time.
#[derive(Debug)]
pub(super) enum Computer {
    Child {
        slot: Box<ComputeSlot>,
        /// For a fetch as for a measurement.
        deadline: Duration,
    },
    Nobody(Duration),
}

impl Worker {
    pub(super) fn new(broker: Arc<dyn Broker>, options: WorkerOptions, metrics: Metrics) -> Self {
        Self {
            broker,
            options,
            metrics,
            runs: Runs::default(),
            answered: Answered::default(),
        }
    }

    pub(super) fn computer(&self) -> Computer {
        match &self.options.compute {
            Compute::Children { program, limits } => {
                let fetcher = self.options.fetcher.clone();
                let slot = ComputeSlot::new(program.clone(), *limits, fetcher);
                Computer::Child {
                    slot: Box::new(slot),
                    deadline: limits.deadline(),
                }
            }
            Compute::Nobody { job_time } => Computer::Nobody(*job_time),
        }
    }

    /// Does a delivery and settles it, or hands it back once `hand_back` says so.
    ///
    /// # Errors
    /// [`ServeError`], when no job can be done here any more; this one then comes again.
    pub(super) async fn work(
        &self,
        computer: &mut Computer,
        delivery: Delivery,
        hand_back: watch::Receiver<bool>,
    ) -> Result<(), ServeError> {
        let Message {
            id,
            attempt,
            traceparent,
            ..
        } = &delivery.message;
        let parent = traceparent.as_deref().and_then(TraceContext::parse);
        let trace = parent.map_or_else(TraceContext::root, TraceContext::child);
        let span = info_span!(
            "job.run",
            job_id = %id,
            attempt,
            redeliveries = delivery.redeliveries,
            trace_id = trace.trace_id(),
            span_id = trace.span_id(),
            parent_span_id = parent.map(TraceContext::span_id),
        );
        self.work_traced(computer, delivery, hand_back, trace)
            .instrument(span)
            .await
    }

    async fn work_traced(
        &self,
        computer: &mut Computer,
        delivery: Delivery,
        hand_back: watch::Receiver<bool>,
        trace: TraceContext,
    ) -> Result<(), ServeError> {
        let Delivery {
            message,
            redeliveries,
            ..
        } = &delivery;
        if *redeliveries > 0 && self.answered.take(&message.id) {
            self.metrics.job("repeated");
            return self.settle(delivery, Settlement::Done).await;
        }
        let FleetJob { run, job } =
            match judge(&message.body, *redeliveries, self.options.files.as_deref()) {
                Judged::Work(job) => job,
                Judged::Refuse { owed, reason } => {
                    tracing::warn!(reason, "a job is refused");
                    let Some((run, video)) = owed else {
                        self.metrics.job("unreadable");
                        return self.settle(delivery, Settlement::Reject { reason }).await;
                    };
                    let answer = Outcome {
                        video,
                        measurement: refused(&reason),
                        cost: plumbline_common::row::Cost::default(),
                        thumbnails: None,
                    };
                    let verdict = Verdict {
                        answer: Some((answer, message.attempt)),
                        settlement: Settlement::Reject { reason },
                    };
                    return self.conclude(delivery, run, verdict, trace).await;
                }
            };
        if !self.runs.is_there(&*self.broker, &run).await? {
            self.metrics.job("dropped");
            tracing::info!(%run, "dropped: the run is finished or cancelled");
            return self.settle(delivery, Settlement::Done).await;
        }
        let happened = tokio::select! {
            happened = self.compute(computer, &job) => happened?,
            () = told(hand_back) => {
                self.metrics.job("handed_back");
                tracing::info!("handed back");
                // Not left unsettled: that would count as a worker that died with it.
                return self.settle(delivery, Settlement::Retry { after: HAND_BACK_AFTER }).await;
            }
        };
        let attempt = delivery.message.attempt;
        let verdict = verdict(&job, happened, attempt, &self.options.fetch_retries);
        self.conclude(delivery, run, verdict, trace).await
    }

    async fn compute(&self, computer: &mut Computer, job: &Job) -> Result<Happened, ServeError> {
        let (slot, deadline) = match computer {
            Computer::Nobody(job_time) => {
                tokio::time::sleep(*job_time).await;
                let measurement =
                    Measurement::without_score(Status::Static, "not measured (--no-op)");
                return Ok(Happened::Measured(Box::new(Measured {
                    outcome: row(job, measurement),
                    attempts: 1,
                    answered: true,
                })));
            }
            Computer::Child { slot, deadline } => (slot, *deadline),
        };
        let fetching = self.options.fetcher.fetch_within(job, deadline);
        let fetching = fetching.instrument(info_span!("fetch"));
        let fetched = match fetching.await {
            Ok(fetched) => fetched,
            Err(error) => {
                tracing::warn!(%error, failure = ?error.failure, "not fetched");
                return Ok(Happened::NotFetched(error));
            }
        };
        if fetched.bytes > 0 {
            self.metrics.fetched(fetched.bytes, fetched.took);
        }
        let lost_before = slot.children_lost();
        let measuring = slot
            .measure_fetched(job, &fetched)
            .instrument(info_span!("compute"));
        let measured = match measuring.await {
            Ok(measured) => measured,
            Err(SlotError::Message(error)) => Measured {
                outcome: row(
                    job,
                    refused(&format!("the job is too large to hand on: {error}")),
                ),
                attempts: 1,
                answered: false,
            },
            Err(error) => return Err(error.into()),
        };
        self.metrics
            .children_lost(slot.children_lost() - lost_before);
        self.metrics.stages(&measured.outcome.cost);
        Ok(Happened::Measured(Box::new(measured)))
    }

    /// Publishes the row, then settles the job.
    async fn conclude(
        &self,
        delivery: Delivery,
        run: RunId,
        verdict: Verdict,
        trace: TraceContext,
    ) -> Result<(), ServeError> {
        let Verdict {
            answer,
            mut settlement,
        } = verdict;
        let Some((outcome, attempts)) = answer else {
            self.metrics.job("retried");
            return self.settle(delivery, settlement).await;
        };
        let (status, video) = (outcome.measurement.status, outcome.video.clone());
        let result = FleetResult {
            run,
            outcome,
            attempts,
            worker: self.options.name.clone(),
        };
        let (body, oversize) = encoded(&result)?;
        if let Some(reason) = oversize {
            settlement = Settlement::Reject { reason };
        }
        let mut answer = Message::new(result.message_id(), body);
        answer.traceparent = Some(trace.to_string());
        let started = Instant::now();
        let results = Queue::Results(result.run);
        let publishing = self.broker.publish(&results, answer);
        match publishing.instrument(info_span!("publish")).await {
            Ok(()) => {
                self.metrics.published(started.elapsed());
                self.metrics.job(status.as_str());
                tracing::info!(%video, status = status.as_str(), attempts, "answered");
            }
            // The run is finished or cancelled: nobody waits for it.
            Err(QueueError::Missing { .. }) => {
                self.metrics.job("dropped");
                settlement = Settlement::Done;
            }
            Err(error) => return Err(error.into()),
        }
        self.settle_answered(delivery, settlement).await
    }

    /// Settles; what came too late comes again, which is no failure.
    async fn settle(&self, delivery: Delivery, settlement: Settlement) -> Result<(), ServeError> {
        if matches!(settlement, Settlement::Reject { .. }) {
            self.metrics.dead_letter();
        }
        match delivery.settle(settlement).await {
            Err(QueueError::Lost { .. }) => {
                tracing::info!("the broker took the job back before it was settled");
                Ok(())
            }
            settled => Ok(settled?),
        }
    }

    /// The same for a job whose result is safe.
    async fn settle_answered(
        &self,
        delivery: Delivery,
        settlement: Settlement,
    ) -> Result<(), ServeError> {
        let id = delivery.message.id.clone();
        if settlement != Settlement::Done {
            return self.settle(delivery, settlement).await;
        }
        match delivery.settle(settlement).await {
            Err(QueueError::Lost { .. }) => {
                self.answered.remember(id);
                Ok(())
            }
            settled => Ok(settled?),
        }
    }
}

/// A result on the wire. One that does not fit is replaced by a row that says so, and the reason for a dead
/// letter is given.
fn encoded(result: &FleetResult) -> Result<(Vec<u8>, Option<String>), ServeError> {
    let error = match message::encode(result) {
        Ok(body) => return Ok((body, None)),
        Err(error) => error,
    };
    let reason =
        format!("its result cannot be handed over: {error}; cut the clip into shorter ones");
    let smaller = FleetResult {
        outcome: Outcome {
            measurement: refused(&reason),
            thumbnails: None,
            ..result.outcome.clone()
        },
        ..result.clone()
    };
    let body = message::encode(&smaller).map_err(SlotError::from)?;
    Ok((body, Some(reason)))
}

/// Returns once it is said.
async fn told(mut said: watch::Receiver<bool>) {
    if said.wait_for(|said| *said).await.is_err() {
        std::future::pending::<()>().await;
    }
}
