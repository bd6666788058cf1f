//! Times the learned networks over converted models of random weights: `tests/benches/learned.sh`.
//!
//! `learned_times LIBRARY MODELS NAME REPEAT` prints one line per repeat: name, CPU seconds, wall seconds,
//! mean |output|. MODELS has the sets `sea-raft-m` and `droid`. Inputs are those of
//! `tests/benches/learned_twin.py`. One thread.

#![allow(clippy::print_stdout, reason = "the lines are what it is for")]

use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, bail};
use plumbline_vision::image::Rgb8;
use plumbline_vision::learned::droid::{Edges, GATES, HIDDEN, MOTION, WINDOW};
use plumbline_worker::learned::{ModelSet, Runtime, Threads};

/// Stripes that move by three columns and one row a frame.
fn picture(width: usize, height: usize, frame: usize) -> anyhow::Result<Rgb8> {
    let pixel = |n: usize| {
        let (x, y) = (n % width + 3 * frame, n / width + frame);
        [0, 1, 2].map(|c| ((x * (7 + c) + y * (5 + 2 * c) + x * y / (11 + c)) % 256) as u8)
    };
    let data = (0..width * height).flat_map(pixel).collect();
    Ok(Rgb8::new(width, height, data)?)
}

/// Values in [−1, 1) that repeat after 1009 numbers.
fn ramp(count: usize) -> Vec<f32> {
    (0..count)
        .map(|n| ((n % 1009) as f64 / 504.5 - 1.0) as f32)
        .collect()
}

fn mean_size(values: &[f32]) -> f64 {
    let sum: f64 = values.iter().map(|&v| f64::from(v).abs()).sum();
    sum / values.len() as f64
}

/// The network of a name as a call that returns the mean size of its output.
fn work(
    runtime: &Runtime,
    models: &Path,
    name: &str,
) -> anyhow::Result<Box<dyn FnMut() -> anyhow::Result<f64>>> {
    let (kind, size) = name.split_once(' ').context("NAME is a kind and a size")?;
    if kind.starts_with("sea-raft-m") {
        let set = ModelSet::read(&models.join("sea-raft-m"))?;
        let mut sea_raft = set.sea_raft(runtime, Threads::ONE)?;
        sea_raft.params_mut().half_resolution = false;
        let (width, height) = size.split_once('x').context("a size is WIDTHxHEIGHT")?;
        let (width, height) = (width.parse()?, height.parse()?);
        let frames = [picture(width, height, 0)?, picture(width, height, 1)?];
        if kind == "sea-raft-m-clip" {
            let mut last = sea_raft.prepare(&frames[0])?;
            let mut turn = 0;
            return Ok(Box::new(move || {
                turn += 1;
                let next = sea_raft.prepare(&frames[turn % 2])?;
                let forward = sea_raft.flow(&last, &next)?;
                let backward = sea_raft.flow(&next, &last)?;
                last = next;
                let sum = mean_size(&forward.network_flow) + mean_size(&backward.network_flow);
                Ok(sum / 2.0)
            }));
        }
        return Ok(Box::new(move || {
            let first = sea_raft.prepare(&frames[0])?;
            let second = sea_raft.prepare(&frames[1])?;
            Ok(mean_size(&sea_raft.flow(&first, &second)?.network_flow))
        }));
    }
    let mut droid = ModelSet::read(&models.join("droid"))?.droid(runtime, Threads::ONE)?;
    let frame = picture(512, 384, 0)?;
    Ok(match kind {
        "droid-features" => Box::new(move || Ok(mean_size(droid.features(&frame)?.cells()))),
        "droid-context" => Box::new(move || {
            let found = droid.context(&frame)?;
            Ok((mean_size(&found.net) + mean_size(&found.context)) / 2.0)
        }),
        "droid-update" => {
            let (edges, rows, columns): (usize, _, _) = (size.parse()?, 48, 64);
            let part = |channels| ramp(edges * channels * rows * columns);
            let (net, correlation, motion) = (part(HIDDEN), part(WINDOW.channels()), part(MOTION));
            // Once per frame, not part of an update. The twin's contexts differ from edge to edge.
            let context =
                |edge: usize| &net[edge * HIDDEN * rows * columns..][..HIDDEN * rows * columns];
            let mut gates = Vec::with_capacity(edges * GATES * rows * columns);
            for edge in 0..edges {
                gates.extend(droid.gates(context(edge), (rows, columns))?);
            }
            Box::new(move || {
                let found = droid.update(Edges {
                    shape: (edges, rows, columns),
                    net: &net,
                    gates: &gates,
                    correlation: &correlation,
                    motion: &motion,
                })?;
                let parts = [
                    (&found.net, 128.0),
                    (&found.change, 2.0),
                    (&found.weight, 2.0),
                ];
                let sum: f64 = parts
                    .iter()
                    .map(|(values, width)| width * mean_size(values))
                    .sum();
                Ok(sum / 132.0)
            })
        }
        _ => bail!("no network {kind}"),
    })
}

/// CPU seconds of this process.
fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [library, models, name, repeat] = arguments.as_slice() else {
        bail!("learned_times LIBRARY MODELS NAME REPEAT");
    };
    let runtime = Runtime::load(Path::new(library))?;
    let mut call = work(runtime, Path::new(models), name)?;
    call()?;
    for _ in 0..repeat.parse()? {
        let (cpu, wall) = (cpu_s(), Instant::now());
        let size = call()?;
        let (cpu, wall) = (cpu_s() - cpu, wall.elapsed().as_secs_f64());
        println!("{name},{cpu:.4},{wall:.4},{size:.9e}");
    }
    Ok(())
}
