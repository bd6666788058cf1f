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
            let mut differences = Differences::<P>::new(first.pixels_at(x, y), second, at);
            for row in 0..P {
                let difference = differences.row(row);
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
    upper: Vec<[f32; 2]>,
    lower: Vec<[f32; 2]>,
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
        if (width, height) == (field.width, field.height) {
            let vectors = field.u.iter().zip(&field.v);
            flow.data.extend(vectors.map(|(&u, &v)| [u, v]));
            return;
        }
        flow.data.resize(width * height, [0.0; 2]);
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
        // Two widened source rows at a time; consecutive output rows mostly share them.
        let mut held = None;
        for (y, out) in flow.data.chunks_exact_mut(flow.width).enumerate() {
            let tap = Tap::new(y, field.height, flow.height);
            if held != Some((tap.index, tap.next)) {
                widen(field, &self.columns, tap.index, scale, &mut self.upper);
                widen(field, &self.columns, tap.next, scale, &mut self.lower);
                held = Some((tap.index, tap.next));
            }
            for ((out, a), b) in out.iter_mut().zip(&self.upper).zip(&self.lower) {
                *out = [
                    a[0] + tap.fraction * (b[0] - a[0]),
                    a[1] + tap.fraction * (b[1] - a[1]),
                ];
            }
        }
    }
}

/// Row `row` of the field at the taps, scaled.
#[inline(always)]
fn widen(
    field: &DenseField,
    columns: &[Tap],
    row: usize,
    scale: [f32; 2],
    out: &mut Vec<[f32; 2]>,
) {
    let u = &field.u[row * field.width..][..field.width];
    let v = &field.v[row * field.width..][..field.width];
    out.clear();
    out.extend(
        columns
            .iter()
            .map(|tap| [tap.mix(u) * scale[0], tap.mix(v) * scale[1]]),
    );
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
