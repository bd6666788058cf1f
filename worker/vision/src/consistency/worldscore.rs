//! WorldScore's photometric consistency: the forward/backward end-point error with all its oddities,
//! to the bit (reference: WorldScore snapshot 344983c, `compute_epe`; goldens in `tests/golden`).
//!
//! 30 rows and 30 columns are cut away in total, 15 on each side, and the grid restarts at 0 in the
//! crop. The end point is rounded half-to-even and clamped to the crop to read the backward flow;
//! points that leave still count. Units: pixels of the flow's own grid; sums in f64, in NumPy's order.
//! An average that does not exist (empty crop, non-finite flow) is `None`.

use super::{ConsistencyError, ConsistencyParams, check_pair};
use crate::flow::Flow;
use crate::flow::simd::{Kernel, dispatch};

/// Rows and columns cut away, both sides together.
const CROP_PX: usize = 30;
/// WorldScore counts a pixel as failed above this error.
const FAILURE_PX: f64 = 5.0;
// From here on an f64 does not fit in an i64.
const I64_RANGE: f64 = 9_223_372_036_854_775_808.0;

/// WorldScore's end-point error of one pair.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldscoreEpe {
    /// Mean over the crop, pixels of the flow's own grid; `None` when the crop is empty or an error
    /// is not finite.
    pub average_px: Option<f64>,
    /// Pixels of the crop whose error exceeds 5 px.
    pub failure_count: usize,
    /// The same, `[height − 30, width − 30]` row-major.
    pub failure_mask: Vec<bool>,
    /// Rows of the flow, which give the average its unit.
    pub flow_height: usize,
}

impl WorldscoreEpe {
    /// The average in pixels of a picture `reference_height_px` high.
    #[must_use]
    pub fn average_reference_px(&self, params: &ConsistencyParams) -> Option<f64> {
        let scale = params.reference_height_px / self.flow_height as f64;
        self.average_px.map(|average| average * scale)
    }
}

/// WorldScore's end-point error of `forward` against `backward`.
///
/// # Errors
/// [`ConsistencyError`] when the flows differ in size or are incomplete.
pub fn worldscore_epe(forward: &Flow, backward: &Flow) -> Result<WorldscoreEpe, ConsistencyError> {
    check_pair(forward, backward)?;
    Ok(dispatch(Measurement { forward, backward }))
}

struct Measurement<'a> {
    forward: &'a Flow,
    backward: &'a Flow,
}

impl Kernel for Measurement<'_> {
    type Output = WorldscoreEpe;

    #[inline(always)]
    fn run(self) -> WorldscoreEpe {
        let Self { forward, backward } = self;
        let width = forward.width.saturating_sub(CROP_PX);
        let height = forward.height.saturating_sub(CROP_PX);
        let at = |flow: &Flow, x: usize, y: usize| {
            let [u, v] = flow.data[(y + CROP_PX / 2) * flow.width + x + CROP_PX / 2];
            [f64::from(u), f64::from(v)]
        };
        let mut errors_px = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let [u, v] = at(forward, x, y);
                let end = [x as f64 + u, y as f64 + v];
                let [back_u, back_v] = at(
                    backward,
                    clipped_index(end[0], width),
                    clipped_index(end[1], height),
                );
                let dx = end[0] + back_u - x as f64;
                let dy = end[1] + back_v - y as f64;
                errors_px.push((dx * dx + dy * dy).sqrt());
            }
        }
        let average = numpy_sum(&errors_px) / errors_px.len() as f64;
        let failure_mask: Vec<bool> = errors_px.iter().map(|&error| error > FAILURE_PX).collect();
        WorldscoreEpe {
            average_px: average.is_finite().then_some(average),
            failure_count: failure_mask.iter().filter(|&&failed| failed).count(),
            failure_mask,
            flow_height: forward.height,
        }
    }
}

/// The sum of contiguous f64 values in the order of NumPy's `add.reduce` (`pairwise_sum` of its
/// `loops_utils.h.src`): halves down to blocks of 128, eight running sums inside a block. The same order
/// gives the same last bits.
fn numpy_sum(values: &[f64]) -> f64 {
    const BLOCK: usize = 128;
    const RUNNING: usize = 8;
    if values.len() > BLOCK {
        let half = values.len() / 2;
        let (first, second) = values.split_at(half - half % RUNNING);
        return numpy_sum(first) + numpy_sum(second);
    }
    let (rows, rest) = values.as_chunks::<RUNNING>();
    let Some((&first, rows)) = rows.split_first() else {
        return rest.iter().fold(0.0, |sum, value| sum + value);
    };
    let mut r = first;
    for row in rows {
        for (sum, value) in r.iter_mut().zip(row) {
            *sum += value;
        }
    }
    let sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
    rest.iter().fold(sum, |sum, value| sum + value)
}

/// Rounds half-to-even and clips to `0..length`. NaN, infinities and values beyond i64 become index
/// 0, as the x86 conversion that the reference relies on (INT64_MIN, then clipped) has it.
#[inline(always)]
fn clipped_index(position: f64, length: usize) -> usize {
    let rounded = position.round_ties_even();
    if rounded.is_nan() || rounded.abs() >= I64_RANGE {
        return 0;
    }
    (rounded as i64).clamp(0, length as i64 - 1) as usize
}
