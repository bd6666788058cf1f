//! From one vector per patch to one per pixel: the mean of the patches that cover a pixel, weighted
//! by 1 / max(1, |I₂(x + u) − I₁(x)|) (Kroeger et al. 2016, equation 3). Pixels of the level's grid.

use super::frame::Level;
use super::params::DisParams;
use super::patch::{Placement, weights};
use crate::flow::Flow;

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
    pub(super) fn densify(
        &mut self,
        vectors: &[[f32; 2]],
        first: &Level,
        second: &Level,
        params: &DisParams,
        field: &mut DenseField,
    ) {
        match params.patch_size {
            4 => self.densify_sized::<4>(vectors, first, second, field),
            12 => self.densify_sized::<12>(vectors, first, second, field),
            16 => self.densify_sized::<16>(vectors, first, second, field),
            // `DisParams::validate` admits no other size.
            _ => self.densify_sized::<8>(vectors, first, second, field),
        }
    }

    /// Patch by patch, not pixel by pixel: inside a patch the fractional shift is the same, so the
    /// rows interpolate as in the search. Every pixel lies in some patch (the last row and column
    /// touch the border) and every weight is positive, so the division is safe.
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
            weights::<P>(first.pixels_at(x, y), second, at, |row, weight| {
                let start = (y + row) * width + x;
                let total = &mut self.weight[start..][..P];
                let sum_u = &mut field.u[start..][..P];
                let sum_v = &mut field.v[start..][..P];
                for k in 0..P {
                    total[k] += weight[k];
                    sum_u[k] += weight[k] * u;
                    sum_v[k] += weight[k] * v;
                }
            });
        }
        for ((u, v), &weight) in field.u.iter_mut().zip(&mut field.v).zip(&self.weight) {
            let scale = 1.0 / weight;
            *u *= scale;
            *v *= scale;
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

    /// The field on a `width` × `height` grid over the same picture, in pixels of that grid.
    pub(super) fn upsample(&self, width: usize, height: usize) -> Flow {
        if (width, height) == (self.width, self.height) {
            let data = self.u.iter().zip(&self.v).map(|(&u, &v)| [u, v]).collect();
            return Flow {
                width,
                height,
                data,
            };
        }
        let scale = [
            width as f32 / self.width as f32,
            height as f32 / self.height as f32,
        ];
        let columns: Vec<Tap> = (0..width).map(|x| Tap::new(x, self.width, width)).collect();
        // Two widened source rows at a time; consecutive output rows mostly share them.
        let widen = |row: usize, out: &mut Vec<[f32; 2]>| {
            let u = &self.u[row * self.width..][..self.width];
            let v = &self.v[row * self.width..][..self.width];
            out.clear();
            out.extend(
                columns
                    .iter()
                    .map(|tap| [tap.mix(u) * scale[0], tap.mix(v) * scale[1]]),
            );
        };
        let (mut upper, mut lower) = (Vec::new(), Vec::new());
        let mut held = None;
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            let tap = Tap::new(y, self.height, height);
            if held != Some((tap.index, tap.next)) {
                widen(tap.index, &mut upper);
                widen(tap.next, &mut lower);
                held = Some((tap.index, tap.next));
            }
            data.extend(upper.iter().zip(&lower).map(|(a, b)| {
                [
                    a[0] + tap.fraction * (b[0] - a[0]),
                    a[1] + tap.fraction * (b[1] - a[1]),
                ]
            }));
        }
        Flow {
            width,
            height,
            data,
        }
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
