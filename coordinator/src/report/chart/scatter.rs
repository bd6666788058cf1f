//! Two values of each video against each other, by series.

use plotters::backend::SVGBackend;
use plotters::chart::ChartBuilder;
use plotters::element::{Circle, Cross, DynElement, IntoDynElement, TriangleMarker};
use plotters::style::{Color, ShapeStyle};

use plumbline_worker::explain::DrawError;

use super::{Ink, Mesh, drawn};
use crate::report::axis::Axis;

/// Size of a drawing, in units.
const SIZE: (u32, u32) = (900, 420);
/// Half the size of a mark.
const MARK: i32 = 4;

/// One video.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Point {
    pub(in crate::report) x: f64,
    pub(in crate::report) y: f64,
    pub(in crate::report) series: usize,
}

/// The chart; points beyond the axes stand at their ends.
pub(in crate::report) fn scatter(
    points: &[Point],
    (x, x_name): (Axis, &str),
    (y, y_name): (Axis, &str),
    says: &str,
) -> Option<String> {
    if !(x.is_drawable() && y.is_drawable()) {
        return None;
    }
    drawn(SIZE, says, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin_right(12)
            .margin_top(8)
            .x_label_area_size(42)
            .y_label_area_size(58)
            .build_cartesian_2d(x.lo..x.hi, y.lo..y.hi)
            .map_err(DrawError::new)?;
        let mesh = Mesh {
            x: (x, 10, x_name),
            y: (y, 8, y_name),
            upright: true,
        };
        mesh.draw(&mut chart)?;
        let marks = points.iter().map(|point| {
            let place = (point.x.clamp(x.lo, x.hi), point.y.clamp(y.lo, y.hi));
            mark(point.series, place)
        });
        chart.draw_series(marks).map_err(DrawError::new)?;
        Ok(())
    })
}

/// The mark of a series alone, for a key.
pub(in crate::report) fn marker(series: usize) -> Option<String> {
    drawn((14, 14), "", |area| {
        area.draw(&mark(series, (7, 7))).map_err(DrawError::new)
    })
}

/// A mark of its own per series, so that colour is not alone in telling them apart.
fn mark<'b, C: Clone + 'static>(series: usize, at: C) -> DynElement<'static, SVGBackend<'b>, C> {
    let ink = Ink::Series(series).number().mix(0.75);
    let (filled, hollow): (ShapeStyle, ShapeStyle) = (ink.filled(), ink.stroke_width(2));
    match series {
        0 => Circle::new(at, MARK, filled).into_dyn(),
        1 => TriangleMarker::new(at, MARK + 2, filled).into_dyn(),
        2 => Cross::new(at, MARK, hollow).into_dyn(),
        3 => Circle::new(at, MARK, hollow).into_dyn(),
        4 => TriangleMarker::new(at, MARK + 2, hollow).into_dyn(),
        5 => Circle::new(at, MARK + 2, hollow).into_dyn(),
        _ => Circle::new(at, MARK - 2, filled).into_dyn(),
    }
}
