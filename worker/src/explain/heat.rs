//! A heat map beside the frame it lies on, with its scale.

use plumbline_vision::faults::{FaultKind, KeptMap};
use plumbline_vision::image::{Plane, Rgb8, box_mean};
use plumbline_vision::scene::AdjustedEdge;

use super::canvas::{Anchor, Canvas, DrawError, LIGHT, MUTED, SMALL_PX, TEXT_PX, fitted};
use super::scale::{BAR_BLOCK_PX, Scale, digits};
use crate::profile::Profile;

/// Space around and between the parts, px.
const GAP_PX: usize = 10;
/// Rows of the two lines above the pictures.
const TITLE_PX: usize = 52;
/// Narrower drawings have no room for their text.
const MIN_WIDTH_PX: usize = 640;

/// The end-point error of a frame against the one before; a plane on the frame's view.
pub(super) fn end_point_error(
    frame: u32,
    time_s: f64,
    rgb: &Rgb8,
    error_px: &Plane,
    mean_px: Option<f64>,
) -> Result<Rgb8, DrawError> {
    let title = format!("end-point error at frame {frame} ({time_s:.2} s)");
    let mean = mean_px.map_or(String::new(), |px| format!("; mean {} px", digits(px)));
    let about = format!("where forward and backward flow disagree with the frame before{mean}");
    drawing(
        &title,
        &about,
        rgb,
        error_px,
        &Scale::end_point_error(),
        None,
    )
}

/// What the best rigid camera and scene leave on one edge; drawn on the frame whose cells it follows.
pub(super) fn rigid_residual(
    edge: &AdjustedEdge,
    time_s: f64,
    rgb: &Rgb8,
) -> Result<Rgb8, DrawError> {
    let (from, to) = (edge.from_frame, edge.to_frame);
    let title = format!("rigid residual from frame {from} ({time_s:.2} s) to frame {to}");
    let mean = edge
        .mean_px()
        .map_or(String::new(), |px| format!("; mean {} px", digits(px)));
    let about = format!("what the best rigid camera and scene do not explain{mean}");
    let shown = |residual: &Option<f32>| residual.unwrap_or(0.0);
    let values = Plane {
        width: edge.columns,
        height: edge.rows,
        data: edge.map_px.iter().map(shown).collect(),
    };
    let most = values.data.iter().fold(0.0f32, |most, &v| most.max(v));
    let name = "rigid residual, px of a 256-px-high picture".to_owned();
    let scale = Scale::up_to(most, name, None);
    drawing(&title, &about, rgb, &values, &scale, None)
}

/// A detector's map, smoothed as its peak is searched, with the peak's bounds.
pub(super) fn fault(
    kept: &KeptMap,
    time_s: f64,
    rgb: &Rgb8,
    profile: &Profile,
) -> Result<Rgb8, DrawError> {
    let smooth = box_mean(&kept.map, profile.faults.peak_radius_cells);
    let full = smooth.data.iter().fold(0.0f32, |most, &v| most.max(v));
    let name = kept.kind.as_str().replace('_', " ");
    let threshold = profile.fault_thresholds.of(kept.kind);
    let severity = threshold
        .filter(|threshold| *threshold > 0.0)
        .map(|threshold| format!(": {} × its threshold", digits(kept.point.score / threshold)))
        .unwrap_or_default();
    let title = format!(
        "{name} at frame {} ({time_s:.2} s){severity}",
        kept.point.frame
    );
    // The threshold of a detector that takes the map's mean is not on the map's scale.
    let is_mean = matches!(kept.kind, FaultKind::BadFrame | FaultKind::Jump);
    let scale = Scale::up_to(
        full,
        format!("{} (no unit)", meaning(kept.kind)),
        threshold.filter(|_| !is_mean).map(|t| t as f32),
    );
    let about = if is_mean {
        format!(
            "score {} = mean of the map before smoothing",
            digits(kept.point.score)
        )
    } else {
        format!(
            "score {} = largest value of the map",
            digits(kept.point.score)
        )
    };
    let bounds = kept.point.place.map(|place| {
        let cells = [smooth.width, smooth.height, smooth.width, smooth.height];
        std::array::from_fn(|k| place.bounds[k] as f64 / cells[k] as f64)
    });
    drawing(&title, &about, rgb, &smooth, &scale, bounds)
}

/// What a map's values say.
fn meaning(kind: FaultKind) -> &'static str {
    match kind {
        FaultKind::BadFrame => "change against both neighbours, less the change between them",
        FaultKind::Jump => "change of appearance along the flow, both ways",
        FaultKind::Appear => "lasting change of a still surface",
        FaultKind::Vanish => "texture lost for good where nothing moves",
        FaultKind::Flicker => "change on every one of four pairs",
        FaultKind::Freeze => "standstill",
    }
}

/// Frame and heat map side by side (above each other for wide pictures). `bounds` are shares of width
/// and height: [x0, y0, x1, y1].
fn drawing(
    title: &str,
    about: &str,
    rgb: &Rgb8,
    values: &Plane,
    scale: &Scale,
    bounds: Option<[f64; 4]>,
) -> Result<Rgb8, DrawError> {
    let frame = fitted(rgb);
    let heat = scale.over(&frame, values);
    let (w, h) = (frame.width, frame.height);
    let stacked = w > 2 * h;
    let (columns, rows) = if stacked { (1, 2) } else { (2, 1) };
    let inner = (columns * w + (columns - 1) * GAP_PX).max(MIN_WIDTH_PX);
    let height = TITLE_PX + rows * (h + GAP_PX) + GAP_PX + BAR_BLOCK_PX;
    let mut canvas = Canvas::new(inner + 2 * GAP_PX, height);
    canvas.text(title, (GAP_PX, 8), Anchor::Left, TEXT_PX, LIGHT)?;
    canvas.text(about, (GAP_PX, 30), Anchor::Left, SMALL_PX, MUTED)?;
    let x = (canvas.picture.width - (columns * w + (columns - 1) * GAP_PX)) / 2;
    let second = if stacked {
        (x, TITLE_PX + h + GAP_PX)
    } else {
        (x + w + GAP_PX, TITLE_PX)
    };
    for (picture, (x, y)) in [(&frame, (x, TITLE_PX)), (&heat, second)] {
        canvas.place(picture, (x, y));
        if let Some(bounds) = bounds {
            canvas.outline(on_picture(bounds, (w, h), (x, y)));
        }
    }
    let bar_y = TITLE_PX + rows * (h + GAP_PX) + 4;
    let right = canvas.picture.width - GAP_PX;
    scale.bar(&mut canvas, [GAP_PX, right], bar_y)?;
    Ok(canvas.picture)
}

/// Bounds as shares of a picture, on the canvas where the picture lies at `(x, y)`.
pub(super) fn on_picture(
    bounds: [f64; 4],
    (width, height): (usize, usize),
    (x, y): (usize, usize),
) -> [usize; 4] {
    let at = |share: f64, length: usize| (share * length as f64).round().max(0.0) as usize;
    let x0 = x + at(bounds[0], width);
    let y0 = y + at(bounds[1], height);
    [
        x0,
        y0,
        (x + at(bounds[2], width)).max(x0 + 4),
        (y + at(bounds[3], height)).max(y0 + 4),
    ]
}
