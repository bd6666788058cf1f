//! P, the piecewise-affine residual: what is left of the moving cells' flow after up to four affine
//! motions, relative to its length (`evidence.md`, section 2).
//!
//! Sequential RANSAC (Fischler & Bolles 1981): each model is sought among the points that no earlier
//! one explains, refitted by least squares on its inliers, and every point keeps its smallest
//! residual. Points and residuals in pixels of a picture 256 px high. Seeded: the same evidence gives
//! the same bits. Degenerate samples (collinear points) are skipped; nothing fails.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::moving_cells;
use crate::consistency::Evidence;
use crate::flow::simd::{Kernel, dispatch};

/// Points that fix an affine motion.
const SAMPLE_POINTS: usize = 3;
// Twice the area (px²) below which a sample's triangle is a line: one grid cell is 2 px wide.
const MIN_TRIANGLE_PX2: f64 = 1.0;
// Determinant of the inliers' scatter, relative to its trace squared, below which they are a line.
const MIN_SCATTER: f64 = 1e-9;

/// Constants of the piecewise-affine residual.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PiecewiseParams {
    /// P needs more moving cells than this.
    pub min_cells: usize,
    /// At most this many of them are used, drawn without replacement.
    pub max_points: usize,
    /// At most this many affine motions.
    pub max_models: usize,
    /// No further model is sought for fewer unexplained points.
    pub min_unexplained: usize,
    /// A point is explained within this distance, pixels.
    pub inlier_px: f32,
    /// RANSAC samples per model at most.
    pub max_iterations: usize,
    /// RANSAC stops once a better model is this unlikely to have been missed, as a confidence.
    pub confidence: f64,
    /// Largest residual that counts, pixels.
    pub residual_limit_px: f64,
    /// Added to |F| in the relative residual, pixels.
    pub speed_offset_px: f64,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for PiecewiseParams {
    fn default() -> Self {
        Self {
            min_cells: 100,
            max_points: 600,
            max_models: 4,
            min_unexplained: 30,
            inlier_px: 0.75,
            max_iterations: 200,
            confidence: 0.99,
            residual_limit_px: 10.0,
            speed_offset_px: 1.0,
            seed: 0,
        }
    }
}

/// P: mean of min(residual, 10) / (|F| + 1) over moving cells; `None` with too few of them.
#[must_use]
pub fn piecewise_residual(
    evidence: &Evidence,
    moving_px: f32,
    params: &PiecewiseParams,
) -> Option<f64> {
    let mut cells = moving_cells(evidence, moving_px);
    if cells.len() <= params.min_cells {
        return None;
    }
    let mut random = Pcg64Mcg::seed_from_u64(params.seed);
    draw(&mut cells, params.max_points, &mut random);
    let points = Points::gather(&cells, evidence);
    let residuals = points.residuals(params, &mut random);
    let sum: f64 = residuals
        .iter()
        .zip(&cells)
        .map(|(&residual, &cell)| {
            let speed = f64::from(evidence.speed_px[cell]);
            f64::from(residual).min(params.residual_limit_px) / (speed + params.speed_offset_px)
        })
        .sum();
    (!cells.is_empty()).then(|| sum / cells.len() as f64)
}

/// Keeps `count` of the items, drawn without replacement (Fisher-Yates, cut short).
fn draw(items: &mut Vec<usize>, count: usize, random: &mut Pcg64Mcg) {
    if items.len() <= count {
        return;
    }
    for position in 0..count {
        let other = random.random_range(position..items.len());
        items.swap(position, other);
    }
    items.truncate(count);
}

/// Positions and displacements, one array each so that residuals vectorise.
#[derive(Debug, Clone, Default)]
struct Points {
    x: Vec<f32>,
    y: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

/// Displacement = `linear` · (x, y) + `offset`.
#[derive(Debug, Clone, Copy)]
struct Affine {
    linear: [[f64; 2]; 2],
    offset: [f64; 2],
}

impl Points {
    fn gather(cells: &[usize], evidence: &Evidence) -> Self {
        let mut points = Self::default();
        for &cell in cells {
            let [u, v] = evidence.flow_px[cell];
            points.push([
                (cell % evidence.width) as f32 / evidence.cells_per_px[0],
                (cell / evidence.width) as f32 / evidence.cells_per_px[1],
                u,
                v,
            ]);
        }
        points
    }

    fn push(&mut self, [x, y, u, v]: [f32; 4]) {
        self.x.push(x);
        self.y.push(y);
        self.u.push(u);
        self.v.push(v);
    }

    fn len(&self) -> usize {
        self.x.len()
    }

    /// Position and displacement of one point.
    fn get(&self, index: usize) -> [f64; 4] {
        [self.x[index], self.y[index], self.u[index], self.v[index]].map(f64::from)
    }

    /// The smallest residual of each point under the models found, pixels; infinite without any.
    fn residuals(&self, params: &PiecewiseParams, random: &mut Pcg64Mcg) -> Vec<f32> {
        let mut best = vec![f32::INFINITY; self.len()];
        for _ in 0..params.max_models {
            let unexplained: Vec<usize> = (0..self.len())
                .filter(|&index| best[index] > params.inlier_px)
                .collect();
            if unexplained.len() < params.min_unexplained.max(SAMPLE_POINTS) {
                break;
            }
            let Some(model) = self.subset(&unexplained).ransac(params, random) else {
                break;
            };
            for (best, squared) in best.iter_mut().zip(self.squared_residuals(&model)) {
                *best = best.min(squared.sqrt());
            }
        }
        best
    }

    fn subset(&self, indices: &[usize]) -> Self {
        let mut points = Self::default();
        for &index in indices {
            points.push([self.x[index], self.y[index], self.u[index], self.v[index]]);
        }
        points
    }

    /// The affine motion with most inliers, refitted on them; `None` when every sample was a line.
    fn ransac(&self, params: &PiecewiseParams, random: &mut Pcg64Mcg) -> Option<Affine> {
        let limit = params.inlier_px * params.inlier_px;
        let mut best = None;
        let mut most = 0;
        let mut iterations = params.max_iterations;
        let mut done = 0;
        while done < iterations {
            done += 1;
            let Some(model) = self.sample_model(random) else {
                continue;
            };
            let inliers = self.count_inliers(&model, limit);
            if inliers > most {
                most = inliers;
                best = Some(model);
                let share = inliers as f64 / self.len() as f64;
                iterations = iterations.min(iterations_needed(share, params.confidence));
            }
        }
        let best = best?;
        let inliers: Vec<usize> = self
            .squared_residuals(&best)
            .enumerate()
            .filter_map(|(index, squared)| (squared <= limit).then_some(index))
            .collect();
        Some(self.subset(&inliers).least_squares().unwrap_or(best))
    }

    /// The affine motion through three distinct random points; `None` when they are on a line.
    fn sample_model(&self, random: &mut Pcg64Mcg) -> Option<Affine> {
        let first = random.random_range(0..self.len());
        let second = random.random_range(0..self.len());
        let third = random.random_range(0..self.len());
        let [x0, y0, u0, v0] = self.get(first);
        let [x1, y1, u1, v1] = self.get(second);
        let [x2, y2, u2, v2] = self.get(third);
        let (ax, ay, bx, by) = (x1 - x0, y1 - y0, x2 - x0, y2 - y0);
        let area = ax * by - ay * bx;
        // A point drawn twice has no area either.
        if area.abs() < MIN_TRIANGLE_PX2 {
            return None;
        }
        let row = |d1: f64, d2: f64| [(d1 * by - d2 * ay) / area, (d2 * ax - d1 * bx) / area];
        let linear = [row(u1 - u0, u2 - u0), row(v1 - v0, v2 - v0)];
        Some(Affine::through(linear, [x0, y0], [u0, v0]))
    }

    #[inline(always)]
    fn squared_residuals(&self, model: &Affine) -> impl Iterator<Item = f32> + '_ {
        let [[a, b], [c, d]] = model.linear.map(|row| row.map(|value| value as f32));
        let [e, f] = model.offset.map(|value| value as f32);
        let positions = self.x.iter().zip(&self.y);
        let displacements = self.u.iter().zip(&self.v);
        positions
            .zip(displacements)
            .map(move |((&x, &y), (&u, &v))| {
                let du = a * x + b * y + e - u;
                let dv = c * x + d * y + f - v;
                du * du + dv * dv
            })
    }

    fn count_inliers(&self, model: &Affine, limit: f32) -> u32 {
        dispatch(CountInliers {
            points: self,
            model,
            limit,
        })
    }

    /// The least-squares affine motion; `None` when the points are on a line.
    fn least_squares(&self) -> Option<Affine> {
        let count = self.len() as f64;
        let mut centre = [0.0; 4];
        for index in 0..self.len() {
            for (sum, value) in centre.iter_mut().zip(self.get(index)) {
                *sum += value;
            }
        }
        let [cx, cy, cu, cv] = centre.map(|sum| sum / count);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        let mut cross = [[0.0; 2]; 2];
        for index in 0..self.len() {
            let [x, y, u, v] = self.get(index);
            let (x, y, displacement) = (x - cx, y - cy, [u - cu, v - cv]);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            for (sums, value) in cross.iter_mut().zip(displacement) {
                sums[0] += x * value;
                sums[1] += y * value;
            }
        }
        let determinant = xx * yy - xy * xy;
        // NaN comes of no points at all.
        if determinant.is_nan() || determinant <= MIN_SCATTER * (xx + yy) * (xx + yy) {
            return None;
        }
        let linear = cross.map(|[x, y]| {
            [
                (x * yy - y * xy) / determinant,
                (y * xx - x * xy) / determinant,
            ]
        });
        Some(Affine::through(linear, [cx, cy], [cu, cv]))
    }
}

/// Points within the squared distance `limit` of a motion, in whole vectors.
struct CountInliers<'a> {
    points: &'a Points,
    model: &'a Affine,
    limit: f32,
}

impl Kernel for CountInliers<'_> {
    type Output = u32;

    #[inline(always)]
    fn run(self) -> u32 {
        self.points
            .squared_residuals(self.model)
            .map(|squared| u32::from(squared <= self.limit))
            .sum()
    }
}

impl Affine {
    /// The motion with this linear part that moves `point` by `displacement`.
    fn through(linear: [[f64; 2]; 2], point: [f64; 2], displacement: [f64; 2]) -> Self {
        let offset = [0, 1].map(|axis| {
            displacement[axis] - linear[axis][0] * point[0] - linear[axis][1] * point[1]
        });
        Self { linear, offset }
    }
}

/// Samples after which one free of outliers was drawn with this confidence.
fn iterations_needed(inlier_share: f64, confidence: f64) -> usize {
    let all_inliers = inlier_share * inlier_share * inlier_share;
    if all_inliers >= 1.0 {
        return 0;
    }
    let needed = libm::log(1.0 - confidence) / libm::log1p(-all_inliers);
    // NaN (a confidence outside [0, 1]) and infinity mean: no early stop.
    if needed.is_finite() {
        needed.ceil().max(0.0) as usize
    } else {
        usize::MAX
    }
}
