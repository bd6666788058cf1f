//! The freeze rule: a run of pairs that hardly change, between pairs that do.
//!
//! The evidence's rule compares a run with the clip's median change alone. That also flags a robot that
//! stands still: on 32 recorded clips of full length it flagged 41%. But a robot comes to rest and starts
//! again over several frames, while a frozen picture stops and resumes at once. So the run is compared
//! with the weakest of three: the median, the pair just before it and the pair just after it; what has
//! no pair on one side (a clip that begins or ends at rest) is no freeze. On the same clips: 3%, with
//! every injected freeze found. Repeats that come at one regular distance are a property of the file (its
//! frame rate was converted), not a fault.

use super::series::FaultPoint;

/// Equal distances between successive runs that make a cadence: two could be chance.
const CADENCE_RUNS: usize = 3;
/// A pair that changes by less than this share of the run's neighbours counts towards a cadence.
const CADENCE_SCORE: f64 = 0.5;

/// 1 − d / min(median, before, after) of every pair, with d the largest mean |ΔG| of a run of at least
/// `pairs` pairs that it belongs to, the run where the score is largest, and not below 0.
/// `grey_changes`: (later frame, mean |ΔG|) of every adjacent pair. Empty when the clip is shorter than
/// a run or half its pairs do not change at all (then nothing was moving).
pub(super) fn scores(grey_changes: &[(usize, f64)], pairs: usize) -> Vec<FaultPoint> {
    let changes: Vec<f64> = grey_changes.iter().map(|&(_, change)| change).collect();
    let median = crate::signals::median(&mut changes.clone());
    let Some(median) = median.filter(|&median| median > 0.0 && changes.len() >= pairs) else {
        return Vec::new();
    };
    let mut scores = bounded_runs(&changes, median, pairs);
    if is_cadence(&scores) {
        scores.fill(0.0);
    }
    let frames = grey_changes.iter().zip(scores);
    let point = |(&(frame, _), score)| FaultPoint {
        frame,
        score,
        place: None,
    };
    frames.map(point).collect()
}

fn bounded_runs(changes: &[f64], median: f64, pairs: usize) -> Vec<f64> {
    let mut scores = vec![0.0f64; changes.len()];
    for first in 1..changes.len() {
        let reference = median.min(changes[first - 1]);
        let mut change = 0.0f64;
        for last in first..changes.len() - 1 {
            change = change.max(changes[last]);
            let reference = reference.min(changes[last + 1]);
            if last + 1 - first >= pairs && change < reference {
                let score = 1.0 - change / reference;
                for of_pair in &mut scores[first..=last] {
                    *of_pair = of_pair.max(score);
                }
            }
            // A longer run holds this pair too, and nothing is below it.
            if change >= median.min(changes[first - 1]) {
                break;
            }
        }
    }
    scores
}

/// Whether the runs begin at one regular distance.
fn is_cadence(scores: &[f64]) -> bool {
    let begins = |&pair: &usize| {
        scores[pair] > CADENCE_SCORE && (pair == 0 || scores[pair - 1] <= CADENCE_SCORE)
    };
    let starts: Vec<usize> = (0..scores.len()).filter(begins).collect();
    let mut distances = starts.windows(2).map(|pair| pair[1] - pair[0]);
    let first = distances.next();
    starts.len() > CADENCE_RUNS && distances.all(|distance| Some(distance) == first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(changes: &[f64]) -> Vec<f64> {
        let numbered: Vec<(usize, f64)> = changes.iter().copied().enumerate().collect();
        scores(&numbered, 2).iter().map(|p| p.score).collect()
    }

    #[test]
    fn a_sudden_stop_is_a_freeze_and_a_rest_is_not() {
        let sudden = of(&[1.0, 1.0, 0.8, 0.0, 0.0, 0.0, 2.0, 1.0, 1.0]);
        // The pair of 0.8 and what follows are a weak run of their own.
        let weak = 1.0 - 0.8 / 1.0;
        assert_eq!(sudden, [0.0, 0.0, weak, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        // With coding noise in the copies, measured against the weaker side.
        let coded = of(&[1.0, 1.0, 0.8, 0.04, 0.02, 2.0, 1.0, 1.0]);
        assert!((coded[3] - 0.95).abs() < 1e-12 && (coded[4] - 0.95).abs() < 1e-12);
        // Comes to rest and starts again by and by.
        let rest = of(&[1.0, 1.0, 0.6, 0.2, 0.05, 0.04, 0.15, 0.5, 1.0, 1.0, 1.0]);
        assert!(rest.iter().all(|&score| score < 0.88), "{rest:?}");
        // Begins or ends at rest.
        let ends = of(&[0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
        assert_eq!(ends, [0.0; 8]);
        // One repeated frame is no run.
        assert_eq!(of(&[1.0, 1.0, 0.0, 1.0, 1.0]), [0.0; 5]);
    }

    #[test]
    fn repeats_at_a_regular_distance_are_the_file_s_cadence() {
        let cadence: Vec<f64> = (0..30).map(|k| f64::from(u8::from(k % 6 > 1))).collect();
        assert_eq!(of(&cadence), [0.0; 30]);
        let mut once = vec![1.0; 30];
        once[12..14].fill(0.0);
        assert_eq!(of(&once).iter().filter(|&&score| score == 1.0).count(), 2);
    }

    #[test]
    fn clips_without_motion_or_too_short_have_no_score() {
        assert!(of(&[0.0; 9]).is_empty());
        assert!(of(&[1.0]).is_empty());
        assert!(of(&[]).is_empty());
        assert_eq!(of(&[1.0, 1.0]), [0.0; 2]);
    }
}
