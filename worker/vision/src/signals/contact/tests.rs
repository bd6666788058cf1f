//! The statistic on clips in which a cover passes over a still scene and either leaves it as it was or
//! changes it.

use super::*;
use crate::consistency::{ConsistencyParams, Evidence, GridFlow, NormalisedFrame};

const SIDE: usize = 128;
const FRAMES: usize = 12;
/// The cover is on these cells from frame 3 to frame 7.
const COVER: [std::ops::Range<usize>; 2] = [40..60, 40..70];
const COVERED: std::ops::Range<usize> = 3..8;

fn in_cover(cell: usize) -> bool {
    COVER[0].contains(&(cell % SIDE)) && COVER[1].contains(&(cell / SIDE))
}

/// Grey levels of the scene: `after` is what the cover leaves behind.
fn picture(frame: usize, after: u8, exposure: u8) -> Rgb8 {
    let level = |cell: usize| match (in_cover(cell), frame) {
        (true, t) if COVERED.contains(&t) => 200,
        (true, t) if t >= COVERED.end => after,
        _ => 90,
    };
    let data = (0..SIDE * SIDE)
        .flat_map(|cell| [level(cell) + exposure * u8::from(frame > COVERED.end); 3])
        .collect();
    Rgb8::new(SIDE, SIDE, data).unwrap()
}

/// Flow between two frames: the cover's cells move while it is there.
fn pair(earlier: usize) -> ChangePair {
    let moves = COVERED.contains(&earlier) || COVERED.contains(&(earlier + 1));
    let grid = |sign: f32| GridFlow {
        width: SIDE,
        height: SIDE,
        cells_per_px: [0.5, 0.5],
        flow_px: (0..SIDE * SIDE)
            .map(|cell| {
                if moves && in_cover(cell) {
                    [sign * 2.0, 0.0]
                } else {
                    [0.0; 2]
                }
            })
            .collect(),
    };
    let params = ConsistencyParams::default();
    let flat = Plane::from_fn(SIDE, SIDE, |_, _| 90.0);
    let frame = NormalisedFrame::new(&flat, &params).unwrap();
    let of = |sign: f32| Evidence::new(&grid(sign), &grid(-sign), &frame, &frame, &params).unwrap();
    ChangePair::new(of(1.0), of(-1.0))
}

fn contact(after: u8, exposure: u8) -> Contact {
    let mut stream = ContactStream::new(ContactParams::default());
    for frame in 0..FRAMES {
        let pair = (frame > 0).then(|| pair(frame - 1));
        let picture = picture(frame, after, exposure);
        stream.push(&picture, pair.as_ref()).unwrap();
    }
    stream.finish().unwrap()
}

#[test]
fn only_what_comes_back_different_counts_as_touched() {
    let untouched = contact(90, 0);
    assert_eq!(untouched.revealed_changed, 0.0);
    // The cover's cells, and a rim that the erosion takes along, come back once.
    let cover = COVER[0].len() * COVER[1].len();
    assert!(
        (cover..cover + 400).contains(&untouched.revealed_cells),
        "{untouched:?}"
    );
    // All of it moved but the cells at its side whose flow does not come back; of the 120² cells
    // inside the margin.
    let all = cover as f64 / 14_400.0;
    assert!(untouched.moved_share > 0.8 * all && untouched.moved_share <= all);
    let touched = contact(130, 0);
    assert!(touched.revealed_changed > 0.5, "{touched:?}");
    assert_eq!(touched.moved_share, untouched.moved_share);
    assert!(touched.score() > 0.0 && untouched.score() == 0.0);
    // 15 levels are not enough.
    assert_eq!(contact(105, 0).revealed_changed, 0.0);
}

#[test]
fn a_change_of_exposure_at_the_reveal_is_common_to_all() {
    // The first frame on which the cells are static again (the one after the cover's last motion) is
    // also 30 levels brighter: only by the shift of the cells that stayed static is it not a change.
    assert_eq!(contact(90, 30).revealed_changed, 0.0);
    assert!(contact(130, 30).revealed_changed > 0.5);
}

#[test]
fn wrong_input_is_an_error_and_short_clips_give_nothing() {
    let mut stream = ContactStream::new(ContactParams::default());
    assert!(stream.clone().finish().is_none());
    stream.push(&picture(0, 90, 0), None).unwrap();
    assert!(stream.clone().finish().is_none());
    assert_eq!(
        stream.push(&picture(1, 90, 0), None),
        Err(ContactError::MissingPair)
    );
    let mut broken = pair(0);
    broken.forward_change.data.pop();
    assert!(matches!(
        stream.push(&picture(1, 90, 0), Some(&broken)),
        Err(ContactError::SizeMismatch { .. })
    ));
    let no_picture = Rgb8 {
        width: 3,
        height: 3,
        data: vec![],
    };
    assert!(stream.push(&no_picture, Some(&pair(0))).is_err());
    stream.push(&picture(1, 90, 0), Some(&pair(0))).unwrap();
    assert!(stream.finish().is_some());
}
