//! `--budget`: what was typed.

use std::fmt;
use std::str::FromStr;

use super::goal::Goal;

/// The agreement that `auto` means.
pub const DEFAULT_AGREEMENT: f64 = 0.99;

/// A budget as typed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Budget {
    /// `auto`, `agreement=99.5%`: this share of the top profile's decisions.
    Agreement(f64),
    /// `cpu=2h`: processor time of the whole run, seconds.
    Cpu(f64),
    /// `per-video=0.3s`: processor time per video of the corpus, seconds.
    PerVideo(f64),
}

impl Budget {
    /// What that is for a corpus of `videos`.
    #[must_use]
    pub fn goal(self, videos: usize) -> Goal {
        match self {
            Self::Agreement(share) => Goal::Agreement(share),
            Self::Cpu(budget_s) => Goal::Cpu(budget_s),
            Self::PerVideo(each_s) => Goal::Cpu(each_s * videos as f64),
        }
    }
}

impl FromStr for Budget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || {
            format!(
                "'{text}' is no budget: give auto, a share of equal decisions ('agreement=99.5%'), or processor time ('cpu=2h', 'per-video=0.3s'; s, min or h)"
            )
        };
        if text.trim() == "auto" {
            return Ok(Self::Agreement(DEFAULT_AGREEMENT));
        }
        let (name, value) = text.split_once('=').ok_or_else(refused)?;
        let value = value.trim();
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|n| n.is_finite());
        if name.trim() == "agreement" {
            let percent = value.strip_suffix('%').and_then(number);
            let percent = percent.filter(|percent| (50.0..=100.0).contains(percent));
            return percent
                .map(|percent| Self::Agreement(percent / 100.0))
                .ok_or_else(refused);
        }
        let units = [("min", 60.0), ("h", 3600.0), ("s", 1.0)];
        let seconds = units.iter().find_map(|(unit, seconds)| {
            let number = value.strip_suffix(unit).and_then(number)?;
            Some(number * seconds)
        });
        let seconds = seconds.filter(|seconds| seconds.is_finite() && *seconds > 0.0);
        match (name.trim(), seconds) {
            ("cpu", Some(seconds)) => Ok(Self::Cpu(seconds)),
            ("per-video", Some(seconds)) => Ok(Self::PerVideo(seconds)),
            _ => Err(refused()),
        }
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // Back from a share without the rounding of 100 × 0.995.
            Self::Agreement(share) => write!(f, "agreement={}%", (share * 1e11).round() / 1e9),
            Self::Cpu(seconds) => write!(f, "cpu={seconds}s"),
            Self::PerVideo(seconds) => write!(f, "per-video={seconds}s"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_read_and_written() {
        for (text, budget, written) in [
            ("auto", Budget::Agreement(0.99), "agreement=99%"),
            (
                "agreement=99.5%",
                Budget::Agreement(0.995),
                "agreement=99.5%",
            ),
            ("cpu=2h", Budget::Cpu(7200.0), "cpu=7200s"),
            ("cpu=1.5min", Budget::Cpu(90.0), "cpu=90s"),
            ("per-video = 0.3 s", Budget::PerVideo(0.3), "per-video=0.3s"),
        ] {
            let found: Budget = text.parse().unwrap();
            assert_eq!((found, found.to_string().as_str()), (budget, written));
        }
        for text in [
            "",
            "1h",
            "cpu",
            "cpu=",
            "cpu=2",
            "cpu=-1s",
            "cpu=0s",
            "cpu=infs",
            "cpu=NaNh",
            "gpu=1h",
            "agreement=1",
            "agreement=101%",
            "agreement=0%",
            "per-video=x s",
        ] {
            assert!(
                text.parse::<Budget>().unwrap_err().contains("cpu=2h"),
                "{text}"
            );
        }
        assert_eq!(Budget::PerVideo(0.5).goal(10), Goal::Cpu(5.0));
    }
}
