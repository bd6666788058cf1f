//! Rulers: how far a value lies from its corpus, in units of the corpus' spread.
//!
//! The paper's signals are measured by z = (s − μ)/σ with population σ; the motion-balanced ones by
//! the robust z = (s − median)/MAD clipped to [−3, 6] (evidence.md section 2). Where the spread is
//! zero, z is 0 and the signal is degenerate. No unit. Nothing fails.

use serde::{Deserialize, Serialize};

use super::moments::Standard;

/// Robust z-scores are clipped: below −3 a clip is as good as can be told, and above 6 one signal
/// alone must not decide more.
const ROBUST_Z_RANGE: (f64, f64) = (-3.0, 6.0);

/// Median and median absolute deviation (unscaled).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobustStandard {
    /// The median.
    pub median: f64,
    /// The median of |s − median|.
    pub mad: f64,
}

impl RobustStandard {
    /// True where MAD = 0: at least half of the values are equal.
    #[must_use]
    pub fn is_degenerate(&self) -> bool {
        self.mad == 0.0
    }

    /// (value − median)/MAD clipped to [−3, 6], and 0 where MAD = 0.
    #[must_use]
    pub fn z(&self, value: f64) -> f64 {
        if self.is_degenerate() {
            return 0.0;
        }
        let z = deviation(value, self.median) / self.mad;
        z.clamp(ROBUST_Z_RANGE.0, ROBUST_Z_RANGE.1) + 0.0
    }
}

/// value − median; a difference beyond the largest float counts as that, so that no quotient is NaN.
fn deviation(value: f64, median: f64) -> f64 {
    (value - median).clamp(-f64::MAX, f64::MAX)
}

/// What a signal is measured with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ruler {
    /// No row has the signal.
    Absent,
    /// By mean and standard deviation.
    Standard(Standard),
    /// By median and MAD.
    Robust(RobustStandard),
}

impl Ruler {
    /// The value's z; `None` where there is nothing to compare with.
    #[must_use]
    pub fn z(&self, value: f64) -> Option<f64> {
        match self {
            Self::Absent => None,
            Self::Standard(standard) => Some(standard.z(value)),
            Self::Robust(robust) => Some(robust.z(value)),
        }
    }

    /// True where there are values, but no spread between them.
    #[must_use]
    pub fn is_degenerate(&self) -> bool {
        match self {
            Self::Absent => false,
            Self::Standard(standard) => standard.is_degenerate(),
            Self::Robust(robust) => robust.is_degenerate(),
        }
    }

    /// True where the numbers can be those of some values: what was read from a file may be anything.
    #[must_use]
    pub(super) fn is_usable(&self) -> bool {
        match self {
            Self::Absent => true,
            Self::Standard(standard) => standard.is_usable(),
            Self::Robust(robust) => {
                robust.median.is_finite() && robust.mad.is_finite() && robust.mad >= 0.0
            }
        }
    }

    /// True where the signal tells rows apart.
    #[must_use]
    pub fn tells(&self) -> bool {
        !matches!(self, Self::Absent) && !self.is_degenerate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::histogram::median_of_sorted;

    /// The slow twin: everything sorted.
    fn robust(values: &[f64]) -> RobustStandard {
        let middle = |mut values: Vec<f64>| {
            values.sort_unstable_by(f64::total_cmp);
            median_of_sorted(&values).unwrap()
        };
        let median = middle(values.to_vec());
        let mad = middle(values.iter().map(|&v| deviation(v, median).abs()).collect());
        RobustStandard { median, mad }
    }

    #[test]
    fn robust_z_is_clipped() {
        // Median 3, deviations 2 1 0 1 97: MAD 1.
        let r = robust(&[1.0, 2.0, 3.0, 4.0, 100.0]);
        assert_eq!(
            r,
            RobustStandard {
                median: 3.0,
                mad: 1.0
            }
        );
        assert_eq!([r.z(2.5), r.z(-9.0), r.z(100.0)], [-0.5, -3.0, 6.0]);
    }

    #[test]
    fn degenerate_and_extreme_values() {
        let equal = robust(&[2.0, 2.0, 2.0, 5.0]);
        assert!(equal.is_degenerate());
        assert_eq!(equal.z(5.0), 0.0);
        let wide = robust(&[-f64::MAX, -f64::MAX, f64::MAX]);
        assert!(wide.is_degenerate());
        let wide = robust(&[-f64::MAX, f64::MAX]);
        assert_eq!((wide.z(-f64::MAX), wide.z(f64::MAX)), (-1.0, 1.0));
        let tiny = robust(&[0.0, 5e-324, 1e-323]);
        assert_eq!(
            [tiny.z(0.0), tiny.z(1e-323), tiny.z(f64::MAX)],
            [-1.0, 1.0, 6.0]
        );
        assert_eq!(Ruler::Absent.z(1.0), None);
    }
}
