//! Convex up-sampling by eight: every fine value is a mean of the 3 × 3 cells around it, weighted by a
//! softmax that a network gives. Source: RAFT (Teed & Deng, 2020), as SEA-RAFT and DROID-SLAM use it.

use super::CELL_PX;
use super::error::{LearnedError, check_length};

/// Cells around a cell, itself among them.
const NEIGHBOURS: usize = 9;
const FINE: usize = CELL_PX * CELL_PX;
/// Logits of a cell: neighbour, then row, then column within the cell.
pub const LOGITS: usize = NEIGHBOURS * FINE;

/// `values` `[channels, rows, columns]` at `[channels, 8 rows, 8 columns]`, by `logits`
/// `[576, rows, columns]`. Cells outside count as 0, with their weight.
///
/// # Errors
/// [`LearnedError::LengthMismatch`] where an array does not have these sizes.
pub fn upsample(
    values: &[f32],
    logits: &[f32],
    (channels, rows, columns): (usize, usize, usize),
) -> Result<Vec<f32>, LearnedError> {
    let cells = rows * columns;
    check_length("values to be up-sampled", values.len(), channels * cells)?;
    check_length("up-sampling logits", logits.len(), LOGITS * cells)?;
    let fine_columns = columns * CELL_PX;
    let mut out = vec![0.0; channels * cells * FINE];
    for y in 0..rows {
        for x in 0..columns {
            let cell = y * columns + x;
            for fine in 0..FINE {
                let weights = softmax(|k| logits[(k * FINE + fine) * cells + cell]);
                let at =
                    (y * CELL_PX + fine / CELL_PX) * fine_columns + x * CELL_PX + fine % CELL_PX;
                for channel in 0..channels {
                    let plane = &values[channel * cells..(channel + 1) * cells];
                    out[channel * cells * FINE + at] =
                        weighted(plane, &weights, (x, y), (rows, columns));
                }
            }
        }
    }
    Ok(out)
}

fn softmax(logit: impl Fn(usize) -> f32) -> [f32; NEIGHBOURS] {
    let logits: [f32; NEIGHBOURS] = std::array::from_fn(logit);
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let powers = logits.map(|l| libm::expf(l - largest));
    let sum: f32 = powers.iter().sum();
    powers.map(|p| p / sum)
}

fn weighted(
    plane: &[f32],
    weights: &[f32; NEIGHBOURS],
    (x, y): (usize, usize),
    (rows, columns): (usize, usize),
) -> f32 {
    let mut sum = 0.0;
    for (k, weight) in weights.iter().enumerate() {
        // One more than the neighbour, so that nothing is negative.
        let (column, row) = (x + k % 3, y + k / 3);
        if (1..=columns).contains(&column) && (1..=rows).contains(&row) {
            sum += weight * plane[(row - 1) * columns + column - 1];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_inside_and_a_chosen_neighbour_is_copied() {
        let shape = (1, 3, 4);
        let up = upsample(&[2.0; 12], &[0.0; LOGITS * 12], shape).unwrap();
        // Inner cells see nine neighbours, a corner four.
        assert!((up[12 * 32 + 12] - 2.0).abs() < 1e-6);
        assert!((up[0] - 8.0 / 9.0).abs() < 1e-6);

        let values: Vec<f32> = (0..12).map(|n| n as f32).collect();
        let mut logits = vec![-200.0; LOGITS * 12];
        // Neighbour 5 is the one to the right.
        logits[5 * FINE * 12..6 * FINE * 12].fill(0.0);
        let up = upsample(&values, &logits, shape).unwrap();
        for (n, &value) in up.iter().enumerate() {
            let (x, y) = (n % 32 / 8, n / 32 / 8);
            let right = if x < 3 { (y * 4 + x + 1) as f32 } else { 0.0 };
            assert_eq!(value, right, "{n}");
        }
    }

    #[test]
    fn wrong_lengths_are_named() {
        let error = upsample(&[0.0; 11], &[0.0; LOGITS * 12], (1, 3, 4)).unwrap_err();
        assert!(error.to_string().contains("values to be up-sampled has 11"));
        assert!(upsample(&[0.0; 12], &[0.0; 12], (1, 3, 4)).is_err());
    }
}
