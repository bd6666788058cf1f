//! From one vector per patch to one per pixel: the mean of the patches that cover a pixel, weighted
//! by 1 / max(1, |I₂(x + u) − I₁(x)|) (Kroeger et al. 2016, equation 3). Pixels of the level's grid.

use super::frame::Level;
use super::params::DisParams;
use super::patch::{Differences, Placement};
use crate::flow::Flow;
use crate::flow::simd::{Kernel, dispatch};

/// A dense field in two planes; empty means zero everywhere.
#[derive(Debug, Clone, Default)]
pub(super) struct DenseField {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) u: Vec<f32>,
    pub(super) v: Vec<f32>,
}

/// Running sums of the weighted mean.
#[derive(Debug, Clone, Default)]
pub(super) struct Densifier {
    weight: Vec<f32>,
}

impl Densifier {
    // A stage of its own in a profile.
    #[inline(never)]
    pub(super) fn densify(
        &mut self,
        vectors: &[[f32; 2]],
        first: &Level,
        second: &Level,
        params: &DisParams,
        field: &mut DenseField,
    ) {
        dispatch(Densification {
            densifier: self,
            vectors,
            first,
            second,
            params,
            field,
        });
    }

    /// Patch by patch, not pixel by pixel: inside a patch the fractional shift is the same, so the
    /// rows interpolate as in the search. Every pixel lies in some patch (the last row and column
    /// touch the border) and every weight is positive, so the division is safe.
    #[inline(always)]
    fn densify_sized<const P: usize>(
        &mut self,
        vectors: &[[f32; 2]],
        first: &Level,
        second: &Level,
        field: &mut DenseField,
    ) {
        let (width, height) = (first.width, first.height);
        field.width = width;
        field.height = height;
        for sums in [&mut self.weight, &mut field.u, &mut field.v] {
            sums.clear();
            sums.resize(width * height, 0.0);
        }
        let patches = first
            .patch_rows
            .iter()
            .flat_map(|&y| first.patch_columns.iter().map(move |&x| (x, y)));
        for ((x, y), &[u, v]) in patches.zip(vectors) {
            let at = Placement::new(second, x, y, [u, v], P);
            let reference = first.pixels_at(x, y);
            let mut differences = Differences::<P>::new(second, at);
            for row in 0..P {
                let difference = differences.row(row, &reference[row * first.stride..]);
                let start = (y + row) * width + x;
                let total = &mut self.weight[start..][..P];
                let sum_u = &mut field.u[start..][..P];
                let sum_v = &mut field.v[start..][..P];
                let mut weight = [0.0; P];
                for k in 0..P {
                    weight[k] = 1.0 / difference[k].abs().max(1.0);
                }
                // One plane after the other: interleaved stores to three would not be vectors.
                add(total, weight);
                add(sum_u, weight.map(|weight| weight * u));
                add(sum_v, weight.map(|weight| weight * v));
            }
        }
        for ((u, v), &weight) in field.u.iter_mut().zip(&mut field.v).zip(&self.weight) {
            let scale = 1.0 / weight;
            *u *= scale;
            *v *= scale;
        }
    }
}

#[inline(always)]
fn add<const P: usize>(sums: &mut [f32], values: [f32; P]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += value;
    }
}

struct Densification<'a> {
    densifier: &'a mut Densifier,
    vectors: &'a [[f32; 2]],
    first: &'a Level,
    second: &'a Level,
    params: &'a DisParams,
    field: &'a mut DenseField,
}

impl Kernel for Densification<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            densifier,
            vectors,
            first,
            second,
            params,
            field,
        } = self;
        match params.patch_size {
            4 => densifier.densify_sized::<4>(vectors, first, second, field),
            12 => densifier.densify_sized::<12>(vectors, first, second, field),
            16 => densifier.densify_sized::<16>(vectors, first, second, field),
            // `DisParams::validate` admits no other size.
            _ => densifier.densify_sized::<8>(vectors, first, second, field),
        }
    }
}

impl DenseField {
    pub(super) fn reset_to_zero(&mut self) {
        self.width = 0;
        self.height = 0;
    }

    /// The field at pixel `(x, y)` of a `width` × `height` grid over the same picture, in pixels of
    /// that grid: bilinear, half-pixel centres, clamped border.
    pub(super) fn sample_scaled(
        &self,
        x: usize,
        y: usize,
        width: usize,
        height: usize,
    ) -> [f32; 2] {
        if self.width == 0 {
            return [0.0; 2];
        }
        let column = Tap::new(x, self.width, width);
        let row = Tap::new(y, self.height, height);
        let read = |plane: &[f32]| {
            let line = |index: usize| column.mix(&plane[index * self.width..]);
            let (upper, lower) = (line(row.index), line(row.next));
            upper + row.fraction * (lower - upper)
        };
        [
            read(&self.u) * (width as f32 / self.width as f32),
            read(&self.v) * (height as f32 / self.height as f32),
        ]
    }
}

/// Brings the finest field to the full grid; holds the rows it interpolates between.
#[derive(Debug, Clone, Default)]
pub(super) struct Upsampler {
    columns: Vec<Tap>,
    widener: Widener,
    upper: Vec<[f32; 2]>,
    lower: Vec<[f32; 2]>,
    /// The row between them.
    row: Vec<[f32; 2]>,
}

impl Upsampler {
    /// `field` on a `width` × `height` grid over the same picture, in pixels of that grid.
    // A stage of its own in a profile.
    #[inline(never)]
    pub(super) fn upsample(
        &mut self,
        field: &DenseField,
        width: usize,
        height: usize,
        flow: &mut Flow,
    ) {
        (flow.width, flow.height) = (width, height);
        flow.data.clear();
        flow.data.reserve_exact(width * height);
        if (width, height) == (field.width, field.height) {
            let vectors = field.u.iter().zip(&field.v);
            flow.data.extend(vectors.map(|(&u, &v)| [u, v]));
            return;
        }
        dispatch(Upsampling {
            upsampler: self,
            field,
            flow,
        });
    }

    #[inline(always)]
    fn run(&mut self, field: &DenseField, flow: &mut Flow) {
        let scale = [
            flow.width as f32 / field.width as f32,
            flow.height as f32 / field.height as f32,
        ];
        self.columns.clear();
        self.columns
            .extend((0..flow.width).map(|x| Tap::new(x, field.width, flow.width)));
        self.widener.aim(&self.columns, scale);
        // Two widened source rows at a time; consecutive output rows mostly share them.
        let mut held = None;
        self.row.resize(flow.width, [0.0; 2]);
        for y in 0..flow.height {
            let tap = Tap::new(y, field.height, flow.height);
            if held != Some((tap.index, tap.next)) {
                if held.is_some_and(|(_, next)| next == tap.index) {
                    std::mem::swap(&mut self.upper, &mut self.lower);
                } else {
                    let upper = &mut self.upper;
                    self.widener.widen(field, &self.columns, tap.index, upper);
                }
                let lower = &mut self.lower;
                self.widener.widen(field, &self.columns, tap.next, lower);
                held = Some((tap.index, tap.next));
            }
            // Components in one run, which becomes whole vectors.
            let (upper, lower) = (self.upper.as_flattened(), self.lower.as_flattened());
            let row = self.row.as_flattened_mut();
            for ((out, a), b) in row.iter_mut().zip(upper).zip(lower) {
                *out = a + tap.fraction * (b - a);
            }
            flow.data.extend_from_slice(&self.row);
        }
    }
}

/// Interpolates rows of the field at the taps: vectors are gathered first, u and v by one load, so that
/// the arithmetic runs over whole vectors.
#[derive(Debug, Clone, Default)]
struct Widener {
    /// Per tap and component: the fraction, and the factor to the larger grid.
    fractions: Vec<[f32; 2]>,
    scales: Vec<[f32; 2]>,
    source: Vec<[f32; 2]>,
    left: Vec<[f32; 2]>,
    right: Vec<[f32; 2]>,
}

impl Widener {
    #[inline(always)]
    fn aim(&mut self, columns: &[Tap], scale: [f32; 2]) {
        self.fractions.clear();
        for tap in columns {
            self.fractions.push([tap.fraction; 2]);
        }
        self.scales.clear();
        self.scales.resize(columns.len(), scale);
        self.left.resize(columns.len(), [0.0; 2]);
        self.right.resize(columns.len(), [0.0; 2]);
    }

    /// Row `row` at the taps, scaled.
    #[inline(always)]
    fn widen(&mut self, field: &DenseField, columns: &[Tap], row: usize, out: &mut Vec<[f32; 2]>) {
        let u = &field.u[row * field.width..][..field.width];
        let v = &field.v[row * field.width..][..field.width];
        self.source.resize(field.width, [0.0; 2]);
        for ((vector, &u), &v) in self.source.iter_mut().zip(u).zip(v) {
            *vector = [u, v];
        }
        let source = &self.source[..];
        for ((left, right), tap) in self.left.iter_mut().zip(&mut self.right).zip(columns) {
            *left = source[tap.index];
            *right = source[tap.next];
        }
        out.resize(columns.len(), [0.0; 2]);
        let out = out.as_flattened_mut().iter_mut();
        let ends = self
            .left
            .as_flattened()
            .iter()
            .zip(self.right.as_flattened());
        let factors = self
            .fractions
            .as_flattened()
            .iter()
            .zip(self.scales.as_flattened());
        for ((out, (a, b)), (fraction, scale)) in out.zip(ends).zip(factors) {
            *out = (a + fraction * (b - a)) * scale;
        }
    }
}

struct Upsampling<'a> {
    upsampler: &'a mut Upsampler,
    field: &'a DenseField,
    flow: &'a mut Flow,
}

impl Kernel for Upsampling<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.upsampler.run(self.field, self.flow);
    }
}

/// Linear interpolation along one axis: between `index` and `next`.
#[derive(Debug, Clone, Copy)]
struct Tap {
    index: usize,
    next: usize,
    fraction: f32,
}

impl Tap {
    fn new(position: usize, source: usize, target: usize) -> Self {
        let centre = (position as f32 + 0.5) * (source as f32 / target as f32) - 0.5;
        let centre = centre.max(0.0).min((source - 1) as f32);
        let index = centre as usize;
        Self {
            index,
            next: (index + 1).min(source - 1),
            fraction: centre - index as f32,
        }
    }

    fn mix(&self, line: &[f32]) -> f32 {
        line[self.index] + self.fraction * (line[self.next] - line[self.index])
    }
}
