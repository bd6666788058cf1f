//! `costs.*`: what each measurement cost. Differs from run to run, hence apart from the scores.
//! Times are wall seconds, but for `cpu_s`.

use plumbline_common::id::VideoId;
use plumbline_common::row::Cost;

use crate::collect::Record;
use crate::publish::table::Column;
use crate::publish::table::Kind::{Float64, Text, UInt32, UInt64};

/// What one video's measurement cost.
#[derive(Debug, Clone, PartialEq)]
pub struct CostRow {
    /// The video.
    pub video: VideoId,
    /// Seconds per stage.
    pub cost: Cost,
    /// Deliveries until the result, at least 1.
    pub attempts: u32,
    /// Who measured it.
    pub worker: String,
    /// The name of the profile, where a run has several: a row for each that measured the video.
    pub rung: Option<String>,
}

impl CostRow {
    /// What a record cost.
    #[must_use]
    pub fn of(record: &Record, rung: Option<String>) -> Self {
        Self {
            video: record.outcome.video.clone(),
            cost: record.outcome.cost,
            attempts: record.attempts,
            worker: record.worker.clone(),
            rung,
        }
    }
}

/// The columns of `costs.*` for these rows.
#[must_use]
pub fn cost_columns(rows: &[CostRow]) -> Vec<Column<CostRow>> {
    let mut columns: Vec<Column<CostRow>> = vec![
        Column::field("video", Text, |r| r.video.as_str().into()),
        Column::field("total_s", Float64, |r| r.cost.total_s.into()),
        Column::field("cpu_s", Float64, |r| r.cost.cpu_s.into()),
        Column::field("fetch_s", Float64, |r| r.cost.fetch_s.into()),
        Column::field("decode_s", Float64, |r| r.cost.decode_s.into()),
        Column::field("flow_s", Float64, |r| r.cost.flow_s.into()),
        Column::field("signals_s", Float64, |r| r.cost.signals_s.into()),
        Column::field("geometry_s", Float64, |r| r.cost.geometry_s.into()),
        Column::field("flow_pairs", UInt64, |r| r.cost.flow_pairs.into()),
        Column::field("flow_pairs_saved", UInt64, |r| {
            r.cost.flow_pairs_saved.into()
        }),
        Column::field("frames_repeated", UInt64, |r| r.cost.frames_repeated.into()),
        Column::field("photometric_s", Float64, |r| r.cost.photometric_s.into()),
        Column::field("tracking_s", Float64, |r| r.cost.tracking_s.into()),
        Column::field("edge_updates", UInt64, |r| r.cost.edge_updates.into()),
        Column::field("peak_memory_mib", UInt64, |r| r.cost.peak_memory_mib.into()),
        Column::field("adjustment_steps", UInt64, |r| {
            r.cost.adjustment_steps.into()
        }),
        Column::field("depth_cells", UInt64, |r| r.cost.depth_cells.into()),
        Column::field("depth_cells_saved", UInt64, |r| {
            r.cost.depth_cells_saved.into()
        }),
        Column::field("attempts", UInt32, |r| r.attempts.into()),
        Column::field("worker", Text, |r| r.worker.as_str().into()),
    ];
    if rows.iter().any(|row| row.rung.is_some()) {
        columns.push(Column::field("rung", Text, |r: &CostRow| {
            r.rung.as_deref().into()
        }));
    }
    columns
}
