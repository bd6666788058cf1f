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
// 2^52: from here on every f64 is a whole number.
const INTEGERS_FROM: f64 = 4_503_599_627_370_496.0;

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
        let row = |flow: &'_ Flow, y: usize| (y + CROP_PX / 2) * flow.width + CROP_PX / 2;
        let mut errors_px = vec![0.0; width * height];
        // Of one row: the index of what each pixel's end point reads, and that vector.
        let mut read = vec![0u32; width];
        let mut back = vec![[0.0f32; 2]; width];
        let corner = &backward.data[row(backward, 0).min(backward.data.len())..];
        let stride = backward.width as u32;
        for y in 0..height {
            let ahead = &forward.data[row(forward, y)..][..width];
            for (x, (read, &[u, v])) in read.iter_mut().zip(ahead).enumerate() {
                let column = clipped_index(f64::from(x as u32) + f64::from(u), width);
                let row = clipped_index(f64::from(y as u32) + f64::from(v), height);
                *read = row * stride + column;
            }
            for (back, &read) in back.iter_mut().zip(&read) {
                *back = corner[read as usize];
            }
            let errors = &mut errors_px[y * width..][..width];
            let vectors = ahead.iter().zip(&back);
            for (x, (error, (ahead, back))) in errors.iter_mut().zip(vectors).enumerate() {
                let (x, y) = (f64::from(x as u32), f64::from(y as u32));
                let [u, v] = ahead.map(f64::from);
                let [back_u, back_v] = back.map(f64::from);
                let dx = x + u + back_u - x;
                let dy = y + v + back_v - y;
                *error = (dx * dx + dy * dy).sqrt();
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
fn clipped_index(position: f64, length: usize) -> u32 {
    let rounded = position.round_ties_even();
    // NaN fails the comparison; what is below the range is clipped to 0 anyway.
    let in_range = if rounded < I64_RANGE { rounded } else { 0.0 };
    let clipped = in_range.max(0.0).min((length - 1) as f64);
    // The bits of a whole number lie in the mantissa once 2^52 is added: done in whole vectors.
    (clipped + INTEGERS_FROM).to_bits() as u32
}
