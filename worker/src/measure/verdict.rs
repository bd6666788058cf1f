//! From a clip's evidence to its status: a clip that cannot be judged is never "perfect".

use plumbline_common::row::Status;
use plumbline_vision::faults::FaultPoint;

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
    /// Share of the structured cells that correspond; `None` with too little structure.
    pub(super) corresponding_fraction: Option<f64>,
}

/// The status, with the reason where it is not `scored`.
pub(super) fn verdict(
    usable_frames: u32,
    pairs: &[PairEvidence],
    bad_frames: &[FaultPoint],
    params: &VerdictParams,
) -> (Status, Option<String>) {
    if usable_frames < params.min_frames {
        let reason = format!(
            "{usable_frames} usable frame(s), {} are needed; see also --conditioning-frames",
            params.min_frames
        );
        return (Status::TooShort, Some(reason));
    }
    if let Some(reason) =
        vanished(pairs, params).or_else(|| broken(bad_frames, params.max_bad_frame))
    {
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

/// Why correspondences vanish, at the frame where the fewest are left; `None` where enough are.
fn vanished(pairs: &[PairEvidence], params: &VerdictParams) -> Option<String> {
    let least = |share: fn(&PairEvidence) -> Option<f64>, limit: f64| {
        pairs
            .iter()
            .filter_map(|pair| Some((pair.frame, share(pair)?)))
            .filter(|(_, share)| *share < limit)
            .reduce(|least, pair| if pair.1 < least.1 { pair } else { least })
    };
    let by_structure = least(
        |pair| pair.corresponding_fraction,
        params.min_corresponding_fraction,
    )
    .map(|(frame, share)| (frame, share, "structure"));
    let by_flow = || {
        let found = least(
            |pair| Some(pair.consistent_fraction),
            params.min_consistent_fraction,
        );
        found.map(|(frame, share)| (frame, share, "picture"))
    };
    let (frame, share, what) = by_structure.or_else(by_flow)?;
    Some(format!(
        "at frame {frame} only {:.1}% of the {what} corresponds to the frame before: a cut, or a broken frame",
        100.0 * share
    ))
}

/// Why the worst frame is broken; `None` where none is above `limit`.
fn broken(bad_frames: &[FaultPoint], limit: f64) -> Option<String> {
    let worst = bad_frames
        .iter()
        .reduce(|worst, point| {
            if point.score > worst.score {
                point
            } else {
                worst
            }
        })
        .filter(|worst| worst.score > limit)?;
    Some(format!(
        "frame {} is broken: {:.1}% of it differs from the frame before and the one after, which agree",
        worst.frame,
        100.0 * worst.score
    ))
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
                corresponding_fraction: Some(consistent_fraction),
            })
            .collect()
    }

    fn status(frames: u32, pairs: &[PairEvidence]) -> Status {
        verdict(frames, pairs, &[], &VerdictParams::default()).0
    }

    #[test]
    fn each_verdict_has_its_cause() {
        assert_eq!(status(11, &pairs(0.2, 0.9)), Status::Scored);
        assert_eq!(status(2, &pairs(0.2, 0.9)[..1]), Status::TooShort);
        assert_eq!(status(11, &pairs(0.0, 1.0)), Status::Static);
        let mut broken = pairs(0.2, 0.9);
        broken[4].consistent_fraction = 0.01;
        assert_collapsed(&broken, &[], "frame 5");
    }

    fn assert_collapsed(pairs: &[PairEvidence], bad_frames: &[FaultPoint], named: &str) {
        let (status, reason) = verdict(11, pairs, bad_frames, &VerdictParams::default());
        assert_eq!(status, Status::Collapsed);
        let reason = reason.unwrap();
        assert!(reason.contains(named), "{reason}");
    }

    #[test]
    fn either_kind_of_correspondence_may_vanish() {
        // A black frame: the flows agree on zero where there is nothing to see.
        let mut black = pairs(0.2, 0.9);
        black[6].corresponding_fraction = Some(0.0);
        assert_collapsed(&black, &[], "at frame 7 only 0.0% of the structure");
        // Without structure anywhere the flow decides.
        let mut flat = pairs(0.2, 0.9);
        for pair in &mut flat {
            pair.corresponding_fraction = None;
        }
        assert_eq!(status(11, &flat), Status::Scored);
        flat[2].consistent_fraction = 0.01;
        assert_collapsed(&flat, &[], "at frame 3 only 1.0% of the picture");
    }

    #[test]
    fn a_frame_that_no_neighbour_knows_is_broken() {
        let point = |frame: usize, score: f64| FaultPoint {
            frame,
            score,
            place: None,
        };
        let points = [point(3, 0.05), point(4, 0.3), point(5, 0.2)];
        assert_collapsed(&pairs(0.2, 0.9), &points, "frame 4 is broken: 30.0%");
        let (status, _) = verdict(
            11,
            &pairs(0.2, 0.9),
            &points[..1],
            &VerdictParams::default(),
        );
        assert_eq!(status, Status::Scored);
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
