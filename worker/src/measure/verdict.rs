//! From a clip's evidence to its status: a clip that cannot be judged is never "perfect".

use plumbline_common::row::Status;

use crate::profile::VerdictParams;

/// What the verdict looks at in one adjacent pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PairEvidence {
    /// Index of the later frame.
    pub(super) frame: u32,
    /// Share of the picture that moves by more than 1 px.
    pub(super) moving_fraction: f64,
    /// Share of the picture whose forward and backward flow agree.
    pub(super) consistent_fraction: f64,
}

/// The status, with the reason where it is not `scored`.
pub(super) fn verdict(
    usable_frames: u32,
    pairs: &[PairEvidence],
    params: &VerdictParams,
) -> (Status, Option<String>) {
    if usable_frames < params.min_frames {
        let reason = format!(
            "{usable_frames} usable frame(s), {} are needed; see also --conditioning-frames",
            params.min_frames
        );
        return (Status::TooShort, Some(reason));
    }
    let least = pairs.iter().reduce(|worst, pair| {
        if pair.consistent_fraction < worst.consistent_fraction {
            pair
        } else {
            worst
        }
    });
    if let Some(worst) =
        least.filter(|pair| pair.consistent_fraction < params.min_consistent_fraction)
    {
        let reason = format!(
            "at frame {} only {:.1}% of the picture corresponds to the frame before: a cut, or a broken frame",
            worst.frame,
            100.0 * worst.consistent_fraction
        );
        return (Status::Collapsed, Some(reason));
    }
    let moving = pairs
        .iter()
        .filter(|pair| pair.moving_fraction >= params.min_moving_fraction)
        .count();
    if moving < params.min_moving_pairs as usize {
        let reason = format!(
            "insufficient evidence: {moving} of {} frame pairs have motion in {:.1}% or more of the picture",
            pairs.len(),
            100.0 * params.min_moving_fraction
        );
        return (Status::Static, Some(reason));
    }
    (Status::Scored, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(moving_fraction: f64, consistent_fraction: f64) -> Vec<PairEvidence> {
        (1..=10)
            .map(|frame| PairEvidence {
                frame,
                moving_fraction,
                consistent_fraction,
            })
            .collect()
    }

    fn status(frames: u32, pairs: &[PairEvidence]) -> Status {
        verdict(frames, pairs, &VerdictParams::default()).0
    }

    #[test]
    fn each_verdict_has_its_cause() {
        assert_eq!(status(11, &pairs(0.2, 0.9)), Status::Scored);
        assert_eq!(status(2, &pairs(0.2, 0.9)[..1]), Status::TooShort);
        assert_eq!(status(11, &pairs(0.0, 1.0)), Status::Static);
        let mut broken = pairs(0.2, 0.9);
        broken[4].consistent_fraction = 0.01;
        let (status, reason) = verdict(11, &broken, &VerdictParams::default());
        assert_eq!(status, Status::Collapsed);
        assert!(reason.unwrap().contains("frame 5"));
    }

    #[test]
    fn a_few_moving_pairs_are_enough() {
        let mut mostly_still = pairs(0.0, 1.0);
        for pair in &mut mostly_still[..2] {
            pair.moving_fraction = 0.1;
        }
        assert_eq!(status(11, &mostly_still), Status::Static);
        mostly_still[2].moving_fraction = 0.1;
        assert_eq!(status(11, &mostly_still), Status::Scored);
    }
}
