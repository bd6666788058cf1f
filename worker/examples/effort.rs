//! Measures clips with knobs changed one way and another, clip by clip in turn, in one process.
//!
//! `effort ROUNDS RUNG KNOBS... -- CLIP...`: each of KNOBS is a JSON object laid over the rung's profile
//! (`{}`, `{"follow_flow": false}`). Prints one JSON line per clip and knobs: the least `cpu_s` of the rounds with
//! its stages, and the whole row.

#![allow(clippy::print_stdout, reason = "the lines are what the program is for")]

use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use anyhow::{Context, Result, bail};
use plumbline_common::file_time::modified_ns;
use plumbline_common::id::VideoId;
use plumbline_common::message::{Job, Location};
use plumbline_worker::measure::measure;
use plumbline_worker::profile::{Profile, Rung};
use serde_json::{Value, json};

/// `over` laid over `under`, object by object.
fn lay(under: &mut Value, over: &Value) {
    match (under, over) {
        (Value::Object(under), Value::Object(over)) => {
            for (key, value) in over {
                lay(under.entry(key).or_insert(Value::Null), value);
            }
        }
        (under, over) => *under = over.clone(),
    }
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut halves = arguments.splitn(2, |argument| argument == "--");
    let (options, clips) = (
        halves.next().unwrap_or_default(),
        halves.next().unwrap_or_default(),
    );
    let [rounds, rung, knobs @ ..] = options else {
        bail!("effort ROUNDS RUNG KNOBS... -- CLIP...");
    };
    let rounds: usize = rounds.parse()?;
    let rung = Rung::ALL.into_iter().find(|r| r.as_str() == rung);
    let base = serde_json::to_value(Profile::new(rung.context("no such rung")?))?;
    for clip in clips {
        let mut least: Vec<Option<(f64, Value)>> = vec![None; knobs.len()];
        for _ in 0..rounds {
            for (knobs, least) in knobs.iter().zip(&mut least) {
                let mut profile = base.clone();
                lay(&mut profile, &serde_json::from_str(knobs)?);
                let profile: Profile = serde_json::from_value(profile)?;
                let metadata = std::fs::metadata(clip).with_context(|| clip.clone())?;
                let outcome = measure(&Job {
                    video: VideoId::new("clip")?,
                    location: Location::File(Path::new(clip).as_os_str().as_bytes().to_vec()),
                    bytes: metadata.len(),
                    modified_ns: modified_ns(&metadata)?,
                    profile: profile.canonical()?,
                })?;
                let cpu_s = outcome.cost.cpu_s;
                if least.as_ref().is_none_or(|(before, _)| cpu_s < *before) {
                    let found = json!({"clip": clip, "knobs": knobs, "cost": outcome.cost,
                                       "row": outcome.measurement});
                    *least = Some((cpu_s, found));
                }
            }
        }
        for (_, line) in least.into_iter().flatten() {
            println!("{line}");
        }
    }
    Ok(())
}
