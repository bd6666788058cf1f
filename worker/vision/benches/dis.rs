//! Times Dense Inverse Search per preset and frame size, one thread. Prints one CSV line each:
//! `preset,size,pair_ms,flow_ms`, medians over the repetitions.
//!
//! `pair` prepares both frames and finds the flow, which is what OpenCV's `calc` does; `flow` is the
//! flow alone, as where frames are shared between pairs. Frames are `<size>_a.png` and `<size>_b.png`
//! of the folder `--frames`, grey, or else a synthetic moving texture.
//!
//! Options: `--frames DIR`, `--repeat N` (default 15), `--only PRESET`, `--size NAME`.

#![expect(clippy::unwrap_used, reason = "a wrong option ends the benchmark")]
#![expect(clippy::print_stdout, reason = "the result is what it prints")]

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::Plane;

const SIZES: [(&str, usize, usize); 5] = [
    ("64", 64, 64),
    ("128", 128, 128),
    ("256", 256, 256),
    ("512", 512, 512),
    ("1080", 1920, 1080),
];

const REPEAT: usize = 15;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str| {
        let at = arguments.iter().position(|a| a == name)?;
        arguments.get(at + 1).cloned()
    };
    let frames = option("--frames");
    let repeat = option("--repeat").map_or(REPEAT, |text| text.parse().unwrap());
    let (only, only_size) = (option("--only"), option("--size"));
    let presets = [
        ("ultrafast0", DisParams::ultrafast(0)),
        ("ultrafast1", DisParams::ultrafast(1)),
        ("ultrafast", DisParams::ultrafast(2)),
        ("fast", DisParams::fast()),
        ("medium", DisParams::medium()),
    ];
    for (size, width, height) in SIZES {
        if only_size.as_ref().is_some_and(|only| only != size) {
            continue;
        }
        let [a, b] = match &frames {
            Some(folder) => ["a", "b"].map(|side| read(folder, size, side)),
            None => [0.0, 2.3].map(|shift| texture(width, height, shift)),
        };
        for (name, params) in &presets {
            if only.as_ref().is_none_or(|only| only == name) {
                let [pair_ms, flow_ms] = time(&a, &b, params, repeat);
                println!("{name},{size},{pair_ms:.4},{flow_ms:.4}");
            }
        }
    }
}

fn time(a: &Plane, b: &Plane, params: &DisParams, repeat: usize) -> [f64; 2] {
    let mut dis = Dis::new(params.clone());
    let mut flow = Flow::default();
    let (mut pair_ms, mut flow_ms) = (Vec::new(), Vec::new());
    // The first run warms the buffers and is not counted, unless it is the only one.
    for run in 0..repeat.max(2) {
        let start = Instant::now();
        let first = DisFrame::new(a, params).unwrap();
        let second = DisFrame::new(b, params).unwrap();
        let prepared = start.elapsed();
        dis.flow_into(&first, &second, &mut flow).unwrap();
        let total = start.elapsed();
        black_box(&flow);
        if run > 0 || repeat == 1 {
            pair_ms.push(total.as_secs_f64() * 1e3);
            flow_ms.push((total - prepared).as_secs_f64() * 1e3);
        }
        if repeat == 1 {
            break;
        }
    }
    [median(pair_ms), median(flow_ms)]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn read(folder: &str, size: &str, side: &str) -> Plane {
    let path = Path::new(folder).join(format!("{size}_{side}.png"));
    let picture = image::open(path).unwrap().to_luma8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Plane::new(
        width,
        height,
        picture.into_raw().into_iter().map(f32::from).collect(),
    )
    .unwrap()
}

/// Waves of several lengths, moved to the right and a little down.
fn texture(width: usize, height: usize, shift: f64) -> Plane {
    let waves = [
        (0.31, 0.12, 0.3),
        (-0.17, 0.29, 1.1),
        (0.07, -0.11, 2.0),
        (0.05, 0.43, 0.7),
        (0.83, -0.61, 0.2),
    ];
    Plane::from_fn(width, height, |x, y| {
        let (x, y) = (x as f64 - shift, y as f64 - 0.5 * shift);
        let sum: f64 = waves
            .iter()
            .map(|(a, b, c)| libm::sin(a * x + b * y + c))
            .sum();
        (128.0 + 24.0 * sum).round() as f32
    })
}
