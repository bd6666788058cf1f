//! An episode among others in one video: which frames belong to it, and where decoding starts.
//!
//! The frames are those that decoding the whole and cutting would give, bit for bit: decoding starts at a
//! keyframe that is presented no later than the first of them.

use ffmpeg_next::format::context::Input;
use ffmpeg_next::{Packet, Rational};
use serde::{Deserialize, Serialize};

/// The frames whose presentation times t are `from_ns` ≤ t < `to_ns`, nanoseconds on the video's own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// The earliest time that belongs to it; before 0 is the video's start.
    pub from_ns: i64,
    /// The earliest time after it.
    pub to_ns: i64,
}

impl Interval {
    /// Its length in seconds, as far as it lies after the video's start.
    pub(super) fn length_s(self) -> f64 {
        self.to_ns.saturating_sub(self.from_ns.max(0)) as f64 / 1e9
    }
}

/// An interval in ticks of a stream's clock; the whole video where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    from: i64,
    to: i64,
}

/// Where a time lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    Before,
    Inside,
    After,
}

impl Window {
    pub(super) const WHOLE: Self = Self {
        from: i64::MIN,
        to: i64::MAX,
    };

    /// `time_base`: seconds per tick, a positive fraction.
    pub(super) fn of(interval: Interval, time_base: Rational) -> Self {
        // The first tick at or after a time: rounded up, in whole numbers.
        let first_tick = |ns: i64| {
            let ticks_e9 = i128::from(ns) * i128::from(time_base.denominator().max(1));
            let per_tick = i128::from(time_base.numerator().max(1)) * 1_000_000_000;
            let ticks = -(-ticks_e9).div_euclid(per_tick);
            ticks.clamp(i64::MIN.into(), i64::MAX.into()) as i64
        };
        Self {
            from: first_tick(interval.from_ns),
            to: first_tick(interval.to_ns),
        }
    }

    pub(super) fn place(self, ticks: i64) -> Place {
        if self == Self::WHOLE {
            Place::Inside
        } else if ticks < self.from {
            Place::Before
        } else if ticks < self.to {
            Place::Inside
        } else {
            Place::After
        }
    }

    /// Whether a keyframe that is presented then is early enough.
    fn can_start_at(self, ticks: i64) -> bool {
        ticks <= self.from
    }

    /// Whether frames up to `last`, `interval` ticks apart, leave no room for one more. Half of an interval is
    /// for clocks that were rounded.
    pub(super) fn is_filled(self, last: i64, interval: f64) -> bool {
        self == Self::WHOLE || last as f64 + 1.5 * interval >= self.to as f64
    }
}

/// Farther back than a keyframe that came too late, microseconds; doubled as often as it takes.
const FIRST_STEP_BACK_US: i64 = 1_000_000;

/// Goes to a keyframe from which all frames from `from_ns` on can be decoded, and gives the packet there, which
/// is read already; none where reading simply goes on.
///
/// # Errors
/// Where the demuxer cannot go there.
pub(super) fn go_to(
    input: &mut Input,
    stream: usize,
    interval: Interval,
    window: Window,
) -> Result<Option<Packet>, ffmpeg_next::Error> {
    let from_us = interval.from_ns.div_euclid(1000);
    let mut back_us = 0;
    loop {
        let target_us = from_us.saturating_sub(back_us);
        if target_us <= 0 && back_us == 0 {
            return Ok(None);
        }
        // The start is the last place that is tried.
        let at_start = target_us <= 0;
        input.seek(target_us.max(0), ..target_us.max(0))?;
        let packet = loop {
            let mut packet = Packet::empty();
            match packet.read(input) {
                Ok(()) if packet.stream() == stream => break Some(packet),
                Ok(()) => {}
                // Told again by the next read.
                Err(_) => break None,
            }
        };
        // Demuxers look for decoding times, which may come before those of presentation.
        let pts = packet.as_ref().and_then(Packet::pts);
        if at_start || pts.is_some_and(|pts| window.can_start_at(pts)) {
            return Ok(packet);
        }
        back_us = if back_us == 0 {
            FIRST_STEP_BACK_US
        } else {
            back_us.saturating_mul(2)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(from_ns: i64, to_ns: i64, time_base: Rational) -> Window {
        Window::of(Interval { from_ns, to_ns }, time_base)
    }

    #[test]
    fn ends_are_the_first_ticks_at_or_after_a_time() {
        // 30 frames per second in ticks of 1/15360 s; the ends lie half a frame before frames 3 and 6.
        let half = 1_000_000_000 / 60;
        let at = |frame: i64| frame * 1_000_000_000 / 30;
        let w = window(at(3) - half, at(6) - half, Rational(1, 15360));
        let placed: Vec<Place> = (0..9).map(|frame| w.place(frame * 512)).collect();
        assert_eq!(placed[..3], [Place::Before; 3]);
        assert_eq!(placed[3..6], [Place::Inside; 3]);
        assert_eq!(placed[6..], [Place::After; 3]);
        // Exactly on a tick, and one nanosecond after it.
        let tenth = Rational(1, 10);
        assert_eq!(
            window(100_000_000, 200_000_001, tenth),
            Window { from: 1, to: 3 }
        );
        assert_eq!(window(-100_000_001, 0, tenth), Window { from: -1, to: 0 });
        assert_eq!(window(-50_000_000, 0, tenth).place(0), Place::After);
    }

    #[test]
    fn extremes_do_not_overflow() {
        for time_base in [Rational(1, i32::MAX), Rational(i32::MAX, 1), Rational(0, 0)] {
            let w = window(i64::MIN, i64::MAX, time_base);
            assert_eq!(w.place(0), Place::Inside);
        }
        let interval = Interval {
            from_ns: i64::MIN,
            to_ns: i64::MIN,
        };
        assert!(interval.length_s() <= 0.0);
        assert_eq!(Window::WHOLE.place(i64::MAX), Place::Inside);
    }

    #[test]
    fn a_file_that_ends_early_leaves_room() {
        let w = Window { from: 100, to: 200 };
        assert!(w.is_filled(190, 10.0) && w.is_filled(186, 10.0));
        assert!(!w.is_filled(180, 10.0));
        assert!(Window::WHOLE.is_filled(0, 1.0));
    }
}
