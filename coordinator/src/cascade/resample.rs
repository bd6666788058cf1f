//! What the calibrations do not know: how many decisions hang on which videos were drawn into the sample.
//!
//! A row from the top is scored with statistics to which videos that were never measured there contribute
//! carried values ([`super::calibration`]); a line fitted to a few pairs is rough, and moves scores and cut.
//! The bootstrap (Efron 1979) says how much: the lines are fitted again to resamples of the sample, and the
//! share of them in which a row is decided otherwise is the probability that the whole corpus would. Nothing
//! is uncertain where nothing is carried.

use plumbline_common::row::Decision;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;

use super::calibration::calibrate;
use super::flip::decide;
use super::{Video, place};
use crate::reduce::ReduceOptions;
use crate::reduce::draw::index_below;
use crate::reduce::population::Surveyed;

/// Resamples: the sum over a corpus is wanted, of which a few tell enough.
const REPLICATES: u8 = 16;

/// For each video, the share of resamples in which it is not decided as in `decisions`.
#[must_use]
pub fn flips(
    videos: &[Video],
    sample: &[usize],
    calibrations: &[Surveyed],
    decisions: &[Decision],
    options: &ReduceOptions,
) -> Vec<f64> {
    let mut flips = vec![0_u8; videos.len()];
    // Without a sample nothing is carried.
    let replicates = if sample.is_empty() { 0 } else { REPLICATES };
    for seed in 0..replicates {
        let mut rng = Pcg64::from_seed([seed; 32]);
        let drawn = sample
            .iter()
            .filter_map(|_| sample.get(index_below(sample.len(), &mut rng)));
        let resample: Vec<usize> = drawn.copied().collect();
        let recalibrated: Vec<Surveyed> = calibrations
            .iter()
            .enumerate()
            .map(|(rung, calibration)| match rung {
                // It has measured everything.
                0 => calibration.clone(),
                _ => calibrate(videos, &resample, rung, options),
            })
            .collect();
        let placed = place(videos, &recalibrated, options);
        let others = decide(videos, &placed, options).decisions;
        for ((flips, decision), other) in flips.iter_mut().zip(decisions).zip(&others) {
            *flips += u8::from(decision != other);
        }
    }
    let shares = flips.into_iter();
    shares
        .map(|flips| f64::from(flips) / f64::from(REPLICATES))
        .collect()
}
