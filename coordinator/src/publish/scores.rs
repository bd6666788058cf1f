//! `scores.*`: one row per input video; the columns of design section 7, flat, in their order.
//! The series behind the means are not columns.

use plumbline_common::row::{GeometryMethod, Row, Scene};

use crate::publish::table::Kind::{Bool, Float64, ListText, ListUInt32, Text, UInt32, UInt64};
use crate::publish::table::{Cell, Column, carried_columns};
use crate::reduce::decision_name;

/// The columns of `scores.*` for these rows: ours, with the carried columns after `group`.
#[must_use]
pub fn score_columns(rows: &[Row]) -> Vec<Column<Row>> {
    let carried = carried_columns(rows.iter().map(|row| &row.carried), &own_names());
    let mut columns = identity();
    columns.extend(
        carried
            .iter()
            .map(|column| Column::carried(column, |row: &Row| &row.carried)),
    );
    columns.extend(measured());
    columns.extend(judged());
    if rows.iter().any(|row| row.rung.is_some()) {
        columns.extend(on_ladder());
    }
    columns
}

/// Names of all columns that are ours, whatever the rows: no carried column bears one of them.
#[must_use]
pub fn own_names() -> Vec<String> {
    let columns = [identity(), measured(), judged(), on_ladder()];
    columns
        .into_iter()
        .flatten()
        .map(|column| column.name)
        .collect()
}

fn identity() -> Vec<Column<Row>> {
    vec![
        Column::field("video", Text, |row| Cell::from(row.video.as_str())),
        Column::field("group", Text, |row| Cell::from(row.group.as_deref())),
    ]
}

/// What the worker says of the video alone.
fn measured() -> Vec<Column<Row>> {
    vec![
        Column::field("status", Text, |r| r.measured.status.as_str().into()),
        Column::field("status_reason", Text, |r| {
            r.measured.status_reason.as_deref().into()
        }),
        Column::field("digest", Text, |r| r.measured.digest.as_deref().into()),
        Column::field("bytes", UInt64, |r| r.measured.bytes.into()),
        Column::field("frames", UInt32, |r| r.measured.frames.into()),
        Column::field("fps", Float64, |r| r.measured.fps.into()),
        Column::field("width", UInt32, |r| r.measured.width.into()),
        Column::field("height", UInt32, |r| r.measured.height.into()),
        Column::field("duration_s", Float64, |r| r.measured.duration_s.into()),
        Column::field("scene", Text, |r| r.measured.scene.map(scene_name).into()),
        Column::field("motion_px", Float64, |r| r.measured.motion_px.into()),
        Column::field("reproj_px", Float64, |r| r.measured.reproj_px.into()),
        Column::field("reproj_method", Text, |r| {
            r.measured.reproj_method.map(method_name).into()
        }),
        Column::field("layer_residual_px", Float64, |r| {
            r.measured.layer_residual_px.into()
        }),
        Column::field("aepe_px", Float64, |r| r.measured.aepe_px.into()),
        Column::field("aepe_worldscore_px", Float64, |r| {
            r.measured.aepe_worldscore_px.into()
        }),
        Column::field("reproj_droid_px", Float64, |r| {
            r.measured.reproj_droid_px.into()
        }),
        Column::field("worldscore_3d", Float64, |r| {
            r.measured.worldscore_3d.into()
        }),
        Column::field("worldscore_photometric", Float64, |r| {
            r.measured.worldscore_photometric.into()
        }),
        Column::field("models", Text, |r| r.measured.models.as_deref().into()),
        Column::field("occluded_fraction", Float64, |r| {
            r.measured.occluded_fraction.into()
        }),
        Column::field("piecewise_residual", Float64, |r| {
            r.measured.piecewise_residual.into()
        }),
        Column::field("appearance_ratio", Float64, |r| {
            r.measured.appearance_ratio.into()
        }),
        Column::field("layer_acceleration", Float64, |r| {
            r.measured.layer_acceleration.into()
        }),
        Column::field("layer_acceleration_q25", Float64, |r| {
            r.measured.layer_acceleration_q25.into()
        }),
        Column::field("interior_shear", Float64, |r| {
            r.measured.interior_shear.into()
        }),
        Column::field("detail_change", Float64, |r| {
            r.measured.detail_change.into()
        }),
        Column::field("detail_change_q25", Float64, |r| {
            r.measured.detail_change_q25.into()
        }),
        Column::field("contact", Float64, |r| r.measured.contact.into()),
    ]
}

/// What the corpus says of it, then the absolute assessment and the origin.
fn judged() -> Vec<Column<Row>> {
    vec![
        Column::field("z_reproj_px", Float64, |r| r.z_reproj_px.into()),
        Column::field("z_aepe_worldscore_px", Float64, |r| {
            r.z_aepe_worldscore_px.into()
        }),
        Column::field("z_piecewise_residual", Float64, |r| {
            r.z_piecewise_residual.into()
        }),
        Column::field("z_appearance_ratio", Float64, |r| {
            r.z_appearance_ratio.into()
        }),
        Column::field("z_layer_acceleration_q25", Float64, |r| {
            r.z_layer_acceleration_q25.into()
        }),
        Column::field("z_interior_shear", Float64, |r| r.z_interior_shear.into()),
        Column::field("z_detail_change_q25", Float64, |r| {
            r.z_detail_change_q25.into()
        }),
        Column::field("anomaly", Float64, |r| r.anomaly.into()),
        Column::field("anomaly_lo", Float64, |r| r.anomaly_lo.into()),
        Column::field("anomaly_hi", Float64, |r| r.anomaly_hi.into()),
        Column::field("rank", UInt64, |r| r.rank.into()),
        Column::field("percentile", Float64, |r| r.percentile.into()),
        Column::field("decision", Text, |r| decision_name(r.decision).into()),
        Column::field("reward", Float64, |r| r.reward.into()),
        Column::field("peak_frame", UInt32, |r| r.measured.peak_frame.into()),
        Column::field("paper_peak_frame", UInt32, |r| {
            r.measured.paper_peak_frame.into()
        }),
        Column::field("peak_reliable", Bool, |r| r.measured.peak_reliable.into()),
        Column::field("mean_error", Float64, |r| r.measured.mean_error.into()),
        Column::field("max_jump", Float64, |r| r.measured.max_jump.into()),
        Column::field("fault_frames", ListUInt32, |r| {
            r.measured.fault_frames.as_ref().into()
        }),
        Column::field("fault_kinds", ListText, |r| {
            r.measured.fault_kinds.as_ref().into()
        }),
        Column::field("recipe", Text, |r| r.recipe.as_str().into()),
        Column::field("profile_digest", Text, |r| r.profile_digest.as_str().into()),
    ]
}

/// What a cascade says of it.
fn on_ladder() -> Vec<Column<Row>> {
    vec![
        Column::field("rung", Text, |r| r.rung.as_deref().into()),
        Column::field("flip_probability", Float64, |r| r.flip_probability.into()),
    ]
}

/// The name of a scene class in every output.
#[must_use]
pub fn scene_name(scene: Scene) -> &'static str {
    match scene {
        Scene::StaticCamera => "static_camera",
        Scene::Rotation => "rotation",
        Scene::Parallax => "parallax",
    }
}

fn method_name(method: GeometryMethod) -> &'static str {
    match method {
        GeometryMethod::TwoViewGric => "two_view_gric",
        GeometryMethod::DenseAdjustment => "dense_adjustment",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_wire() {
        for scene in [Scene::StaticCamera, Scene::Rotation, Scene::Parallax] {
            assert_eq!(serde_json::to_value(scene).unwrap(), scene_name(scene));
        }
        for method in [GeometryMethod::TwoViewGric, GeometryMethod::DenseAdjustment] {
            assert_eq!(serde_json::to_value(method).unwrap(), method_name(method));
        }
    }

    /// Design section 7, as far as this version measures it.
    const DOCUMENTED: &str = "video, group, status, status_reason, digest, bytes, frames, fps, \
        width, height, duration_s, scene, motion_px, reproj_px, reproj_method, \
        layer_residual_px, aepe_px, \
        aepe_worldscore_px, reproj_droid_px, worldscore_3d, worldscore_photometric, models, \
        occluded_fraction, piecewise_residual, appearance_ratio, \
        layer_acceleration, layer_acceleration_q25, interior_shear, detail_change, detail_change_q25, \
        contact, \
        z_reproj_px, z_aepe_worldscore_px, z_piecewise_residual, z_appearance_ratio, \
        z_layer_acceleration_q25, z_interior_shear, z_detail_change_q25, anomaly, \
        anomaly_lo, anomaly_hi, rank, percentile, decision, reward, peak_frame, paper_peak_frame, \
        peak_reliable, mean_error, max_jump, fault_frames, fault_kinds, recipe, profile_digest";

    #[test]
    fn columns_are_the_documented_ones_in_order() {
        let names: Vec<_> = score_columns(&[]).into_iter().map(|c| c.name).collect();
        assert_eq!(names.join(", "), DOCUMENTED);
    }
}
