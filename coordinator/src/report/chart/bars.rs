//! A few named shares as bars with their standard errors.

use plotters::chart::ChartBuilder;
use plotters::element::{PathElement, Rectangle, Text};
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use plumbline_worker::explain::DrawError;

use super::{Ink, Mesh, drawn, font};
use crate::report::axis::{Axis, as_float};

/// Units of width per bar, and of height.
const BAR: u32 = 110;
const HEIGHT: u32 = 240;

/// One share.
pub(in crate::report) struct Bar<'b> {
    pub(in crate::report) name: &'b str,
    pub(in crate::report) percent: f64,
    /// In the same unit.
    pub(in crate::report) standard_error: Option<f64>,
}

/// The chart.
pub(in crate::report) fn bars(bars: &[Bar<'_>], says: &str) -> Option<String> {
    let count = u32::try_from(bars.len()).ok().filter(|count| *count > 0)?;
    let (x, y) = (
        Axis::spanning(0.0, as_float(bars.len())),
        Axis::spanning(0.0, 100.0),
    );
    drawn((60 + BAR * count, HEIGHT), says, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin_right(8)
            .margin_top(20)
            .x_label_area_size(26)
            .y_label_area_size(46)
            .build_cartesian_2d(x.lo..x.hi, y.lo..y.hi)
            .map_err(DrawError::new)?;
        Mesh {
            x: (x, 0, ""),
            y: (y, 5, ""),
            upright: false,
        }
        .draw(&mut chart)?;
        let named = |ink: Ink, vertical| {
            font()
                .color(&ink.number())
                .pos(Pos::new(HPos::Center, vertical))
        };
        for (index, bar) in bars.iter().enumerate() {
            let (left, middle) = (as_float(index), as_float(index) + 0.5);
            let top = bar.percent.clamp(0.0, 100.0);
            let filled = Ink::Bar.number().filled();
            chart
                .draw_series([Rectangle::new(
                    [(left + 0.2, 0.0), (left + 0.8, top)],
                    filled,
                )])
                .map_err(DrawError::new)?;
            let mut above = top;
            if let Some(error) = bar.standard_error {
                let ends = [(top - error).max(0.0), (top + error).min(100.0)];
                above = ends[1];
                let ink = Ink::Text.number().stroke_width(2);
                let caps = ends.map(|end| vec![(middle - 0.06, end), (middle + 0.06, end)]);
                let lines = [vec![(middle, ends[0]), (middle, ends[1])]]
                    .into_iter()
                    .chain(caps);
                chart
                    .draw_series(lines.map(|line| PathElement::new(line, ink)))
                    .map_err(DrawError::new)?;
            }
            let (at, above) = chart.backend_coord(&(middle, above));
            let value = format!("{:.1}%", bar.percent);
            let value = Text::new(value, (at, above - 5), named(Ink::Text, VPos::Bottom));
            area.draw(&value).map_err(DrawError::new)?;
            let (at, below) = chart.backend_coord(&(middle, 0.0));
            let name = Text::new(
                bar.name.to_owned(),
                (at, below + 6),
                named(Ink::Text, VPos::Top),
            );
            area.draw(&name).map_err(DrawError::new)?;
        }
        Ok(())
    })
}
