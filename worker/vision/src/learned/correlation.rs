//! Correlations of two feature maps around given positions, at four scales.
//!
//! Level `l` correlates with the second map averaged over blocks of 2^l × 2^l cells; around a position a
//! window of (2 r + 1)² taps, one cell of the level apart, is read bilinearly, with 0 outside the map.
//! Within a level the x offset is the *slow* index: channel = l (2 r + 1)² + (dx + r)(2 r + 1) + dy + r.
//!
//! Computed where it is asked for, by scalar products of feature vectors, rather than from a volume of all
//! pairs: pooling is linear, so that the numbers are the same but for rounding, a look-up of 48 cells'
//! windows costs less than a row of the volume, and memory does not grow with the fourth power of the
//! picture's side (the volume of one pair at 512 × 512 px has 89 MB). The tests hold it against the volume.

use super::error::{LearnedError, check_length};
use crate::flow::simd::{Kernel, dispatch};

/// Levels of the pyramid.
pub const LEVELS: usize = 4;
/// Largest radius of a window; more than either network uses.
const MOST_RADIUS: usize = 4;
const MOST_SIDE: usize = 2 * MOST_RADIUS + 2;
/// Positions this far out read 0 everywhere; keeps cell indices exact.
const FARTHEST_CELLS: f32 = 1e6;
/// Products that are summed side by side: one order on every machine.
const LANES: usize = 32;

/// Feature vectors of a grid of cells.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureMap {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Numbers per cell.
    pub channels: usize,
    /// `[rows, columns, channels]`.
    data: Vec<f32>,
}

impl FeatureMap {
    /// A map from a network's planar output `[channels, rows, columns]`.
    ///
    /// # Errors
    /// [`LearnedError::LengthMismatch`] where it does not have these sizes.
    pub fn from_planar(
        planar: &[f32],
        (channels, rows, columns): (usize, usize, usize),
    ) -> Result<Self, LearnedError> {
        check_length("feature map", planar.len(), channels * rows * columns)?;
        let cells = rows * columns;
        let data = (0..cells)
            .flat_map(|cell| (0..channels).map(move |channel| planar[channel * cells + cell]))
            .collect();
        Ok(Self {
            rows,
            columns,
            channels,
            data,
        })
    }

    /// All vectors, `[rows, columns, channels]`.
    #[must_use]
    pub fn cells(&self) -> &[f32] {
        &self.data
    }

    fn cell(&self, row: usize, column: usize) -> &[f32] {
        let at = (row * self.columns + column) * self.channels;
        &self.data[at..at + self.channels]
    }

    /// Means over blocks of 2 × 2 cells; an odd last row or column is not used.
    fn halved(&self) -> Self {
        let (rows, columns) = (self.rows / 2, self.columns / 2);
        let mut data = Vec::with_capacity(rows * columns * self.channels);
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [0, 1].map(|j| self.cell(2 * row + j, 2 * column));
                let [c, d] = [0, 1].map(|j| self.cell(2 * row + j, 2 * column + 1));
                data.extend((0..self.channels).map(|k| ((a[k] + c[k]) + (b[k] + d[k])) * 0.25));
            }
        }
        Self {
            rows,
            columns,
            channels: self.channels,
            data,
        }
    }
}

/// A feature map at the scales 1, 1/2, 1/4 and 1/8.
#[derive(Debug, Clone, PartialEq)]
pub struct FeaturePyramid {
    levels: [FeatureMap; LEVELS],
}

impl FeaturePyramid {
    /// Averages a map three times.
    #[must_use]
    pub fn new(map: FeatureMap) -> Self {
        let half = map.halved();
        let quarter = half.halved();
        let eighth = quarter.halved();
        Self {
            levels: [map, half, quarter, eighth],
        }
    }

    /// The map itself.
    #[must_use]
    pub fn finest(&self) -> &FeatureMap {
        &self.levels[0]
    }
}

/// Which window is read, and how products are scaled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Taps on either side of the position.
    pub radius: usize,
    /// Factor of every scalar product.
    pub scale: f32,
}

impl Window {
    /// Numbers per cell.
    #[must_use]
    pub fn channels(self) -> usize {
        LEVELS * (2 * self.radius + 1).pow(2)
    }
}

/// Correlations of every cell of `source` with `target` around `at` (`[2, rows, columns]`: column, row, in
/// cells of the target), into `out` `[window.channels(), rows, columns]`. A position that is not finite
/// reads 0.
///
/// # Errors
/// [`LearnedError`] where sizes do not fit each other, or the window is larger than either network's.
pub fn look_up(
    source: &FeatureMap,
    target: &FeaturePyramid,
    at: &[f32],
    window: Window,
    out: &mut [f32],
) -> Result<(), LearnedError> {
    let cells = source.rows * source.columns;
    check_length("positions", at.len(), 2 * cells)?;
    check_length("correlations", out.len(), window.channels() * cells)?;
    check_length(
        "feature vector of the second map",
        target.finest().channels,
        source.channels,
    )?;
    if window.radius > MOST_RADIUS {
        return Err(LearnedError::LengthMismatch {
            name: "radius of the window",
            expected: MOST_RADIUS,
            actual: window.radius,
        });
    }
    dispatch(LookUp {
        source,
        target,
        at,
        window,
        out,
    });
    Ok(())
}

struct LookUp<'a> {
    source: &'a FeatureMap,
    target: &'a FeaturePyramid,
    at: &'a [f32],
    window: Window,
    out: &'a mut [f32],
}

impl Kernel for LookUp<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let cells = self.source.rows * self.source.columns;
        let taps = (2 * self.window.radius + 1).pow(2);
        for cell in 0..cells {
            let vector = &self.source.data[cell * self.source.channels..][..self.source.channels];
            for (level, map) in self.target.levels.iter().enumerate() {
                let shrink = (1u32 << level) as f32;
                let position = [self.at[cell] / shrink, self.at[cells + cell] / shrink];
                let out = &mut self.out[level * taps * cells..];
                window_of(vector, map, position, self.window, |tap, value| {
                    out[tap * cells + cell] = value;
                });
            }
        }
    }
}

/// The taps of one window: scalar products at the (2 r + 2)² cells around the position, then bilinear.
#[inline(always)]
fn window_of(
    vector: &[f32],
    map: &FeatureMap,
    [x, y]: [f32; 2],
    window: Window,
    mut put: impl FnMut(usize, f32),
) {
    let side = 2 * window.radius + 1;
    // NaN is not within reach either.
    let reachable = x.abs() < FARTHEST_CELLS && y.abs() < FARTHEST_CELLS;
    let (x, y) = if reachable {
        (x, y)
    } else {
        (-FARTHEST_CELLS, -FARTHEST_CELLS)
    };
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let radius = window.radius as isize;
    let (left, top) = (left as isize - radius, top as isize - radius);
    // [row, column]
    let mut products = [[0.0; MOST_SIDE]; MOST_SIDE];
    for (j, products) in products.iter_mut().take(side + 1).enumerate() {
        let row = top + j as isize;
        if row < 0 || row >= map.rows as isize {
            continue;
        }
        for (i, product) in products.iter_mut().take(side + 1).enumerate() {
            let column = left + i as isize;
            if column >= 0 && column < map.columns as isize {
                *product = dot(vector, map.cell(row as usize, column as usize)) * window.scale;
            }
        }
    }
    for i in 0..side {
        for j in 0..side {
            let upper = products[j][i] * (1.0 - fx) + products[j][i + 1] * fx;
            let lower = products[j + 1][i] * (1.0 - fx) + products[j + 1][i + 1] * fx;
            put(i * side + j, upper * (1.0 - fy) + lower * fy);
        }
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    let (a_whole, a_rest) = a.as_chunks::<LANES>();
    let (b_whole, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a_whole.iter().zip(b_whole) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let mut half = LANES;
    while half > 1 {
        half /= 2;
        for lane in 0..half {
            sums[lane] += sums[lane + half];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums[0] + rest
}

#[cfg(test)]
mod tests;
