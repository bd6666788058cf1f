//! What a worker remembers for a moment, to ask the broker less and to do less twice. Both memories are
//! small, and forgetting costs time only.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use plumbline_common::id::RunId;
use plumbline_common::queue::{Broker, Queue, QueueError};

/// How long a run that was there counts as being there: what is computed in vain after a cancellation.
const RUN_KNOWN_FOR: Duration = Duration::from_secs(2);

/// Runs remembered at once.
const MAX_RUNS: usize = 1000;

/// Answered jobs remembered at once: far more than slots, whose number is what one lost connection costs.
const MAX_ANSWERED: usize = 10_000;

/// The runs that were there a moment ago.
#[derive(Debug, Default)]
pub(super) struct Runs {
    seen: Mutex<HashMap<RunId, Instant>>,
}

impl Runs {
    /// Whether the run's results queue is there: not once it is finished or cancelled.
    pub(super) async fn is_there(
        &self,
        broker: &dyn Broker,
        run: &RunId,
    ) -> Result<bool, QueueError> {
        let fresh = |seen: &Instant| seen.elapsed() < RUN_KNOWN_FOR;
        if lock(&self.seen).get(run).is_some_and(fresh) {
            return Ok(true);
        }
        match broker.ready(&Queue::Results(run.clone())).await {
            Ok(_waiting) => {
                let mut seen = lock(&self.seen);
                if seen.len() >= MAX_RUNS {
                    seen.retain(|_, at| fresh(at));
                }
                seen.insert(run.clone(), Instant::now());
                Ok(true)
            }
            Err(QueueError::Missing { .. }) => {
                lock(&self.seen).remove(run);
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }
}

/// Jobs whose result is safe but whose settlement came too late: they come again, and need no second answer.
#[derive(Debug, Default)]
pub(super) struct Answered {
    ids: Mutex<VecDeque<String>>,
}

impl Answered {
    pub(super) fn remember(&self, id: String) {
        let mut ids = lock(&self.ids);
        if ids.len() >= MAX_ANSWERED {
            ids.pop_front();
        }
        ids.push_back(id);
    }

    /// Whether it was remembered; not any more after that.
    pub(super) fn take(&self, id: &str) -> bool {
        let mut ids = lock(&self.ids);
        let place = ids.iter().position(|known| known == id);
        place.and_then(|place| ids.remove(place)).is_some()
    }
}

/// A panic elsewhere leaves nothing half done under these locks.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answered_job_is_recognised_once_and_the_oldest_are_forgotten() {
        let answered = Answered::default();
        answered.remember("first".to_owned());
        assert!(!answered.take("other"));
        assert!(answered.take("first"));
        assert!(!answered.take("first"));
        for number in 0..=MAX_ANSWERED {
            answered.remember(number.to_string());
        }
        assert!(!answered.take("0"));
        assert!(answered.take("1"));
    }
}
