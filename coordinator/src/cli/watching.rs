//! The options by which `score` watches its sources.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Failure;
use crate::watch::WatchOptions;

/// What was typed.
#[derive(Debug, Args)]
pub(super) struct WatchingArgs {
    /// Score videos one by one as they arrive in SOURCE, each row final at once, until Ctrl-C
    #[arg(long, requires = "reference")]
    watch: bool,
    /// Time between two looks, seconds; what does not change in between is taken for whole
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 2.0,
        requires = "watch"
    )]
    watch_poll_s: f64,
    /// End the watch when nothing has come for so many seconds
    #[arg(long, value_name = "SECONDS", requires = "watch")]
    watch_idle_s: Option<f64>,
    /// End the watch when this file exists and all that came before it is scored
    #[arg(long, value_name = "FILE", requires = "watch")]
    watch_until: Option<PathBuf>,
}

impl WatchingArgs {
    /// How to watch; `None` where that was not asked for.
    pub(super) fn usable(&self, to_stdout: bool) -> Result<Option<WatchOptions>, Failure> {
        let seconds = |name: &str, s: f64| match Duration::try_from_secs_f64(s) {
            Ok(duration) if !duration.is_zero() => Ok(duration),
            _ => Err(Failure::usage(format!("{name} must be above 0"))),
        };
        let idle = self.watch_idle_s.map(|s| seconds("--watch-idle-s", s));
        let poll = seconds("--watch-poll-s", self.watch_poll_s)?;
        Ok(self.watch.then_some(WatchOptions {
            poll,
            idle: idle.transpose()?,
            until: self.watch_until.clone(),
            to_stdout,
        }))
    }
}
