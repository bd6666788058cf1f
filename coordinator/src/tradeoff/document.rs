//! `tradeoff.parquet` and `tradeoff.json`: one row per point, and everything.

use std::io::Write;

use super::{PointResult, Tradeoff};
use crate::publish::encode::{self, EncodeError, Format};
use crate::publish::table::Kind::{Bool, Float64, ListUInt32, Text, UInt32, UInt64};
use crate::publish::table::{Cell, Column};
use crate::reduce::recipe::Signal;

/// Everything, for programs.
///
/// # Errors
/// When a number is not finite, which none is.
pub(super) fn json(found: &Tradeoff) -> Result<String, serde_json::Error> {
    let mut text = serde_json::to_string_pretty(found)?;
    text.push('\n');
    Ok(text)
}

/// Writes the points as columns.
///
/// # Errors
/// [`EncodeError`].
pub(super) fn parquet(found: &Tradeoff, file: &mut (dyn Write + Send)) -> Result<(), EncodeError> {
    encode::write(Format::Parquet, &columns(), &found.points, file)
}

/// The columns. Those that differ from run to run are times: `cpu_s_per_video`, `relative_cost`, `*_s`.
pub(super) fn columns() -> Vec<Column<PointResult>> {
    let mut columns = vec![
        Column::field("point", Text, |p: &PointResult| p.name.as_str().into()),
        Column::field("profile", Text, |p| p.profile.as_str().into()),
        Column::field("profile_digest", Text, |p| p.profile_digest.as_str().into()),
        Column::field("top", Bool, |p| p.top.into()),
        Column::field("working_height_px", UInt32, |p| p.working_height_px.into()),
        Column::field("finest_scale", UInt32, |p| p.finest_scale.into()),
        Column::field("edge_spans", ListUInt32, |p| (&p.edge_spans).into()),
        Column::field("scored", UInt64, |p| (p.scored as u64).into()),
        Column::field("cpu_s_per_video", Float64, |p| p.cpu_s_per_video.into()),
        Column::field("relative_cost", Float64, |p| p.relative_cost.into()),
        Column::field("decode_s", Float64, |p| p.stages_s.decode.into()),
        Column::field("flow_s", Float64, |p| p.stages_s.flow.into()),
        Column::field("signals_s", Float64, |p| p.stages_s.signals.into()),
        Column::field("geometry_s", Float64, |p| p.stages_s.geometry.into()),
        Column::field("on_front", Bool, |p| p.on_front.into()),
        Column::field("compared", UInt64, |p| (p.agreement.videos as u64).into()),
        Column::field("spearman", Float64, |p| p.agreement.spearman.into()),
        Column::field("kendall", Float64, |p| p.agreement.kendall.into()),
        Column::field("score_error_median", Float64, |p| {
            p.agreement.score_error_median.into()
        }),
        Column::field("score_error_p95", Float64, |p| {
            p.agreement.score_error_p95.into()
        }),
        Column::field("flips", UInt64, |p| p.agreement.flips.count().into()),
        Column::field("flips_of", UInt64, |p| p.agreement.flips.videos.into()),
        Column::field("flips_within_interval", UInt64, |p| {
            p.agreement.flips_within_interval.into()
        }),
        Column::field("spearman_paper", Float64, |p| by_recipe(p, "paper").into()),
        Column::field("spearman_balanced", Float64, |p| {
            by_recipe(p, "balanced").into()
        }),
        Column::field("auroc_failure", Float64, |p| {
            p.auroc_failure.map(|found| found.area).into()
        }),
        Column::field("flow_epe_px", Float64, |p| {
            p.truth.and_then(|t| t.flow_epe_px).into()
        }),
        Column::field("flow_epe_moving_px", Float64, |p| {
            p.truth.and_then(|t| t.flow_epe_moving_px).into()
        }),
        Column::field("pose_error_percent", Float64, |p| {
            p.truth.and_then(|t| t.pose_error_percent).into()
        }),
        Column::field("depth_error", Float64, |p| {
            p.truth.and_then(|t| t.depth_error).into()
        }),
        Column::field("tracked", UInt64, |p| {
            p.truth.map(|t| t.tracked as u64).into()
        }),
        Column::field("fault_auroc", Float64, |p| {
            p.faults.as_ref().and_then(|f| f.auroc).into()
        }),
        Column::field("fault_temporal_hit", Float64, |p| {
            p.faults.as_ref().and_then(|f| f.temporal_hit).into()
        }),
        Column::field("planned_cpu_s", Float64, |p| {
            p.plan.map(|plan| plan.cpu_s).into()
        }),
        Column::field("planned_wall_s", Float64, |p| {
            p.plan.map(|plan| plan.wall_s).into()
        }),
    ];
    columns.extend(Signal::ALL.into_iter().zip(BY_SIGNAL).map(|(signal, get)| {
        Column::field(&format!("spearman_{}", signal.column()), Float64, get)
    }));
    columns
}

fn by_recipe(point: &PointResult, recipe: &str) -> Option<f64> {
    point.spearman_by_recipe.get(recipe).copied().flatten()
}

/// A column's getter captures nothing, so that there is one per signal, in the order of [`Signal::ALL`].
const BY_SIGNAL: [for<'r> fn(&'r PointResult) -> Cell<'r>; 7] = [
    |p| of_signal(p, Signal::ReprojPx),
    |p| of_signal(p, Signal::AepeWorldscorePx),
    |p| of_signal(p, Signal::PiecewiseResidual),
    |p| of_signal(p, Signal::AppearanceRatio),
    |p| of_signal(p, Signal::LayerAcceleration),
    |p| of_signal(p, Signal::InteriorShear),
    |p| of_signal(p, Signal::DetailChange),
];

fn of_signal(point: &PointResult, signal: Signal) -> Cell<'_> {
    let by_signal = &point.agreement.spearman_by_signal;
    by_signal.get(signal.column()).copied().flatten().into()
}
