//! Inverse search: every patch of one scale finds its displacement in the second frame (Kroeger et
//! al. 2016, section 2.1), in pixels of that scale.
//!
//! The gradient and its structure tensor belong to the first frame, so an iteration costs one
//! interpolated difference. Two sweeps, forwards and backwards, each trying the vectors of the two
//! neighbours visited before in its stripe. A patch keeps its starting vector when the search ends further away
//! than a patch size: it has slid off along an edge or over flat ground.

use super::densify::DenseField;
use super::frame::Level;
use super::params::DisParams;
use super::patch::{Comparison, Placement, Template, compare, distance};
use crate::flow::simd::{Kernel, dispatch};

/// The sparse field, one vector per patch, row-major.
#[derive(Debug, Clone, Default)]
pub(super) struct Search {
    vectors: Vec<[f32; 2]>,
}

impl Search {
    pub(super) fn vectors(&self) -> &[[f32; 2]] {
        &self.vectors
    }

    /// Takes each patch's starting vector from the coarser scale's dense field, at the patch centre.
    pub(super) fn start_from(&mut self, field: &DenseField, level: &Level, params: &DisParams) {
        let half = params.patch_size / 2;
        self.vectors.clear();
        for &y in &level.patch_rows {
            for &x in &level.patch_columns {
                self.vectors.push(field.sample_scaled(
                    x + half,
                    y + half,
                    level.width,
                    level.height,
                ));
            }
        }
    }

    // A stage of its own in a profile.
    #[inline(never)]
    pub(super) fn run(&mut self, first: &Level, second: &Level, params: &DisParams) {
        dispatch(Sweeps {
            search: self,
            first,
            second,
            params,
        });
    }

    #[inline(always)]
    fn run_sized<const P: usize>(&mut self, first: &Level, second: &Level, params: &DisParams) {
        let columns = first.patch_columns.len();
        let rows = first.patch_rows.len();
        let iterations = params.gradient_descent_iterations / params.sweeps();
        let stripe_rows = rows.div_ceil(params.propagation_stripes);
        for sweep in 0..params.sweeps() {
            let backwards = sweep % 2 == 1;
            for step in 0..rows * columns {
                let index = if backwards {
                    rows * columns - 1 - step
                } else {
                    step
                };
                let (row, column) = (index / columns, index % columns);
                let neighbours = if backwards {
                    [
                        (column + 1 < columns).then_some(index + 1),
                        (row + 1 < rows && !(row + 1).is_multiple_of(stripe_rows))
                            .then_some(index + columns),
                    ]
                } else {
                    [
                        (column > 0).then(|| index - 1),
                        (!row.is_multiple_of(stripe_rows)).then(|| index - columns),
                    ]
                };
                let (x, y) = (first.patch_columns[column], first.patch_rows[row]);
                let patch = Patch::<P> {
                    first,
                    second,
                    params,
                    template: Template::new(first, x, y),
                    index,
                    x,
                    y,
                };
                self.vectors[index] = patch.search(
                    self.vectors[index],
                    neighbours.map(|n| n.map(|n| self.vectors[n])),
                    iterations,
                );
            }
        }
    }
}

struct Sweeps<'a> {
    search: &'a mut Search,
    first: &'a Level,
    second: &'a Level,
    params: &'a DisParams,
}

impl Kernel for Sweeps<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            search,
            first,
            second,
            params,
        } = self;
        match params.patch_size {
            4 => search.run_sized::<4>(first, second, params),
            12 => search.run_sized::<12>(first, second, params),
            16 => search.run_sized::<16>(first, second, params),
            // `DisParams::validate` admits no other size.
            _ => search.run_sized::<8>(first, second, params),
        }
    }
}

/// One patch of the first frame.
struct Patch<'a, const P: usize> {
    first: &'a Level,
    second: &'a Level,
    params: &'a DisParams,
    template: Template<P>,
    index: usize,
    x: usize,
    y: usize,
}

impl<const P: usize> Patch<'_, P> {
    /// The displacement found from the best of `start` and the neighbours' vectors.
    #[inline(always)]
    fn search(
        &self,
        start: [f32; 2],
        neighbours: [Option<[f32; 2]>; 2],
        iterations: usize,
    ) -> [f32; 2] {
        let mut best = start;
        let mut comparison = self.compare(start);
        // Nothing matches better, and the next steps would be zero.
        if comparison.square == 0.0 {
            return start;
        }
        if self.params.spatial_propagation {
            let mut shortest = comparison.distance;
            for candidate in neighbours.into_iter().flatten() {
                if candidate == best {
                    continue;
                }
                let distance = self.distance(candidate);
                if distance < shortest {
                    shortest = distance;
                    best = candidate;
                }
            }
            if best != start {
                comparison = self.compare(best);
            }
        }
        let found = self.descend(best, comparison, iterations);
        let moved = [found[0] - best[0], found[1] - best[1]];
        let size = P as f32;
        if moved[0] * moved[0] + moved[1] * moved[1] <= size * size {
            found
        } else {
            best
        }
    }

    /// Iterates until the distance stops falling. `comparison` is the one at `start`.
    #[inline(always)]
    fn descend(&self, start: [f32; 2], mut comparison: Comparison, iterations: usize) -> [f32; 2] {
        let tensor = &self.first.tensors[self.index];
        let step_length = self.params.step_length;
        let mut vector = start;
        let mut previous = f32::INFINITY;
        for iteration in 0..iterations {
            if iteration > 0 {
                comparison = self.compare(vector);
            }
            let [gx, gy] = comparison.descent;
            vector[0] -= step_length * (tensor.inverse_xx * gx + tensor.inverse_xy * gy);
            vector[1] -= step_length * (tensor.inverse_xy * gx + tensor.inverse_yy * gy);
            if comparison.distance >= previous {
                break;
            }
            previous = comparison.distance;
        }
        vector
    }

    #[inline(always)]
    fn place(&self, vector: [f32; 2]) -> Placement {
        Placement::new(self.second, self.x, self.y, vector, P)
    }

    #[inline(always)]
    fn distance(&self, vector: [f32; 2]) -> f32 {
        distance(
            &self.template,
            self.second,
            self.place(vector),
            self.params.mean_normalisation,
        )
    }

    #[inline(always)]
    fn compare(&self, vector: [f32; 2]) -> Comparison {
        compare(
            &self.template,
            self.second,
            self.place(vector),
            &self.first.tensors[self.index],
            self.params.mean_normalisation,
        )
    }
}
