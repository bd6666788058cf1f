//! Work shared out between threads.

use std::sync::Mutex;

use super::error::{ReduceFilesError, joined};

/// Does every piece of work once, on so many threads, the first ones first. Each thread has a state of
/// its own, which it finishes with. The first error found ends it.
pub(super) fn in_parallel<W: Send, S>(
    mut work: Vec<W>,
    threads: usize,
    start: impl Fn() -> S + Sync,
    each: impl Fn(&mut S, W) -> Result<(), ReduceFilesError> + Sync,
    finish: impl Fn(S) -> Result<(), ReduceFilesError> + Sync,
) -> Result<(), ReduceFilesError> {
    work.reverse();
    let queue = Mutex::new(work);
    let one = || -> Result<(), ReduceFilesError> {
        let mut state = start();
        loop {
            let next = queue.lock().map_err(|_| ReduceFilesError::Thread)?.pop();
            let Some(work) = next else {
                return finish(state);
            };
            let done = each(&mut state, work);
            if done.is_err() {
                queue.lock().map_err(|_| ReduceFilesError::Thread)?.clear();
            }
            done?;
        }
    };
    std::thread::scope(|scope| {
        let one = &one;
        let others: Vec<_> = (1..threads.max(1)).map(|_| scope.spawn(one)).collect();
        let own = one();
        others
            .into_iter()
            .map(|other| joined(other.join()))
            .fold(own, Result::and)
    })
}
