//! Dense Inverse Search on request, one thread: `tests/benches/flow.sh` alternates it with OpenCV's.
//!
//! Standard input has one job a line, `PRESET FINEST_SCALE REPEAT FRAME1 FRAME2 TRUTH`, separated by
//! tabs; TRUTH is a `.flo` file or `-`. Each is answered by one line of tab-separated numbers: the median
//! time of a pair in milliseconds, the mean end-point error in pixels and the shares of errors above 1
//! and 3 px (`-` without TRUTH). A pair is both frames prepared and the flow found, as in OpenCV's
//! `calc`; buffers live as long as the preset stays, and are warmed by one run that is not counted.

#![expect(clippy::unwrap_used, reason = "a wrong job ends the benchmark")]

use std::hint::black_box;
use std::io::{BufRead, Write};
use std::time::Instant;

use plumbline_vision::flow::Flow;
use plumbline_vision::flow::accuracy::FlowAccuracy;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::flow::file::middlebury;
use plumbline_vision::image::{Plane, Rgb8};

fn main() {
    // `cargo test --benches` runs this with nothing on standard input, which is no job.
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        let words: Vec<&str> = line.split('\t').collect();
        let &[preset, finest_scale, repeat, first, second, truth] = words.as_slice() else {
            return;
        };
        let params = params(preset, finest_scale.parse().unwrap());
        let (first, second) = (read(first), read(second));
        let (flow, pair_ms) = time(&first, &second, &params, repeat.parse().unwrap());
        let accuracy = if truth == "-" {
            "-\t-\t-".to_owned()
        } else {
            let truth = middlebury::decode(&std::fs::read(truth).unwrap()).unwrap();
            let accuracy = FlowAccuracy::new(&flow, &truth).unwrap().unwrap();
            format!(
                "{:.6}\t{:.6}\t{:.6}",
                accuracy.mean_epe_px, accuracy.outlier_share_1px, accuracy.outlier_share_3px
            )
        };
        let mut out = std::io::stdout();
        writeln!(out, "{pair_ms:.5}\t{accuracy}").unwrap();
        out.flush().unwrap();
    }
}

fn params(preset: &str, finest_scale: u32) -> DisParams {
    let params = match preset {
        "ultrafast" => Some(DisParams::ultrafast(finest_scale)),
        "fast" => Some(DisParams::fast()),
        "medium" => Some(DisParams::medium()),
        _ => None,
    };
    DisParams {
        finest_scale,
        ..params.unwrap()
    }
}

fn time(first: &Plane, second: &Plane, params: &DisParams, repeat: usize) -> (Flow, f64) {
    let mut dis = Dis::new(params.clone());
    let mut flow = Flow::default();
    let mut times_ms = Vec::new();
    for run in 0..=repeat {
        let start = Instant::now();
        let a = DisFrame::new(first, params).unwrap();
        let b = DisFrame::new(second, params).unwrap();
        dis.flow_into(&a, &b, &mut flow).unwrap();
        let elapsed = start.elapsed();
        black_box(&flow);
        if run > 0 {
            times_ms.push(elapsed.as_secs_f64() * 1e3);
        }
    }
    times_ms.sort_by(f64::total_cmp);
    (flow, times_ms[times_ms.len() / 2])
}

fn read(path: &str) -> Plane {
    let picture = image::open(path).unwrap().to_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Rgb8::new(width, height, picture.into_raw()).unwrap().grey()
}
