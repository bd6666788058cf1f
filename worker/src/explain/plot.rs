//! The series of a clip as one picture: a panel per measure over a shared axis of frames.

use plotters::backend::BitMapBackend;
use plotters::chart::ChartBuilder;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Text};
use plotters::series::LineSeries;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, IntoFont, RGBColor, ShapeStyle};
use plumbline_vision::image::Rgb8;

use super::canvas::{DrawError, FONT, SMALL_PX, TEXT_PX, load_font};

/// Size of the picture, px.
const WIDTH_PX: u32 = 1100;
const PANEL_PX: u32 = 200;
const TITLE_PX: u32 = 40;
const FOOT_PX: u32 = 30;
/// Room for the numbers of the vertical axis.
const LABELS_PX: u32 = 64;
/// Largest severity drawn; higher ones touch the top.
pub const SEVERITY_CUT: f64 = 4.0;

const INK: RGBColor = RGBColor(34, 34, 40);
const FAINT: RGBColor = RGBColor(225, 225, 230);
const ALERT: RGBColor = RGBColor(176, 32, 32);
/// Okabe and Ito's colours, told apart by people who see few.
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(150, 110, 0),
];

/// One line: a value per frame, with gaps where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// What it is; empty for the only line of a panel.
    pub name: String,
    /// Frame and value; every value is finite.
    pub points: Vec<(u32, Option<f64>)>,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What is drawn, with its unit.
    pub title: String,
    /// At most six lines.
    pub lines: Vec<Line>,
    /// A level drawn across, with its name.
    pub level: Option<(f64, String)>,
    /// Frames marked, with the mark's name.
    pub marks: Vec<(u32, String)>,
}

/// Draws the panels over frames 0 to `last_frame`.
///
/// # Errors
/// [`DrawError`], when the drawing library fails.
pub fn series(title: &str, last_frame: u32, panels: &[Panel]) -> Result<Rgb8, DrawError> {
    load_font()?;
    let height = TITLE_PX + FOOT_PX + PANEL_PX * panels.len() as u32;
    let mut data = vec![255; (WIDTH_PX * height * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut data, (WIDTH_PX, height)).into_drawing_area();
        let style = (FONT, TEXT_PX).into_font().color(&INK);
        area.draw(&Text::new(title.to_owned(), (12, 10), style))
            .map_err(failed)?;
        let (_, rest) = area.split_vertically(TITLE_PX);
        let (body, foot) = rest.split_vertically(PANEL_PX * panels.len() as u32);
        for (panel, area) in panels.iter().zip(body.split_evenly((panels.len(), 1))) {
            draw_panel(&area, panel, last_frame)?;
        }
        let style = (FONT, SMALL_PX)
            .into_font()
            .color(&INK)
            .pos(Pos::new(HPos::Center, VPos::Top));
        let middle = (WIDTH_PX + LABELS_PX) as i32 / 2;
        foot.draw(&Text::new("frame".to_owned(), (middle, 4), style))
            .map_err(failed)?;
        area.present().map_err(failed)?;
    }
    Ok(Rgb8 {
        width: WIDTH_PX as usize,
        height: height as usize,
        data,
    })
}

fn draw_panel(
    area: &DrawingArea<BitMapBackend<'_>, Shift>,
    panel: &Panel,
    last_frame: u32,
) -> Result<(), DrawError> {
    let values = panel.lines.iter().flat_map(|line| &line.points);
    let largest = values.filter_map(|(_, value)| *value).fold(0.0, f64::max);
    let level = panel.level.as_ref().map_or(0.0, |(value, _)| *value);
    let top = match 1.12 * largest.max(level) {
        top if top > 0.0 => top,
        _ => 1.0,
    };
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(18)
        .margin_top(36)
        .x_label_area_size(20)
        .y_label_area_size(LABELS_PX)
        .build_cartesian_2d(0.0..f64::from(last_frame.max(1)), 0.0..top)
        .map_err(failed)?;
    let decimals = match top {
        top if top >= 30.0 => 0,
        top if top >= 3.0 => 1,
        top if top >= 0.3 => 2,
        top if top >= 0.03 => 3,
        _ => 4,
    };
    let small = (FONT, SMALL_PX).into_font().color(&INK);
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(FAINT.mix(0.0))
        .bold_line_style(FAINT)
        .axis_style(INK.mix(0.5))
        .x_labels(16)
        .y_labels(4)
        .x_label_formatter(&|frame| format!("{frame:.0}"))
        .y_label_formatter(&|value| format!("{value:.decimals$}"))
        .label_style(small.clone())
        .draw()
        .map_err(failed)?;
    if let Some((level, name)) = &panel.level {
        let ends = [(0.0, *level), (f64::from(last_frame.max(1)), *level)];
        chart
            .draw_series([PathElement::new(ends, ALERT.stroke_width(1))])
            .map_err(failed)?;
        let style = (FONT, SMALL_PX)
            .into_font()
            .color(&ALERT)
            .pos(Pos::new(HPos::Right, VPos::Bottom));
        chart
            .draw_series([Text::new(name.clone(), ends[1], style)])
            .map_err(failed)?;
    }
    for (frame, _) in &panel.marks {
        let x = f64::from(*frame);
        let line = PathElement::new([(x, 0.0), (x, top)], ALERT.mix(0.55).stroke_width(1));
        chart.draw_series([line]).map_err(failed)?;
    }
    for (line, colour) in panel.lines.iter().zip(COLOURS) {
        for run in line.points.split(|(_, value)| value.is_none()) {
            let points: Vec<(f64, f64)> = run
                .iter()
                .filter_map(|(frame, value)| Some((f64::from(*frame), (*value)?)))
                .collect();
            // A value between two gaps is a dot.
            if let [(x, y)] = points[..] {
                let dot = ShapeStyle::from(&colour).filled();
                chart
                    .draw_series([Circle::new((x, y), 2, dot)])
                    .map_err(failed)?;
            } else {
                chart
                    .draw_series(LineSeries::new(points, colour.stroke_width(2)))
                    .map_err(failed)?;
            }
        }
    }
    head(area, panel)
}

/// The panel's title, the names of its lines in their colours, and of its marks.
fn head(area: &DrawingArea<BitMapBackend<'_>, Shift>, panel: &Panel) -> Result<(), DrawError> {
    let style = |colour: &RGBColor| (FONT, SMALL_PX).into_font().color(colour);
    let mut x = LABELS_PX as i32 + 8;
    let mut put = |text: &str, colour: &RGBColor| -> Result<(), DrawError> {
        let size = area
            .estimate_text_size(text, &style(colour))
            .map_err(failed)?;
        area.draw(&Text::new(text.to_owned(), (x, 14), style(colour)))
            .map_err(failed)?;
        x += size.0 as i32 + 16;
        Ok(())
    };
    put(&panel.title, &INK)?;
    for (line, colour) in panel.lines.iter().zip(&COLOURS) {
        if !line.name.is_empty() {
            put(&line.name, colour)?;
        }
    }
    for (frame, name) in &panel.marks {
        put(&format!("{name} {frame}"), &ALERT)?;
    }
    Ok(())
}

pub(super) fn failed(error: impl std::fmt::Display) -> DrawError {
    DrawError::new(error)
}
