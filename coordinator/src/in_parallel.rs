//! Work shared out between threads.

use std::sync::Mutex;

/// A thread panicked.
#[derive(Debug, thiserror::Error)]
#[error("a thread broke down, which is a defect to report")]
pub struct BrokenThread;

/// Does every piece of work once, on so many threads, the first ones first. Each thread has a state of
/// its own, which it finishes with. The first error found ends it.
pub(crate) fn in_parallel<W: Send, S, E: From<BrokenThread> + Send>(
    mut work: Vec<W>,
    threads: usize,
    start: impl Fn() -> S + Sync,
    each: impl Fn(&mut S, W) -> Result<(), E> + Sync,
    finish: impl Fn(S) -> Result<(), E> + Sync,
) -> Result<(), E> {
    work.reverse();
    let queue = Mutex::new(work);
    let one = || -> Result<(), E> {
        let mut state = start();
        loop {
            let next = queue.lock().map_err(|_| BrokenThread)?.pop();
            let Some(work) = next else {
                return finish(state);
            };
            let done = each(&mut state, work);
            if done.is_err() {
                queue.lock().map_err(|_| BrokenThread)?.clear();
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
            .map(|other| other.join().unwrap_or_else(|_| Err(BrokenThread.into())))
            .fold(own, Result::and)
    })
}
