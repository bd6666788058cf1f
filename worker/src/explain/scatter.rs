//! Points over a shared axis, panel by panel, with the front of each. The axis is whatever scale the caller
//! has chosen: places come with the marks, and ticks with their labels.

use plotters::backend::{BitMapBackend, DrawingBackend};
use plotters::chart::ChartBuilder;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, EmptyElement, PathElement, Text};
use plotters::series::LineSeries;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, IntoFont, RGBColor};
use plumbline_vision::image::Rgb8;

use super::canvas::{DrawError, FONT, SMALL_PX, TEXT_PX, load_font};
use super::plot::failed;

/// Size of a panel, px; there are two in a row.
const PANEL_PX: (u32, u32) = (620, 420);
const TITLE_PX: u32 = 44;
const LABELS_PX: u32 = 64;

/// Colours of a panel.
#[derive(Debug, Clone, Copy)]
pub struct Palette {
    /// Words and axes.
    pub ink: RGBColor,
    /// Points off the front.
    pub quiet: RGBColor,
    /// Lines behind the points.
    pub faint: RGBColor,
    /// The front and its points.
    pub front: RGBColor,
}

/// On white.
const PAPER: Palette = Palette {
    ink: RGBColor(34, 34, 40),
    quiet: RGBColor(120, 124, 132),
    faint: RGBColor(225, 225, 230),
    front: RGBColor(0, 114, 178),
};

/// A point.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// What is written beside it.
    pub name: String,
    /// Place on the horizontal axis; finite.
    pub x: f64,
    /// Finite.
    pub y: f64,
    /// Whether the panel's front goes through it.
    pub on_front: bool,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub struct ScatterPanel {
    /// What is drawn upwards, with its unit.
    pub title: String,
    /// In the order of x.
    pub marks: Vec<Mark>,
    /// Places on the horizontal axis and their labels; those beyond it are left out.
    pub ticks: Vec<(f64, String)>,
}

/// Draws the panels; `x_title` stands below each.
///
/// # Errors
/// [`DrawError`], when the drawing library fails.
pub fn scatter(title: &str, x_title: &str, panels: &[ScatterPanel]) -> Result<Rgb8, DrawError> {
    load_font()?;
    let rows = panels.len().div_ceil(2).max(1);
    let (width, height) = (2 * PANEL_PX.0, TITLE_PX + PANEL_PX.1 * rows as u32);
    let mut data = vec![255; (width * height * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut data, (width, height)).into_drawing_area();
        let style = (FONT, TEXT_PX).into_font().color(&PAPER.ink);
        area.draw(&Text::new(title.to_owned(), (16, 14), style))
            .map_err(failed)?;
        let (_, body) = area.split_vertically(TITLE_PX);
        for (panel, area) in panels.iter().zip(body.split_evenly((rows, 2))) {
            draw_panel(&area, panel, x_title, &PAPER)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(Rgb8 {
        width: width as usize,
        height: height as usize,
        data,
    })
}

/// A little more than from the smallest to the largest.
fn span(values: impl Iterator<Item = f64> + Clone, share: f64) -> (f64, f64) {
    let lo = values.clone().fold(f64::INFINITY, f64::min);
    let hi = values.fold(f64::NEG_INFINITY, f64::max);
    let pad = match (hi - lo) * share {
        pad if pad > 0.0 => pad,
        _ => lo.abs().max(1.0) * share,
    };
    (lo - pad, hi + pad)
}

/// Draws one panel on an area of any kind, whose fonts are loaded.
///
/// # Errors
/// [`DrawError`], when the drawing library fails.
pub fn draw_panel<B>(
    area: &DrawingArea<B, Shift>,
    panel: &ScatterPanel,
    x_title: &str,
    palette: &Palette,
) -> Result<(), DrawError>
where
    B: DrawingBackend,
    B::ErrorType: 'static,
{
    if panel.marks.is_empty() {
        return Ok(());
    }
    let (lo, hi) = span(panel.marks.iter().map(|mark| mark.x), 0.14);
    let (bottom, top) = span(panel.marks.iter().map(|mark| mark.y), 0.15);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(
            panel.title.clone(),
            (FONT, TEXT_PX).into_font().color(&palette.ink),
        )
        .x_label_area_size(44)
        .y_label_area_size(LABELS_PX)
        .build_cartesian_2d(lo..hi, bottom..top)
        .map_err(failed)?;
    let decimals = match top - bottom {
        size if size >= 3.0 => 1,
        size if size >= 0.1 => 2,
        _ => 3,
    };
    chart
        .configure_mesh()
        .light_line_style(palette.faint.mix(0.0))
        .bold_line_style(palette.faint)
        .axis_style(palette.ink.mix(0.5))
        .disable_x_mesh()
        .x_labels(0)
        .y_labels(6)
        .x_desc(x_title)
        .y_label_formatter(&|y| format!("{y:.decimals$}"))
        .label_style((FONT, SMALL_PX).into_font().color(&palette.ink))
        .draw()
        .map_err(failed)?;
    for (x, label) in panel.ticks.iter().filter(|(x, _)| lo < *x && *x < hi) {
        let line = PathElement::new([(*x, bottom), (*x, top)], palette.faint);
        chart.draw_series([line]).map_err(failed)?;
        let style = (FONT, SMALL_PX)
            .into_font()
            .color(&palette.ink)
            .pos(Pos::new(HPos::Center, VPos::Top));
        let name = Text::new(label.clone(), (0, 6), style);
        let placed = EmptyElement::at((*x, bottom)) + name;
        chart.plotting_area().draw(&placed).map_err(failed)?;
    }
    let front = panel.marks.iter().filter(|mark| mark.on_front);
    chart
        .draw_series(LineSeries::new(
            front.map(|mark| (mark.x, mark.y)),
            palette.front.stroke_width(2),
        ))
        .map_err(failed)?;
    let colour = |mark: &Mark| {
        if mark.on_front {
            palette.front
        } else {
            palette.quiet
        }
    };
    let dots = panel
        .marks
        .iter()
        .map(|mark| Circle::new((mark.x, mark.y), 5, colour(mark).filled()));
    chart.draw_series(dots).map_err(failed)?;
    // Names of neighbours stand on different sides.
    for (index, mark) in panel.marks.iter().enumerate() {
        let (at, offset) = match index % 2 {
            0 => (VPos::Bottom, -8),
            _ => (VPos::Top, 8),
        };
        let style = (FONT, SMALL_PX)
            .into_font()
            .color(&colour(mark))
            .pos(Pos::new(HPos::Center, at));
        let name = Text::new(mark.name.clone(), (0, offset), style);
        let placed = EmptyElement::at((mark.x, mark.y)) + name;
        chart.draw_series([placed]).map_err(failed)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mark(x: f64, y: f64, on_front: bool) -> Mark {
        Mark {
            name: format!("{x}"),
            x,
            y,
            on_front,
        }
    }

    #[test]
    fn points_the_front_and_one_point_alone_are_drawn_and_repeat() {
        let panels = [
            ScatterPanel {
                title: "order".into(),
                marks: vec![
                    mark(0.1, 0.9, true),
                    mark(0.5, 0.8, false),
                    mark(2.0, 1.0, true),
                ],
                ticks: vec![(1.0, "one".into()), (9.0, "beyond".into())],
            },
            ScatterPanel {
                title: "alone".into(),
                marks: vec![mark(1.0, 1.0, true)],
                ticks: Vec::new(),
            },
            ScatterPanel {
                title: "nothing".into(),
                marks: Vec::new(),
                ticks: Vec::new(),
            },
        ];
        let picture = scatter("title", "cost", &panels).unwrap();
        assert_eq!((picture.width, picture.height), (1240, 884));
        let pixels = |colour: RGBColor| {
            let wanted = [colour.0, colour.1, colour.2];
            picture.data.chunks(3).filter(|p| *p == wanted).count()
        };
        // A filled circle of radius 5 has about 80 pixels.
        assert!(pixels(PAPER.front) > 3 * 60, "{}", pixels(PAPER.front));
        assert!(
            (60..400).contains(&pixels(PAPER.quiet)),
            "{}",
            pixels(PAPER.quiet)
        );
        assert_eq!(picture, scatter("title", "cost", &panels).unwrap());
    }
}
