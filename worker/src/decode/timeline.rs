//! Presentation times: ticks of the stream's clock to seconds since the first frame, rate and regularity.
//!
//! fps = (n − 1) / (t_last − t_first). The rate is called variable when an interval differs from the mean
//! one by more than one tick of the clock (rounding) plus one percent (clocks that were rounded twice).

/// Relative difference of intervals that still counts as regular.
const REGULAR_FRACTION: f64 = 0.01;

/// Times of the frames delivered so far. Constant size whatever the length of the clip.
#[derive(Debug, Clone)]
pub(super) struct Timeline {
    tick_s: f64,
    first: Option<i64>,
    last: i64,
    frames: u32,
    shortest: i64,
    longest: i64,
}

impl Timeline {
    /// `tick_s`: seconds per tick of the stream's time base.
    pub(super) fn new(tick_s: f64) -> Self {
        Self {
            tick_s,
            first: None,
            last: 0,
            frames: 0,
            shortest: i64::MAX,
            longest: 0,
        }
    }

    /// Takes a frame's time in ticks: its index and its seconds since the first frame, or nothing when
    /// the time does not come after its predecessor's.
    pub(super) fn push(&mut self, ticks: i64) -> Option<(u32, f64)> {
        let first = *self.first.get_or_insert(ticks);
        if self.frames > 0 {
            let interval = ticks
                .checked_sub(self.last)
                .filter(|&interval| interval > 0)?;
            self.shortest = self.shortest.min(interval);
            self.longest = self.longest.max(interval);
        }
        let index = self.frames;
        self.frames += 1;
        self.last = ticks;
        Some((index, ticks.saturating_sub(first) as f64 * self.tick_s))
    }

    /// The latest time in ticks.
    pub(super) fn last(&self) -> Option<i64> {
        self.first.map(|_| self.last)
    }

    pub(super) fn frames(&self) -> u32 {
        self.frames
    }

    /// Frames per second; none for fewer than two frames.
    pub(super) fn fps(&self) -> Option<f64> {
        self.mean_interval_s().map(|interval_s| 1.0 / interval_s)
    }

    /// First frame to the end of the last one, seconds.
    pub(super) fn duration_s(&self) -> Option<f64> {
        self.mean_interval_s()
            .map(|interval_s| interval_s * f64::from(self.frames))
    }

    pub(super) fn is_variable(&self) -> bool {
        let Some(mean_s) = self.mean_interval_s() else {
            return false;
        };
        let slack_s = self.tick_s + REGULAR_FRACTION * mean_s;
        let off = |ticks: i64| (ticks as f64 * self.tick_s - mean_s).abs() > slack_s;
        off(self.shortest) || off(self.longest)
    }

    /// Mean ticks between frames; none for fewer than two.
    pub(super) fn interval(&self) -> Option<f64> {
        self.mean_interval_s()
            .map(|interval_s| interval_s / self.tick_s)
    }

    fn mean_interval_s(&self) -> Option<f64> {
        let span_s = self.last.saturating_sub(self.first?) as f64 * self.tick_s;
        (self.frames > 1 && span_s > 0.0).then(|| span_s / f64::from(self.frames - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(tick_s: f64, ticks: &[i64]) -> Timeline {
        let mut timeline = Timeline::new(tick_s);
        for &tick in ticks {
            timeline.push(tick);
        }
        timeline
    }

    #[test]
    fn millisecond_rounding_is_not_variable_but_a_pause_is() {
        let regular: Vec<i64> = (0..50)
            .map(|i| (f64::from(i) * 1000.0 / 30.0).round() as i64)
            .collect();
        let clip = timeline(1e-3, &regular);
        assert!(!clip.is_variable());
        assert!((clip.fps().unwrap_or_default() - 30.0).abs() < 0.01);
        assert!(timeline(1e-3, &[0, 33, 67, 133, 167]).is_variable());
    }

    #[test]
    fn times_that_do_not_increase_are_left_out() {
        let mut clip = Timeline::new(0.1);
        assert_eq!(clip.push(5), Some((0, 0.0)));
        assert_eq!(clip.push(5), None);
        assert_eq!(clip.push(4), None);
        assert_eq!(clip.push(10), Some((1, 0.5)));
        assert_eq!(
            (clip.fps(), clip.duration_s(), clip.frames()),
            (Some(2.0), Some(1.0), 2)
        );
    }

    #[test]
    fn one_frame_has_no_rate_and_extremes_do_not_overflow() {
        assert_eq!(timeline(0.1, &[7]).fps(), None);
        let clip = timeline(1.0, &[i64::MIN, i64::MAX]);
        assert_eq!(clip.frames(), 1);
    }
}
