//! Spreads jobs over threads. Which thread takes a job changes nothing: each job writes to its own
//! place, and what is summed over jobs is summed afterwards, in their order.
//!
//! Scoped threads of the standard library: a step starts them three times, some 0.1 ms in all, which
//! steps of tens of milliseconds do not notice; a pool would be one more thing to own.

use std::sync::{Mutex, PoisonError};

/// Runs `work` on every job, on the calling thread and one more for each further worker.
pub(super) fn for_each<W: Send, J: Send>(
    workers: &mut [W],
    jobs: impl Iterator<Item = J> + Send,
    work: impl Fn(&mut W, J) + Sync,
) {
    let Some((own, others)) = workers.split_first_mut() else {
        return;
    };
    if others.is_empty() {
        jobs.for_each(|job| work(own, job));
        return;
    }
    let jobs = Mutex::new(jobs);
    let next = || jobs.lock().unwrap_or_else(PoisonError::into_inner).next();
    let run = |worker: &mut W| {
        while let Some(job) = next() {
            work(worker, job);
        }
    };
    std::thread::scope(|scope| {
        for worker in others {
            scope.spawn(|| run(worker));
        }
        run(own);
    });
}
