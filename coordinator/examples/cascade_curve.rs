//! What a cascade would have come to, from runs that measured everything at every rung:
//!
//! `cascade_curve OUT_CHEAPEST ... OUT_TOP [--keep RULE] [--recipe R]`, each an OUT of `plumbline score
//! --format jsonl` over the same videos. Prints Markdown: how the rungs agree, and for several targets the
//! agreement and the share of the top's cost, over many draws of the sample. Videos of a sample fit the flip
//! model and are not judged ("judged"); "all" counts them, too.

#![allow(
    clippy::print_stdout,
    reason = "a table on standard output is what this is for"
)]

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Status};
use plumbline_coordinator::agreement::{Flips, kendall, score_error, spearman};
use plumbline_coordinator::cascade::{Assessment, Goal, Seen, Step, Video, assess, next, sample};
use plumbline_coordinator::reduce::outcome::{NormaliseWithin, Range, Recipe};
use plumbline_coordinator::reduce::recipe::{BySignal, Signal};
use plumbline_coordinator::reduce::{PAPER_BINS, ReduceOptions};
use serde_json::{Map, Value};

/// Draws of the sample.
const DRAWS: u8 = 40;
const TARGETS: [f64; 7] = [0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999];

type Rows = BTreeMap<String, Map<String, Value>>;

fn main() -> Result<(), Box<dyn Error>> {
    let mut keep = "80%".to_owned();
    let mut recipe = Recipe::Balanced;
    let mut outs = Vec::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--keep" => keep = words.next().ok_or("--keep RULE")?,
            "--recipe" => {
                recipe = match words.next().as_deref() {
                    Some("paper") => Recipe::Paper,
                    Some("balanced") => Recipe::Balanced,
                    _ => return Err("--recipe paper or balanced".into()),
                }
            }
            _ => outs.push(word),
        }
    }
    if outs.len() < 2 {
        return Err("two OUTs or more, the cheapest first".into());
    }
    let options = ReduceOptions {
        recipe,
        bins: PAPER_BINS,
        range: Range::Full,
        keep: keep.parse()?,
        profile_digest: String::new(),
        normalise_within: NormaliseWithin::Corpus,
        reference: None,
    };
    let world = world(&outs)?;
    let n = world.len();
    println!("{n} videos, keep rule {keep}, recipe {recipe:?}\n");
    rungs(&outs, &world, &options);
    println!(
        "\n| ladder | target | agreement, judged | worst draw | all | expected | cost of top | at top |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let top = outs.len() - 1;
    let mut ladders: Vec<Vec<usize>> = (0..top).map(|rung| vec![rung, top]).collect();
    if top > 1 {
        ladders.push((0..=top).collect());
    }
    for ladder in ladders {
        let name: Vec<String> = ladder.iter().map(|&rung| name(&outs[rung])).collect();
        let world = on_ladder(&world, &ladder);
        for target in TARGETS {
            let (told, _) = draws(&world, Goal::Agreement(target), &options);
            println!("| {} | {target} | {told} |", name.join(" → "));
        }
    }
    println!(
        "\n| ladder | cpu budget, share of top | agreement, judged | worst draw | all | expected | cost of top | at top |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let world = on_ladder(&world, &[0, top]);
    let full_s = cost_s(&world, 1);
    for share in [0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8] {
        let (told, _) = draws(&world, Goal::Cpu(share * full_s), &options);
        println!(
            "| {} → {} | {share} | {told} |",
            name(&outs[0]),
            name(&outs[top])
        );
    }
    Ok(())
}

fn name(out: &str) -> String {
    let name = Path::new(out).file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// Every video at every rung.
fn world(outs: &[String]) -> Result<Vec<Video>, Box<dyn Error>> {
    let mut videos: BTreeMap<VideoId, Video> = BTreeMap::new();
    for (rung, out) in outs.iter().enumerate() {
        let scores = rows(&Path::new(out).join("scores.jsonl"))?;
        let costs = rows(&Path::new(out).join("costs.jsonl"))?;
        for (video, row) in scores {
            let number = |name: &str| row.get(name).and_then(Value::as_f64);
            let status = row.get("status").cloned().unwrap_or_default();
            let status: Status = serde_json::from_value(status)?;
            let values = match status {
                Status::Scored => BySignal::from_fn(|signal: Signal| number(signal.column())),
                _ => BySignal::default(),
            };
            let cost = costs.get(&video).and_then(|cost| cost.get("cpu_s"));
            let seen = Seen {
                status,
                values,
                frames: number("frames").unwrap_or(0.0) as u32,
                cpu_s: cost.and_then(Value::as_f64).unwrap_or(0.0),
            };
            let entry = videos.entry(VideoId::new(video)?);
            let video = entry.or_insert_with(|| Video {
                group: None,
                seen: vec![None; outs.len()],
            });
            video.seen[rung] = Some(seen);
        }
    }
    if videos
        .values()
        .any(|video| video.seen.iter().any(Option::is_none))
    {
        return Err("the OUTs do not hold the same videos".into());
    }
    Ok(videos.into_values().collect())
}

fn rows(path: &Path) -> Result<Rows, Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut rows = Rows::new();
    for line in text.lines() {
        let row: Map<String, Value> = serde_json::from_str(line)?;
        let video = row.get("video").and_then(Value::as_str).unwrap_or_default();
        rows.insert(video.to_owned(), row);
    }
    Ok(rows)
}

fn on_ladder(world: &[Video], ladder: &[usize]) -> Vec<Video> {
    let chosen = |video: &Video| {
        ladder
            .iter()
            .map(|&rung| video.seen[rung].clone())
            .collect()
    };
    let videos = world.iter().map(|video| Video {
        group: video.group.clone(),
        seen: chosen(video),
    });
    videos.collect()
}

fn cost_s(world: &[Video], rung: usize) -> f64 {
    let seen = world.iter().filter_map(|video| video.seen[rung].as_ref());
    seen.map(|seen| seen.cpu_s).sum()
}

/// Everything at one rung alone.
fn alone(world: &[Video], rung: usize, options: &ReduceOptions) -> Assessment {
    assess(&on_ladder(world, &[rung]), &[], options)
}

fn decisions(assessment: &Assessment) -> Vec<Decision> {
    let judged = assessment.judged.iter().flatten();
    judged.map(|judged| judged.decision).collect()
}

/// Each rung by itself against the top by itself.
fn rungs(outs: &[String], world: &[Video], options: &ReduceOptions) {
    let top = outs.len() - 1;
    let truth = alone(world, top, options);
    let top_s = cost_s(world, top);
    println!(
        "| rung | CPU s per video | of top | Spearman | Kendall τ-b | score error, median | p95 | flips | agreement |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (rung, out) in outs.iter().enumerate() {
        let here = alone(world, rung, options);
        let pairs: Vec<(f64, f64)> = here
            .judged
            .iter()
            .zip(&truth.judged)
            .filter_map(|(a, b)| (*a)?.anomaly.zip((*b)?.anomaly))
            .collect();
        let flips = Flips::between(&decisions(&here), &decisions(&truth));
        let cost_s = cost_s(world, rung);
        let error = score_error(&pairs);
        let told = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
        println!(
            "| {} | {:.2} | {:.3} | {} | {} | {} | {} | {} | {:.3} |",
            name(out),
            cost_s / world.len() as f64,
            cost_s / top_s,
            told(spearman(&pairs)),
            told(kendall(&pairs)),
            told(error.map(|error| error.median)),
            told(error.map(|error| error.p95)),
            flips.count(),
            flips.agreement(),
        );
    }
}

/// A line of the table, means over draws of the sample; and the mean agreement.
fn draws(world: &[Video], goal: Goal, options: &ReduceOptions) -> (String, f64) {
    let top = world[0].seen.len() - 1;
    let truth = decisions(&alone(world, top, options));
    let full_s = cost_s(world, top);
    let (mut judged, mut worst, mut all, mut expected, mut cost, mut at_top) =
        (0.0, 1.0_f64, 0.0, 0.0, 0.0, 0.0);
    for seed in 0..DRAWS {
        let sample = sample::sample(world.len(), [seed; 32]);
        let mut known: Vec<Video> = world
            .iter()
            .map(|video| Video {
                group: video.group.clone(),
                seen: vec![None; top + 1],
            })
            .collect();
        let assessment = loop {
            match next(&known, &sample, &goal, options) {
                Step::Measure(wave) => {
                    for index in wave.videos {
                        known[index].seen[wave.rung].clone_from(&world[index].seen[wave.rung]);
                    }
                }
                Step::Done(assessment, _) => break assessment,
            }
        };
        let found = decisions(&assessment);
        let others = |decisions: &[Decision]| -> Vec<Decision> {
            let others = decisions.iter().enumerate();
            let others = others.filter(|(index, _)| !sample.contains(index));
            others.map(|(_, decision)| *decision).collect()
        };
        let of_others = Flips::between(&others(&found), &others(&truth)).agreement();
        judged += of_others;
        worst = worst.min(of_others);
        all += Flips::between(&found, &truth).agreement();
        expected += 1.0 - assessment.expected_flips() / world.len() as f64;
        cost += (0..=top).map(|rung| cost_s(&known, rung)).sum::<f64>() / full_s;
        let at = known.iter().filter(|video| video.seen[top].is_some());
        at_top += at.count() as f64 / world.len() as f64;
    }
    let mean = |sum: f64| sum / f64::from(DRAWS);
    let told = format!(
        "{:.4} | {worst:.3} | {:.4} | {:.4} | {:.3} | {:.3}",
        mean(judged),
        mean(all),
        mean(expected),
        mean(cost),
        mean(at_top)
    );
    (told, mean(all))
}
