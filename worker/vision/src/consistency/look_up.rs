//! Bilinear look-ups of a whole row of end points at once, in whole vectors; same arithmetic as
//! [`Bilinear`](crate::image::Bilinear). All functions are inlined into kernels.

use crate::flow::simd::whole;

/// Where the pixels of one row go; where one leaves the frame, the nearest point of the frame stands in.
pub(super) struct LookUpRow {
    pub(super) inside: Vec<bool>,
    /// Column and row of the value up left of the end point.
    left: Vec<u32>,
    top: Vec<u32>,
    /// Steps to the right and lower values: 1, or 0 at the far edges.
    right: Vec<u32>,
    below: Vec<u32>,
    pub(super) fraction_x: Vec<f32>,
    pub(super) fraction_y: Vec<f32>,
}

impl LookUpRow {
    pub(super) fn new(width: usize) -> Self {
        Self {
            inside: vec![false; width],
            left: vec![0; width],
            top: vec![0; width],
            right: vec![0; width],
            below: vec![0; width],
            fraction_x: vec![0.0; width],
            fraction_y: vec![0.0; width],
        }
    }

    /// Row `y` moved by `ahead`, times `scale` (x, y), on a grid `height` rows high and as wide as the row.
    #[inline(always)]
    pub(super) fn locate(&mut self, ahead: &[[f32; 2]], scale: [f32; 2], y: usize, height: usize) {
        let width = ahead.len();
        let (last_x, last_y) = ((width - 1) as f32, (height - 1) as f32);
        let y = y as f32;
        let inside_row = &mut self.inside[..width];
        let left_row = &mut self.left[..width];
        let top_row = &mut self.top[..width];
        let right = &mut self.right[..width];
        let below = &mut self.below[..width];
        let (last_column, last_row) = (width as u32 - 1, height as u32 - 1);
        let fraction_x = &mut self.fraction_x[..width];
        let fraction_y = &mut self.fraction_y[..width];
        for x in 0..width {
            let [u, v] = ahead[x];
            // Through i32, which converts in one instruction; no frame is 2^31 wide.
            let (to_x, to_y) = (x as i32 as f32 + u * scale[0], y + v * scale[1]);
            inside_row[x] = (to_x >= 0.0) & (to_x <= last_x) & (to_y >= 0.0) & (to_y <= last_y);
            let (to_x, to_y) = (to_x.max(0.0).min(last_x), to_y.max(0.0).min(last_y));
            let (left, top) = (to_x.floor(), to_y.floor());
            left_row[x] = whole(left).min(last_column);
            top_row[x] = whole(top).min(last_row);
            right[x] = u32::from(left_row[x] < last_column);
            below[x] = u32::from(top_row[x] < last_row);
            fraction_x[x] = to_x - left;
            fraction_y[x] = to_y - top;
        }
    }

    /// The four values around every end point: top left, top right, bottom left, bottom right.
    #[inline(always)]
    pub(super) fn gather<T: Copy>(&self, values: &[T], around: &mut [Vec<T>; 4]) {
        let [a, b, c, d] = around;
        let width = self.left.len();
        let corners = self.left.iter().zip(&self.top);
        let steps = self.right.iter().zip(&self.below);
        let around = a.iter_mut().zip(b).zip(c).zip(d);
        for (((&left, &top), (&right, &below)), (((a, b), c), d)) in corners.zip(steps).zip(around)
        {
            let (right, below) = (right as usize, below as usize * width);
            let from = &values[top as usize * width + left as usize..];
            *a = from[0];
            *b = from[right];
            *c = from[below];
            *d = from[below + right];
        }
    }
}

/// Between the top and bottom pairs, then between those.
#[inline(always)]
pub(super) fn mix([a, b, c, d]: [f32; 4], fraction_x: f32, fraction_y: f32) -> f32 {
    let top = a + fraction_x * (b - a);
    let bottom = c + fraction_x * (d - c);
    top + fraction_y * (bottom - top)
}
