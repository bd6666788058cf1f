//! The child's side: limits first, then requests from standard input, answers to standard output.

use std::ffi::OsString;
use std::io::{BufWriter, Write};
use std::os::unix::ffi::OsStringExt;
use std::path::PathBuf;
use std::sync::mpsc;

use anyhow::Context;
use plumbline_common::frame;
use plumbline_common::message;
use rustix::process::{Resource, Rlimit, setrlimit};
use serde::Serialize;

use super::protocol::{Ask, Drawn, Request};
use super::sandbox;
use crate::explain::{self, Picture};
use crate::learned::Loaded;
use crate::measure::{Models, frames, measure_copy, measure_in_detail};
use crate::profile::Profile;
use crate::slam;

/// Answers requests until standard input closes.
///
/// # Errors
/// When the limits cannot be set, a job does not decode, or standard output is gone. The parent
/// sees the exit code and the message on standard error.
pub fn run(memory_mib: u64) -> anyhow::Result<()> {
    limit_resources(memory_mib)?;
    // Before any other thread is there. What this kernel does not offer, a worker says in its log.
    let _protections = sandbox::confine();
    let (jobs, inbox) = mpsc::sync_channel(1);
    // A thread of its own watches the pipe, so that a child in the middle of a long video still
    // ends at once when its parent is gone.
    std::thread::spawn(move || {
        let mut stdin = std::io::stdin().lock();
        while let Ok(Some(bytes)) = frame::read(&mut stdin) {
            if jobs.send(bytes).is_err() {
                break;
            }
        }
        std::process::exit(0);
    });
    let mut stdout = BufWriter::new(std::io::stdout().lock());
    let mut loaded = Loaded::default();
    while let Ok(bytes) = inbox.recv() {
        let Request { ask, copy, models } = message::decode(&bytes)?;
        let places = models.as_ref();
        let loaded = &mut loaded;
        let copy = copy.map(|path| PathBuf::from(OsString::from_vec(path.into_vec())));
        let copy = copy.as_deref();
        match ask {
            Ask::Measure(job) => {
                let mut models = Models { loaded, places };
                send(&mut stdout, &measure_copy(&job, copy, &mut models)?)?;
            }
            Ask::Detail(job) => {
                let mut models = Models { loaded, places };
                send(
                    &mut stdout,
                    &measure_in_detail(&job, copy, &mut models, None)?,
                )?;
            }
            Ask::Load(profile) => {
                let profile: Profile = serde_json::from_slice(&profile)?;
                let refused = loaded.networks(&profile, places).err();
                send(&mut stdout, &refused.map(|error| error.to_string()))?;
            }
            Ask::Track(job) => send(&mut stdout, &slam::track(&job, copy)?)?,
            Ask::Frames(job) => send(&mut stdout, &frames::sample(&job, copy)?)?,
            Ask::Draw(job) => {
                let mut hand_over =
                    |picture: Picture| Ok(send(&mut stdout, &Drawn::Picture(picture))?);
                let mut models = Models { loaded, places };
                let missing = explain::draw(&job, copy, &mut models, &mut hand_over)?;
                send(&mut stdout, &Drawn::End(missing))?;
            }
        }
    }
    Ok(())
}

fn send(stdout: &mut impl Write, answer: &impl Serialize) -> anyhow::Result<()> {
    frame::write(stdout, &message::encode(answer)?)?;
    Ok(stdout.flush()?)
}

/// Memory as given; no core dumps and no file writes: the child only reads.
fn limit_resources(memory_mib: u64) -> anyhow::Result<()> {
    let limits = [
        (Resource::As, memory_mib.saturating_mul(1 << 20)),
        (Resource::Core, 0),
        (Resource::Fsize, 0),
    ];
    for (resource, value) in limits {
        let limit = Rlimit {
            current: Some(value),
            maximum: Some(value),
        };
        setrlimit(resource, limit)
            .with_context(|| format!("cannot limit {resource:?} to {value} bytes"))?;
    }
    Ok(())
}
