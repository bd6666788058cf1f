//! From values to colours, and the bar that says which is which.

use colorous::INFERNO;
use plumbline_vision::image::{Plane, Rgb8, resize_plane};

use super::canvas::{Anchor, Canvas, DrawError, LIGHT, MARK, MUTED, SMALL_PX};

/// End-point error at the bright end, px of a 256-px-high picture: WorldScore's failure threshold, as in
/// the report's pictures.
const END_POINT_FULL_PX: f32 = 5.0;

/// A frame under a heat map keeps this share of its brightness...
const FRAME_SHARE: f32 = 0.5;
/// ...and dark frames are lifted by this much, so that they can still be made out.
const FRAME_LIFT: f32 = 28.0;
/// The heat covers the frame from this share of the scale on; below it the frame shines through.
const COVER_SHARE: f32 = 0.33;
/// How much of the frame it covers there.
const COVER: f32 = 0.88;

/// Height of a bar, px.
const BAR_PX: usize = 14;
/// Rows that a bar needs with its numbers and its name.
pub(super) const BAR_BLOCK_PX: usize = BAR_PX + 48;

/// A linear scale from zero.
pub(super) struct Scale {
    full: f32,
    name: String,
    ticks: Vec<(f32, String)>,
    mark: Option<(f32, String)>,
}

impl Scale {
    /// Of end-point errors.
    pub(super) fn end_point_error() -> Self {
        let ticks = (0..=END_POINT_FULL_PX as u32)
            .map(|px| (px as f32, px.to_string()))
            .map(|(px, text)| {
                if px < END_POINT_FULL_PX {
                    (px, text)
                } else {
                    (px, format!("≥ {text}"))
                }
            });
        Self {
            full: END_POINT_FULL_PX,
            name: "end-point error, px of a 256-px-high picture".to_owned(),
            ticks: ticks.collect(),
            mark: None,
        }
    }

    /// From 0 to `full`, with a mark at `threshold` where it lies on the scale.
    pub(super) fn up_to(full: f32, name: String, threshold: Option<f32>) -> Self {
        let full = if full > 0.0 { full } else { 1.0 };
        Self {
            full,
            name,
            ticks: round_ticks(full),
            mark: threshold
                .filter(|threshold| *threshold <= full)
                .map(|threshold| (threshold, "threshold".to_owned())),
        }
    }

    /// `frame` in dimmed grey under the heat of `values`, which cover the same view.
    pub(super) fn over(&self, frame: &Rgb8, values: &Plane) -> Rgb8 {
        let (width, height) = (frame.width, frame.height);
        let values = resize_plane(values, width, height);
        let grey = frame.grey();
        let mut data = Vec::with_capacity(width * height * 3);
        for (value, grey) in values.data.iter().zip(&grey.data) {
            let share = (value / self.full).clamp(0.0, 1.0);
            let cover = COVER * (share / COVER_SHARE).min(1.0);
            let under = FRAME_LIFT + FRAME_SHARE * grey;
            let colour = INFERNO.eval_continuous(f64::from(share)).as_array();
            data.extend(colour.map(|c| {
                let mixed = cover * f32::from(c) + (1.0 - cover) * under;
                mixed.round().clamp(0.0, 255.0) as u8
            }));
        }
        Rgb8 {
            width,
            height,
            data,
        }
    }

    /// Draws the bar with its numbers and its name, from `x0` to `x1` at `y`.
    pub(super) fn bar(
        &self,
        canvas: &mut Canvas,
        [x0, x1]: [usize; 2],
        y: usize,
    ) -> Result<(), DrawError> {
        let span = x1.saturating_sub(x0).max(1);
        for x in x0..x1 {
            let share = (x - x0) as f64 / (span - 1).max(1) as f64;
            let colour = INFERNO.eval_continuous(share).as_array();
            canvas.fill([x, y, x + 1, y + BAR_PX], colour);
        }
        let at = |value: f32| x0 + ((value / self.full) * (span - 1) as f32).round() as usize;
        for (value, text) in &self.ticks {
            let x = at(*value);
            canvas.fill([x, y + BAR_PX, x + 1, y + BAR_PX + 4], MUTED);
            // Numbers at the ends stay on the bar.
            let anchor = match value / self.full {
                share if share < 0.02 => Anchor::Left,
                share if share > 0.97 => Anchor::Right,
                _ => Anchor::Centre,
            };
            canvas.text(text, (x, y + BAR_PX + 6), anchor, SMALL_PX, LIGHT)?;
        }
        let name_y = y + BAR_PX + 26;
        canvas.text(&self.name, (x0, name_y), Anchor::Left, SMALL_PX, MUTED)?;
        if let Some((value, text)) = &self.mark {
            let x = at(*value);
            canvas.fill([x.saturating_sub(1), y - 3, x + 1, y + BAR_PX + 3], MARK);
            canvas.text(text, (x1, name_y), Anchor::Right, SMALL_PX, MARK)?;
        }
        Ok(())
    }
}

/// 0 and the multiples of 1, 2 or 5 times a power of ten below `full`, three to seven of them.
fn round_ticks(full: f32) -> Vec<(f32, String)> {
    let most = f64::from(full) / 3.0;
    let power = most.log10().floor();
    let ten = 10f64.powf(power);
    let step = [5.0, 2.0, 1.0]
        .into_iter()
        .map(|factor| factor * ten)
        .find(|step| *step <= most)
        .unwrap_or(ten);
    let decimals = if step < 1.0 {
        (-power).clamp(0.0, 9.0) as usize
    } else {
        0
    };
    let count = (f64::from(full) / step) as u32;
    (0..=count)
        .map(|k| f64::from(k) * step)
        .map(|value| (value as f32, format!("{value:.decimals$}")))
        .collect()
}

/// Three significant digits.
pub(super) fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs().log10().floor() as i32;
    let decimals = (2 - magnitude).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_significant_digits() {
        let shown = [0.0, 0.012345, 1.0, 12.34, 1234.6].map(digits);
        assert_eq!(shown, ["0", "0.0123", "1.00", "12.3", "1235"]);
    }

    #[test]
    fn ticks_are_round_and_lie_on_the_scale() {
        let texts = |full| {
            round_ticks(full)
                .into_iter()
                .map(|tick| tick.1)
                .collect::<Vec<_>>()
        };
        assert_eq!(texts(2.12), ["0.0", "0.5", "1.0", "1.5", "2.0"]);
        assert_eq!(texts(0.037), ["0.00", "0.01", "0.02", "0.03"]);
        assert_eq!(texts(43.0), ["0", "10", "20", "30", "40"]);
        for full in [1e-6, 0.3, 1.0, 6.9, 1234.0] {
            let ticks = round_ticks(full);
            assert!((3..=8).contains(&ticks.len()), "{full}: {ticks:?}");
            assert!(ticks.iter().all(|(value, _)| *value <= full * 1.000_1));
        }
    }

    /// Heat is brightest where the value is, and the frame is still told from black where it is not,
    /// however dark the frame.
    #[test]
    fn the_heat_stands_out_of_dark_and_bright_frames() {
        for grey in [0, 128, 255] {
            let frame = Rgb8 {
                width: 64,
                height: 32,
                data: vec![grey; 64 * 32 * 3],
            };
            let values = Plane::from_fn(32, 16, |x, _| if x < 16 { 0.0 } else { 5.0 });
            let shown = Scale::end_point_error().over(&frame, &values);
            let light = |x: usize| -> u32 {
                let at = (16 * 64 + x) * 3;
                shown.data[at..at + 3].iter().map(|&c| u32::from(c)).sum()
            };
            assert!(light(4) >= 60 && light(60) > light(4) + 100, "{grey}");
        }
    }
}
