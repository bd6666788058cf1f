//! What ends a worker.

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// How far the end has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// Not at all.
    No,
    /// Take no more jobs; finish what is in work within the grace.
    Drain,
    /// At once.
    Now,
}

/// The first SIGTERM or SIGINT drains, the second ends. Must be called inside a tokio runtime.
///
/// # Errors
/// When signals cannot be listened for.
pub fn on_signals() -> std::io::Result<watch::Receiver<Stop>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let (sender, receiver) = watch::channel(Stop::No);
    tokio::spawn(async move {
        for stop in [Stop::Drain, Stop::Now] {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            sender.send_replace(stop);
        }
        // The sender lives as long as anybody listens.
        sender.closed().await;
    });
    Ok(receiver)
}
