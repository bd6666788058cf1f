//! U·R_c, whether anything was touched: clips in which nothing is have little to be judged by
//! (`evidence.md`, section 5; yardstick `prototype/feat.py`, `memory`).
//!
//! U: share of the cells inside the margin that moved in any adjacent pair (consistent, |F| > 1).
//! A cell is static on a frame when towards both neighbours |F| < 0.7 and q < 0.35, as are the cells
//! around it. A static cell whose last static frame is at least three frames ago was covered and came
//! back: it is *revealed*, and *changed* when its colour, less the picture's common shift, differs by
//! more than 20 levels on the mean of the channels. R_c = changed / (revealed + 125): a few cells prove
//! nothing. The common shift is that since the frame before, so that a slow drift of exposure under a
//! long cover looks like a change. Evidence grid, reference pixels, 8-bit levels. Needs a static
//! camera. One frame is held back until its second neighbour is known, and one colour per cell.

use serde::{Deserialize, Serialize};

use crate::faults::ChangePair;
use crate::image::{Plane, Rgb8, gaussian_blur, resize_rgb};

use super::erode::erode;
use super::median_f32;

/// Constants of the statistic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactParams {
    /// A cell moves when its flow is longer than this, reference pixels.
    pub moving_px: f32,
    /// A static cell's flow is shorter than this, reference pixels.
    pub static_px: f32,
    /// A static cell's change map is below this.
    pub static_change: f32,
    /// A cell is static only if all cells this near are, cells.
    pub erosion_radius_cells: usize,
    /// Frames since a cell was last static, from which on it counts as revealed.
    pub covered_frames: usize,
    /// Standard deviation of the Gaussian on the colours, cells.
    pub colour_sigma_cells: f64,
    /// Mean difference over the channels above which a revealed cell changed, levels.
    pub changed_levels: f32,
    /// The common shift of colour is taken from more static cells than this; with fewer it is 0.
    pub shift_min_cells: usize,
    /// Added to the number of revealed cells in R_c.
    pub prior_cells: f64,
    /// Cells at the border that U does not count.
    pub margin_cells: usize,
}

impl Default for ContactParams {
    fn default() -> Self {
        Self {
            moving_px: 1.0,
            static_px: 0.7,
            static_change: 0.35,
            erosion_radius_cells: 1,
            covered_frames: 3,
            colour_sigma_cells: 1.0,
            changed_levels: 20.0,
            shift_min_cells: 300,
            prior_cells: 125.0,
            margin_cells: 4,
        }
    }
}

/// The clip's statistic.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// U, 0..=1.
    pub moved_share: f64,
    /// R_c, 0..=1.
    pub revealed_changed: f64,
    /// Revealed cells, summed over the frames: how much R_c rests on.
    pub revealed_cells: usize,
}

impl Contact {
    /// U·R_c: low where the arm touches nothing.
    #[must_use]
    pub fn score(&self) -> f64 {
        self.moved_share * self.revealed_changed
    }
}

/// Why a frame was not taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ContactError {
    /// Every frame but the first needs the pair with the frame before it.
    #[error("a frame came without the pair before it")]
    MissingPair,
    /// The grid changed, or the frame is no picture.
    #[error("grid of {actual:?}, not {expected:?} (width, height)")]
    SizeMismatch {
        /// The first pair's grid.
        expected: (usize, usize),
        /// The input's.
        actual: (usize, usize),
    },
}

/// The statistic's state.
#[derive(Debug, Clone)]
pub struct ContactStream {
    params: ContactParams,
    /// The frame whose later neighbour is not known yet.
    pending: Option<Pending>,
    memory: Option<Memory>,
    revealed: usize,
    changed: usize,
}

/// A frame and the cells that are static towards its earlier neighbour.
#[derive(Debug, Clone)]
struct Pending {
    picture: Rgb8,
    is_static: Option<Vec<bool>>,
}

/// What each cell looked like when it was last static.
#[derive(Debug, Clone)]
struct Memory {
    width: usize,
    height: usize,
    /// Frames taken.
    frame: usize,
    moved: Vec<bool>,
    last_static: Vec<Option<usize>>,
    /// One plane per channel.
    colour: [Vec<f32>; 3],
}

impl ContactStream {
    /// A statistic that has seen nothing.
    #[must_use]
    pub fn new(params: ContactParams) -> Self {
        Self {
            params,
            pending: None,
            memory: None,
            revealed: 0,
            changed: 0,
        }
    }

    /// Takes the next frame (any size; it is brought to the grid) and its pair with the frame before
    /// (`None` only with the first).
    ///
    /// # Errors
    /// [`ContactError`] when the pair is missing, grids differ or the frame is no picture; the state is
    /// then unchanged.
    pub fn push(&mut self, picture: &Rgb8, pair: Option<&ChangePair>) -> Result<(), ContactError> {
        if picture.validate().is_err() {
            return Err(ContactError::SizeMismatch {
                expected: self.grid().unwrap_or_default(),
                actual: (0, 0),
            });
        }
        let is_static = match (self.pending.is_some(), pair) {
            (false, _) => None,
            (true, None) => return Err(ContactError::MissingPair),
            (true, Some(pair)) => {
                self.check(pair)?;
                self.remember_motion(pair);
                self.settle(Some(&self.still(pair, Direction::Forward)));
                Some(self.still(pair, Direction::Backward))
            }
        };
        // Kept at the grid's size, once it is known: the first frame waits as it is.
        let picture = match self.grid() {
            Some((width, height)) => resize_rgb(picture, width, height),
            None => picture.clone(),
        };
        self.pending = Some(Pending { picture, is_static });
        Ok(())
    }

    /// The clip's statistic; `None` of fewer than two frames.
    #[must_use]
    pub fn finish(mut self) -> Option<Contact> {
        self.settle(None);
        let memory = self.memory?;
        let margin = self.params.margin_cells;
        let inner = |length: usize| margin..length.saturating_sub(margin);
        let (mut moved, mut counted) = (0usize, 0usize);
        for y in inner(memory.height) {
            for x in inner(memory.width) {
                moved += usize::from(memory.moved[y * memory.width + x]);
                counted += 1;
            }
        }
        (counted > 0).then(|| Contact {
            moved_share: moved as f64 / counted as f64,
            revealed_changed: self.changed as f64
                / (self.revealed as f64 + self.params.prior_cells),
            revealed_cells: self.revealed,
        })
    }

    fn grid(&self) -> Option<(usize, usize)> {
        let memory = self.memory.as_ref()?;
        Some((memory.width, memory.height))
    }

    fn check(&mut self, pair: &ChangePair) -> Result<(), ContactError> {
        let actual = (pair.forward.width, pair.forward.height);
        let expected = self.grid().unwrap_or(actual);
        if pair.size() != Some(expected) {
            return Err(ContactError::SizeMismatch { expected, actual });
        }
        let cells = expected.0 * expected.1;
        self.memory.get_or_insert_with(|| Memory {
            width: expected.0,
            height: expected.1,
            frame: 0,
            moved: vec![false; cells],
            last_static: vec![None; cells],
            colour: [vec![0.0; cells], vec![0.0; cells], vec![0.0; cells]],
        });
        Ok(())
    }

    fn remember_motion(&mut self, pair: &ChangePair) {
        let Some(memory) = &mut self.memory else {
            return;
        };
        let flow = &pair.forward;
        for (cell, moved) in memory.moved.iter_mut().enumerate() {
            *moved |= flow.consistent(cell) && flow.speed_px[cell] > self.params.moving_px;
        }
    }

    /// Cells that stay where and what they are in one direction of a pair.
    fn still(&self, pair: &ChangePair, direction: Direction) -> Vec<bool> {
        let (evidence, change) = match direction {
            Direction::Forward => (&pair.forward, &pair.forward_change),
            Direction::Backward => (&pair.backward, &pair.backward_change),
        };
        let still = |(&speed, &change): (&f32, &f32)| {
            speed < self.params.static_px && change < self.params.static_change
        };
        evidence
            .speed_px
            .iter()
            .zip(&change.data)
            .map(still)
            .collect()
    }

    /// Judges the pending frame, whose cells towards the later neighbour are `still_ahead`.
    fn settle(&mut self, still_ahead: Option<&[bool]>) {
        let (Some(pending), Some(memory)) = (self.pending.take(), &mut self.memory) else {
            return;
        };
        let (width, height) = (memory.width, memory.height);
        let mut is_static = vec![true; width * height];
        for mask in [pending.is_static.as_deref(), still_ahead]
            .into_iter()
            .flatten()
        {
            for (cell, &still) in is_static.iter_mut().zip(mask) {
                *cell &= still;
            }
        }
        let is_static = erode(&is_static, width, self.params.erosion_radius_cells);
        let picture = resize_rgb(&pending.picture, width, height);
        let colour = planes(&picture)
            .map(|plane| gaussian_blur(&plane, self.params.colour_sigma_cells).data);
        let shift = memory.common_shift(&colour, &is_static, &self.params);
        for cell in (0..is_static.len()).filter(|&cell| is_static[cell]) {
            if memory
                .age(cell)
                .is_some_and(|age| age >= self.params.covered_frames)
            {
                let difference: f32 = (0..3)
                    .map(|channel| {
                        (colour[channel][cell] - memory.colour[channel][cell] - shift).abs()
                    })
                    .sum();
                self.revealed += 1;
                self.changed += usize::from(difference / 3.0 > self.params.changed_levels);
            }
            for (kept, now) in memory.colour.iter_mut().zip(&colour) {
                kept[cell] = now[cell];
            }
            memory.last_static[cell] = Some(memory.frame);
        }
        memory.frame += 1;
    }
}

/// The channels of a picture, each as a plane.
fn planes(picture: &Rgb8) -> [Plane; 3] {
    let pixels = picture.width * picture.height;
    let mut levels = [vec![0.0; pixels], vec![0.0; pixels], vec![0.0; pixels]];
    let [red, green, blue] = &mut levels;
    let places = red.iter_mut().zip(green).zip(blue);
    for (((r, g), b), &[red, green, blue]) in places.zip(picture.data.as_chunks::<3>().0) {
        (*r, *g, *b) = (f32::from(red), f32::from(green), f32::from(blue));
    }
    levels.map(|data| Plane {
        width: picture.width,
        height: picture.height,
        data,
    })
}

/// Of a pair, by the frame it starts from.
#[derive(Debug, Clone, Copy)]
enum Direction {
    Forward,
    Backward,
}

impl Memory {
    /// Frames since the cell was static.
    fn age(&self, cell: usize) -> Option<usize> {
        Some(self.frame - self.last_static[cell]?)
    }

    /// Median change of level over all channels of the cells that were static just before: exposure.
    fn common_shift(
        &self,
        colour: &[Vec<f32>; 3],
        is_static: &[bool],
        params: &ContactParams,
    ) -> f32 {
        let stayed: Vec<usize> = (0..is_static.len())
            .filter(|&cell| is_static[cell])
            .filter(|&cell| {
                self.age(cell)
                    .is_some_and(|age| age < params.covered_frames)
            })
            .collect();
        if stayed.len() <= params.shift_min_cells {
            return 0.0;
        }
        let mut changes = Vec::with_capacity(3 * stayed.len());
        for (now, then) in colour.iter().zip(&self.colour) {
            changes.extend(stayed.iter().map(|&cell| now[cell] - then[cell]));
        }
        median_f32(changes.into_iter()).unwrap_or(0.0) as f32
    }
}

#[cfg(test)]
mod tests;
