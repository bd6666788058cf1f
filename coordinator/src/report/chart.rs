//! Charts as SVG: plotters draws them, and what it draws takes its colours from the page.
//!
//! A colour here is a name ([`Ink`]). Plotters gets a number that stands for it, and in the finished SVG
//! each number becomes the style sheet's variable, so that one drawing serves light and dark. Numbers
//! stand at the axes; names of groups and videos never enter a drawing (keys are HTML beside it), names of
//! settings do where they are safe to draw. A chart that cannot be drawn is left out, since a report never fails.

mod bars;
mod frames;
mod fronts;
mod histogram;
mod scatter;

pub(super) use bars::{Bar, bars};
pub(super) use frames::{FrameLine, FramePanel, Mark, Size, frames};
pub(crate) use fronts::fronts;
pub(super) use histogram::{Histogram, Outline, histogram};
pub(super) use scatter::{Point, marker, scatter};

use plotters::backend::SVGBackend;
use plotters::chart::ChartContext;
use plotters::coord::Shift;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::{cartesian::Cartesian2d, ranged1d::Ranged};
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::style::{Color, FontDesc, IntoFont, RGBColor};
use plumbline_worker::explain::{DrawError, FONT, load_font};

use super::axis::Axis;

/// A colour of the style sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ink {
    /// Text and what must stand out.
    Text,
    /// Less important text.
    Soft,
    /// Lines behind the data.
    Grid,
    /// Bars of the whole corpus.
    Bar,
    /// A marked place.
    Mark,
    /// One of several series.
    Series(usize),
}

/// Colours of series; further ones share the last.
pub(super) const SERIES: usize = 7;
const VARIABLES: [&str; 5 + SERIES] = [
    "ink", "soft", "grid", "bar", "mark", "s0", "s1", "s2", "s3", "s4", "s5", "s6",
];

impl Ink {
    fn index(self) -> u8 {
        match self {
            Self::Text => 0,
            Self::Soft => 1,
            Self::Grid => 2,
            Self::Bar => 3,
            Self::Mark => 4,
            Self::Series(series) => 5 + series.min(SERIES - 1) as u8,
        }
    }

    /// What stands for it while plotters draws.
    fn number(self) -> RGBColor {
        RGBColor(0xfe, 0xed, self.index())
    }
}

/// Height of text, in units of a drawing.
const TEXT: f64 = 15.0;

/// The font of numbers and short words, whose size plotters measures and the browser draws.
fn font() -> FontDesc<'static> {
    (FONT, TEXT).into_font()
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws on an area of `size` units; `None` where plotters fails.
fn drawn(
    size: (u32, u32),
    says: &str,
    draw: impl FnOnce(&Area<'_>) -> Result<(), DrawError>,
) -> Option<String> {
    load_font().ok()?;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area).ok()?;
        area.present().ok()?;
    }
    Some(themed(&svg, size, says))
}

/// Colours by name, the page's font, and words for those who do not see it.
fn themed(svg: &str, (width, height): (u32, u32), says: &str) -> String {
    // Everything after the opening tag, which plotters always writes first.
    let body = svg.split_once('>').map_or("", |(_, body)| body);
    // A mark in a key says nothing that the word beside it does not.
    let role = match says {
        "" => "aria-hidden=\"true\"".to_owned(),
        says => format!(
            "role=\"img\" aria-label=\"{}\"",
            maud::html! { (says) }.into_string()
        ),
    };
    let mut page = format!("<svg class=\"chart\" viewBox=\"0 0 {width} {height}\" {role}>\n{body}");
    for (index, variable) in VARIABLES.iter().enumerate() {
        page = page.replace(
            &format!("\"#FEED{index:02X}\""),
            &format!("\"var(--{variable})\""),
        );
    }
    // The defaults of SVG.
    for default in [
        format!(" font-family=\"{FONT}\""),
        " opacity=\"1\"".to_owned(),
        " stroke=\"none\"".to_owned(),
    ] {
        page = page.replace(&default, "");
    }
    page.trim_end().to_owned()
}

/// A picture of its own, for a file: the colours come along.
pub(super) fn standing_alone(chart: &str) -> Option<String> {
    const COLOURS: &str = include_str!("colours.css");
    let (open, body) = chart.split_once('>')?;
    Some(format!(
        "{open} xmlns=\"http://www.w3.org/2000/svg\">\n<style>\n{COLOURS}svg {{ font-family: system-ui, sans-serif; background: var(--paper); }}\n</style>{body}\n"
    ))
}

/// A number at an axis of this length: as many decimals as tell its ticks apart.
fn tick(value: f64, length: f64) -> String {
    let step = length / 6.0;
    if !(1e-4..1e5).contains(&step) || value.abs() >= 1e6 {
        return if value == 0.0 {
            "0".to_owned()
        } else {
            format!("{value:.1e}")
        };
    }
    let decimals = (-libm::floor(libm::log10(step))).clamp(0.0, 4.0) as usize;
    let label = format!("{value:.decimals$}");
    match label.trim_start_matches(['-', '0', '.']) {
        "" => label.trim_start_matches('-').to_owned(),
        _ => label,
    }
}

/// Axes with quiet lines behind the data: how many numbers stand at each, and what each is called.
struct Mesh<'t> {
    x: (Axis, usize, &'t str),
    y: (Axis, usize, &'t str),
    /// Whether lines run up from the numbers below.
    upright: bool,
}

impl Mesh<'_> {
    fn draw<X, Y>(
        &self,
        chart: &mut ChartContext<'_, SVGBackend<'_>, Cartesian2d<X, Y>>,
    ) -> Result<(), DrawError>
    where
        X: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let ((x, x_labels, x_name), (y, y_labels, y_name)) = (self.x, self.y);
        let style = font().color(&Ink::Soft.number());
        let mut mesh = chart.configure_mesh();
        if !self.upright {
            mesh.disable_x_mesh();
        }
        mesh.light_line_style(Ink::Grid.number().mix(0.0))
            .bold_line_style(Ink::Grid.number())
            .axis_style(Ink::Soft.number())
            .x_labels(x_labels)
            .y_labels(y_labels)
            .x_label_formatter(&|value| tick(*value, x.hi - x.lo))
            .y_label_formatter(&|value| tick(*value, y.hi - y.lo))
            .x_desc(x_name)
            .y_desc(y_name)
            .label_style(style.clone())
            .axis_desc_style(style)
            .draw()
            .map_err(DrawError::new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_become_variables_and_every_word_is_escaped() {
        let chart = drawn((40, 20), "<b>\"x\"", |area| {
            let line = plotters::element::PathElement::new(
                [(0, 0), (40, 20)],
                Ink::Series(99).number().stroke_width(2),
            );
            area.draw(&line).map_err(DrawError::new)
        });
        let chart = chart.unwrap();
        assert!(chart.contains("stroke=\"var(--s6)\""), "{chart}");
        assert!(
            chart.contains("aria-label=\"&lt;b&gt;&quot;x&quot;\""),
            "{chart}"
        );
        assert!(!chart.contains("FEED") && chart.ends_with("</svg>"));
        let alone = standing_alone(&chart).unwrap();
        assert!(alone.contains("prefers-color-scheme") && alone.contains("--s6:"));
    }

    #[test]
    fn ticks_have_the_decimals_that_tell_them_apart() {
        assert_eq!(tick(0.25, 1.0), "0.2");
        assert_eq!(tick(3.0, 12.0), "3");
        assert_eq!(tick(-0.0, 1.0), "0.0");
        assert_eq!(tick(0.015, 0.05), "0.015");
        assert_eq!(tick(2e7, 4e7), "2.0e7");
    }
}
