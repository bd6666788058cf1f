//! sh, the detail change: how much fine texture moving surfaces gain or lose over four steps.
//!
//! D = box7 |G − Gauss₂(G)|. Points start at every cell of a kept frame and follow the chained flow;
//! one is lost when ρ there is not below 1 or it comes within the margin. sh = mean (or lower quartile)
//! of |ln((D_later(X) + 1) / (D + 1))| over points alive throughout and displaced by more than 3 px. No
//! unit.

use super::{ArcParams, CellSample, CellSummary, DetailParams};
use crate::consistency::{Evidence, NormalisedFrame};
use crate::image::{Bilinear, Plane, box_mean, gaussian_blur};

/// D of a frame, `[H, W]`, grey levels.
#[derive(Debug, Clone, PartialEq)]
pub struct DetailFrame {
    level: Plane,
}

impl DetailFrame {
    /// From the frame on the evidence grid.
    #[must_use]
    pub fn new(frame: &NormalisedFrame, params: &DetailParams) -> Self {
        let mut detail = gaussian_blur(&frame.grey, params.detail_sigma_cells);
        for (detail, grey) in detail.data.iter_mut().zip(&frame.grey.data) {
            *detail = (grey - *detail).abs();
        }
        Self {
            level: box_mean(&detail, params.detail_radius_cells),
        }
    }

    /// Width and height, cells.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.level.width, self.level.height)
    }
}

/// sh from `first` along successive `steps` to `last`; `None` with too few points, without steps, or on
/// grids of different size.
#[must_use]
pub fn detail_change<'a>(
    first: &DetailFrame,
    steps: impl IntoIterator<Item = &'a Evidence>,
    last: &DetailFrame,
    params: &ArcParams,
) -> Option<CellSummary> {
    let size = first.size();
    let steps: Vec<&Evidence> = steps.into_iter().collect();
    let fits = |step: &&Evidence| (step.width, step.height) == size;
    let px_per_cell = steps.first()?.cells_per_px.map(|cells| 1.0 / cells);
    if last.size() != size || !steps.iter().all(fits) {
        return None;
    }
    let (width, height) = size;
    let margin = params.detail.margin_cells;
    let offset = params.detail.detail_offset;
    let limit = params.detail.min_displacement_px;
    let mut sample = CellSample::default();
    for y in margin..height.saturating_sub(margin) {
        for x in margin..width.saturating_sub(margin) {
            let start = [x as f32, y as f32];
            let Some(end) = follow(start, &steps, margin) else {
                continue;
            };
            let moved = [0, 1].map(|axis| (end[axis] - start[axis]) * px_per_cell[axis]);
            if moved[0] * moved[0] + moved[1] * moved[1] <= limit * limit {
                continue;
            }
            let at = Bilinear::at(end[0], end[1], width, height);
            let before = first.level.data[y * width + x] + offset;
            let after = last.level.bilinear(at) + offset;
            sample.add(libm::logf(after / before).abs());
        }
    }
    sample.over(params.min_cells)
}

/// Where a point ends, cells; `None` once it is lost.
fn follow(mut point: [f32; 2], steps: &[&Evidence], margin: usize) -> Option<[f32; 2]> {
    for step in steps {
        let at = Bilinear::at(point[0], point[1], step.width, step.height);
        let [a, b, c, d] = at.indices;
        let rho = at.mix(step.rho[a], step.rho[b], step.rho[c], step.rho[d]);
        let [a, b, c, d] = at.indices.map(|index| step.flow_px[index]);
        for axis in [0, 1] {
            let flow = at.mix(a[axis], b[axis], c[axis], d[axis]);
            point[axis] += flow * step.cells_per_px[axis];
        }
        let least = margin as f32;
        let inside =
            |value: f32, length: usize| value >= least && value <= (length - 1) as f32 - least;
        let alive = rho < 1.0 && inside(point[0], step.width) && inside(point[1], step.height);
        if !alive {
            return None;
        }
    }
    Some(point)
}
