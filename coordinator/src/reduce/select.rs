//! Ranks, and which videos to keep.
//!
//! Videos are ranked over the whole corpus by anomaly score, ties by video id: rank 1 is the most
//! consistent; percentile = 100 (rank − 0.5)/n, against a frozen reference the share of its scores
//! that are better. The keep rule is applied within each group (all rows
//! together where there are no groups; rows without a group are a group of their own). A row without
//! a score is never ranked and goes to review.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use plumbline_common::id::VideoId;
use plumbline_common::row::Decision;

/// Percentages are kept as whole billionths of a percent, so that ⌈P% of n⌉ is exact.
const PERCENT_DECIMALS: usize = 9;
const UNITS_PER_PERCENT: u64 = 1_000_000_000;

/// How much of each group to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KeepRule {
    /// `N`: the N best.
    Best(u64),
    /// `P%`: the best ⌈P% of n⌉, n being the group's rows that have a score.
    Percent(Percent),
    /// `s<=X`: those whose anomaly score is at most X.
    AtMost(f64),
}

/// A percentage in (0, 100] with up to nine decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Percent {
    billionths: u64,
}

impl Percent {
    /// ⌈this share of n⌉.
    #[must_use]
    pub fn of(self, n: u64) -> u64 {
        let whole = u128::from(100 * UNITS_PER_PERCENT);
        // At most n, hence within u64.
        (u128::from(n) * u128::from(self.billionths)).div_ceil(whole) as u64
    }
}

/// Why a text is no keep rule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeepRuleError {
    /// None of the three forms.
    #[error(
        "'{0}' is no keep rule: give a count ('500'), a share ('30%') or a threshold ('s<=0.8')"
    )]
    Form(String),
    /// A count or share of zero.
    #[error("'{0}' keeps nothing: give a count of at least 1 or a share above 0%")]
    Nothing(String),
    /// Not in (0, 100] with at most nine decimals.
    #[error(
        "'{0}' is no share: give a number above 0 and up to 100 with at most 9 decimals, such as '12.5%'"
    )]
    Percent(String),
    /// The threshold is no finite number.
    #[error("'{0}' is no threshold: give a finite number, such as 's<=0.8'")]
    Threshold(String),
}

impl FromStr for KeepRule {
    type Err = KeepRuleError;

    fn from_str(text: &str) -> Result<Self, KeepRuleError> {
        let rule = text.trim();
        if let Some(number) = rule.strip_suffix('%') {
            return percent(number.trim_end(), rule).map(Self::Percent);
        }
        if let Some(threshold) = rule.strip_prefix('s').map(str::trim_start) {
            let number = threshold
                .strip_prefix("<=")
                .ok_or_else(|| KeepRuleError::Form(rule.to_owned()))?;
            return match number.trim().parse::<f64>() {
                Ok(x) if x.is_finite() => Ok(Self::AtMost(x + 0.0)),
                _ => Err(KeepRuleError::Threshold(rule.to_owned())),
            };
        }
        match rule.parse::<u64>() {
            Ok(0) => Err(KeepRuleError::Nothing(rule.to_owned())),
            Ok(n) => Ok(Self::Best(n)),
            Err(_) => Err(KeepRuleError::Form(rule.to_owned())),
        }
    }
}

impl KeepRule {
    /// What becomes of a row with this place and score.
    #[must_use]
    pub fn decide(&self, place: &Place, anomaly: f64) -> Decision {
        let kept = match self {
            Self::Best(n) => place.group_rank <= *n,
            Self::Percent(percent) => place.group_rank <= percent.of(place.group_size),
            Self::AtMost(most) => anomaly <= *most,
        };
        if kept { Decision::Keep } else { Decision::Drop }
    }
}

fn percent(number: &str, rule: &str) -> Result<Percent, KeepRuleError> {
    let refused = || KeepRuleError::Percent(rule.to_owned());
    let (whole, decimals) = number.split_once('.').unwrap_or((number, "0"));
    let digits = |part: &str, most: usize| {
        !part.is_empty() && part.len() <= most && part.bytes().all(|b| b.is_ascii_digit())
    };
    if !digits(whole, 3) || !digits(decimals, PERCENT_DECIMALS) {
        return Err(refused());
    }
    let whole: u64 = whole.parse().map_err(|_| refused())?;
    let decimals: u64 = format!("{decimals:0<PERCENT_DECIMALS$}")
        .parse()
        .map_err(|_| refused())?;
    match whole * UNITS_PER_PERCENT + decimals {
        0 => Err(KeepRuleError::Nothing(rule.to_owned())),
        billionths if billionths <= 100 * UNITS_PER_PERCENT => Ok(Percent { billionths }),
        _ => Err(refused()),
    }
}

impl fmt::Display for Percent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (whole, rest) = (
            self.billionths / UNITS_PER_PERCENT,
            self.billionths % UNITS_PER_PERCENT,
        );
        write!(f, "{whole}")?;
        if rest > 0 {
            let decimals = format!("{rest:0PERCENT_DECIMALS$}");
            write!(f, ".{}", decimals.trim_end_matches('0'))?;
        }
        f.write_str("%")
    }
}

impl fmt::Display for KeepRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Best(n) => write!(f, "{n}"),
            Self::Percent(percent) => percent.fmt(f),
            Self::AtMost(x) => write!(f, "s<={x}"),
        }
    }
}

/// What selection needs to know of a row.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<'a> {
    /// Breaks ties; unique.
    pub video: &'a VideoId,
    /// The group it is selected within.
    pub group: Option<&'a str>,
    /// S_r; never NaN.
    pub anomaly: Option<f64>,
}

/// A row's place in the corpus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// 1 is the best of the corpus.
    pub rank: u64,
    /// Rows of the corpus that have a rank.
    pub ranked: u64,
    /// 1 is the best of its group.
    pub group_rank: u64,
    /// Rows of its group that have a rank.
    pub group_size: u64,
}

/// A row's place, and what becomes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selected {
    /// `None` for a row without a score.
    pub place: Option<Place>,
    /// Keep or drop; review without a score.
    pub decision: Decision,
}

/// Ranks and decides; one result per candidate, in the order given.
#[must_use]
pub fn select(candidates: &[Candidate<'_>], keep: &KeepRule) -> Vec<Selected> {
    let mut order: Vec<(f64, usize)> = candidates
        .iter()
        .enumerate()
        // + 0 makes −0 equal to 0, as the tie rule has it.
        .filter_map(|(i, candidate)| Some((candidate.anomaly? + 0.0, i)))
        .collect();
    order.sort_unstable_by(|a, b| {
        a.0.total_cmp(&b.0)
            .then_with(|| candidates[a.1].video.cmp(candidates[b.1].video))
    });

    let mut group_sizes: BTreeMap<Option<&str>, u64> = BTreeMap::new();
    for &(_, i) in &order {
        *group_sizes.entry(candidates[i].group).or_default() += 1;
    }
    let mut selected = vec![
        Selected {
            place: None,
            decision: Decision::Review
        };
        candidates.len()
    ];
    let mut seen: BTreeMap<Option<&str>, u64> = BTreeMap::new();
    for (before, &(anomaly, i)) in order.iter().enumerate() {
        let group = candidates[i].group;
        let group_rank = seen.entry(group).or_default();
        *group_rank += 1;
        let place = Place {
            rank: before as u64 + 1,
            ranked: order.len() as u64,
            group_rank: *group_rank,
            group_size: group_sizes.get(&group).copied().unwrap_or(0),
        };
        let decision = keep.decide(&place, anomaly);
        selected[i] = Selected {
            place: Some(place),
            decision,
        };
    }
    selected
}

impl Place {
    /// Among the rows of the corpus.
    #[must_use]
    pub fn standing(&self) -> Standing {
        Standing {
            better: self.rank as f64 - 0.5,
            of: self.ranked,
        }
    }
}

/// Where a score stands among others: how many are better, itself and its equals counted by half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// Better ones.
    pub better: f64,
    /// All of them, at least 1.
    pub of: u64,
}

impl Standing {
    /// In percent; 0 is the best.
    #[must_use]
    pub fn percentile(&self) -> f64 {
        100.0 * self.better / self.of as f64
    }

    /// The share that is worse.
    #[must_use]
    pub fn reward(&self) -> f64 {
        1.0 - self.better / self.of as f64
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn rule(text: &str) -> KeepRule {
        text.parse().unwrap()
    }

    #[test]
    fn rules_are_read_and_written() {
        for text in [
            "1",
            "500",
            "30%",
            "12.5%",
            "0.000000001%",
            "100%",
            "s<=0.8",
            "s<=-1.25",
        ] {
            assert_eq!(rule(text).to_string(), text);
        }
        assert_eq!(rule(" s <= 1e-3 ").to_string(), "s<=0.001");
        assert_eq!(rule("5.50 %").to_string(), "5.5%");
        assert_eq!(rule("s<=-0").to_string(), "s<=0");
    }

    #[test]
    fn what_is_no_rule_is_refused_with_the_remedy() {
        use KeepRuleError as E;
        let refused = |text: &str| text.parse::<KeepRule>().unwrap_err();
        for text in [
            "",
            "all",
            "-3",
            "1.5",
            "s<0.8",
            "s",
            "s=<1",
            "99999999999999999999",
        ] {
            assert_eq!(refused(text), E::Form(text.to_owned()));
        }
        for text in ["0", "0%", "0.0%"] {
            assert_eq!(refused(text), E::Nothing(text.to_owned()));
        }
        for text in [
            "%",
            ".5%",
            "5.%",
            "100.1%",
            "-5%",
            "1e1%",
            "1.0000000001%",
            "+5%",
            "NaN%",
        ] {
            assert_eq!(refused(text), E::Percent(text.to_owned()));
        }
        for text in ["s<=", "s<=x", "s<=NaN", "s<=inf", "s<=1e999"] {
            assert_eq!(refused(text), E::Threshold(text.to_owned()));
        }
        assert!(refused("half").to_string().contains("'30%'"));
    }

    /// 0.07·100 is 7.000000000000001 in floats; 7% of 100 is 7.
    #[test]
    fn shares_are_exact() {
        let of = |text: &str, n| match rule(text) {
            KeepRule::Percent(percent) => percent.of(n),
            other => panic!("{other:?}"),
        };
        assert_eq!(of("7%", 100), 7);
        assert_eq!(of("7%", 101), 8);
        assert_eq!(of("33.3%", 1000), 333);
        assert_eq!(of("100%", u64::MAX), u64::MAX);
        assert_eq!(of("0.000000001%", 1), 1);
        assert_eq!(of("50%", 0), 0);
    }

    fn run(rows: &[(&str, Option<&str>, Option<f64>)], keep: &str) -> Vec<Selected> {
        let ids: Vec<VideoId> = rows
            .iter()
            .map(|row| VideoId::new(row.0).unwrap())
            .collect();
        let candidates: Vec<Candidate<'_>> = rows
            .iter()
            .zip(&ids)
            .map(|(row, video)| Candidate {
                video,
                group: row.1,
                anomaly: row.2,
            })
            .collect();
        select(&candidates, &rule(keep))
    }

    #[test]
    fn ties_by_id_and_groups() {
        let rows = [
            ("d", Some("x"), Some(0.0)),
            ("b", Some("x"), Some(-0.0)),
            ("c", Some("y"), Some(-1.0)),
            ("a", Some("y"), None),
            ("e", None, Some(9.0)),
        ];
        let found = run(&rows, "1");
        let ranks: Vec<_> = found
            .iter()
            .map(|s| s.place.map(|p| (p.rank, p.group_rank, p.group_size)))
            .collect();
        assert_eq!(
            ranks,
            [
                Some((3, 2, 2)),
                Some((2, 1, 2)),
                Some((1, 1, 1)),
                None,
                Some((4, 1, 1))
            ]
        );
        use Decision::{Drop, Keep, Review};
        let decisions = |keep| {
            run(&rows, keep)
                .iter()
                .map(|s| s.decision)
                .collect::<Vec<_>>()
        };
        assert_eq!(decisions("1"), [Drop, Keep, Keep, Review, Keep]);
        assert_eq!(decisions("50%"), [Drop, Keep, Keep, Review, Keep]);
        assert_eq!(decisions("51%"), [Keep, Keep, Keep, Review, Keep]);
        assert_eq!(decisions("s<=0"), [Keep, Keep, Keep, Review, Drop]);
        assert_eq!(found[2].place.unwrap().standing().percentile(), 12.5);
        assert!(run(&[], "1").is_empty());
    }

    proptest! {
        #[test]
        fn counts_are_as_asked(
            scores in prop::collection::vec((prop::option::of(-3_i8..3), 0_u8..3), 0..40),
            n in 1_u64..10, percent in 1_u64..=100,
        ) {
            let names: Vec<String> = (0..scores.len()).map(|i| format!("{i:03}")).collect();
            let groups = ["a", "b", "c"];
            let rows: Vec<_> = scores.iter().zip(&names)
                .map(|(&(s, g), name)| (name.as_str(), Some(groups[usize::from(g)]), s.map(f64::from)))
                .collect();
            for (g, group) in groups.into_iter().enumerate() {
                let size = scores.iter().filter(|s| usize::from(s.1) == g && s.0.is_some()).count() as u64;
                let kept = |rule: String| {
                    let found = run(&rows, &rule);
                    rows.iter().zip(&found)
                        .filter(|(row, s)| row.1 == Some(group) && s.decision == Decision::Keep).count() as u64
                };
                prop_assert_eq!(kept(n.to_string()), n.min(size));
                prop_assert_eq!(kept(format!("{percent}%")), (percent * size).div_ceil(100));
            }
            let mut ranks: Vec<u64> = run(&rows, "1").iter().filter_map(|s| s.place.map(|p| p.rank)).collect();
            ranks.sort_unstable();
            prop_assert!(ranks.iter().copied().eq(1..=ranks.len() as u64));
        }
    }
}
