//! From what happened to a job to what is published of it and how it is settled. Pure: the one place where
//! that is decided.

use plumbline_common::backoff::Backoff;
use plumbline_common::message::{Job, Outcome};
use plumbline_common::queue::Settlement;
use plumbline_common::row::{Cost, Measurement, Status};

use crate::child::Measured;
use crate::fetch::{FetchError, FetchFailure};

/// What happened.
#[derive(Debug)]
pub(super) enum Happened {
    /// There is a row.
    Measured(Box<Measured>),
    /// Its object was not fetched.
    NotFetched(FetchError),
}

/// What follows.
#[derive(Debug, PartialEq)]
pub(super) struct Verdict {
    /// The row to publish before the job is settled, and how often the job was tried for it in all.
    pub(super) answer: Option<(Outcome, u32)>,
    /// What becomes of the job.
    pub(super) settlement: Settlement,
}

/// Decides; `attempt` is the message's, from 1.
pub(super) fn verdict(job: &Job, happened: Happened, attempt: u32, retries: &Backoff) -> Verdict {
    let settled_retries = attempt.saturating_sub(1);
    match happened {
        Happened::Measured(measured) => Verdict {
            settlement: if measured.answered {
                Settlement::Done
            } else {
                reject(&measured.outcome.measurement)
            },
            answer: Some((
                measured.outcome,
                settled_retries.saturating_add(measured.attempts),
            )),
        },
        Happened::NotFetched(error) => {
            let again = match error.failure {
                FetchFailure::Final => None,
                FetchFailure::Refused | FetchFailure::Passing => retries.after_with_jitter(attempt),
            };
            if let Some(after) = again {
                return Verdict {
                    answer: None,
                    settlement: Settlement::Retry { after },
                };
            }
            Verdict {
                settlement: match error.failure {
                    FetchFailure::Final => Settlement::Done,
                    FetchFailure::Refused | FetchFailure::Passing => reject(&error.row),
                },
                answer: Some((row(job, *error.row), attempt)),
            }
        }
    }
}

/// A row that no child has measured.
pub(super) fn row(job: &Job, measurement: Measurement) -> Outcome {
    Outcome {
        video: job.video.clone(),
        measurement,
        cost: Cost::default(),
        thumbnails: None,
    }
}

/// The row of a message that is no job for this worker.
pub(super) fn refused(reason: &str) -> Measurement {
    Measurement::without_score(Status::Failed, reason)
}

/// The dead letter says what the row says.
fn reject(row: &Measurement) -> Settlement {
    Settlement::Reject {
        reason: row.status_reason.clone().unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use plumbline_common::id::VideoId;
    use plumbline_common::message::Location;

    use super::*;

    const RETRIES: Backoff = Backoff {
        first: Duration::from_secs(1),
        longest: Duration::from_secs(4),
        attempts: 3,
    };

    fn job() -> Job {
        Job {
            video: VideoId::new("v").unwrap(),
            location: Location::File(b"/v".to_vec()),
            bytes: 1,
            modified_ns: 0,
            profile: Vec::new(),
        }
    }

    fn measured(status: Status, attempts: u32, answered: bool) -> Happened {
        Happened::Measured(Box::new(Measured {
            outcome: row(&job(), Measurement::without_score(status, "why")),
            attempts,
            answered,
        }))
    }

    fn not_fetched(failure: FetchFailure) -> Happened {
        Happened::NotFetched(FetchError {
            failure,
            row: Box::new(Measurement::without_score(Status::OverLimit, "why")),
            source: "details".into(),
        })
    }

    fn decide(happened: Happened, attempt: u32) -> (Option<(Status, u32)>, Settlement) {
        let Verdict { answer, settlement } = verdict(&job(), happened, attempt, &RETRIES);
        let answer = answer.map(|(outcome, tries)| {
            assert_eq!(outcome.video, job().video);
            (outcome.measurement.status, tries)
        });
        (answer, settlement)
    }

    fn dead() -> Settlement {
        Settlement::Reject {
            reason: "why".to_owned(),
        }
    }

    #[test]
    fn every_row_that_a_child_gives_is_done() {
        for status in [
            Status::Scored,
            Status::Static,
            Status::Undecodable,
            Status::Failed,
        ] {
            let decided = decide(measured(status, 1, true), 1);
            assert_eq!(decided, (Some((status, 1)), Settlement::Done));
        }
        // A child that died and one that answered, on the third delivery.
        let decided = decide(measured(Status::Scored, 2, true), 3);
        assert_eq!(decided, (Some((Status::Scored, 4)), Settlement::Done));
    }

    #[test]
    fn what_kills_every_child_or_passes_the_deadline_is_a_row_and_a_dead_letter_at_once() {
        for tries in [1, 2] {
            let decided = decide(measured(Status::Failed, tries, false), 1);
            assert_eq!(decided, (Some((Status::Failed, tries)), dead()));
        }
    }

    #[test]
    fn an_object_that_will_never_be_had_is_a_row() {
        let decided = decide(not_fetched(FetchFailure::Final), 1);
        assert_eq!(decided, (Some((Status::OverLimit, 1)), Settlement::Done));
    }

    #[test]
    fn a_store_that_fails_is_asked_again_a_bounded_number_of_times() {
        for failure in [FetchFailure::Passing, FetchFailure::Refused] {
            for attempt in 1..RETRIES.attempts {
                let (answer, settlement) = decide(not_fetched(failure), attempt);
                assert_eq!(answer, None);
                let Settlement::Retry { after } = settlement else {
                    panic!("{settlement:?}");
                };
                let longest = RETRIES.after(attempt).unwrap();
                assert!(after <= longest && after >= longest / 2);
            }
            let last = decide(not_fetched(failure), RETRIES.attempts);
            assert_eq!(last, (Some((Status::OverLimit, 3)), dead()));
        }
    }
}
