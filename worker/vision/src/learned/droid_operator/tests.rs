//! The operator over networks of a few sums: which state goes where. The real networks are held in the
//! worker's tests.

use super::*;
use crate::learned::{Network, NetworkError, Tensor, TensorView};

/// Computes outputs from inputs by a formula, and notes every batch.
struct Formula(fn(&[(&'static str, TensorView<'_>)], &str) -> Tensor);

impl Network for Formula {
    fn run(
        &mut self,
        inputs: &[(&'static str, TensorView<'_>)],
        outputs: &[&'static str],
    ) -> Result<Vec<Tensor>, NetworkError> {
        Ok(outputs
            .iter()
            .map(|output| (self.0)(inputs, output))
            .collect())
    }
}

const SIDE: usize = 16;
const CELLS: usize = SIDE * SIDE;

fn input<'a>(inputs: &'a [(&'static str, TensorView<'a>)], name: &str) -> &'a [f32] {
    inputs.iter().find(|(n, _)| *n == name).unwrap().1.data
}

/// `[items, channels, 16, 16]` of `value(item, channel, cell)`.
fn tensor((items, channels): (usize, usize), value: impl Fn(usize, usize, usize) -> f32) -> Tensor {
    let data = (0..items * channels * CELLS)
        .map(|n| value(n / (channels * CELLS), n / CELLS % channels, n % CELLS))
        .collect();
    Tensor {
        shape: vec![items, channels, SIDE, SIDE],
        data,
    }
}

/// Features and contexts tell the picture's grey level; an update adds one to the hidden state, moves by
/// a thousandth of it and weighs by the context.
fn operator(params: DroidOperatorParams) -> DroidOperator {
    let features = |inputs: &[(&'static str, TensorView<'_>)], _: &str| {
        let level = input(inputs, "picture")[0];
        tensor((1, HIDDEN), |_, channel, _| level + channel as f32)
    };
    let context = |inputs: &[(&'static str, TensorView<'_>)], output: &str| {
        let level = input(inputs, "picture")[0];
        let sign = if output == "net" { 1.0 } else { -1.0 };
        tensor((1, HIDDEN), |_, channel, _| sign * (level + channel as f32))
    };
    let gates = |inputs: &[(&'static str, TensorView<'_>)], _: &str| {
        let held = input(inputs, "context");
        tensor((1, GATES), |_, c, cell| held[c / 3 * CELLS + cell])
    };
    let update = |inputs: &[(&'static str, TensorView<'_>)], output: &str| {
        let (net, held) = (input(inputs, "net"), input(inputs, "gates"));
        let count = net.len() / (HIDDEN * CELLS);
        let last = |item: usize| (item * HIDDEN + HIDDEN - 1) * CELLS;
        match output {
            "next_net" => tensor((count, HIDDEN), |i, c, cell| {
                net[(i * HIDDEN + c) * CELLS + cell] + 1.0
            }),
            "target_change" => tensor((count, 2), |i, _, cell| net[last(i) + cell] / 1000.0),
            _ => tensor((count, 2), |i, _, cell| {
                held[(i * GATES + GATES - 1) * CELLS + cell]
            }),
        }
    };
    let aggregate = |inputs: &[(&'static str, TensorView<'_>)], _: &str| {
        let (net, averages) = (input(inputs, "net"), input(inputs, "averages"));
        tensor((1, 1), |_, _, cell| {
            averages
                .iter()
                .enumerate()
                .map(|(e, a)| a * net[e * HIDDEN * CELLS + cell])
                .sum()
        })
    };
    let networks = DroidNetworks {
        features: Box::new(Formula(features)),
        context: Box::new(Formula(context)),
        gates: Box::new(Formula(gates)),
        update: Box::new(Formula(update)),
        aggregate: Box::new(Formula(aggregate)),
    };
    DroidOperator::new(networks, params)
}

fn exact() -> DroidOperatorParams {
    DroidOperatorParams {
        half_storage: false,
        broadcast_first: false,
        edges_per_call: 2,
        ..DroidOperatorParams::default()
    }
}

fn grey(level: u8) -> Rgb8 {
    Rgb8::new(8 * SIDE, 8 * SIDE, vec![level; 3 * 64 * CELLS]).unwrap()
}

fn level(value: u8) -> f32 {
    (f32::from(value) / 255.0 - 0.485) / 0.229
}

/// Change and weight of the first cell of every edge.
fn ask(operator: &mut DroidOperator, edges: &[(u64, usize, usize)]) -> Vec<(f32, f32)> {
    let here = vec![3.0; 2 * CELLS];
    let queries: Vec<EdgeQuery<'_>> = edges
        .iter()
        .map(|&(id, source_frame, target_frame)| EdgeQuery {
            id: EdgeId(id),
            source_frame,
            target_frame,
            reprojected: &here,
            last_target: &here,
        })
        .collect();
    let mut fields = vec![(vec![0.0; 2 * CELLS], vec![0.0; 2 * CELLS]); edges.len()];
    let mut answers: Vec<EdgeAnswer<'_>> = fields
        .iter_mut()
        .map(|(at, weight)| EdgeAnswer { at, weight })
        .collect();
    operator.update(&queries, &mut answers).unwrap();
    fields
        .iter()
        .map(|(at, weight)| (at[0] - 3.0, weight[0]))
        .collect()
}

#[test]
fn a_state_belongs_to_its_edge_and_begins_as_the_source() {
    let mut operator = operator(exact());
    for (frame, grey_level) in [(0, 10), (5, 200), (7, 90)] {
        assert!(operator.offer(frame, &grey(grey_level)).unwrap());
    }
    let start = |grey_level| level(grey_level) + 127.0;
    let near = |found: f32, net: f32| (found - net / 1000.0).abs() < 1e-5;
    let edges = [(0, 0, 5), (1, 5, 0), (2, 7, 0)];
    for round in 0..3 {
        let found = ask(&mut operator, &edges);
        for (&(change, weight), grey_level) in found.iter().zip([10, 200, 90]) {
            assert!(
                near(change, start(grey_level) + round as f32),
                "{round} {change}"
            );
            assert_eq!(weight, -start(grey_level));
        }
    }
    // Edge 1 rests for one update and begins anew; edge 0 goes on, whatever its place in the list.
    ask(&mut operator, &[(0, 0, 5)]);
    let found = ask(&mut operator, &[(1, 5, 0), (0, 0, 5)]);
    assert!(near(found[0].0, start(200)) && near(found[1].0, start(10) + 4.0));

    // Damping: the mean over the edges of a source of the last update.
    let mut damping = vec![0.0; CELLS];
    ask(&mut operator, &[(0, 0, 5), (1, 5, 0), (8, 0, 7)]);
    operator.depth_damping(0, &mut damping).unwrap();
    assert!((damping[0] - (level(10) + (6.0 + 1.0) / 2.0)).abs() < 1e-4);
    let error = operator.depth_damping(7, &mut damping).unwrap_err();
    assert!(
        matches!(error, LearnedError::LengthMismatch { .. }),
        "{error}"
    );
}

#[test]
fn batches_change_nothing() {
    let edges: Vec<(u64, usize, usize)> = (0..7).map(|n| (n, n as usize % 2, 1)).collect();
    let all: Vec<Vec<(f32, f32)>> = [1, 3, 100]
        .map(|edges_per_call| {
            let mut operator = operator(DroidOperatorParams {
                edges_per_call,
                ..exact()
            });
            operator.offer(0, &grey(10)).unwrap();
            operator.offer(1, &grey(70)).unwrap();
            ask(&mut operator, &edges);
            ask(&mut operator, &edges)
        })
        .to_vec();
    assert_eq!(all[0], all[1]);
    assert_eq!(all[0], all[2]);
}

#[test]
fn only_the_first_keyframe_is_broadcast_and_half_storage_rounds() {
    let mut operator = operator(DroidOperatorParams::default());
    operator.offer(0, &grey(10)).unwrap();
    operator.offer(1, &grey(70)).unwrap();
    let found = ask(&mut operator, &[(0, 0, 1), (1, 1, 0)]);
    let rounded = |value: f32| f16::from_f32(value).to_f32();
    // The last channel is the first one, and 127 more in the second frame.
    assert_eq!(found[0].1, -rounded(level(10)));
    assert_eq!(found[1].1, -rounded(level(70) + 127.0));
}

#[test]
fn still_frames_are_no_keyframes_and_sizes_may_not_change() {
    let params = DroidOperatorParams {
        keyframe_motion: 0.15,
        ..exact()
    };
    let mut operator = operator(params);
    // The formula moves by some 0.125 cells each way, whatever the picture.
    assert!(operator.offer(0, &grey(0)).unwrap());
    assert!(operator.offer(1, &grey(0)).unwrap());
    operator.params.keyframe_motion = 1.0;
    assert!(!operator.offer(2, &grey(0)).unwrap());
    let wide = Rgb8::new(136, 128, vec![0; 3 * 136 * 128]).unwrap();
    assert!(operator.offer(3, &wide).is_err());
    let here = vec![0.0; 2 * CELLS];
    let query = EdgeQuery {
        id: EdgeId(0),
        source_frame: 0,
        target_frame: 2,
        reprojected: &here,
        last_target: &here,
    };
    let (mut at, mut weight) = (here.clone(), here.clone());
    let mut answers = [EdgeAnswer {
        at: &mut at,
        weight: &mut weight,
    }];
    let error = operator.update(&[query], &mut answers).unwrap_err();
    assert!(matches!(error, LearnedError::UnknownFrame { frame: 2 }));
}
