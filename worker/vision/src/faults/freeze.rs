//! The freeze rule: a run of pairs that hardly change, between pairs that do.
//!
//! The evidence's rule compares a run with the clip's median change alone. That also flags a robot that
//! stands still: on 32 recorded clips of full length it flagged 41%. But a robot comes to rest and starts
//! again over several frames, while a frozen picture stops and resumes at once. So the run is compared
//! with the weakest of three: the median, the pair just before it and the pair just after it; what has
//! no pair on one side (a clip that begins or ends at rest) is no freeze. On the same clips: 3%, with
//! every injected freeze found. Repeats that come at one regular distance are a property of the file (its
//! frame rate was converted), not a fault.

use super::FaultParams;
use super::series::FaultPoint;

/// Equal distances between successive runs that make a cadence: two could be chance.
const CADENCE_RUNS: usize = 3;
/// A pair that changes by less than this share of the run's neighbours counts towards a cadence.
const CADENCE_SCORE: f64 = 0.5;

/// 1 − d / min(median, before, after) of every pair, with d the largest mean |ΔG| of a run of at least
/// `freeze_pairs` pairs that it belongs to, the run where the score is largest, and not below 0.
/// `grey_changes`: (later frame, mean |ΔG|) of every adjacent pair. Empty when the clip is shorter than
/// a run or half its pairs do not change at all (then nothing was moving).
pub(super) fn scores(grey_changes: &[(usize, f64)], params: &FaultParams) -> Vec<FaultPoint> {
    let changes: Vec<f64> = grey_changes.iter().map(|&(_, change)| change).collect();
    let median = crate::signals::median(&mut changes.clone());
    let Some(median) =
        median.filter(|&median| median > 0.0 && changes.len() >= params.freeze_pairs)
    else {
        return Vec::new();
    };
    let mut scores = runs(&changes, median, params);
    if params.freeze_needs_motion_around && is_cadence(&scores) {
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

fn runs(changes: &[f64], median: f64, params: &FaultParams) -> Vec<f64> {
    let neighbour = |pair: Option<usize>| {
        if params.freeze_needs_motion_around {
            pair.and_then(|pair| changes.get(pair)).map_or(0.0, |&c| c)
        } else {
            f64::INFINITY
        }
    };
    let mut scores = vec![0.0f64; changes.len()];
    for first in 0..changes.len() {
        let before = median.min(neighbour(first.checked_sub(1)));
        let mut change = 0.0f64;
        for last in first..changes.len() {
            change = change.max(changes[last]);
            if change >= before {
                // Nor can a longer run from here be below it.
                break;
            }
            let reference = before.min(neighbour(Some(last + 1)));
            if last + 1 - first >= params.freeze_pairs && change < reference {
                let score = 1.0 - change / reference;
                for of_pair in &mut scores[first..=last] {
                    *of_pair = of_pair.max(score);
                }
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
        scores(&numbered, &FaultParams::default())
            .iter()
            .map(|p| p.score)
            .collect()
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
    fn without_the_gate_it_is_the_rule_of_the_evidence() {
        let changes = [0.0, 0.1, 1.0, 1.0, 0.2, 0.05, 0.1, 0.5, 1.0, 1.0, 0.0];
        let median = 0.2;
        let params = FaultParams {
            freeze_needs_motion_around: false,
            ..FaultParams::default()
        };
        let numbered: Vec<(usize, f64)> = changes.iter().copied().enumerate().collect();
        for (pair, point) in scores(&numbered, &params).iter().enumerate() {
            // The quietest pair of pairs that holds this one.
            let with = |other: usize| f64::max(changes[pair], changes[other]);
            let before = pair.checked_sub(1).map_or(f64::INFINITY, with);
            let after = (pair + 1 < changes.len()).then(|| with(pair + 1));
            let least = before.min(after.unwrap_or(f64::INFINITY));
            let expected = (1.0 - least / median).max(0.0);
            assert!((point.score - expected).abs() < 1e-12, "{pair}: {point:?}");
        }
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
