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

/// Mean N² around each cell of a frame; computed once per frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameStructure(Plane);

impl FrameStructure {
    /// Of a frame on the evidence grid.
    #[must_use]
    pub fn new(frame: &NormalisedFrame) -> Self {
        let Plane { width, height, .. } = frame.normalised;
        Self(mean_square((width, height), &frame.normalised.data))
    }
}

/// Mean of the squares over the box around each cell of a grid of `size` (width, height).
fn mean_square((width, height): (usize, usize), values: &[f32]) -> Plane {
    let squares = Plane {
        width,
        height,
        data: values.iter().map(|value| value * value).collect(),
    };
    box_mean(&squares, RADIUS_CELLS)
}

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
    /// Of direction first → second: `evidence` of that direction, and the structure of its first frame.
    ///
    /// # Errors
    /// [`ConsistencyError::SizeMismatch`] when the two are not on one grid.
    pub fn new(evidence: &Evidence, first: &FrameStructure) -> Result<Self, ConsistencyError> {
        let FrameStructure(structure) = first;
        let (size, other) = (
            (evidence.width, evidence.height),
            (structure.width, structure.height),
        );
        if size != other || evidence.appearance.len() != structure.data.len() {
            return Err(ConsistencyError::SizeMismatch {
                first: size,
                second: other,
            });
        }
        let structure = &structure.data;
        let unexplained = mean_square(size, &evidence.appearance).data;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::consistency::{ConsistencyParams, GridFlow};
    use crate::flow::dis::{Dis, DisFrame, DisParams};

    const WIDTH: usize = 160;
    const HEIGHT: usize = 128;

    fn hash(x: usize, y: usize) -> f32 {
        let mixed = (x * 7919 + 13) ^ (y * 104_729 + 7);
        (mixed.wrapping_mul(2_654_435_761) >> 16 & 255) as f32
    }

    /// Blotches some 8 px wide on the left half, a flat wall on the right.
    fn picture(shift: usize) -> Plane {
        Plane::from_fn(WIDTH, HEIGHT, |x, y| {
            if x < WIDTH / 2 {
                hash((x + shift) / 8, y / 8)
            } else {
                100.0
            }
        })
    }

    fn both(
        first: &Plane,
        second: &Plane,
    ) -> ([Structure; 2], [Evidence; 2], [NormalisedFrame; 2]) {
        let (params, dis) = (ConsistencyParams::default(), DisParams::ultrafast(1));
        let frames = [first, second].map(|p| DisFrame::new(p, &dis).unwrap());
        let normalised = [first, second].map(|p| NormalisedFrame::new(p, &params).unwrap());
        let mut solver = Dis::new(dis);
        let mut flow = |a: usize, b: usize| {
            GridFlow::new(&solver.flow(&frames[a], &frames[b]).unwrap(), &params).unwrap()
        };
        let (ahead, back) = (flow(0, 1), flow(1, 0));
        let [a, b] = &normalised;
        let evidence = [
            Evidence::new(&ahead, &back, a, b, &params).unwrap(),
            Evidence::new(&back, &ahead, b, a, &params).unwrap(),
        ];
        let structure = [0, 1].map(|k| {
            let first = FrameStructure::new(&normalised[k]);
            Structure::new(&evidence[k], &first).unwrap()
        });
        (structure, evidence, normalised)
    }

    fn fraction(first: &Plane, second: &Plane) -> Option<f64> {
        Structure::corresponding_fraction(both(first, second).0, 0.01)
    }

    #[test]
    fn structure_is_found_again_only_where_it_is() {
        let here = picture(0);
        assert_eq!(fraction(&here, &here), Some(1.0));
        // The rim of the texture and the strip that comes in are what is not found.
        assert!(fraction(&here, &picture(2)).unwrap() > 0.8);
        let flat = |level: f32| Plane::from_fn(WIDTH, HEIGHT, |_, _| level);
        for broken in [
            flat(0.0),
            flat(128.0),
            flat(255.0),
            Plane::from_fn(WIDTH, HEIGHT, hash),
        ] {
            for found in [fraction(&here, &broken), fraction(&broken, &here)] {
                assert!(found.unwrap() < 0.02, "{found:?}");
            }
        }
        // Two flat pictures: nothing to tell, which is neither good nor bad.
        assert_eq!(fraction(&flat(0.0), &flat(255.0)), None);
    }

    #[test]
    fn counts_are_those_of_the_definition() {
        let (found, evidence, frames) = both(&picture(0), &picture(3));
        for k in 0..2 {
            let (width, height) = (evidence[k].width, evidence[k].height);
            let mirrored = |place: i64, length: usize| {
                let last = length as i64 - 1;
                let place = place.abs();
                (if place > last {
                    2 * last - place
                } else {
                    place
                }) as usize
            };
            let mean = |values: &[f32], x: usize, y: usize| {
                let reach = RADIUS_CELLS as i64;
                let mut sum = 0.0;
                for dy in -reach..=reach {
                    for dx in -reach..=reach {
                        let (column, row) = (
                            mirrored(x as i64 + dx, width),
                            mirrored(y as i64 + dy, height),
                        );
                        sum += f64::from(values[row * width + column]).powi(2);
                    }
                }
                sum / (2.0 * reach as f64 + 1.0).powi(2)
            };
            let mut expected = Structure::default();
            for cell in 0..width * height {
                if !evidence[k].counted[cell] {
                    continue;
                }
                expected.counted += 1;
                let (x, y) = (cell % width, cell / width);
                let structure = mean(&frames[k].normalised.data, x, y);
                if structure < 0.5 {
                    continue;
                }
                expected.structured += 1;
                let explained = mean(&evidence[k].appearance, x, y) <= 0.5 * structure;
                expected.corresponding += usize::from(explained && evidence[k].rho[cell] < 1.0);
            }
            assert_eq!(found[k].counted, expected.counted);
            // f32 sums may fall on the other side of a limit: a cell in a thousand.
            let apart = |a: usize, b: usize| a.abs_diff(b) <= expected.counted / 1000;
            assert!(
                apart(found[k].structured, expected.structured)
                    && apart(found[k].corresponding, expected.corresponding),
                "{:?} {expected:?}",
                found[k]
            );
        }
    }

    #[test]
    fn another_grid_is_refused() {
        let (_, evidence, _) = both(&picture(0), &picture(0));
        let params = ConsistencyParams::default();
        let wide = Plane::from_fn(2 * WIDTH, HEIGHT, |_, _| 0.0);
        let other = NormalisedFrame::new(&wide, &params).unwrap();
        assert!(matches!(
            Structure::new(&evidence[0], &FrameStructure::new(&other)),
            Err(ConsistencyError::SizeMismatch { .. })
        ));
    }
}
