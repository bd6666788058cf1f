//! Times one step of the dense bundle adjustment. Prints one CSV line per case:
//! `frames,edges,columns,rows,best,median,norm of the pose step`, times in milliseconds over the
//! repetitions. `tests/benches/bundle_twin.py` builds the same inputs.
//!
//! Options: `--repeat N` (default 5), `--threads N` (default 1), `--only FRAMESxEDGESxCOLUMNS`.

#![expect(clippy::unwrap_used, reason = "a wrong option ends the benchmark")]
#![expect(clippy::print_stdout, reason = "the result is what it prints")]

use std::hint::black_box;
use std::num::NonZeroUsize;
use std::time::Instant;

use plumbline_vision::slam::bundle::{
    BundleOptions, EdgeObservation, Problem, Scene, Workspace, adjust,
};
use plumbline_vision::slam::camera::{Grid, Pinhole};
use plumbline_vision::slam::se3::Se3;

const REPEAT: usize = 5;
const GRIDS: [(usize, usize); 2] = [(32, 32), (64, 48)];
/// Frames and edges; more edges than ordered pairs cannot be.
const SIZES: [(usize, usize); 6] = [
    (8, 30),
    (30, 30),
    (30, 300),
    (100, 30),
    (100, 300),
    (100, 2000),
];

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str| {
        let at = arguments.iter().position(|a| a == name)?;
        arguments.get(at + 1).cloned()
    };
    let repeat: usize = option("--repeat").map_or(REPEAT, |text| text.parse().unwrap());
    let threads: NonZeroUsize =
        option("--threads").map_or(NonZeroUsize::MIN, |text| text.parse().unwrap());
    let only = option("--only");
    for (columns, rows) in GRIDS {
        for (frames, edges) in SIZES {
            let name = format!("{frames}x{edges}x{columns}");
            if only.as_ref().is_none_or(|only| *only == name) {
                let mut workspace = Workspace::with_threads(threads);
                let grid = Grid { columns, rows };
                let times = time(frames, edges, grid, repeat, &mut workspace);
                let (best, median) = (times[0], times[times.len() / 2]);
                let step = workspace.pose_step().iter();
                let norm = step.map(|x| x * x).sum::<f64>().sqrt();
                println!("{frames},{edges},{columns},{rows},{best:.4},{median:.4},{norm:.9e}");
            }
        }
    }
}

/// Ordered pairs, nearest in time first.
fn ends(frames: usize, count: usize) -> Vec<(usize, usize)> {
    let spans = (1..frames).flat_map(|span| (0..frames - span).map(move |i| (i, i + span)));
    spans
        .flat_map(|(i, j)| [(i, j), (j, i)])
        .take(count)
        .collect()
}

/// Milliseconds of each step from the same state, in increasing order.
fn time(
    frames: usize,
    edges: usize,
    grid: Grid,
    repeat: usize,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let cells = grid.cells();
    let camera = Pinhole {
        fx: grid.columns as f64,
        fy: grid.columns as f64,
        cx: 0.5 * grid.columns as f64,
        cy: 0.5 * grid.rows as f64,
    };
    let pose = |i: usize| {
        let t = i as f64;
        let pose = [
            0.05 * t,
            0.02 * t.sin(),
            0.03 * t.cos(),
            0.005 * (2.0 * t).sin(),
            0.005 * (3.0 * t).cos(),
            0.002 * t.sin(),
            1.0,
        ];
        Se3::from_array(pose).normalised().unwrap()
    };
    let depth = |k: usize| {
        let (frame, cell) = ((k / cells) as f64, (k % cells) as f64);
        0.8 + 0.3 * (0.1 * cell + frame).sin()
    };
    let scene = Scene {
        camera,
        grid,
        poses: (0..frames).map(pose).collect(),
        inverse_depths: (0..frames * cells).map(depth).collect(),
    };
    let ends = ends(frames, edges);
    let plane = |f: &dyn Fn(f64, usize) -> f64| {
        (0..cells)
            .map(|k| f(k as f64, k) as f32)
            .collect::<Vec<f32>>()
    };
    let fields: Vec<[Vec<f32>; 2]> = ends
        .iter()
        .map(|&(i, j)| {
            let (i, j) = (i as f64, j as f64);
            let u = plane(&|k, c| (c % grid.columns) as f64 + 1.5 * (0.05 * k + i - j).sin());
            let v = plane(&|k, c| (c / grid.columns) as f64 + (0.04 * k + i + j).cos());
            let w = plane(&|k, _| 0.5 + 0.4 * (0.3 * k + i - j).sin());
            [[u, v].concat(), [w.clone(), w].concat()]
        })
        .collect();
    let edges: Vec<EdgeObservation<'_>> = ends
        .iter()
        .zip(&fields)
        .map(|(&(source, target), [at, weight])| EdgeObservation {
            source,
            target,
            at,
            weight,
        })
        .collect();
    let damping = vec![1e-3; frames * cells];
    let problem = Problem {
        edges: &edges,
        free: 1..frames,
        depth_damping: Some(&damping),
        measured: None,
    };
    let options = BundleOptions {
        iterations: 1,
        first_free_pose_quirk: false,
        ..BundleOptions::worldscore_backend()
    };
    let mut times = Vec::new();
    for _ in 0..=repeat {
        let mut state = scene.clone();
        let started = Instant::now();
        adjust(black_box(&mut state), &problem, &options, workspace).unwrap();
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    // The first call allocates.
    times.remove(0);
    times.sort_by(f64::total_cmp);
    times
}
