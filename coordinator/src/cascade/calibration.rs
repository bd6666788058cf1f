//! The calibration of each rung: the statistics that its rows, and no others, are scored with.
//!
//! The cheapest rung has measured everything, and is its own population. A dearer rung has measured some
//! videos; statistics of those alone would be rough for a small sample, and wrong for a choice of uncertain
//! ones. Each signal of the others is therefore carried over from the dearest rung that has it by linear
//! equating, the way in which two tests of the same people are put on one scale (Kolen and Brennan, *Test
//! Equating*): t = median_t + MAD_t/MAD_d (d − median_d), medians and MADs over the sample. The statistics
//! are then those of the whole corpus, near to what measuring all of it would give; carried values make
//! statistics and nothing else.

use crate::reduce::ReduceOptions;
use crate::reduce::order::OrderStatistics;
use crate::reduce::population::{self, Surveyed, survey};
use crate::reduce::recipe::{BySignal, Signal};
use crate::reduce::values::{Distances, InMemory};

use super::Video;

/// The calibration of one rung.
#[must_use]
pub fn calibrate(
    videos: &[Video],
    sample: &[usize],
    rung: usize,
    options: &ReduceOptions,
) -> Surveyed {
    let from_below: Vec<BySignal<Line>> = (0..rung)
        .map(|below| equate(videos, sample, below, rung))
        .collect();
    let rows: Vec<BySignal<Option<f64>>> = videos
        .iter()
        .filter_map(|video| values_at(video, rung, &from_below))
        .collect();
    let signals = population::in_memory(&rows);
    let Ok(surveyed) = survey(rows.len() as u64, &signals, options.bins, options.range);
    surveyed
}

/// A video's values at a rung, measured or carried over; `None` where it is not scored.
fn values_at(
    video: &Video,
    rung: usize,
    from_below: &[BySignal<Line>],
) -> Option<BySignal<Option<f64>>> {
    if video.at(rung).is_some() {
        return video.values(rung).copied();
    }
    let below = (0..rung).rev().find(|&below| video.at(below).is_some())?;
    let (values, lines) = (video.values(below)?, from_below.get(below)?);
    Some(BySignal::from_fn(|signal| {
        values[signal].map(|value| lines[signal].at(value))
    }))
}

/// From one rung's scale to another's.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    from: f64,
    to: f64,
    slope: f64,
}

impl Line {
    /// Where nothing is known: every rung measures in the same unit.
    const IDENTITY: Self = Self {
        from: 0.0,
        to: 0.0,
        slope: 1.0,
    };

    fn at(self, value: f64) -> f64 {
        self.to + self.slope * (value - self.from)
    }
}

fn equate(videos: &[Video], sample: &[usize], from: usize, to: usize) -> BySignal<Line> {
    let both: Vec<_> = sample
        .iter()
        .filter_map(|&index| {
            let video = videos.get(index)?;
            Some((video.values(from)?, video.values(to)?))
        })
        .collect();
    BySignal::from_fn(|signal: Signal| {
        let pairs = both
            .iter()
            .filter_map(|(from, to)| from[signal].zip(to[signal]));
        let (from, to): (Vec<f64>, Vec<f64>) = pairs.unzip();
        line(from, to).unwrap_or(Line::IDENTITY)
    })
}

fn line(from: Vec<f64>, to: Vec<f64>) -> Option<Line> {
    let ((from, spread), (to, to_spread)) = (centre(from)?, centre(to)?);
    let slope = match spread > 0.0 {
        true => to_spread / spread,
        false => 1.0,
    };
    let line = Line { from, to, slope };
    slope.is_finite().then_some(line)
}

/// Median and MAD of finite values.
fn centre(values: Vec<f64>) -> Option<(f64, f64)> {
    let n = values.len() as u64;
    let values: InMemory = values.into_iter().collect();
    let Ok(order) = OrderStatistics::find(&values, n, &[], 0);
    let median = order.median()?;
    let distances = Distances {
        values: &values,
        centre: median,
    };
    let Ok(order) = OrderStatistics::find(&distances, n, &[], 0);
    Some((median, order.median()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_takes_centre_and_spread_over() {
        let from = vec![1.0, 2.0, 3.0, 4.0, 100.0];
        let to = from.iter().map(|x| 10.0 + 3.0 * x).collect();
        let found = line(from, to).unwrap();
        assert_eq!((found.at(3.0), found.at(5.0)), (19.0, 25.0));
        assert_eq!(line(vec![], vec![]), None);
        assert_eq!(line(vec![2.0; 3], vec![5.0; 3]).unwrap().at(3.0), 6.0);
    }
}
