//! SEA-RAFT and DROID-SLAM through converted models and ONNX Runtime, against the reference
//! implementations' own numbers (`../shared/golden`).
//!
//! `deploy/test.sh parity` converts the seeded weights that come with the numbers. Tolerances are the
//! suggested ones: 1e-3 px on SEA-RAFT's flows (the reference's f32 and f64 runs differ by 4e-5), 1e-4 on
//! everything of DROID-SLAM's (1e-5).

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "what cannot be read fails the test"
)]

#[path = "../vision/tests/archive/mod.rs"]
mod archive;

use std::path::{Path, PathBuf};

use archive::{Archive, farthest};
use plumbline_vision::consistency::worldscore_epe;
use plumbline_vision::flow::Flow;
use plumbline_vision::image::Rgb8;
use plumbline_vision::learned::LearnedError;
use plumbline_vision::learned::correlation::{FeatureMap, FeaturePyramid, look_up};
use plumbline_vision::learned::droid::{
    DroidNetworks, Edges, FrameContext, HIDDEN, WINDOW, mean_length,
};
use plumbline_vision::learned::droid_operator::{DroidOperator, DroidOperatorParams};
use plumbline_vision::learned::sea_raft::SeaRaft;
use plumbline_vision::slam::camera::{Grid, Pinhole};
use plumbline_vision::slam::operator::{CorrespondenceOperator, EdgeAnswer, EdgeId, EdgeQuery};
use plumbline_vision::slam::reference::{ReferenceParams, ReferenceTracker};
use plumbline_worker::learned::{ModelError, ModelSet, Runtime, Threads};

const SEA_RAFT: f32 = 1e-3;
const DROID: f32 = 1e-4;
/// A rounded look-up that falls on the other side moves one pixel's error, of some 36,000, by a few pixels.
const END_POINT: f64 = 1e-3;

/// A converted set and the library, as `deploy/test.sh` leaves them.
fn converted(set: &str) -> Option<(PathBuf, &'static Runtime)> {
    let work = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let set = work.join("learned").join(set);
    if !set.join("model.json").is_file() {
        println!("skipped: no ../shared, or not converted by deploy/test.sh");
        return None;
    }
    let library = work.join("models-venv/libonnxruntime.so");
    Some((set, Runtime::load(&library).unwrap()))
}

fn sea_raft() -> Option<(SeaRaft, Archive)> {
    let (set, runtime) = converted("sea-raft-small")?;
    let set = ModelSet::read(&set).unwrap();
    let sea_raft = set.sea_raft(runtime, Threads::ONE).unwrap();
    Some((sea_raft, Archive::shared("sea_raft_small.npz")?))
}

fn picture(golden: &mut Archive, key: &str) -> Rgb8 {
    let shape = golden.shape(key);
    Rgb8::new(shape[1], shape[0], golden.bytes(key)).unwrap()
}

/// Flows compare as `[H, W, 2]`.
fn values(flow: &Flow) -> Vec<f32> {
    flow.data.iter().flatten().copied().collect()
}

#[test]
fn sea_raft_gives_the_reference_flow_after_any_number_of_iterations() {
    let Some((mut sea_raft, mut golden)) = sea_raft() else {
        return;
    };
    assert_eq!(sea_raft.params().iterations, 4);
    sea_raft.params_mut().half_resolution = false;
    for pair in ["pair0", "pair1"] {
        let first = sea_raft
            .prepare(&picture(&mut golden, &format!("{pair}/image1")))
            .unwrap();
        let second = sea_raft
            .prepare(&picture(&mut golden, &format!("{pair}/image2")))
            .unwrap();
        for iterations in [0, 1, 4] {
            sea_raft.params_mut().iterations = iterations;
            let found = sea_raft.flow(&first, &second).unwrap();
            assert_eq!(found.iterations, iterations);
            let key = format!("{pair}/iters{iterations}");
            let flow = farthest(&found.network_flow, &golden.f32(&format!("{key}/flow")));
            let info = farthest(&found.uncertainty, &golden.f32(&format!("{key}/info")));
            println!("{key}: flow differs by at most {flow:.1e} px, uncertainty by {info:.1e}");
            assert!(flow < SEA_RAFT && info < SEA_RAFT);
        }
    }
}

#[test]
fn sea_raft_measures_a_pair_as_worldscore_does() {
    let Some((mut sea_raft, mut golden)) = sea_raft() else {
        return;
    };
    let [first, second] =
        ["ws/image1", "ws/image2"].map(|key| sea_raft.prepare(&picture(&mut golden, key)).unwrap());
    let forward = sea_raft.flow(&first, &second).unwrap();
    let backward = sea_raft.flow(&second, &first).unwrap();
    assert!(farthest(&forward.network_flow, &golden.f32("ws/flow_half")) < SEA_RAFT);
    for (found, key) in [(&forward, "ws/flow_fwd"), (&backward, "ws/flow_bwd")] {
        assert_eq!(
            [found.flow.height, found.flow.width],
            golden.shape(key)[..2]
        );
        assert!(
            farthest(&values(&found.flow), &golden.f32(key)) < SEA_RAFT,
            "{key}"
        );
    }
    let found = worldscore_epe(&forward.flow, &backward.flow).unwrap();
    let expected = golden.f64("ws/avg_epe")[0];
    let average = found.average_px.unwrap();
    println!("end-point error {average} px, the reference's {expected} px");
    assert!((average - expected).abs() < END_POINT);
    let failures = golden.f64("ws/failure_count")[0];
    assert!((found.failure_count as f64 - failures).abs() <= 2.0);
}

#[test]
fn sea_raft_stops_early_and_refuses_what_does_not_fit() {
    let Some((mut sea_raft, mut golden)) = sea_raft() else {
        return;
    };
    sea_raft.params_mut().half_resolution = false;
    let one = picture(&mut golden, "pair0/image1");
    let frame = sea_raft.prepare(&one).unwrap();
    sea_raft.params_mut().stop_below_px = Some(1e9);
    assert_eq!(sea_raft.flow(&frame, &frame).unwrap().iterations, 1);
    sea_raft.params_mut().stop_below_px = Some(0.0);
    assert_eq!(sea_raft.flow(&frame, &frame).unwrap().iterations, 4);

    let other = sea_raft
        .prepare(&picture(&mut golden, "pair1/image1"))
        .unwrap();
    let error = sea_raft.flow(&frame, &other).unwrap_err();
    assert!(matches!(error, LearnedError::SizeMismatch { .. }));
    // 121 px are padded to 128, whose pyramid has a cell on every level; 120 px are not. Halved, twice that.
    let grey = |width, height| Rgb8::new(width, height, vec![128; 3 * width * height]).unwrap();
    assert!(sea_raft.prepare(&grey(121, 130)).is_ok());
    let error = sea_raft.prepare(&grey(130, 120)).unwrap_err();
    assert!(error.to_string().contains("121 px"), "{error}");
    sea_raft.params_mut().half_resolution = true;
    assert!(sea_raft.prepare(&grey(242, 243)).is_ok());
    let error = sea_raft.prepare(&grey(241, 300)).unwrap_err();
    assert!(error.to_string().contains("242 px"), "{error}");
    // Weights of another width than the parameters say.
    sea_raft.params_mut().width += 1;
    let error = sea_raft.prepare(&grey(242, 242)).unwrap_err();
    assert!(error.to_string().contains("has shape"), "{error}");
}

/// Frames of the DROID numbers with what the networks make of them.
struct Droid {
    networks: DroidNetworks,
    golden: Archive,
    frames: Vec<Rgb8>,
    maps: Vec<FeatureMap>,
    contexts: Vec<FrameContext>,
}

const GRID: (usize, usize) = (16, 18);
const CELLS: usize = GRID.0 * GRID.1;

fn droid() -> Option<Droid> {
    let (set, runtime) = converted("droid")?;
    let set = ModelSet::read(&set).unwrap();
    let mut networks = set.droid(runtime, Threads::ONE).unwrap();
    let mut golden = Archive::shared("droid_nets.npz")?;
    let bgr = golden.bytes("images_bgr");
    let frames: Vec<Rgb8> = bgr
        .chunks_exact(3 * 128 * 144)
        .map(|frame| {
            let rgb = frame.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]);
            Rgb8::new(144, 128, rgb.collect()).unwrap()
        })
        .collect();
    let maps = frames
        .iter()
        .map(|f| networks.features(f).unwrap())
        .collect();
    let contexts = frames
        .iter()
        .map(|f| networks.context(f).unwrap())
        .collect();
    Some(Droid {
        networks,
        golden,
        frames,
        maps,
        contexts,
    })
}

/// `[..., cells, 2]` as `[..., 2, cells]`.
fn planar(pairs: &[f32]) -> Vec<f32> {
    pairs
        .chunks_exact(2 * CELLS)
        .flat_map(|pairs| [0, 1].map(|axis| pairs.iter().skip(axis).step_by(2)))
        .flatten()
        .copied()
        .collect()
}

fn correlations(droid: &Droid, source: usize, target: usize, at: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; WINDOW.channels() * CELLS];
    let target = FeaturePyramid::new(droid.maps[target].clone());
    look_up(&droid.maps[source], &target, at, WINDOW, &mut out).unwrap();
    out
}

#[test]
fn droid_makes_the_reference_features_and_contexts() {
    let Some(mut droid) = droid() else {
        return;
    };
    let (rows, columns) = GRID;
    let features = droid.golden.f32("fnet");
    let (nets, contexts) = (droid.golden.f32("net0"), droid.golden.f32("inp0"));
    for frame in 0..3 {
        let part = |all: &[f32]| all[frame * HIDDEN * CELLS..][..HIDDEN * CELLS].to_vec();
        let expected = FeatureMap::from_planar(&part(&features), (HIDDEN, rows, columns)).unwrap();
        let (found, expected) = (droid.maps[frame].cells(), expected.cells());
        assert!(farthest(found, expected) < DROID);
        assert!(farthest(&droid.contexts[frame].net, &part(&nets)) < DROID);
        assert!(farthest(&droid.contexts[frame].context, &part(&contexts)) < DROID);
    }
    let odd = Rgb8::new(132, 128, vec![0; 3 * 132 * 128]).unwrap();
    let error = droid.networks.features(&odd).unwrap_err();
    assert!(matches!(error, LearnedError::NotWholeCells { .. }));
    let small = Rgb8::new(128, 120, vec![0; 3 * 128 * 120]).unwrap();
    let error = droid.networks.context(&small).unwrap_err();
    assert!(matches!(error, LearnedError::TooSmall { .. }));
}

#[test]
fn droid_updates_edges_twice_and_damps_their_sources() {
    let Some(mut droid) = droid() else {
        return;
    };
    let (rows, columns) = GRID;
    let (sources, targets) = (droid.golden.indices("ii"), droid.golden.indices("jj"));
    let at = planar(&droid.golden.f32("coords1"));
    let correlation: Vec<f32> = (0..sources.len())
        .flat_map(|e| {
            correlations(
                &droid,
                sources[e],
                targets[e],
                &at[e * 2 * CELLS..][..2 * CELLS],
            )
        })
        .collect();
    let motion = droid.golden.f32("motn");
    let of_sources = |part: fn(&FrameContext) -> &Vec<f32>| -> Vec<f32> {
        sources
            .iter()
            .flat_map(|&i| part(&droid.contexts[i]))
            .copied()
            .collect()
    };
    let net = of_sources(|c| &c.net);
    let gates: Vec<f32> = sources
        .iter()
        .flat_map(|&i| {
            let context = &droid.contexts[i].context;
            droid.networks.gates(context, GRID).unwrap()
        })
        .collect();
    let shape = (sources.len(), rows, columns);
    let mut edges = Edges {
        shape,
        net: &net,
        gates: &gates,
        correlation: &correlation,
        motion: &motion,
    };
    let once = droid.networks.update(edges).unwrap();
    let mut hold = |found: &[f32], key: &str| {
        let expected = droid.golden.f32(key);
        let expected = if key.ends_with("delta") || key.ends_with("weight") {
            planar(&expected)
        } else {
            expected
        };
        let worst = farthest(found, &expected);
        println!("{key} differs by at most {worst:.1e}");
        assert!(worst < DROID, "{key}");
    };
    hold(&once.net, "upd/net1");
    hold(&once.change, "upd/delta");
    hold(&once.weight, "upd/weight");
    edges.net = &once.net;
    let twice = droid.networks.update(edges).unwrap();
    hold(&twice.net, "upd2/net");
    hold(&twice.change, "upd2/delta");
    hold(&twice.weight, "upd2/weight");

    let damping: Vec<f32> = (0..3)
        .flat_map(|source| {
            let net: Vec<f32> = (0..sources.len())
                .filter(|&e| sources[e] == source)
                .flat_map(|e| &once.net[e * HIDDEN * CELLS..][..HIDDEN * CELLS])
                .copied()
                .collect();
            let count = net.len() / (HIDDEN * CELLS);
            droid
                .networks
                .damping(&net, (count, rows, columns))
                .unwrap()
        })
        .collect();
    hold(&damping, "upd/eta");
    assert!(droid.networks.damping(&[], (0, rows, columns)).is_err());
}

/// The operator gives what the networks give when driven by hand: twice the same question, so that the
/// second answer shows the state between them.
#[test]
fn the_droid_operator_answers_as_the_reference() {
    let Some(mut droid) = droid() else {
        return;
    };
    let params = DroidOperatorParams {
        half_storage: false,
        broadcast_first: false,
        edges_per_call: 2,
        ..DroidOperatorParams::default()
    };
    let frames = droid.frames;
    let mut operator = DroidOperator::new(droid.networks, params);
    for (frame, picture) in frames.iter().enumerate() {
        assert!(operator.offer(frame, picture).unwrap());
    }
    let (sources, targets) = (droid.golden.indices("ii"), droid.golden.indices("jj"));
    let at = planar(&droid.golden.f32("coords1"));
    let last = planar(&droid.golden.f32("target"));
    let field = |all: &[f32], edge: usize| all[edge * 2 * CELLS..][..2 * CELLS].to_vec();
    let (at, last): (Vec<_>, Vec<_>) = (0..sources.len())
        .map(|e| (field(&at, e), field(&last, e)))
        .unzip();
    let queries: Vec<EdgeQuery<'_>> = (0..sources.len())
        .map(|edge| EdgeQuery {
            id: EdgeId(edge as u64),
            source_frame: sources[edge],
            target_frame: targets[edge],
            reprojected: &at[edge],
            last_target: &last[edge],
        })
        .collect();
    for update in ["upd", "upd2"] {
        let mut fields = vec![(vec![0.0; 2 * CELLS], vec![0.0; 2 * CELLS]); queries.len()];
        let mut answers: Vec<EdgeAnswer<'_>> = fields
            .iter_mut()
            .map(|(at, weight)| EdgeAnswer { at, weight })
            .collect();
        operator.update(&queries, &mut answers).unwrap();
        let changes = planar(&droid.golden.f32(&format!("{update}/delta")));
        let weights = planar(&droid.golden.f32(&format!("{update}/weight")));
        for (edge, (found, weight)) in fields.iter().enumerate() {
            let expected: Vec<f32> = at[edge]
                .iter()
                .zip(field(&changes, edge))
                .map(|(a, b)| a + b)
                .collect();
            assert!(farthest(found, &expected) < DROID, "{update}");
            assert!(farthest(weight, &field(&weights, edge)) < DROID, "{update}");
        }
        if update == "upd" {
            let expected = droid.golden.f32("upd/eta");
            let mut damping = vec![0.0; CELLS];
            for source in 0..3 {
                operator.depth_damping(source, &mut damping).unwrap();
                assert!(farthest(&damping, &expected[source * CELLS..][..CELLS]) < DROID);
            }
        }
    }
}

/// WorldScore's tracker over the real operator: the whole path, with all quirks and 16-bit storage, gives a
/// score, and the same one again.
#[test]
fn the_reference_tracker_runs_on_the_droid_operator() {
    let score = || {
        let droid = droid()?;
        let operator = DroidOperator::new(droid.networks, DroidOperatorParams::default());
        let camera = Pinhole {
            fx: 20.0,
            fy: 20.0,
            cx: 9.0,
            cy: 8.0,
        };
        let (rows, columns) = GRID;
        let grid = Grid { rows, columns };
        let mut tracker = ReferenceTracker::new(camera, grid, operator, ReferenceParams::default());
        for (frame, picture) in droid.frames.iter().enumerate() {
            if tracker.operator_mut().offer(frame, picture).unwrap() {
                tracker.push(frame).unwrap();
            }
        }
        tracker.finish().unwrap().mean_cells
    };
    let Some(first) = score() else {
        return;
    };
    println!("mean error of seeded weights: {first} cells");
    assert!(first.is_finite() && first > 0.0);
    assert_eq!(score().map(f64::to_bits), Some(first.to_bits()));
}

#[test]
fn droid_filters_motion() {
    let Some(mut droid) = droid() else {
        return;
    };
    let (rows, columns) = GRID;
    let x = (0..CELLS).map(|n| (n % columns) as f32);
    let grid: Vec<f32> = x.chain((0..CELLS).map(|n| (n / columns) as f32)).collect();
    let correlation = correlations(&droid, 0, 1, &grid);
    let first = droid.contexts[0].clone();
    let edges = Edges {
        shape: (1, rows, columns),
        net: &first.net,
        gates: &droid.networks.gates(&first.context, GRID).unwrap(),
        correlation: &correlation,
        motion: &vec![0.0; 4 * CELLS],
    };
    let found = droid.networks.update(edges).unwrap();
    assert!(farthest(&found.change, &planar(&droid.golden.f32("mf/delta"))) < DROID);
    assert!(farthest(&found.weight, &planar(&droid.golden.f32("mf/weight"))) < DROID);
    let (length, expected) = (
        mean_length(&found.change),
        droid.golden.f64("mf/mean_norm")[0],
    );
    assert!(
        (length - expected).abs() < f64::from(DROID),
        "{length} {expected}"
    );
}

#[test]
fn damaged_sets_are_refused_by_name() {
    let Some((set, runtime)) = converted("sea-raft-small") else {
        return;
    };
    let copy = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(&set).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, copy.path().join(path.file_name().unwrap())).unwrap();
    }
    let open = || {
        ModelSet::read(copy.path())?
            .sea_raft(runtime, Threads::ONE)
            .map(drop)
    };
    let good = ModelSet::read(copy.path()).unwrap().digest().to_owned();
    open().unwrap();
    assert_eq!(good.len(), 64);
    assert!(matches!(
        ModelSet::read(copy.path())
            .unwrap()
            .droid(runtime, Threads::ONE),
        Err(ModelError::AnotherNetwork { .. })
    ));

    let graph = copy.path().join("update.onnx");
    let mut bytes = std::fs::read(&graph).unwrap();
    bytes[1000] ^= 1;
    std::fs::write(&graph, &bytes).unwrap();
    let message = open().unwrap_err().to_string();
    assert!(message.contains("update.onnx") && message.contains("not what model.json says"));
    std::fs::remove_file(&graph).unwrap();
    assert!(open().unwrap_err().to_string().contains("update.onnx"));

    let sidecar = copy.path().join("model.json");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    let outside = text.replace("\"update.onnx\"", "\"../update.onnx\"");
    std::fs::write(&sidecar, &outside).unwrap();
    assert!(
        open()
            .unwrap_err()
            .to_string()
            .contains("not a file's name")
    );
    assert_ne!(ModelSet::read(copy.path()).unwrap().digest(), good);
    std::fs::write(&sidecar, text.replace("\"format\": 1", "\"format\": 2")).unwrap();
    assert!(open().unwrap_err().to_string().contains("format 2"));
    std::fs::write(&sidecar, &text[..100]).unwrap();
    assert!(open().unwrap_err().to_string().contains("model.json"));
    std::fs::remove_file(&sidecar).unwrap();
    assert!(matches!(open(), Err(ModelError::Missing { .. })));
}
