//! The last gate before statistics: a measurement with NaN or an infinity in it is a failed one.
//!
//! Such a value is a fault of the measurement, whatever its status says; one of them would spoil
//! every sum. It becomes null, and the row `failed` with the column's name as the reason. Every
//! field is named below without `..`, so that a new column does not pass unseen.

use plumbline_common::row::{Measurement, Series, Status};

/// Clears what is not finite; returns true where there was any, the row then being `failed`.
pub fn reject_non_finite(measured: &mut Measurement) -> bool {
    let Some(column) = clear_non_finite(measured) else {
        return false;
    };
    measured.status_reason = Some(rejection(
        column,
        measured.status,
        measured.status_reason.take(),
    ));
    measured.status = Status::Failed;
    true
}

/// The columns of a row that are looked at, in the order in which the first is named.
pub const CHECKED_COLUMNS: [&str; 21] = [
    "fps",
    "duration_s",
    "motion_px",
    "reproj_px",
    "layer_residual_px",
    "aepe_px",
    "aepe_worldscore_px",
    "reproj_droid_px",
    "worldscore_3d",
    "worldscore_photometric",
    "occluded_fraction",
    "piecewise_residual",
    "appearance_ratio",
    "layer_acceleration",
    "layer_acceleration_q25",
    "interior_shear",
    "detail_change",
    "detail_change_q25",
    "contact",
    "mean_error",
    "max_jump",
];

/// The reason of a row that was refused for what stood in `column`.
#[must_use]
pub fn rejection(column: &str, status: Status, reason: Option<String>) -> String {
    let status = status.as_str();
    match reason {
        Some(reason) => format!("{column} is not a finite number (was {status}: {reason})"),
        None => format!(
            "{column} is not a finite number (was {status}); measure the video again and report it if it persists"
        ),
    }
}

/// Sets non-finite values to null; the name of the first column that had one.
fn clear_non_finite(measured: &mut Measurement) -> Option<&'static str> {
    let Measurement {
        status: _,
        status_reason: _,
        digest: _,
        bytes: _,
        frames: _,
        fps,
        width: _,
        height: _,
        duration_s,
        scene: _,
        motion_px,
        reproj_px,
        reproj_method: _,
        layer_residual_px,
        aepe_px,
        aepe_worldscore_px,
        reproj_droid_px,
        worldscore_3d,
        worldscore_photometric,
        models: _,
        occluded_fraction,
        piecewise_residual,
        appearance_ratio,
        layer_acceleration,
        layer_acceleration_q25,
        interior_shear,
        detail_change,
        detail_change_q25,
        contact,
        peak_frame: _,
        fault_frames: _,
        fault_kinds: _,
        mean_error,
        max_jump,
        paper_peak_frame: _,
        peak_reliable: _,
        series,
    } = measured;
    let Series {
        first_frame: _,
        aepe_px: series_aepe_px,
        aepe_worldscore_px: series_aepe_worldscore_px,
        reproj_px: series_reproj_px,
        reproj_cells: _,
        layer_residual_px: series_layer_residual_px,
        piecewise_residual: series_piecewise_residual,
        appearance_ratio: series_appearance_ratio,
        motion_px: series_motion_px,
        layer_acceleration: series_layer_acceleration,
        layer_acceleration_q25: series_layer_acceleration_q25,
        interior_shear: series_interior_shear,
        detail_change: series_detail_change,
        detail_change_q25: series_detail_change_q25,
    } = series;
    let columns: [(&str, &mut [Option<f64>]); 33] = [
        ("fps", std::slice::from_mut(fps)),
        ("duration_s", std::slice::from_mut(duration_s)),
        ("motion_px", std::slice::from_mut(motion_px)),
        ("reproj_px", std::slice::from_mut(reproj_px)),
        ("layer_residual_px", std::slice::from_mut(layer_residual_px)),
        ("aepe_px", std::slice::from_mut(aepe_px)),
        (
            "aepe_worldscore_px",
            std::slice::from_mut(aepe_worldscore_px),
        ),
        ("reproj_droid_px", std::slice::from_mut(reproj_droid_px)),
        ("worldscore_3d", std::slice::from_mut(worldscore_3d)),
        (
            "worldscore_photometric",
            std::slice::from_mut(worldscore_photometric),
        ),
        ("occluded_fraction", std::slice::from_mut(occluded_fraction)),
        (
            "piecewise_residual",
            std::slice::from_mut(piecewise_residual),
        ),
        ("appearance_ratio", std::slice::from_mut(appearance_ratio)),
        (
            "layer_acceleration",
            std::slice::from_mut(layer_acceleration),
        ),
        (
            "layer_acceleration_q25",
            std::slice::from_mut(layer_acceleration_q25),
        ),
        ("interior_shear", std::slice::from_mut(interior_shear)),
        ("detail_change", std::slice::from_mut(detail_change)),
        ("detail_change_q25", std::slice::from_mut(detail_change_q25)),
        ("contact", std::slice::from_mut(contact)),
        ("mean_error", std::slice::from_mut(mean_error)),
        ("max_jump", std::slice::from_mut(max_jump)),
        ("series.aepe_px", series_aepe_px),
        ("series.aepe_worldscore_px", series_aepe_worldscore_px),
        ("series.reproj_px", series_reproj_px),
        ("series.layer_residual_px", series_layer_residual_px),
        ("series.piecewise_residual", series_piecewise_residual),
        ("series.appearance_ratio", series_appearance_ratio),
        ("series.motion_px", series_motion_px),
        ("series.layer_acceleration", series_layer_acceleration),
        (
            "series.layer_acceleration_q25",
            series_layer_acceleration_q25,
        ),
        ("series.interior_shear", series_interior_shear),
        ("series.detail_change", series_detail_change),
        ("series.detail_change_q25", series_detail_change_q25),
    ];
    let mut first = None;
    for (name, values) in columns {
        for value in values
            .iter_mut()
            .filter(|value| value.is_some_and(|v| !v.is_finite()))
        {
            *value = None;
            first.get_or_insert(name);
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_signal_is_checked() {
        for signal in crate::reduce::recipe::Signal::ALL {
            for column in [Some(signal.column()), signal.preferred_column()] {
                assert!(
                    column.is_none_or(|c| CHECKED_COLUMNS.contains(&c)),
                    "{signal:?}"
                );
            }
        }
    }

    #[test]
    fn non_finite_values_become_a_failure() {
        let mut measured = Measurement::without_score(Status::Scored, "");
        measured.status_reason = None;
        measured.reproj_px = Some(1.5);
        assert!(!reject_non_finite(&mut measured));
        assert_eq!(measured.status, Status::Scored);

        measured.aepe_px = Some(f64::NAN);
        measured.series.motion_px = vec![Some(1.0), Some(f64::INFINITY), None];
        assert!(reject_non_finite(&mut measured));
        assert_eq!(measured.status, Status::Failed);
        assert!(
            measured
                .status_reason
                .as_deref()
                .is_some_and(|r| r.starts_with("aepe_px is not"))
        );
        assert_eq!((measured.aepe_px, measured.reproj_px), (None, Some(1.5)));
        assert_eq!(measured.series.motion_px, [Some(1.0), None, None]);
        assert!(!reject_non_finite(&mut measured));
    }
}
