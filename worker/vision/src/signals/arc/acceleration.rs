//! accs, the layer acceleration: what is left of the next step's flow once each neighbourhood's common
//! change of speed and of direction is taken out.
//!
//! With F the step's flow and G the next step's, looked up at x + F:
//! d = (|F| + |G|)/2 + 1; counted k: F consistent, ρ of the next step at x + F below 1, d > 2;
//! α = clip(box(k G·F) / (box(k |F|²) + 0.2), −2, 3); S = G − α F;
//! H = S − box(k S) / (box(k) + 0.001); accs = mean (or lower quartile) over k of min(|H| / d, 4). No
//! unit.

use super::{ArcParams, CellSample, CellSummary, end_point};
use crate::consistency::Evidence;
use crate::image::{Bilinear, Plane, box_mean};

/// accs of two successive steps, the later on the grid of the earlier's second frame; `None` with too
/// few counted cells or on grids of different size.
#[must_use]
pub fn layer_acceleration(
    step: &Evidence,
    next: &Evidence,
    params: &ArcParams,
) -> Option<CellSummary> {
    let (width, height) = (step.width, step.height);
    if (width, height) != (next.width, next.height) || width * height == 0 {
        return None;
    }
    let accel = &params.acceleration;
    let cells = width * height;
    let mut denominator = vec![0.0f32; cells];
    let mut later = vec![[0.0f32; 2]; cells];
    let mut counted = vec![false; cells];
    for cell in (0..cells).filter(|&cell| step.consistent(cell)) {
        let [x, y] = end_point(step, cell);
        let at = Bilinear::at(x, y, width, height);
        let [a, b, c, d] = at.indices;
        let rho = at.mix(next.rho[a], next.rho[b], next.rho[c], next.rho[d]);
        let [a, b, c, d] = at.indices.map(|index| next.flow_px[index]);
        let flow = [
            at.mix(a[0], b[0], c[0], d[0]),
            at.mix(a[1], b[1], c[1], d[1]),
        ];
        let mean_speed = (step.speed_px[cell] + norm(flow)) / 2.0;
        later[cell] = flow;
        denominator[cell] = mean_speed + accel.speed_offset_px;
        counted[cell] = rho < 1.0 && denominator[cell] > accel.min_denominator_px;
    }
    // Known before the smoothing: there will be no more cells than these.
    if counted.iter().filter(|&&counted| counted).count() <= params.min_cells {
        return None;
    }
    let smooth = |mut data: Vec<f32>| {
        for (value, &counted) in data.iter_mut().zip(&counted) {
            *value = if counted { *value } else { 0.0 };
        }
        let plane = Plane {
            width,
            height,
            data,
        };
        box_mean(&plane, accel.layer_radius_cells)
    };
    let vectors = later.iter().zip(&step.flow_px);
    let product = smooth(vectors.map(|(&later, &flow)| dot(later, flow)).collect());
    let flows = step.flow_px.iter();
    let energy = smooth(flows.map(|&flow| dot(flow, flow)).collect());
    let share = smooth(vec![1.0; cells]);
    let change: Vec<[f32; 2]> = (0..cells)
        .map(|cell| {
            let ratio = product.data[cell] / (energy.data[cell] + accel.energy_offset_px2);
            let ratio = ratio.clamp(accel.min_ratio, accel.max_ratio);
            let ([u, v], [before_u, before_v]) = (later[cell], step.flow_px[cell]);
            [u - ratio * before_u, v - ratio * before_v]
        })
        .collect();
    let common = [0, 1].map(|axis| smooth(change.iter().map(|change| change[axis]).collect()));
    let mut sample = CellSample::default();
    for cell in (0..cells).filter(|&cell| counted[cell]) {
        let weight = share.data[cell] + accel.share_offset;
        let own = [0, 1].map(|axis| change[cell][axis] - common[axis].data[cell] / weight);
        sample.add((norm(own) / denominator[cell]).min(accel.residual_limit));
    }
    sample.over(params.min_cells)
}

fn dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

fn norm(vector: [f32; 2]) -> f32 {
    dot(vector, vector).sqrt()
}
