//! The checkerboard: pixels of one colour are neighbours only of the other colour's, so that a whole
//! row of one colour relaxes at once. Red pixels have an even sum of column and row.
//!
//! Each colour's plane holds `half` cells per row: cell `k` of row `y` is column `2 k + parity`.
//! Rows are padded to whole vectors; a border of one cell on every side saves all edge cases. Cells
//! beyond the frame are never read by those inside, or are read as zero or as a repeated edge; the
//! functions that fill a plane say which.

use crate::flow::simd::LANES;

/// Which half of the checkerboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Colour {
    Red,
    Black,
}

impl Colour {
    pub(super) const BOTH: [Self; 2] = [Self::Red, Self::Black];

    #[inline(always)]
    pub(super) fn other(self) -> Self {
        match self {
            Self::Red => Self::Black,
            Self::Black => Self::Red,
        }
    }

    /// Column of this colour's first cell in row `y`: 0 or 1. Also where, in a padded row of the
    /// other colour, the cells' left neighbours start.
    #[inline(always)]
    pub(super) fn parity(self, y: usize) -> usize {
        (y + usize::from(self == Self::Black)) % 2
    }
}

/// Shape of a checkerboard.
#[derive(Debug, Clone, Default)]
pub(super) struct Grid {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Cells per row and colour, a multiple of [`LANES`] so that no loop has a scalar tail.
    pub(super) half: usize,
}

impl Grid {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            half: width.div_ceil(2).next_multiple_of(LANES),
        }
    }

    /// Cells of a padded row.
    #[inline(always)]
    pub(super) fn stride(&self) -> usize {
        self.half + 2
    }

    /// Start of row `y` with its border; `y` = 0 is the row above the frame.
    #[inline(always)]
    fn start(&self, padded_y: usize) -> usize {
        padded_y * self.stride()
    }
}

/// One value per pixel.
#[derive(Debug, Clone, Default)]
pub(super) struct Board {
    red: Vec<f32>,
    black: Vec<f32>,
}

impl Board {
    /// All zero, border included.
    pub(super) fn reset(&mut self, grid: &Grid) {
        for plane in [&mut self.red, &mut self.black] {
            plane.clear();
            plane.resize(grid.stride() * (grid.height + 2), 0.0);
        }
    }

    #[inline(always)]
    fn plane(&self, colour: Colour) -> &[f32] {
        match colour {
            Colour::Red => &self.red,
            Colour::Black => &self.black,
        }
    }

    #[inline(always)]
    fn plane_mut(&mut self, colour: Colour) -> &mut [f32] {
        match colour {
            Colour::Red => &mut self.red,
            Colour::Black => &mut self.black,
        }
    }

    /// A row with its border cells; row 0 is above the frame.
    #[inline(always)]
    pub(super) fn padded_row(&self, grid: &Grid, colour: Colour, padded_y: usize) -> &[f32] {
        &self.plane(colour)[grid.start(padded_y)..][..grid.stride()]
    }

    #[inline(always)]
    fn padded_row_mut(&mut self, grid: &Grid, colour: Colour, padded_y: usize) -> &mut [f32] {
        let start = grid.start(padded_y);
        &mut self.plane_mut(colour)[start..][..grid.stride()]
    }

    /// The cells of row `y`, without border.
    #[inline(always)]
    pub(super) fn row(&self, grid: &Grid, colour: Colour, y: usize) -> &[f32] {
        &self.padded_row(grid, colour, y + 1)[1..][..grid.half]
    }

    #[inline(always)]
    pub(super) fn row_mut(&mut self, grid: &Grid, colour: Colour, y: usize) -> &mut [f32] {
        &mut self.padded_row_mut(grid, colour, y + 1)[1..][..grid.half]
    }

    /// The other colour around row `y` of `colour`.
    #[inline(always)]
    pub(super) fn around(&self, grid: &Grid, colour: Colour, y: usize) -> Around<'_> {
        let other = colour.other();
        let here = self.padded_row(grid, other, y + 1);
        let parity = colour.parity(y);
        Around {
            left: &here[parity..][..grid.half],
            right: &here[parity + 1..][..grid.half],
            above: &self.padded_row(grid, other, y)[1..][..grid.half],
            below: &self.padded_row(grid, other, y + 2)[1..][..grid.half],
        }
    }

    /// A row to write, and the other colour around it.
    #[inline(always)]
    pub(super) fn row_mut_and_around(
        &mut self,
        grid: &Grid,
        colour: Colour,
        y: usize,
    ) -> (&mut [f32], Around<'_>) {
        let (own, other) = match colour {
            Colour::Red => (&mut self.red, &self.black),
            Colour::Black => (&mut self.black, &self.red),
        };
        let parity = colour.parity(y);
        let row = |padded_y: usize| &other[grid.start(padded_y)..][..grid.stride()];
        let around = Around {
            left: &row(y + 1)[parity..][..grid.half],
            right: &row(y + 1)[parity + 1..][..grid.half],
            above: &row(y)[1..][..grid.half],
            below: &row(y + 2)[1..][..grid.half],
        };
        let start = grid.start(y + 1) + 1;
        (&mut own[start..][..grid.half], around)
    }

    /// Deals a row of the picture out to the two colours; cells beyond the frame are zero.
    #[inline(always)]
    pub(super) fn split_row(&mut self, grid: &Grid, y: usize, values: &[f32]) {
        let (even, odd) = match Colour::Red.parity(y) {
            0 => (&mut self.red, &mut self.black),
            _ => (&mut self.black, &mut self.red),
        };
        let start = grid.start(y + 1) + 1;
        let even = &mut even[start..][..grid.half];
        let odd = &mut odd[start..][..grid.half];
        let pairs = values.chunks_exact(2);
        let last = pairs.remainder();
        for ((even, odd), pair) in even.iter_mut().zip(odd).zip(pairs) {
            *even = pair[0];
            *odd = pair[1];
        }
        if let [value] = last {
            even[values.len() / 2] = *value;
        }
    }

    /// The inverse of [`split_row`](Self::split_row).
    #[inline(always)]
    fn merge_row(&self, grid: &Grid, y: usize, values: &mut [f32]) {
        let red = self.row(grid, Colour::Red, y);
        let black = self.row(grid, Colour::Black, y);
        let (even, odd) = match Colour::Red.parity(y) {
            0 => (red, black),
            _ => (black, red),
        };
        let count = values.len();
        let mut pairs = values.chunks_exact_mut(2);
        for ((pair, &even), &odd) in pairs.by_ref().zip(even).zip(odd) {
            pair[0] = even;
            pair[1] = odd;
        }
        if let [value] = pairs.into_remainder() {
            *value = even[count / 2];
        }
    }

    /// Repeats the last column to the right and the last row below, so that forward differences
    /// vanish there. Cells of one column have the other colour in the next.
    #[inline(always)]
    pub(super) fn repeat_far_edges(&mut self, grid: &Grid) {
        let (inside, beyond) = ((grid.width - 1) / 2, grid.width / 2);
        for y in 0..grid.height {
            let last = if (y + grid.width).is_multiple_of(2) {
                Colour::Black
            } else {
                Colour::Red
            };
            let value = self.row(grid, last, y)[inside];
            self.padded_row_mut(grid, last.other(), y + 1)[beyond + 1] = value;
        }
        let (from, to) = (grid.start(grid.height), grid.start(grid.height + 1));
        let stride = grid.stride();
        let copy = |source: &[f32], target: &mut [f32]| {
            target[to..to + stride].copy_from_slice(&source[from..from + stride]);
        };
        copy(&self.red, &mut self.black);
        copy(&self.black, &mut self.red);
    }

    #[inline(always)]
    fn set_sum(&mut self, grid: &Grid, a: &Self, b: &Self) {
        for colour in Colour::BOTH {
            let sums = self.plane_mut(colour);
            for ((sum, &a), &b) in sums.iter_mut().zip(a.plane(colour)).zip(b.plane(colour)) {
                *sum = a + b;
            }
        }
        self.repeat_far_edges(grid);
    }
}

/// The four neighbours of every cell of a row, each a row of the other colour.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around<'a> {
    pub(super) left: &'a [f32],
    pub(super) right: &'a [f32],
    pub(super) above: &'a [f32],
    pub(super) below: &'a [f32],
}

/// A vector field.
#[derive(Debug, Clone, Default)]
pub(super) struct Field {
    pub(super) u: Board,
    pub(super) v: Board,
}

impl Field {
    pub(super) fn reset(&mut self, grid: &Grid) {
        self.u.reset(grid);
        self.v.reset(grid);
    }

    /// From two planes `[H, W]`; far edges repeated.
    #[inline(always)]
    pub(super) fn split(&mut self, grid: &Grid, u: &[f32], v: &[f32]) {
        for (board, plane) in [(&mut self.u, u), (&mut self.v, v)] {
            board.reset(grid);
            for (y, row) in plane.chunks_exact(grid.width).enumerate() {
                board.split_row(grid, y, row);
            }
            board.repeat_far_edges(grid);
        }
    }

    /// To two planes `[H, W]`.
    #[inline(always)]
    pub(super) fn merge(&self, grid: &Grid, u: &mut [f32], v: &mut [f32]) {
        for (board, plane) in [(&self.u, u), (&self.v, v)] {
            for (y, row) in plane.chunks_exact_mut(grid.width).enumerate() {
                board.merge_row(grid, y, row);
            }
        }
    }

    /// `a + b`, far edges repeated.
    #[inline(always)]
    pub(super) fn set_sum(&mut self, grid: &Grid, a: &Self, b: &Self) {
        self.u.set_sum(grid, &a.u, &b.u);
        self.v.set_sum(grid, &a.v, &b.v);
    }
}
