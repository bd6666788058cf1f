//! How long to wait before trying again: exponential, bounded in time and number.

use std::time::Duration;

use rand::RngExt;

/// Waits that double from `first` up to `longest`, for at most `attempts` attempts in all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backoff {
    /// The wait after the first failed attempt.
    pub first: Duration,
    /// No wait is longer.
    pub longest: Duration,
    /// Attempts in all, the first included.
    pub attempts: u32,
}

impl Backoff {
    /// The wait after failed attempt number `attempt` (from 1); `None` when it was the last.
    #[must_use]
    pub fn after(&self, attempt: u32) -> Option<Duration> {
        if attempt >= self.attempts {
            return None;
        }
        let doublings = attempt.saturating_sub(1).min(31);
        Some(self.first.saturating_mul(1 << doublings).min(self.longest))
    }

    /// The same, shortened by up to a half at random, so that many clients that failed at once do not
    /// come back at once.
    #[must_use]
    pub fn after_with_jitter(&self, attempt: u32) -> Option<Duration> {
        let share = rand::rng().random_range(0.5..=1.0);
        self.after(attempt).map(|wait| wait.mul_f64(share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BACKOFF: Backoff = Backoff {
        first: Duration::from_millis(100),
        longest: Duration::from_secs(1),
        attempts: 70,
    };

    #[test]
    fn waits_double_up_to_the_longest_and_end() {
        let waits: Vec<_> = (1..=6)
            .filter_map(|attempt| BACKOFF.after(attempt))
            .map(|wait| wait.as_millis())
            .collect();
        assert_eq!(waits, [100, 200, 400, 800, 1000, 1000]);
        assert_eq!(BACKOFF.after(69), Some(BACKOFF.longest));
        assert_eq!(BACKOFF.after(70), None);
    }

    #[test]
    fn jitter_only_shortens_and_at_most_halves() {
        for _ in 0..1000 {
            let wait = BACKOFF.after_with_jitter(2).unwrap();
            assert!((100..=200).contains(&wait.as_millis()), "{wait:?}");
        }
        assert_eq!(BACKOFF.after_with_jitter(70), None);
    }
}
