//! How much of a picture's structure has a correspondence in another picture.
//!
//! Forward and backward flow also agree where there is nothing to see: before a black frame both are
//! zero. So a cell counts only where there is structure to be found again, and corresponds only where it
//! is: with N the locally normalised first frame and r the appearance residual along the flow
//! ([`Evidence`]), over the box around the cell
//!
//! - structured: mean N² ≥ ½, a local deviation at or above the floor of the normalisation (5 levels);
//! - corresponding: structured, mean r² ≤ ½ mean N² (the second frame explains half of the structure, as a
//!   coefficient of determination; a flat frame explains none, noise adds to it), and the flows agree.
//!
//! Per direction, on the grid of its first frame. Does not fail but for inputs of two grids.

use super::{ConsistencyError, Evidence, NormalisedFrame};
use crate::image::{Plane, box_mean};

/// Radius of the box: the scale of the normalisation, 9 cells across (18 px of 256).
const RADIUS_CELLS: usize = 4;

/// Mean N² of structure: v / (v + floor) with the variance v at the floor.
const MIN_STRUCTURE: f32 = 0.5;

/// Largest unexplained share of the structure of a cell that corresponds.
const MAX_UNEXPLAINED: f32 = 0.5;

/// Counted cells with structure, and those of them that correspond.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Structure {
    /// Cells that are judged: in frame and off the border.
    pub counted: usize,
    /// Cells with structure.
    pub structured: usize,
    /// Structured cells with a correspondence.
    pub corresponding: usize,
}

impl Structure {
    /// Of direction first → second: `evidence` of that direction, and its first frame.
    ///
    /// # Errors
    /// [`ConsistencyError::SizeMismatch`] when the two are not on one grid.
    pub fn new(evidence: &Evidence, first: &NormalisedFrame) -> Result<Self, ConsistencyError> {
        let (size, other) = (
            (evidence.width, evidence.height),
            (first.normalised.width, first.normalised.height),
        );
        if size != other || evidence.appearance.len() != first.normalised.data.len() {
            return Err(ConsistencyError::SizeMismatch {
                first: size,
                second: other,
            });
        }
        let mean_square = |values: &[f32]| {
            let squares = Plane {
                width: size.0,
                height: size.1,
                data: values.iter().map(|value| value * value).collect(),
            };
            box_mean(&squares, RADIUS_CELLS).data
        };
        let structure = mean_square(&first.normalised.data);
        let unexplained = mean_square(&evidence.appearance);
        let mut found = Self::default();
        for cell in (0..structure.len()).filter(|&cell| evidence.counted[cell]) {
            found.counted += 1;
            if structure[cell] >= MIN_STRUCTURE {
                found.structured += 1;
                let explained = unexplained[cell] <= MAX_UNEXPLAINED * structure[cell];
                found.corresponding += usize::from(explained && evidence.consistent(cell));
            }
        }
        Ok(found)
    }

    /// The share of structured cells that correspond, both directions together: a flat frame has no
    /// structure of its own, but the one before it has. `None` with structure in less than `least_share`
    /// of the counted cells, where there is too little to tell.
    #[must_use]
    pub fn corresponding_fraction(both: [Self; 2], least_share: f64) -> Option<f64> {
        let sum = |part: fn(&Self) -> usize| both.iter().map(part).sum::<usize>() as f64;
        let structured = sum(|side| side.structured);
        let enough = structured > 0.0 && structured >= least_share * sum(|side| side.counted);
        enough.then(|| sum(|side| side.corresponding) / structured)
    }
}
