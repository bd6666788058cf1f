//! Shares of videos over bins: bars of the whole corpus, outlines of its parts and of a reference.

use plotters::chart::ChartBuilder;
use plotters::element::{DashedPathElement, Rectangle};
use plotters::series::LineSeries;
use plotters::style::Color;

use plumbline_worker::explain::DrawError;

use super::{Ink, Mesh, drawn};
use crate::report::axis::{Axis, as_float};

/// Size of a drawing, in units: about CSS pixels of a panel.
const SIZE: (u32, u32) = (400, 210);
/// Smallest height of a bar that is not empty, as a share of the highest: an outlier must show.
const LEAST: f64 = 0.012;
/// Length of a dash, and of the gap after it, in units.
const DASH: u32 = 5;

/// What is drawn. All shares are of their own population, a share per bin.
pub(in crate::report) struct Histogram<'h> {
    /// Where bins lie.
    pub(in crate::report) axis: Axis,
    /// Bars.
    pub(in crate::report) shares: &'h [f64],
    /// Lines over them.
    pub(in crate::report) outlines: &'h [Outline],
    /// A value marked by a dashed line.
    pub(in crate::report) mark: Option<f64>,
    /// Name of the axis.
    pub(in crate::report) unit: &'h str,
    /// In words.
    pub(in crate::report) says: &'h str,
}

/// Another population over the same bins.
pub(in crate::report) struct Outline {
    pub(in crate::report) ink: Ink,
    pub(in crate::report) shares: Vec<f64>,
}

/// The chart.
pub(in crate::report) fn histogram(h: &Histogram<'_>) -> Option<String> {
    let lines = h.outlines.iter().flat_map(|line| &line.shares);
    let highest = h.shares.iter().chain(lines).copied().fold(0.0, f64::max);
    if !(highest > 0.0 && h.axis.is_drawable()) {
        return None;
    }
    // Percent.
    let y = Axis::spanning(0.0, 108.0 * highest);
    let width = (h.axis.hi - h.axis.lo) / as_float(h.shares.len().max(1));
    let edge = |bin: usize| h.axis.lo + width * as_float(bin);
    drawn(SIZE, h.says, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin_right(12)
            .margin_top(6)
            .x_label_area_size(if h.unit.is_empty() { 24 } else { 42 })
            .y_label_area_size(38)
            .build_cartesian_2d(h.axis.lo..h.axis.hi, y.lo..y.hi)
            .map_err(DrawError::new)?;
        let mesh = Mesh {
            x: (h.axis, 6, h.unit),
            y: (y, 4, ""),
            upright: false,
        };
        mesh.draw(&mut chart)?;
        let bars = h
            .shares
            .iter()
            .enumerate()
            .filter(|(_, share)| **share > 0.0);
        let bars = bars.map(|(bin, share)| {
            let gap = width * 0.06;
            let top = 100.0 * share.max(highest * LEAST);
            Rectangle::new(
                [(edge(bin) + gap, 0.0), (edge(bin + 1) - gap, top)],
                Ink::Bar.number().filled(),
            )
        });
        chart.draw_series(bars).map_err(DrawError::new)?;
        for Outline { ink, shares } in h.outlines {
            let steps = shares.iter().enumerate();
            let steps = steps.flat_map(|(bin, share)| {
                [(edge(bin), 100.0 * share), (edge(bin + 1), 100.0 * share)]
            });
            chart
                .draw_series(LineSeries::new(steps, ink.number().stroke_width(2)))
                .map_err(DrawError::new)?;
        }
        if let Some(mark) = h.mark.filter(|mark| h.axis.holds(*mark)) {
            let line = DashedPathElement::new(
                [(mark, 0.0), (mark, y.hi)],
                DASH,
                DASH,
                Ink::Text.number().stroke_width(2),
            );
            chart.draw_series([line]).map_err(DrawError::new)?;
        }
        Ok(())
    })
}
