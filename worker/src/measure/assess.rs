//! The paper's absolute assessment on the residual series: e_t, j_t = |e_t − e_{t−1}|, t* = argmax j_t
//! over the frames after the warm-up. Residuals in px of a 256-px-high picture, frames 0-based.

use plumbline_vision::signals::median;

/// A jump stands out when it exceeds the median jump by this many robust standard deviations. The
/// paper's own failures (its Sora and Grok cases) have a largest jump inside the series' scatter.
const RELIABLE_DEVIATIONS: f64 = 6.0;

/// And it is at least this many times the median jump: a series that alternates between a few values
/// has a median deviation of zero, from which every jump would stand out.
const RELIABLE_RATIO: f64 = 2.0;

/// Median absolute deviation of a normal variable, inverse: makes the MAD a standard deviation.
const MAD_TO_SIGMA: f64 = 1.4826;

/// What the series says.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Assessment {
    /// Mean of e_t.
    pub(super) mean_error: Option<f64>,
    /// The largest jump after the warm-up.
    pub(super) max_jump: Option<f64>,
    /// t*.
    pub(super) peak_frame: Option<u32>,
    /// Whether it stands out.
    pub(super) peak_reliable: Option<bool>,
}

/// Assesses `series`, pairs of frame and e_t in increasing frame order; candidates are t > `warmup`.
pub(super) fn assess(series: &[(u32, f64)], warmup: u32) -> Assessment {
    if series.is_empty() {
        return Assessment::default();
    }
    let mean_error = series.iter().map(|(_, error)| error).sum::<f64>() / series.len() as f64;
    let jumps: Vec<(u32, f64)> = series
        .windows(2)
        .filter(|pair| pair[1].0 > warmup && pair[1].0 == pair[0].0 + 1)
        .map(|pair| (pair[1].0, (pair[1].1 - pair[0].1).abs()))
        .collect();
    // The first of equal jumps, so that the answer does not depend on the search.
    let peak = jumps
        .iter()
        .copied()
        .reduce(|best, jump| if jump.1 > best.1 { jump } else { best });
    let peak_reliable = peak.and_then(|(_, jump)| {
        let mut sizes: Vec<f64> = jumps.iter().map(|(_, jump)| *jump).collect();
        let centre = median(&mut sizes)?;
        let mut deviations: Vec<f64> = sizes.iter().map(|size| (size - centre).abs()).collect();
        let scatter = MAD_TO_SIGMA * median(&mut deviations)?;
        Some(jump > centre + RELIABLE_DEVIATIONS * scatter && jump > RELIABLE_RATIO * centre)
    });
    Assessment {
        mean_error: Some(mean_error),
        max_jump: peak.map(|(_, jump)| jump),
        peak_frame: peak.map(|(frame, _)| frame),
        peak_reliable,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(values: &[f64]) -> Vec<(u32, f64)> {
        values
            .iter()
            .enumerate()
            .map(|(t, &error)| (t as u32 + 1, error))
            .collect()
    }

    #[test]
    fn the_peak_is_the_largest_jump_after_the_warm_up() {
        // Frames 1..=12; the jump at frame 3 is larger but inside the warm-up, j_8 uses e_7.
        let mut values = [1.0; 12];
        values[2] = 9.0;
        values[9] = 3.0;
        values[5] = 1.1;
        let found = assess(&series(&values), 7);
        assert_eq!(found.peak_frame, Some(10));
        assert_eq!(found.max_jump, Some(2.0));
        assert_eq!(found.peak_reliable, Some(true));
        assert_eq!(assess(&series(&values), 2).peak_frame, Some(3));
    }

    #[test]
    fn a_jump_inside_the_scatter_is_not_reliable() {
        let values: Vec<f64> = (0..30).map(|t| f64::from(t * 7 % 11)).collect();
        assert_eq!(assess(&series(&values), 7).peak_reliable, Some(false));
    }

    #[test]
    fn missing_frames_give_no_jump_and_short_series_no_peak() {
        assert_eq!(assess(&[(8, 1.0), (10, 5.0)], 7).peak_frame, None);
        assert_eq!(assess(&series(&[1.0, 2.0]), 7).mean_error, Some(1.5));
        assert_eq!(assess(&[], 7), Assessment::default());
    }
}
