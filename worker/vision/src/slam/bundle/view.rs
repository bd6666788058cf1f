//! How one edge sees its cells: reprojections, residuals, weights, four cells at a time.

use super::{BundleOptions, EdgeObservation, Scene};
use crate::slam::camera::Pinhole;
use crate::slam::lanes::{LANES, Lanes};
use crate::slam::se3::Se3;

/// `target_from_source` as plain numbers.
#[derive(Clone, Copy)]
struct Relative {
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Relative {
    fn new(pose: &Se3) -> Self {
        let r = pose.rotation_matrix();
        Self {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)])),
            translation: [0, 1, 2].map(|i| pose.translation[i]),
        }
    }

    /// One coordinate of R (X₀, Y₀, 1) + d t.
    #[inline(always)]
    fn coordinate(&self, i: usize, x: Lanes, y: Lanes, d: Lanes) -> Lanes {
        let [rx, ry, rz] = self.rotation[i];
        let rotated = Lanes::splat(rx) * x + Lanes::splat(ry) * y;
        rotated + (Lanes::splat(rz) + Lanes::splat(self.translation[i]) * d)
    }
}

/// The reprojection of four cells of one edge: what residuals and derivatives are made of. Weights and
/// derivatives are zero where the cell does not count.
pub(super) struct View {
    /// x/z, y/z, d/z.
    pub(super) a: Lanes,
    pub(super) b: Lanes,
    pub(super) h: Lanes,
    /// Relative depth, less the least one that counts; negative where the cell does not.
    pub(super) clearance: Lanes,
    /// Weights of column and row: scaled, and lowered by the robust kernel.
    pub(super) weight: [Lanes; 2],
    /// Target − reprojection.
    pub(super) residual: [Lanes; 2],
    /// Derivatives by the inverse depth.
    pub(super) by_depth: [Lanes; 2],
    /// What both residuals cost.
    pub(super) loss: Lanes,
}

/// One edge.
pub(super) struct EdgeCells<'a> {
    relative: Relative,
    pub(super) camera: &'a Pinhole,
    options: &'a BundleOptions,
    /// Columns and rows of the targets.
    at: [Plane<'a>; 2],
    weight: [Plane<'a>; 2],
}

/// Values of all cells; the last ones, filled up with zeros, apart.
struct Plane<'a> {
    values: &'a [f32],
    end: [f32; LANES],
}

impl<'a> Plane<'a> {
    fn new(values: &'a [f32]) -> Self {
        let rest = values.chunks_exact(LANES).remainder();
        let mut end = [0.0; LANES];
        end[..rest.len()].copy_from_slice(rest);
        Self { values, end }
    }

    #[inline(always)]
    fn load(&self, at: usize) -> Lanes {
        let whole = self.values.get(at..).and_then(|rest| rest.first_chunk());
        Lanes::widen(whole.unwrap_or(&self.end))
    }
}

impl<'a> EdgeCells<'a> {
    /// `relative` is `target_from_source`.
    pub(super) fn new(
        scene: &'a Scene,
        edge: &EdgeObservation<'a>,
        relative: &Se3,
        options: &'a BundleOptions,
    ) -> Self {
        let cells = scene.grid.cells();
        let planes = |values: &'a [f32]| {
            let (u, v) = values.split_at(cells);
            [Plane::new(u), Plane::new(v)]
        };
        Self {
            relative: Relative::new(relative),
            camera: &scene.camera,
            options,
            at: planes(edge.at),
            weight: planes(edge.weight),
        }
    }

    /// Cells `at..at + LANES`. Written out, without `map` over arrays: its closures are not inlined
    /// and keep the baseline's instructions.
    #[inline(always)]
    pub(super) fn view(&self, at: usize, x: Lanes, y: Lanes, d: Lanes) -> View {
        let px = self.relative.coordinate(0, x, y, d);
        let py = self.relative.coordinate(1, x, y, d);
        let pz = self.relative.coordinate(2, x, y, d);
        let least = self.options.min_depth;
        let inverse = Lanes::splat(1.0) / pz.or_one_below(least);
        let inverse = inverse.where_at_least(pz, least);
        let (a, b, h) = (px * inverse, py * inverse, d * inverse);
        let scale = Lanes::splat(self.options.weight_scale);
        let [tx, ty, tz] = self.relative.translation;
        let (tx, ty, tz) = (Lanes::splat(tx), Lanes::splat(ty), Lanes::splat(tz));
        let (fx, fy) = (Lanes::splat(self.camera.fx), Lanes::splat(self.camera.fy));
        let (cx, cy) = (Lanes::splat(self.camera.cx), Lanes::splat(self.camera.cy));
        let wu = (self.weight[0].load(at) * scale).where_at_least(pz, least);
        let wv = (self.weight[1].load(at) * scale).where_at_least(pz, least);
        let ru = self.at[0].load(at) - (fx * a + cx);
        let rv = self.at[1].load(at) - (fy * b + cy);
        let (weight, loss) = match self.options.huber_cells {
            None => ([wu, wv], wu * ru * ru + wv * rv * rv),
            Some(threshold) => {
                let (ku, lu) = huber(ru, threshold);
                let (kv, lv) = huber(rv, threshold);
                ([wu * ku, wv * kv], wu * lu + wv * lv)
            }
        };
        View {
            a,
            b,
            h,
            clearance: pz - Lanes::splat(least),
            weight,
            residual: [ru, rv],
            by_depth: [
                fx * ((tx - a * tz) * inverse),
                fy * ((ty - b * tz) * inverse),
            ],
            loss,
        }
    }
}

/// Huber's kernel: the factor of the weight, min(1, δ/|r|), and the loss: r² up to δ, 2 δ |r| − δ²
/// beyond.
#[inline(always)]
fn huber(residual: Lanes, threshold: f64) -> (Lanes, Lanes) {
    let threshold = Lanes::splat(threshold);
    let size = residual.abs();
    let inner = size.min(threshold);
    (
        threshold / size.max(threshold),
        inner * (size + size - inner),
    )
}
