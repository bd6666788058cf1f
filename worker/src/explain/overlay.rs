//! One frame of the overlay: the frame under its end-point error, with the faults at this time.

use plumbline_vision::faults::FaultEvent;
use plumbline_vision::image::{Plane, Rgb8};

use super::canvas::{Anchor, Canvas, DrawError, LIGHT, MARK, MUTED, SMALL_PX, TEXT_PX, fitted};
use super::heat::on_picture;
use super::scale::{BAR_BLOCK_PX, Scale, digits};
use super::{Marked, pair_value};
use crate::decode::DecodedFrame;

/// Space around the parts, px.
const GAP_PX: usize = 10;
/// Rows of the lines above the picture: frame and error, then faults.
const TITLE_PX: usize = 56;
/// Narrower drawings have no room for their text.
const MIN_WIDTH_PX: usize = 560;
/// A fault of one frame is gone in a blink: its name stays this long, seconds.
const NAMED_S: f64 = 1.0;
/// Faults named at once; the most severe come first.
const NAMED: usize = 3;

/// Draws a frame. `error_px` is its end-point error against the frame before.
pub(super) fn frame(
    decoded: &DecodedFrame,
    error_px: Option<&Plane>,
    marked: &Marked,
) -> Result<Rgb8, DrawError> {
    let scale = Scale::end_point_error();
    let picture = fitted(&decoded.rgb);
    let (w, h) = (picture.width, picture.height);
    let inner = w.max(MIN_WIDTH_PX);
    let mut canvas = Canvas::new(inner + 2 * GAP_PX, TITLE_PX + h + 2 * GAP_PX + BAR_BLOCK_PX);
    let mean_px = pair_value(&marked.aepe_px, marked.first_frame, decoded.index);
    let error = match mean_px {
        Some(px) => format!("mean end-point error {} px", digits(px)),
        None => "no frame before to compare with".to_owned(),
    };
    let at = format!("frame {}   {:.2} s", decoded.index, decoded.time_s);
    canvas.text(&at, (GAP_PX, 8), Anchor::Left, TEXT_PX, LIGHT)?;
    let right = canvas.picture.width - GAP_PX;
    canvas.text(&error, (right, 8), Anchor::Right, TEXT_PX, LIGHT)?;

    let corner = ((canvas.picture.width - w) / 2, TITLE_PX);
    match error_px {
        Some(values) => canvas.place(&scale.over(&picture, values), corner),
        None => canvas.place(&picture, corner),
    }
    let index = decoded.index as usize;
    let mut names = Vec::new();
    for event in &marked.events {
        let now = (event.first_frame..=event.last_frame).contains(&index);
        if now && let (Some(place), Some(grid)) = (event.place, marked.grid_size) {
            let cells = [grid.0, grid.1, grid.0, grid.1];
            let bounds = std::array::from_fn(|k| place.bounds[k] as f64 / cells[k].max(1) as f64);
            canvas.outline(on_picture(bounds, (w, h), corner));
        }
        let began = marked.times_s.get(event.first_frame).copied();
        let ended = marked.times_s.get(event.last_frame).copied();
        let named = index >= event.first_frame
            && (now || ended.is_some_and(|ended| decoded.time_s < ended + NAMED_S));
        if named && names.len() < NAMED && began.is_some() {
            names.push(name(event));
        }
    }
    if names.is_empty() {
        let text = if marked.events.is_empty() {
            "no fault found"
        } else {
            ""
        };
        canvas.text(text, (GAP_PX, 32), Anchor::Left, SMALL_PX, MUTED)?;
    } else {
        canvas.text(
            &names.join("   "),
            (GAP_PX, 32),
            Anchor::Left,
            SMALL_PX,
            MARK,
        )?;
    }
    scale.bar(&mut canvas, [GAP_PX, right], TITLE_PX + h + GAP_PX + 4)?;
    Ok(canvas.picture)
}

fn name(event: &FaultEvent) -> String {
    let kind = event.kind.as_str().replace('_', " ");
    format!(
        "{kind} at frame {} ({} × threshold)",
        event.frame,
        digits(event.severity())
    )
}
