//! The series of one video over its input frames, with marked frames.

use plotters::chart::ChartBuilder;
use plotters::element::{Circle, PathElement, Text};
use plotters::series::LineSeries;
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plumbline_worker::explain::DrawError;

use super::{Area, Ink, Mesh, TEXT, drawn, font};
use crate::report::axis::Axis;

/// Points drawn per line; a longer one shows the maximum of each stretch, so that no peak is lost.
const POINTS: usize = 240;

/// How large and how thorough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::report) enum Size {
    /// On a card: 320 units wide, no names of axes.
    Small,
    /// On its own: 760 units wide.
    Large,
}

/// One set of axes.
pub(in crate::report) struct FramePanel {
    /// What is drawn, with its unit.
    pub(in crate::report) title: String,
    /// Lines over one axis.
    pub(in crate::report) lines: Vec<FrameLine>,
    pub(in crate::report) marks: Vec<Mark>,
}

/// A marked frame with the name of the mark.
pub(in crate::report) type Mark = (u32, String, Ink);

/// One value per frame, from `first` on.
pub(in crate::report) struct FrameLine {
    pub(in crate::report) name: &'static str,
    pub(in crate::report) ink: Ink,
    pub(in crate::report) first: u32,
    pub(in crate::report) values: Vec<Option<f64>>,
}

/// The chart of all panels, one below the other, over frames 0 to `last`.
pub(in crate::report) fn frames(
    panels: &[FramePanel],
    last: u32,
    size: Size,
    says: &str,
) -> Option<String> {
    let (width, height) = match size {
        Size::Small => (320, 110),
        Size::Large => (760, 190),
    };
    let count = u32::try_from(panels.len())
        .ok()
        .filter(|count| *count > 0)?;
    drawn((width, height * count), says, |area| {
        for (panel, area) in panels.iter().zip(area.split_evenly((panels.len(), 1))) {
            draw(&area, panel, last.max(1), size)?;
        }
        Ok(())
    })
}

fn draw(area: &Area<'_>, panel: &FramePanel, last: u32, size: Size) -> Result<(), DrawError> {
    let values = || {
        panel
            .lines
            .iter()
            .flat_map(|line| line.values.iter().flatten())
    };
    let highest = values()
        .copied()
        .filter(|value| value.is_finite())
        .fold(0.0, f64::max);
    let y = Axis::spanning(0.0, if highest > 0.0 { 1.1 * highest } else { 1.0 });
    let x = Axis::spanning(0.0, f64::from(last));
    if !y.is_drawable() {
        return Ok(());
    }
    let large = size == Size::Large;
    let mut chart = ChartBuilder::on(area)
        .margin_right(10)
        .margin_top(if large { 28 } else { 8 })
        .x_label_area_size(22)
        .y_label_area_size(44)
        .build_cartesian_2d(x.lo..x.hi, y.lo..y.hi)
        .map_err(DrawError::new)?;
    let (across, up) = if large { (14, 4) } else { (6, 3) };
    Mesh {
        x: (x, across, ""),
        y: (y, up, ""),
        upright: false,
    }
    .draw(&mut chart)?;
    for (index, (frame, _, ink)) in panel.marks.iter().enumerate() {
        // Marks of one frame share its height, so that none covers another.
        let of_frame = |marks: &[Mark]| marks.iter().filter(|mark| mark.0 == *frame).count();
        let part = y.hi / of_frame(&panel.marks) as f64;
        let (at, low) = (
            f64::from(*frame),
            part * of_frame(&panel.marks[..index]) as f64,
        );
        let line = PathElement::new([(at, low), (at, low + part)], ink.number().stroke_width(2));
        chart.draw_series([line]).map_err(DrawError::new)?;
    }
    for line in &panel.lines {
        let style = line.ink.number().stroke_width(2);
        for run in thinned(line).split(Option::is_none) {
            let points: Vec<(f64, f64)> = run.iter().flatten().copied().collect();
            // A value between two gaps is a dot.
            if let [point] = points[..] {
                let dot = Circle::new(point, 2, line.ink.number().filled());
                chart.draw_series([dot]).map_err(DrawError::new)?;
            } else {
                chart
                    .draw_series(LineSeries::new(points, style))
                    .map_err(DrawError::new)?;
            }
        }
    }
    if large { head(area, panel) } else { Ok(()) }
}

/// The title, the lines' names in their colours, and the marks'.
fn head(area: &Area<'_>, panel: &FramePanel) -> Result<(), DrawError> {
    let width = area.dim_in_pixel().0 as i32;
    let mut x = 44;
    let marks = panel.marks.iter();
    let marks = marks.map(|(frame, name, ink)| (format!("{name} {frame}"), *ink));
    let names = panel.lines.iter().filter(|line| !line.name.is_empty());
    let names = names.map(|line| (line.name.to_owned(), line.ink));
    let words = [(panel.title.clone(), Ink::Text)]
        .into_iter()
        .chain(names)
        .chain(marks);
    for (word, ink) in words {
        let style = font()
            .color(&ink.number())
            .pos(Pos::new(HPos::Left, VPos::Top));
        let size = area
            .estimate_text_size(&word, &style)
            .map_err(DrawError::new)?
            .0 as i32;
        // What has no room is left out; the page lists it all.
        if x + size > width {
            break;
        }
        area.draw(&Text::new(word, (x, (TEXT / 2.0) as i32), style))
            .map_err(DrawError::new)?;
        x += size + 14;
    }
    Ok(())
}

/// At most [`POINTS`] points; `None` where the line breaks.
fn thinned(line: &FrameLine) -> Vec<Option<(f64, f64)>> {
    let stretch = line.values.len().div_ceil(POINTS).max(1);
    let mut points = Vec::new();
    for (index, values) in line.values.chunks(stretch).enumerate() {
        let first = index * stretch;
        let finite = values
            .iter()
            .enumerate()
            .filter_map(|(k, value)| Some((k, (*value)?)));
        let finite = finite.filter(|(_, value)| value.is_finite());
        let highest = finite.max_by(|a, b| a.1.total_cmp(&b.1));
        points.push(highest.map(|(k, value)| {
            (
                f64::from(line.first) + super::super::axis::as_float(first + k),
                value,
            )
        }));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(values: Vec<Option<f64>>) -> FrameLine {
        FrameLine {
            name: "e",
            ink: Ink::Series(0),
            first: 2,
            values,
        }
    }

    #[test]
    fn a_line_breaks_at_gaps_and_keeps_its_peak_when_thinned() {
        let gap = thinned(&line(vec![Some(1.0), None, Some(f64::NAN), Some(3.0)]));
        assert_eq!(gap, [Some((2.0, 1.0)), None, None, Some((5.0, 3.0))]);
        let mut long = vec![Some(0.1); 5_000];
        long[2_501] = Some(10.0);
        let points = thinned(&line(long));
        assert!(points.len() <= POINTS);
        assert!(points.contains(&Some((2_503.0, 10.0))));
    }

    #[test]
    fn marks_are_drawn_and_named() {
        let panel = FramePanel {
            title: "e_t, px".to_owned(),
            lines: vec![line(vec![Some(1.0), Some(2.0)])],
            marks: vec![(3, "t* =".to_owned(), Ink::Mark)],
        };
        let chart = frames(&[panel], 9, Size::Large, "errors").unwrap();
        assert!(
            chart.contains("t* = 3") && chart.contains("var(--mark)") && chart.contains("e_t, px")
        );
        assert_eq!(frames(&[], 9, Size::Large, ""), None);
    }

    #[test]
    fn marks_of_one_frame_share_its_height() {
        let panel = FramePanel {
            title: String::new(),
            lines: vec![line(vec![Some(1.0), Some(2.0)])],
            marks: vec![(3, String::new(), Ink::Mark), (3, String::new(), Ink::Text)],
        };
        let chart = frames(&[panel], 9, Size::Small, "").unwrap();
        let ends_of = |ink: &str| -> Vec<&str> {
            let element = chart.split('<').rfind(|element| element.contains(ink));
            let points = element.unwrap().split("points=\"").nth(1).unwrap();
            points.split(['"', ' ']).take(2).collect()
        };
        let (lower, upper) = (ends_of("var(--mark)"), ends_of("var(--ink)"));
        assert_eq!(lower[1], upper[0]);
        assert_ne!(lower[0], upper[1]);
    }
}
