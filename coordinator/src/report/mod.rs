//! `report.html`: one self-contained page that says what was scored, how to read it, who is worst
//! and best and where, and on what grounds.
//!
//! Inline CSS and SVG, the ranked videos' pictures as `data:` addresses, the rows as a block of JSON, and
//! one inline script that sorts and filters them and opens a video (rankings, charts and totals are there
//! without it). What is loaded when it comes into view lies beside the page ([`beside`]), and a content
//! policy forbids every other request. All text is escaped by maud. The page is bounded whatever the
//! corpus: tables, points, series and pictures are capped, and each cap says so on the page. Rendering
//! cannot fail; equal input gives equal bytes. Pixel figures are pixels of a 256-px-high picture.

pub(crate) mod axis;
pub mod beside;
mod cascade;
pub(crate) mod chart;
mod clip;
mod data;
mod distribution;
mod drift;
mod evaluation;
mod facet;
mod faults;
mod measures;
mod motion;
mod overview;
pub(crate) mod page;
pub mod player;
mod provenance;
mod ranking;
mod spreads;
pub mod state;
mod statuses;
mod table;
pub(crate) mod text;

#[cfg(test)]
pub(crate) mod fixture;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::message::Thumbnails;
use plumbline_common::row::{Row, Status};

use crate::evaluate::Evaluation;
use crate::publish::{CorpusFile, CostRow};
use crate::reduce::recipe::Signal;
use crate::reduce::reference::Frozen;
use beside::BesideReport;

/// Videos shown at each end of the ranking unless the caller says otherwise.
pub const DEFAULT_RANKED: usize = 12;

/// What the report is about, before the source's name.
const SCORES_OF: &str = "Physical consistency of";

/// Everything the report is made of.
pub struct ReportInput<'a> {
    /// What was scored, as the reader calls it.
    pub title: &'a str,
    /// The statistics.
    pub corpus: &'a CorpusFile,
    /// One row per input video.
    pub rows: &'a [Row],
    /// Pictures of a video at its peak frame, asked for the ranked videos only.
    pub thumbnails: &'a dyn Fn(&VideoId) -> Option<Thumbnails>,
    /// Larger pictures of some videos: files beside the report, which is whole without them.
    pub heat_maps: &'a BTreeMap<VideoId, String>,
    /// Files of videos beside the report.
    pub beside: &'a BesideReport,
    /// The address of a video as seen from the report, where it can be played from there.
    pub player: &'a dyn Fn(&VideoId) -> Option<String>,
    /// What the rows were scored against, where it was a frozen reference.
    pub reference: Option<&'a Frozen>,
    /// What the run cost; a report with costs differs from run to run.
    pub costs: Option<CostSummary>,
    /// Options of the run, as name and value, for the record.
    pub options: &'a [(String, String)],
    /// Videos shown at each end of the ranking.
    pub ranked: usize,
}

/// Seconds spent, summed over all measurements.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CostSummary {
    /// Measurements.
    pub videos: u64,
    /// Deliveries beyond the first.
    pub retries: u64,
    /// Wall time of all measurements.
    pub total_s: f64,
    /// Reading and decoding.
    pub decode_s: f64,
    /// Optical flow.
    pub flow_s: f64,
    /// End-point errors and signals.
    pub signals_s: f64,
    /// Motion models.
    pub geometry_s: f64,
}

impl CostSummary {
    /// Sums the costs of a run.
    #[must_use]
    pub fn of(costs: &[CostRow]) -> Self {
        let mut sum = Self::default();
        for row in costs {
            sum.videos += 1;
            sum.retries += u64::from(row.attempts.saturating_sub(1));
            sum.total_s += row.cost.total_s;
            sum.decode_s += row.cost.decode_s;
            sum.flow_s += row.cost.flow_s;
            sum.signals_s += row.cost.signals_s;
            sum.geometry_s += row.cost.geometry_s;
        }
        sum
    }
}

/// The page.
#[must_use]
pub fn render(input: &ReportInput<'_>) -> String {
    let judged = Judged::of(input.rows);
    let listed = data::listed(input.rows);
    let sections = [
        overview::section(input),
        cascade::section(input),
        ranking::worst(input, &judged),
        table::section(input, &listed),
        faults::section(input.rows),
        spreads::section(input, &judged),
        distribution::section(&judged),
        motion::section(&judged),
        drift::section(input.corpus),
        measures::section(input),
        ranking::best(input, &judged),
        statuses::section(input.rows),
        provenance::section(input),
    ];
    let data = (!listed.is_empty()).then(|| data::block(input, &listed));
    page::assemble(SCORES_OF, input.title, sections, data.as_deref())
}

/// The report with the section that says how scores and judgements agree, in place of an earlier one;
/// a page of that section alone where there is no report of ours.
#[must_use]
pub fn with_evaluation(report: Option<&str>, evaluation: &Evaluation) -> String {
    let added = report.and_then(|report| evaluation::added_to(report, evaluation));
    added.unwrap_or_else(|| {
        let bare = page::assemble(SCORES_OF, &evaluation.scores, [], None);
        evaluation::added_to(&bare, evaluation).unwrap_or(bare)
    })
}

/// The report with the evaluation that an earlier one shows, where it does.
#[must_use]
pub fn keeping_evaluation(earlier: &str, report: String) -> String {
    evaluation::taken_over(earlier, &report).unwrap_or(report)
}

/// The column that each signal's values are of: DROID-SLAM's where rows have it.
fn signal_columns(rows: &[Row]) -> [(Signal, &'static str); Signal::ALL.len()] {
    let by_droid = rows
        .iter()
        .any(|row| row.measured.reproj_droid_px.is_some());
    Signal::ALL.map(|signal| {
        let preferred = signal.preferred_column().filter(|_| by_droid);
        (signal, preferred.unwrap_or(signal.column()))
    })
}

/// A row that has an anomaly score.
#[derive(Clone, Copy)]
pub(crate) struct Scored<'a> {
    row: &'a Row,
    anomaly: f64,
}

/// The rows that have a score, the worst first; ties by video, as in the ranks.
pub(crate) struct Judged<'a> {
    worst_first: Vec<Scored<'a>>,
    /// Groups by size, the largest first, ties by name; a single `None` without groups.
    groups: Vec<(Option<&'a str>, usize)>,
}

impl<'a> Judged<'a> {
    fn of(rows: &'a [Row]) -> Self {
        let mut worst_first: Vec<Scored<'a>> = rows
            .iter()
            .filter(|row| row.measured.status == Status::Scored)
            .filter_map(|row| {
                let anomaly = row.anomaly.filter(|anomaly| anomaly.is_finite())?;
                Some(Scored { row, anomaly })
            })
            .collect();
        worst_first.sort_by(|a, b| {
            b.anomaly
                .total_cmp(&a.anomaly)
                .then_with(|| b.row.video.cmp(&a.row.video))
        });
        let groups = facet::sizes(&worst_first, facet::group);
        Self {
            worst_first,
            groups,
        }
    }

    fn grouped(&self) -> bool {
        self.groups.iter().any(|(name, _)| name.is_some())
    }
}
