//! How one point's scores and decisions compare with the top point's, on the same videos.
//!
//! Each point's rows are reduced by themselves: no statistic is shared between profiles. Compared are videos
//! that have a score at both points; decisions are compared for all.

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Row};
use serde::Serialize;

use crate::agreement::{Flips, decisions, kendall, score_error, spearman};
use crate::reduce::auroc::{Auroc, auroc};
use crate::reduce::recipe::Signal;
use crate::reduce::select::{Candidate, KeepRule};

/// Agreement with the top point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Videos with a score at both.
    pub videos: usize,
    /// Spearman's ρ of the anomaly scores.
    pub spearman: Option<f64>,
    /// Kendall's τ-b of them.
    pub kendall: Option<f64>,
    /// Median |difference| of the scores, in units of the score.
    pub score_error_median: Option<f64>,
    /// 95% quantile of it.
    pub score_error_p95: Option<f64>,
    /// Keep/drop decisions that differ.
    pub flips: Flips,
    /// Of those, the ones whose video the top point itself does not place for sure: its interval reaches
    /// across the cut of its group.
    pub flips_within_interval: u64,
    /// Spearman's ρ of each measure, by column.
    pub spearman_by_signal: BTreeMap<&'static str, Option<f64>>,
}

/// Compares rows (by video, the same videos) with the top point's.
pub(super) fn compare(rows: &[Row], top: &[Row], keep: &KeepRule) -> Agreement {
    let anomalies = pairs(rows, top, |row| row.anomaly);
    let error = score_error(&anomalies);
    let [own, tops] = [rows, top].map(|rows| decisions(&candidates(rows), keep));
    let open = top.iter().zip(&tops).zip(uncertain(top, keep));
    let within = open.zip(&own).filter(|(((_, a), open), b)| *open && a != b);
    Agreement {
        videos: anomalies.len(),
        spearman: spearman(&anomalies),
        kendall: kendall(&anomalies),
        score_error_median: error.map(|error| error.median),
        score_error_p95: error.map(|error| error.p95),
        flips: Flips::between(&own, &tops),
        flips_within_interval: within.count() as u64,
        spearman_by_signal: Signal::ALL
            .into_iter()
            .map(|signal| {
                let values = pairs(rows, top, |row| signal.of(&row.measured));
                (signal.column(), spearman(&values))
            })
            .collect(),
    }
}

/// For each row whether its interval reaches across its group's cut: the middle between the worst score
/// kept and the best one dropped.
pub(super) fn uncertain(rows: &[Row], keep: &KeepRule) -> Vec<bool> {
    let decided = decisions(&candidates(rows), keep);
    let mut cuts: BTreeMap<Option<&str>, (f64, f64)> = BTreeMap::new();
    for (row, decision) in rows.iter().zip(&decided) {
        let Some(anomaly) = row.anomaly else { continue };
        let cut = cuts
            .entry(row.group.as_deref())
            .or_insert((f64::NEG_INFINITY, f64::INFINITY));
        match decision {
            Decision::Keep => cut.0 = cut.0.max(anomaly),
            Decision::Drop => cut.1 = cut.1.min(anomaly),
            Decision::Review => {}
        }
    }
    rows.iter()
        .map(|row| {
            let interval = row.anomaly_lo.zip(row.anomaly_hi);
            let cut = cuts.get(&row.group.as_deref());
            let (Some((lo, hi)), Some(&(kept, dropped))) = (interval, cut) else {
                return false;
            };
            // Where all are kept, or all dropped, there is no cut to reach across.
            kept.is_finite() && dropped.is_finite() && {
                let middle = kept / 2.0 + dropped / 2.0;
                lo <= middle && middle <= hi
            }
        })
        .collect()
}

/// How well the scores foretell failure: anomaly of videos labelled 0 above that of videos labelled 1.
pub(super) fn foretells(rows: &[Row], labels: &BTreeMap<VideoId, f64>) -> Option<Auroc> {
    let of = |wanted: f64| -> Vec<f64> {
        rows.iter()
            .filter(|row| labels.get(&row.video) == Some(&wanted))
            .filter_map(|row| row.anomaly)
            .collect()
    };
    auroc(&of(0.0), &of(1.0), [0; 32])
}

fn candidates(rows: &[Row]) -> Vec<Candidate<'_>> {
    rows.iter()
        .map(|row| Candidate {
            video: &row.video,
            group: row.group.as_deref(),
            anomaly: row.anomaly,
        })
        .collect()
}

/// The values of the videos that have one on both sides.
fn pairs(rows: &[Row], top: &[Row], of: impl Fn(&Row) -> Option<f64>) -> Vec<(f64, f64)> {
    let scored = |row: &Row| (row.anomaly.is_some()).then(|| of(row)).flatten();
    rows.iter()
        .zip(top)
        .filter_map(|(row, top)| scored(row).zip(scored(top)))
        .filter(|(a, b)| a.is_finite() && b.is_finite())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
    use crate::reduce::{MeasuredVideo, PAPER_BINS, ReduceOptions, reduce};
    use plumbline_common::row::{Measurement, Status};

    fn rows(values: &[f64]) -> Vec<Row> {
        let videos = values.iter().enumerate().map(|(k, &value)| {
            let mut measurement = Measurement::without_score(Status::Scored, "");
            measurement.reproj_px = Some(value);
            measurement.aepe_worldscore_px = Some(value * value);
            MeasuredVideo {
                video: VideoId::new(format!("{k}.mp4")).unwrap(),
                group: None,
                carried: serde_json::Map::new(),
                measurement,
            }
        });
        let options = ReduceOptions {
            recipe: Recipe::Paper,
            bins: PAPER_BINS,
            range: Range::Full,
            keep: "50%".parse().unwrap(),
            profile_digest: String::new(),
            normalise_within: NormaliseWithin::Corpus,
            reference: None,
        };
        reduce(videos.collect(), &options).rows
    }

    #[test]
    fn scale_is_no_difference_and_order_is() {
        let keep = "50%".parse().unwrap();
        let top = rows(&[1.0, 2.0, 3.0, 4.0]);
        let same = compare(&rows(&[10.0, 20.0, 30.0, 40.0]), &top, &keep);
        // Sums of ranks round.
        for one in [same.spearman, same.kendall] {
            assert!((one.unwrap() - 1.0).abs() < 1e-12, "{one:?}");
        }
        assert_eq!((same.videos, same.flips.count()), (4, 0));
        assert!(same.score_error_p95.unwrap() < 1e-12);
        assert!((same.spearman_by_signal["reproj_px"].unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(same.spearman_by_signal["piecewise_residual"], None);
        // The second and the third change places across the cut.
        let other = compare(&rows(&[1.0, 3.0, 2.0, 4.0]), &top, &keep);
        assert_eq!(other.flips.count(), 2);
        assert!((other.spearman.unwrap() - 0.8).abs() < 1e-12);
    }

    #[test]
    fn intervals_across_the_cut_are_uncertain() {
        let keep = "50%".parse().unwrap();
        let mut top = rows(&[1.0, 2.0, 3.0, 4.0]);
        let cut = (top[1].anomaly.unwrap() + top[2].anomaly.unwrap()) / 2.0;
        for (row, reach) in top.iter_mut().zip([0.0, 9.0, 0.1, 0.0]) {
            let anomaly = row.anomaly.unwrap();
            (row.anomaly_lo, row.anomaly_hi) = (Some(anomaly - reach), Some(anomaly + reach));
        }
        assert!(top[2].anomaly_lo.unwrap() > cut);
        assert_eq!(uncertain(&top, &keep), [false, true, false, false]);
        assert_eq!(uncertain(&top, &"100%".parse().unwrap()), [false; 4]);
        let found = compare(&rows(&[1.0, 3.0, 2.0, 4.0]), &top, &keep);
        assert_eq!((found.flips.count(), found.flips_within_interval), (2, 1));
    }

    #[test]
    fn labels_of_failure_lie_above_those_of_success() {
        let rows = rows(&[1.0, 2.0, 3.0, 4.0]);
        let label = |name: &str, value| (VideoId::new(name).unwrap(), value);
        let labels = [
            label("0.mp4", 1.0),
            label("2.mp4", 0.5),
            label("3.mp4", 0.0),
        ];
        let found = foretells(&rows, &labels.into()).unwrap();
        assert_eq!((found.area, found.positives, found.negatives), (1.0, 1, 1));
        assert_eq!(foretells(&rows, &BTreeMap::new()), None);
    }
}
