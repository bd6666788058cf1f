//! Correspondences as the estimators use them: normalised, in structure-of-arrays form.
//!
//! One similarity (common centroid, mean distance √2 from it: Hartley 1997) normalises *both*
//! pictures. Hartley takes one per picture; a common one keeps distances in proportion, so that
//! transfer and Sampson errors minimised here are pixel errors times `scale`. The order is a
//! seeded shuffle: any prefix is a fair sample, and a poor model shows early in the scoring.

use nalgebra::Matrix3;
use rand::Rng;
use rand_pcg::Pcg32;

use super::correspondence::Correspondence;

/// Below this mean distance from the centroid (px) all points are one: they are not scaled.
const MIN_SPREAD_PX: f64 = 1e-6;

/// Points per scoring block, after which a model that is already worse is given up.
pub(super) const BLOCK: usize = 128;

/// Normalised correspondences; all vectors have one entry per point.
#[derive(Debug, Clone)]
pub(super) struct PointSet {
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
    pub(super) u: Vec<f64>,
    pub(super) v: Vec<f64>,
    pub(super) weight: Vec<f64>,
    /// Normalised units per pixel.
    pub(super) scale: f64,
    centre_px: [f64; 2],
    /// Corners of the source points' bounding box, normalised.
    pub(super) corners: [[f64; 2]; 4],
    /// Sum of the weights: the effective number of observations.
    pub(super) total_weight: f64,
}

impl PointSet {
    /// Normalises and shuffles. `correspondences` must be finite and not empty.
    pub(super) fn new(correspondences: &[Correspondence], rng: &mut Pcg32) -> Self {
        let count = 2.0 * correspondences.len() as f64;
        let ends = || correspondences.iter().flat_map(|c| [c.from_px, c.to_px]);
        let centre_px = [
            ends().map(|p| p[0]).sum::<f64>() / count,
            ends().map(|p| p[1]).sum::<f64>() / count,
        ];
        let spread_px = ends().map(|p| distance(p, centre_px)).sum::<f64>() / count;
        let scale = if spread_px > MIN_SPREAD_PX {
            std::f64::consts::SQRT_2 / spread_px
        } else {
            1.0
        };

        let mut order: Vec<usize> = (0..correspondences.len()).collect();
        for last in (1..order.len()).rev() {
            order.swap(last, below(rng, last + 1));
        }
        let column = |f: &dyn Fn(&Correspondence) -> f64| {
            order
                .iter()
                .map(|&i| f(&correspondences[i]))
                .collect::<Vec<_>>()
        };
        let x = column(&|c| (c.from_px[0] - centre_px[0]) * scale);
        let y = column(&|c| (c.from_px[1] - centre_px[1]) * scale);
        let ([x0, x1], [y0, y1]) = (range(&x), range(&y));
        Self {
            u: column(&|c| (c.to_px[0] - centre_px[0]) * scale),
            v: column(&|c| (c.to_px[1] - centre_px[1]) * scale),
            weight: column(&|c| c.weight),
            x,
            y,
            scale,
            centre_px,
            corners: [[x0, y0], [x1, y0], [x0, y1], [x1, y1]],
            total_weight: correspondences.iter().map(|c| c.weight).sum(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    /// `T` of `normalised = T * pixel`.
    pub(super) fn normalised_from_px(&self) -> Matrix3<f64> {
        let (s, [cx, cy]) = (self.scale, self.centre_px);
        Matrix3::new(s, 0.0, -s * cx, 0.0, s, -s * cy, 0.0, 0.0, 1.0)
    }

    /// `T⁻¹` of `normalised = T * pixel`.
    pub(super) fn px_from_normalised(&self) -> Matrix3<f64> {
        let (s, [cx, cy]) = (1.0 / self.scale, self.centre_px);
        Matrix3::new(s, 0.0, cx, 0.0, s, cy, 0.0, 0.0, 1.0)
    }

    /// `N` different point indices; `None` with fewer than `N` points.
    pub(super) fn draw<const N: usize>(&self, rng: &mut Pcg32) -> Option<[usize; N]> {
        draw_below(self.len(), rng)
    }
}

/// `N` different indices below `count`; `None` if there are too few.
pub(super) fn draw_below<const N: usize>(count: usize, rng: &mut Pcg32) -> Option<[usize; N]> {
    if count < N {
        return None;
    }
    let mut picked = [0; N];
    for k in 0..N {
        // Floyd (Bentley and Floyd 1987): uniform without rejection, so the loop is bounded.
        let top = count - N + k;
        let candidate = below(rng, top + 1);
        picked[k] = if picked[..k].contains(&candidate) {
            top
        } else {
            candidate
        };
    }
    Some(picked)
}

/// A uniform index below `bound` (bias below 2⁻³² · bound), the same on every platform.
fn below(rng: &mut Pcg32, bound: usize) -> usize {
    ((u64::from(rng.next_u32()) * bound as u64) >> 32) as usize
}

/// Sum of a block's values in a fixed order that the compiler can keep in four lanes.
pub(super) fn lane_sum(values: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let chunks = values.chunks_exact(4);
    let rest: f64 = chunks.remainder().iter().sum();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + rest
}

fn range(values: &[f64]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| {
            [low.min(v), high.max(v)]
        })
}

/// Distance of two points.
pub(super) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
    (dx * dx + dy * dy).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalisation_is_a_similarity_that_can_be_undone() {
        let mut rng = Pcg32::new(1, 1);
        let points: Vec<_> = (0..50)
            .map(|i| Correspondence {
                from_px: [f64::from(i) * 3.0, f64::from(i * i % 17)],
                to_px: [f64::from(i), 9.0],
                weight: 0.5,
            })
            .collect();
        let set = PointSet::new(&points, &mut rng);
        assert!(
            (set.normalised_from_px() * set.px_from_normalised() - Matrix3::identity()).norm()
                < 1e-12
        );
        let radius: f64 = (0..50)
            .map(|i| {
                distance([set.x[i], set.y[i]], [0.0; 2]) + distance([set.u[i], set.v[i]], [0.0; 2])
            })
            .sum();
        assert!((radius / 100.0 - std::f64::consts::SQRT_2).abs() < 1e-12);
        assert_eq!(set.total_weight, 25.0);
        let mut back: Vec<i64> = set
            .x
            .iter()
            .map(|x| (x / set.scale + set.centre_px[0]).round() as i64)
            .collect();
        back.sort_unstable();
        assert_eq!(
            back,
            (0..50).map(|i| i * 3).collect::<Vec<_>>(),
            "the shuffle keeps every point once"
        );
    }

    #[test]
    fn draws_are_distinct_and_cover_everything() {
        let mut rng = Pcg32::new(3, 4);
        let mut seen = [0; 9];
        for _ in 0..2000 {
            let mut picked: [usize; 7] = draw_below(9, &mut rng).unwrap();
            picked.iter().for_each(|&i| seen[i] += 1);
            picked.sort_unstable();
            assert!(picked.windows(2).all(|w| w[0] < w[1]));
        }
        // Expected 2000 * 7 / 9 = 1556 each, standard deviation 19: 8 deviations.
        assert!(
            seen.iter().all(|&n: &i32| (n - 1556).abs() < 150),
            "{seen:?}"
        );
        assert_eq!(draw_below::<7>(6, &mut rng), None);
    }
}
