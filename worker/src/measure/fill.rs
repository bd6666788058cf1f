//! From what was measured to the columns of the row.

use plumbline_common::row::{GeometryMethod, Measurement, Scene, Series};
use plumbline_vision::scene::clip::series;
use plumbline_vision::scene::{ClipGeometry, ClipLayers, FrameResidual, Method, SceneKind};
use plumbline_vision::signals::arc::ArcStep;
use plumbline_vision::signals::{PairSignals, median};

use super::assess::assess;
use super::learned::{LearnedResult, consistency_3d, consistency_photometric};
use super::observers::Observed;
use crate::profile::Profile;

/// P and T of a clip are medians; fewer defined pairs are no evidence.
const MIN_DEFINED_PAIRS: usize = 3;

/// Fills in what comes from adjacent pairs (later frame and signals, in order).
pub(super) fn photometric(row: &mut Measurement, pairs: &[(u32, &PairSignals)]) {
    let series = |value: fn(&PairSignals) -> Option<f64>| -> Vec<Option<f64>> {
        pairs.iter().map(|(_, signals)| value(signals)).collect()
    };
    let undefined = vec![None; pairs.len()];
    row.series = Series {
        first_frame: pairs.first().map_or(0, |(frame, _)| *frame),
        aepe_px: series(|signals| signals.aepe_px),
        aepe_worldscore_px: series(|signals| signals.aepe_worldscore_px),
        reproj_px: undefined.clone(),
        reproj_cells: vec![0; pairs.len()],
        layer_residual_px: undefined.clone(),
        piecewise_residual: series(|signals| signals.piecewise_residual),
        appearance_ratio: series(|signals| signals.appearance_ratio),
        motion_px: series(|signals| signals.motion_px),
        layer_acceleration: undefined.clone(),
        layer_acceleration_q25: undefined.clone(),
        interior_shear: undefined.clone(),
        detail_change: undefined.clone(),
        detail_change_q25: undefined,
    };
    row.aepe_px = mean(&row.series.aepe_px);
    row.aepe_worldscore_px = mean(&row.series.aepe_worldscore_px);
    row.motion_px = mean(&row.series.motion_px);
    row.occluded_fraction = mean(&series(|signals| signals.occluded_fraction));
    row.piecewise_residual = median_of_defined(&row.series.piecewise_residual);
    row.appearance_ratio = median_of_defined(&row.series.appearance_ratio);
}

/// Fills in what the motion models say.
pub(super) fn geometric(row: &mut Measurement, geometry: &ClipGeometry, warmup_frames: u32) {
    row.scene = Some(match geometry.scene {
        SceneKind::StaticCamera => Scene::StaticCamera,
        SceneKind::Rotation => Scene::Rotation,
        SceneKind::Parallax => Scene::Parallax,
    });
    row.reproj_method = Some(match geometry.method {
        Method::TwoViewGric => GeometryMethod::TwoViewGric,
        Method::DenseAdjustment => GeometryMethod::DenseAdjustment,
    });
    row.reproj_px = Some(geometry.residual_px);
    residuals(row, &geometry.series, warmup_frames);
}

/// Fills in e_t, and the paper's assessment of it.
fn residuals(row: &mut Measurement, found: &[FrameResidual], warmup_frames: u32) {
    let mut series = Vec::with_capacity(found.len());
    for residual in found {
        series.push((residual.frame as u32, residual.residual_px));
        if let Some(place) = place(row, residual.frame) {
            row.series.reproj_px[place] = Some(residual.residual_px);
            row.series.reproj_cells[place] = u32::try_from(residual.cells).unwrap_or(u32::MAX);
        }
    }
    let assessment = assess(&series, warmup_frames);
    row.mean_error = assessment.mean_error;
    row.max_jump = assessment.max_jump;
    row.paper_peak_frame = assessment.peak_frame;
    row.peak_reliable = assessment.peak_reliable;
}

/// Fills in what learned networks found. e_t, t* and the series behind s_p are then theirs, in their units.
pub(super) fn learned(row: &mut Measurement, found: &LearnedResult, profile: &Profile) {
    if let Some(pairs) = &found.end_point_px {
        row.series.aepe_worldscore_px.fill(None);
        for &(frame, px) in pairs {
            if let Some(place) = place(row, frame as usize) {
                row.series.aepe_worldscore_px[place] = Some(px);
            }
        }
        row.aepe_worldscore_px = mean(&row.series.aepe_worldscore_px);
        row.worldscore_photometric = row.aepe_worldscore_px.map(consistency_photometric);
    }
    if let Some(edges) = &found.residuals {
        row.series.reproj_px.fill(None);
        row.series.reproj_cells.fill(0);
        residuals(row, &series(edges), profile.warmup_frames);
    }
    row.reproj_droid_px = found.reprojection_cells;
    row.worldscore_3d = found.reprojection_cells.map(consistency_3d);
    let [sea_raft, droid] = profile.models();
    let named = [("sea-raft", sea_raft), ("droid", droid)];
    let named = named
        .iter()
        .filter_map(|(name, digest)| Some(format!("{name} {}", (*digest)?)));
    row.models = Some(named.collect::<Vec<_>>().join(", ")).filter(|models| !models.is_empty());
}

/// Fills in what rigid layers leave.
pub(super) fn layers(row: &mut Measurement, layers: &ClipLayers) {
    row.layer_residual_px = layers.residual_px;
    for &(frame, residual_px) in &layers.series {
        if let Some(place) = place(row, frame) {
            row.series.layer_residual_px[place] = Some(residual_px);
        }
    }
}

/// Fills in faults, contact and the signals on steps of constant visual motion.
pub(super) fn observed(row: &mut Measurement, observed: &Observed) {
    if let Some(events) = &observed.events {
        let frames = events.iter().map(|event| event.frame as u32);
        let kinds = events.iter().map(|event| event.kind.as_str().to_owned());
        row.peak_frame = frames.clone().next();
        row.fault_frames = Some(frames.collect());
        row.fault_kinds = Some(kinds.collect());
    }
    row.contact = observed.contact.map(|contact| contact.score());
    row.layer_acceleration = observed.arc.layer_acceleration;
    row.layer_acceleration_q25 = observed.arc.layer_acceleration_q25;
    row.interior_shear = observed.arc.interior_shear;
    row.detail_change = observed.arc.detail_change;
    row.detail_change_q25 = observed.arc.detail_change_q25;
    for step in &observed.arc.steps {
        let ArcStep {
            frame,
            layer_acceleration,
            layer_acceleration_q25,
            interior_shear,
            detail_change,
            detail_change_q25,
        } = *step;
        if let Some(place) = place(row, frame) {
            row.series.layer_acceleration[place] = layer_acceleration;
            row.series.layer_acceleration_q25[place] = layer_acceleration_q25;
            row.series.interior_shear[place] = interior_shear;
            row.series.detail_change[place] = detail_change;
            row.series.detail_change_q25[place] = detail_change_q25;
        }
    }
}

/// Where a frame stands in the series; none outside it.
fn place(row: &Measurement, frame: usize) -> Option<usize> {
    let place = frame.checked_sub(row.series.first_frame as usize)?;
    (place < row.series.reproj_px.len()).then_some(place)
}

fn mean(values: &[Option<f64>]) -> Option<f64> {
    let defined = values.iter().flatten();
    let (sum, count) = defined.fold((0.0, 0usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    (count > 0).then(|| sum / count as f64)
}

fn median_of_defined(values: &[Option<f64>]) -> Option<f64> {
    let mut defined: Vec<f64> = values.iter().flatten().copied().collect();
    if defined.len() < MIN_DEFINED_PAIRS {
        None
    } else {
        median(&mut defined)
    }
}
