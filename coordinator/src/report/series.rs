//! The two error series of a clip as a sparkline: e_t (reprojection) and the end-point error, each
//! on its own scale from zero, over input frames.

use std::fmt::Write as _;

use maud::{Markup, html};
use plumbline_common::row::Measurement;

use super::axis::as_float;
use super::text;

const WIDTH: f64 = 320.0;
const HEIGHT: f64 = 56.0;
/// Room above the highest point, for the stroke.
const MARGIN: f64 = 3.0;
/// Points drawn per series; longer ones show the maximum of each bucket, so that no peak is lost.
const POINTS: usize = 160;

/// The sparkline with its legend; nothing without a series.
pub(super) fn sparkline(measured: &Measurement) -> Markup {
    let series = &measured.series;
    let lines = [
        ("a", "reproj.", &series.reproj_px),
        ("b", "end-point", &series.aepe_px),
    ];
    let frames = lines.iter().map(|line| line.2.len()).max().unwrap_or(0);
    if frames < 2 {
        return html! {};
    }
    let first = series.first_frame;
    let last = u64::from(first) + u64::try_from(frames - 1).unwrap_or(0);
    let peak = measured.paper_peak_frame.and_then(|frame| {
        let steps = frame.checked_sub(first)?;
        (u64::from(frame) <= last).then(|| WIDTH * f64::from(steps) / as_float(frames - 1))
    });
    html! {
        figure.spark {
            svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } preserveAspectRatio="none" role="img"
                aria-label={ "Errors over frames " (first) " to " (last) } {
                path.base d={ "M0 " (HEIGHT) "H" (WIDTH) } {}
                @if let Some(x) = peak { path.peak d={ "M" (tenth(x)) " 0V" (HEIGHT) } {} }
                @for (class, _, values) in &lines {
                    @if let Some(max) = maximum(values) {
                        path class=(class) d=(path(values, frames, max)) {}
                    }
                }
            }
            figcaption {
                @for (class, label, values) in &lines {
                    @if let Some(max) = maximum(values) {
                        span class=(class) { (label) " 0–" (text::magnitude(Some(max))) " px" }
                    }
                }
                span.frames { "frames " (first) "–" (last) }
            }
        }
    }
}

fn maximum(values: &[Option<f64>]) -> Option<f64> {
    values
        .iter()
        .flatten()
        .copied()
        .filter(|value| value.is_finite())
        .max_by(f64::total_cmp)
}

/// A line over the frames, broken where the value is missing.
fn path(values: &[Option<f64>], frames: usize, max: f64) -> String {
    let bucket = values.len().div_ceil(POINTS).max(1);
    let scale = if max > 0.0 { max } else { 1.0 };
    let mut data = String::new();
    let mut drawing = false;
    for (index, bucket_values) in values.chunks(bucket).enumerate() {
        let Some(value) = maximum(bucket_values) else {
            drawing = false;
            continue;
        };
        let middle = as_float(index * bucket) + as_float(bucket_values.len() - 1) / 2.0;
        let x = WIDTH * middle / as_float(frames - 1);
        let y = HEIGHT - (value / scale).clamp(0.0, 1.0) * (HEIGHT - MARGIN);
        let command = if drawing { 'L' } else { 'M' };
        // Writing to a string cannot fail. A lone point becomes a dot by its round cap.
        let _ = write!(data, "{command}{} {}", tenth(x), tenth(y));
        if !drawing {
            data.push_str("h0");
        }
        drawing = true;
    }
    data
}

/// A coordinate in tenths of a unit: finer than the eye, short in the file.
pub(super) fn tenth(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_breaks_at_gaps_and_keeps_its_peak_when_thinned() {
        let values = [Some(1.0), None, Some(2.0), Some(0.0)];
        assert_eq!(path(&values, 4, 2.0), "M0 29.5h0M213.3 3h0L320 56");

        let mut long = vec![Some(0.1); 5_000];
        long[2_500] = Some(10.0);
        let data = path(&long, long.len(), 10.0);
        assert!(data.contains(" 3L"), "the peak reaches the top");
        assert!(data.matches('L').count() < POINTS);
    }
}
