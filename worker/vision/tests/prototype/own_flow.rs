//! The same series on this crate's own flow, from the prototype's frames, as the worker does at
//! `standard`.

use plumbline_vision::consistency::{ConsistencyParams, Evidence, GridFlow, NormalisedFrame};
use plumbline_vision::faults::ChangePair;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::Rgb8;
use plumbline_vision::signals::arc::{ArcSelector, ArcSelectorParams};

use super::measured::{Input, Measured, change_pair, measure};

struct Frame {
    dis: DisFrame,
    normalised: NormalisedFrame,
}

/// Series and kept frames.
pub(crate) fn on_own_flow(pictures: &[Rgb8]) -> (Measured, Vec<usize>) {
    let params = ConsistencyParams::default();
    let flow_params = DisParams::ultrafast(1);
    let mut dis = Dis::new(flow_params.clone());
    let frame = |picture: &Rgb8| {
        let grey = picture.grey();
        Frame {
            dis: DisFrame::new(&grey, &flow_params).unwrap(),
            normalised: NormalisedFrame::new(&grey, &params).unwrap(),
        }
    };
    let frames: Vec<Frame> = pictures.iter().map(frame).collect();
    let mut pair = |from: usize, to: usize| -> ChangePair {
        let (first, second) = (&frames[from], &frames[to]);
        let mut flow = |a: &Frame, b: &Frame| {
            let flow = dis.flow(&a.dis, &b.dis).unwrap();
            GridFlow::new(&flow, &params).unwrap()
        };
        let (ahead, back) = (flow(first, second), flow(second, first));
        change_pair(
            &ahead,
            &back,
            &first.normalised,
            &second.normalised,
            &params,
        )
    };
    let mut pairs = |span: usize| -> Vec<ChangePair> {
        (span..frames.len()).map(|to| pair(to - span, to)).collect()
    };
    let (adjacent, skip) = (pairs(1), pairs(2));
    let mut selector = ArcSelector::new(ArcSelectorParams::default());
    let is_kept = |&frame: &usize| selector.push(&frames[frame].normalised).unwrap();
    let kept: Vec<usize> = (0..frames.len()).filter(is_kept).collect();
    let step = |step: &[usize]| -> Evidence { pair(step[0], step[1]).forward };
    let steps = kept.windows(2).map(step).collect();
    let normalised: Vec<NormalisedFrame> = frames
        .iter()
        .map(|frame| frame.normalised.clone())
        .collect();
    let measured = measure(Input {
        frames: &normalised,
        pictures,
        adjacent: &adjacent,
        skip: &skip,
        kept: &kept,
        steps,
    });
    (measured, kept)
}
