//! Faults of rendered clips, from the encoded file to the published row: right frame, right kind, and
//! none on the clean twin. One clip per kind that the shipped thresholds find on a static camera.

use plumbline_sample::corpus::{ClipSpec, sample_corpus};
use plumbline_sample::fault::FaultKind;
use plumbline_tests::clips;
use plumbline_tests::run::{Place, Started};

/// Detectors that settle a fault by its neighbours may date it one frame off.
const TOLERANCE_FRAMES: u64 = 1;

/// The sample's first clip with this fault.
fn faulty(kind: FaultKind) -> ClipSpec {
    let with_kind = |clip: &ClipSpec| clip.fault.is_some_and(|fault| fault.kind == kind);
    sample_corpus(0).into_iter().find(with_kind).unwrap()
}

#[test]
fn faults_are_published_at_their_frame_and_clean_twins_have_none() {
    let expected = [
        (FaultKind::BlurFrame, "bad_frame"),
        (FaultKind::Vanish, "vanish"),
        (FaultKind::Appear, "appear"),
    ];
    let place = Place::new();
    for (kind, _) in expected {
        let clip = faulty(kind);
        let twin = clip.clean_twin();
        clips::write(
            &place.video(format!("{}.mp4", clip.name)),
            &clips::frames(&clip),
        );
        clips::write(
            &place.video(format!("{}.mp4", twin.name)),
            &clips::frames(&twin),
        );
    }
    let mut standard = place.score(&["videos", "--out", "out"]);
    // The blurred frame is broken as a whole: that clip has no score.
    Started::start(&mut standard).wait().expect_code(3);
    let published = place.published("out");
    for (kind, detector) in expected {
        let clip = faulty(kind);
        let row = published.row(&format!("{}.mp4", clip.name));
        let truth = clip.fault_truth().unwrap().unwrap().first_frame as u64;
        let frame = row["fault_frames"][0].as_u64();
        let frame = frame.unwrap_or_else(|| panic!("no fault in {row:?}"));
        assert!(frame.abs_diff(truth) <= TOLERANCE_FRAMES, "{row:?}");
        assert_eq!(row["fault_kinds"][0], detector, "{row:?}");
        assert_eq!(row["peak_frame"], frame);
        let broken = kind == FaultKind::BlurFrame;
        let status = if broken { "collapsed" } else { "scored" };
        assert_eq!(row["status"], status, "{row:?}");
        let twin = published.row(&format!("{}.mp4", clip.clean_twin().name));
        assert_eq!(
            twin["fault_frames"].as_array().unwrap().len(),
            0,
            "{twin:?}"
        );
    }

    // A profile without calibrated thresholds says nothing instead of "no fault".
    place.run("draft", &[]).expect_code(0);
    for row in place.published("draft").rows() {
        assert!(row["fault_frames"].is_null() && row["peak_frame"].is_null());
    }
}
