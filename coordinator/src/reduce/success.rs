//! Success rates with their standard errors (the paper's Tables 1 and 3).
//!
//! A video succeeds (1), fails (0) or partly succeeds (between); the rate is the mean over videos,
//! its standard error the sample standard deviation (ddof 1) over √n. In percent. Values that are
//! not finite are refused.

use serde::Serialize;

use super::moments::Moments;
use super::sum::NotFinite;

/// A rate and how sure it is, percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SuccessRate {
    /// Mean.
    pub percent: f64,
    /// Standard error of the mean; `None` for a single video.
    pub standard_error: Option<f64>,
    /// Videos.
    pub n: u64,
}

impl SuccessRate {
    /// The rate of these videos, one value each (repeated judgements of a video averaged before);
    /// `None` without videos.
    ///
    /// # Errors
    /// [`NotFinite`].
    pub fn of(successes: &[f64]) -> Result<Option<Self>, NotFinite> {
        let moments = Moments::of(successes)?;
        let n = moments.n();
        Ok(moments.standard().map(|standard| Self {
            percent: 100.0 * standard.mean,
            // σ (ddof 0) √(n/(n−1)) / √n
            standard_error: (n > 1).then(|| 100.0 * standard.std / ((n - 1) as f64).sqrt()),
            n,
        }))
    }

    /// How far this rate lies above another, percentage points, and the standard error of that, the
    /// two being independent.
    #[must_use]
    pub fn gain_over(&self, other: &Self) -> (f64, Option<f64>) {
        let both = self.standard_error.zip(other.standard_error);
        (
            self.percent - other.percent,
            both.map(|(a, b)| (a * a + b * b).sqrt()),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn successes(whole: usize, half: usize, n: usize) -> SuccessRate {
        let mut values = vec![1.0; whole];
        values.extend(vec![0.5; half]);
        values.resize(n, 0.0);
        SuccessRate::of(&values).unwrap().unwrap()
    }

    fn to_one_decimal(rate: &SuccessRate) -> (f64, f64) {
        let round = |x: f64| (x * 10.0).round() / 10.0;
        (round(rate.percent), round(rate.standard_error.unwrap()))
    }

    /// 50 videos, 32 whole and 2 half successes: mean 33/50 = 0.66; Σ(x − μ)² = 32 + 2/4 − 33²/50 =
    /// 10.72, sample variance 10.72/49, standard error √(10.72/49/50) = 0.0661.
    /// 38 whole and 3 half: 39.5/50 = 0.79; 38 + 3/4 − 39.5²/50 = 7.545, √(7.545/49/50) = 0.0555.
    #[test]
    fn paper_table_1() {
        let low = successes(32, 2, 50);
        assert_eq!(to_one_decimal(&low), (66.0, 6.6));
        assert!(
            (low.standard_error.unwrap() - 100.0 * (10.72_f64 / 49.0 / 50.0).sqrt()).abs() < 1e-12
        );
        let high = successes(38, 3, 50);
        assert_eq!((high.percent, high.n), (79.0, 50));
        // 5.549, which the table gives as 5.5.
        assert_eq!(to_one_decimal(&high), (79.0, 5.5));
    }

    /// Whole numbers of half successes among 500 give every mean of the table; the gain is their
    /// difference.
    #[test]
    fn paper_table_3() {
        let rates = [331, 351, 373, 395].map(|whole| successes(whole, 0, 500));
        for (rate, expected) in rates.iter().zip([66.2, 70.2, 74.6, 79.0]) {
            assert!((rate.percent - expected).abs() < 1e-12);
        }
        let (gain, error) = rates[2].gain_over(&rates[0]);
        assert!((gain - 8.4).abs() < 1e-12);
        // √(.746·.254/499 + .662·.338/499): 2.88 points. The table's ±1.1 is no such error.
        assert!((error.unwrap() - 2.88).abs() < 0.01, "{error:?}");
    }

    #[test]
    fn none_one_and_what_is_no_number() {
        assert_eq!(SuccessRate::of(&[]), Ok(None));
        assert_eq!(
            SuccessRate::of(&[1.0]).unwrap().unwrap().standard_error,
            None
        );
        assert!(SuccessRate::of(&[f64::NAN]).is_err());
    }
}
