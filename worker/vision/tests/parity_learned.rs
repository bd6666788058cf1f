//! What stands between the learned networks against the reference implementations' own numbers
//! (`../shared/golden`): correlations, up-sampling, pictures, motion features.
//!
//! Tolerances are those that the numbers come with: 1e-3 on SEA-RAFT's correlations (up to 79; the
//! reference's own f32 and f64 runs differ by 1.1e-4) and flows in pixels, 1e-4 on DROID-SLAM's. Pictures
//! are exact. The networks themselves are held in the worker's tests, which can run them.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "what cannot be read fails the test"
)]

mod archive;

use archive::{Archive, farthest};
use plumbline_vision::image::Rgb8;
use plumbline_vision::learned::convex::upsample;
use plumbline_vision::learned::correlation::{FeatureMap, FeaturePyramid, Window, look_up};
use plumbline_vision::learned::droid::{WINDOW, motion};
use plumbline_vision::learned::picture::{Planar, doubled};

const SEA_RAFT: f32 = 1e-3;
const DROID: f32 = 1e-4;
/// Flows of up to 68 px, of which one unit in the last place is 8e-6, each a weighted mean of four.
const DOUBLED: f32 = 3e-5;

/// Positions `[2, rows, columns]` of the cells themselves.
fn identity(rows: usize, columns: usize) -> Vec<f32> {
    let x = (0..rows * columns).map(|n| (n % columns) as f32);
    x.chain((0..rows * columns).map(|n| (n / columns) as f32))
        .collect()
}

/// `[..., rows * columns, 2]` as `[..., 2, rows * columns]`.
fn planar(pairs: &[f32]) -> Vec<f32> {
    let (x, y) = (pairs.iter().step_by(2), pairs.iter().skip(1).step_by(2));
    x.chain(y).copied().collect()
}

fn correlations(first: &FeatureMap, second: &FeatureMap, at: &[f32], window: Window) -> Vec<f32> {
    let mut out = vec![0.0; window.channels() * first.rows * first.columns];
    look_up(
        first,
        &FeaturePyramid::new(second.clone()),
        at,
        window,
        &mut out,
    )
    .unwrap();
    out
}

#[test]
fn sea_raft_correlations_and_up_sampling() {
    let Some(mut golden) = Archive::shared("sea_raft_small.npz") else {
        return;
    };
    for pair in ["pair0", "pair1"] {
        let shape = golden.shape(&format!("{pair}/fmap1"));
        let shape = (shape[1], shape[2], shape[3]);
        let [first, second] = ["fmap1", "fmap2"].map(|name| {
            FeatureMap::from_planar(&golden.f32(&format!("{pair}/{name}")), shape).unwrap()
        });
        let flow = golden.f32(&format!("{pair}/flow_in_iter1"));
        let at: Vec<f32> = identity(shape.1, shape.2)
            .iter()
            .zip(&flow)
            .map(|(a, b)| a + b)
            .collect();
        let window = Window {
            radius: 4,
            scale: 1.0 / (shape.0 as f32).sqrt(),
        };
        let found = correlations(&first, &second, &at, window);
        let worst = farthest(&found, &golden.f32(&format!("{pair}/corr_iter1")));
        println!("{pair}: correlations differ by at most {worst:.1e}");
        assert!(worst < SEA_RAFT);
    }
    // The first prediction of the pair that needs no padding, whose logits are kept whole.
    let flow: Vec<f32> = golden
        .f32("pair0/flow_in_iter1")
        .iter()
        .map(|v| 8.0 * v)
        .collect();
    let logits = golden.f32("pair0/upsample_logits_iter0");
    let shape = golden.shape("pair0/flow_in_iter1");
    let found = upsample(&flow, &logits, (2, shape[2], shape[3])).unwrap();
    assert!(farthest(&found, &golden.f32("pair0/iters0/flow")) < SEA_RAFT);
}

#[test]
fn worldscore_halves_and_doubles() {
    let Some(mut golden) = Archive::shared("sea_raft_small.npz") else {
        return;
    };
    for frame in ["1", "2"] {
        let shape = golden.shape(&format!("ws/image{frame}"));
        let picture = Rgb8::new(
            shape[1],
            shape[0],
            golden.bytes(&format!("ws/image{frame}")),
        )
        .unwrap();
        let half = Planar::new(&picture).unwrap().halved();
        let expected = golden.shape(&format!("ws/half{frame}"));
        assert_eq!((half.height, half.width), (expected[2], expected[3]));
        assert_eq!(half.data, golden.f32(&format!("ws/half{frame}")));
    }
    let half = golden.f32("ws/flow_half");
    let shape = golden.shape("ws/flow_half");
    let whole = planar(&golden.f32("ws/flow_fwd"));
    let (cells, whole_cells) = (shape[2] * shape[3], whole.len() / 2);
    for axis in 0..2 {
        let found = doubled(&half[axis * cells..][..cells], shape[3], shape[2], 2.0);
        assert!(farthest(&found, &whole[axis * whole_cells..][..whole_cells]) < DOUBLED);
    }
}

#[test]
fn droid_pictures_correlations_and_motion() {
    let Some(mut golden) = Archive::shared("droid_nets.npz") else {
        return;
    };
    let (channels, rows, columns) = (128, 16, 18);
    let cells = rows * columns;
    let bgr = golden.bytes("images_bgr");
    let inputs = golden.f32("inputs");
    for frame in 0..3 {
        let size = 3 * 128 * 144;
        let rgb = bgr[frame * size..][..size]
            .chunks_exact(3)
            .flat_map(|p| [p[2], p[1], p[0]]);
        let picture = Rgb8::new(144, 128, rgb.collect()).unwrap();
        let found = Planar::imagenet(&picture).unwrap();
        assert_eq!(found.data, inputs[frame * size..][..size]);
    }

    let features = golden.f32("fnet");
    let maps: Vec<FeatureMap> = features
        .chunks_exact(channels * cells)
        .map(|map| FeatureMap::from_planar(map, (channels, rows, columns)).unwrap())
        .collect();
    let (sources, targets) = (golden.indices("ii"), golden.indices("jj"));
    let at = golden.f32("coords1");
    let last = golden.f32("target");
    let expected = golden.f32("corr");
    let motions = golden.f32("motn");
    let per_edge = WINDOW.channels() * cells;
    for (edge, (&i, &j)) in sources.iter().zip(&targets).enumerate() {
        let at = planar(&at[edge * 2 * cells..][..2 * cells]);
        let found = correlations(&maps[i], &maps[j], &at, WINDOW);
        let worst = farthest(&found, &expected[edge * per_edge..][..per_edge]);
        println!("edge {edge}: correlations differ by at most {worst:.1e}");
        assert!(worst < DROID);
        let last = planar(&last[edge * 2 * cells..][..2 * cells]);
        let found = motion(&at, &last, (rows, columns)).unwrap();
        assert!(farthest(&found, &motions[edge * 4 * cells..][..4 * cells]) < DROID);
    }
    let grid = identity(rows, columns);
    for name in ["corr_at_grid_edge0", "mf/corr"] {
        let found = correlations(&maps[0], &maps[1], &grid, WINDOW);
        assert!(farthest(&found, &golden.f32(name)) < DROID, "{name}");
    }
}

#[test]
fn droid_disparities_are_up_sampled() {
    let Some(mut golden) = Archive::shared("droid_nets.npz") else {
        return;
    };
    let (disparities, logits) = (golden.f32("cvx/disp"), golden.f32("upd/upmask"));
    let expected = golden.f32("cvx/up");
    let cells = 16 * 18;
    for source in 0..3 {
        let values = &disparities[source * cells..][..cells];
        let logits = &logits[source * 576 * cells..][..576 * cells];
        let found = upsample(values, logits, (1, 16, 18)).unwrap();
        assert!(farthest(&found, &expected[source * 64 * cells..][..64 * cells]) < DROID);
    }
}
