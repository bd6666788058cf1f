//! What a person sees while a run works: a bar with ETA on a terminal, plain lines otherwise.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Seconds between two plain lines: a log of an overnight run stays readable.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Progress of one run, on standard error.
#[derive(Debug)]
pub struct Progress {
    bar: Option<ProgressBar>,
    total: u64,
    done: u64,
    unscored: u64,
    started: Instant,
    started_at: u64,
    last_line: Instant,
}

impl Progress {
    /// Starts at `already_done` of `total`.
    #[must_use]
    pub fn start(total: u64, already_done: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total).with_position(already_done);
            if let Ok(style) = ProgressStyle::with_template(
                "{bar:32} {pos}/{len} videos  {per_sec}  {elapsed} elapsed, {eta} left  {msg}",
            ) {
                bar.set_style(style);
            }
            bar.reset_eta();
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        let now = Instant::now();
        Self {
            bar,
            total,
            done: already_done,
            unscored: 0,
            started: now,
            started_at: already_done,
            last_line: now,
        }
    }

    /// One video is measured.
    pub fn advance(&mut self, scored: bool) {
        self.done += 1;
        self.unscored += u64::from(!scored);
        if let Some(bar) = &self.bar {
            bar.set_position(self.done);
            if self.unscored > 0 {
                bar.set_message(format!("({} without a score)", self.unscored));
            }
        } else if self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            say(&format!(
                "{}/{} videos, about {} left",
                self.done,
                self.total,
                self.time_left()
            ));
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn time_left(&self) -> String {
        let here = self.done - self.started_at;
        if here == 0 {
            return "an unknown time".into();
        }
        let each_s = self.started.elapsed().as_secs_f64() / here as f64;
        let left_s = (each_s * (self.total - self.done) as f64).round() as u64;
        format!(
            "{}:{:02}:{:02}",
            left_s / 3600,
            left_s / 60 % 60,
            left_s % 60
        )
    }
}

/// One line on standard error; a closed standard error is no reason to stop.
pub fn say(line: &str) {
    let _closed = writeln!(std::io::stderr(), "{line}");
}
