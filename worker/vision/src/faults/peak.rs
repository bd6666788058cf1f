//! The mean and the peak of a map, and the bounds of the peak; in cells of the evidence grid.

use serde::{Deserialize, Serialize};

use super::FaultParams;
use crate::image::{Plane, box_mean};

/// Where on the evidence grid a fault is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Column and row of the peak, cells.
    pub peak: [usize; 2],
    /// Bounds of the region around it: [x0, y0, x1, y1], cells, x1 and y1 exclusive.
    pub bounds: [usize; 4],
}

/// A peak and its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    pub(super) value: f64,
    /// `None` for a map that is zero everywhere.
    pub(super) place: Option<Place>,
}

/// Mean over the cells inside the margin; 0 without any.
pub(super) fn central_mean(map: &Plane, params: &FaultParams) -> f64 {
    let margin = params.margin_cells;
    let (columns, rows) = (inner(map.width, margin), inner(map.height, margin));
    let count = columns.len() * rows.len();
    let mut sum = 0.0;
    for y in rows {
        for x in columns.clone() {
            sum += f64::from(map.data[y * map.width + x]);
        }
    }
    if count == 0 { 0.0 } else { sum / count as f64 }
}

/// The largest box mean inside the margin, the first in reading order among equals.
pub(super) fn peak(map: &Plane, params: &FaultParams) -> Peak {
    let smooth = box_mean(map, params.peak_radius_cells);
    let margin = params.margin_cells;
    let mut value = 0.0;
    let mut place = None;
    for y in inner(map.height, margin) {
        for x in inner(map.width, margin) {
            let here = smooth.data[y * map.width + x];
            if here > value {
                (value, place) = (here, Some([x, y]));
            }
        }
    }
    Peak {
        value: f64::from(value),
        place: place.map(|peak| Place {
            peak,
            bounds: bounds(&smooth, peak, value * params.bounds_share),
        }),
    }
}

/// Bounds of the 4-connected cells around `seed` that reach `least`.
fn bounds(map: &Plane, seed: [usize; 2], least: f32) -> [usize; 4] {
    let mut seen = vec![false; map.data.len()];
    let mut open = vec![seed];
    let mut bounds = [seed[0], seed[1], seed[0] + 1, seed[1] + 1];
    while let Some([x, y]) = open.pop() {
        let cell = y * map.width + x;
        if seen[cell] || map.data[cell] < least {
            continue;
        }
        seen[cell] = true;
        bounds = [
            bounds[0].min(x),
            bounds[1].min(y),
            bounds[2].max(x + 1),
            bounds[3].max(y + 1),
        ];
        if x > 0 {
            open.push([x - 1, y]);
        }
        if x + 1 < map.width {
            open.push([x + 1, y]);
        }
        if y > 0 {
            open.push([x, y - 1]);
        }
        if y + 1 < map.height {
            open.push([x, y + 1]);
        }
    }
    bounds
}

fn inner(length: usize, margin: usize) -> std::ops::Range<usize> {
    margin.min(length)..length.saturating_sub(margin).max(margin.min(length))
}
