//! `plumbline fleet`: what waits on a fleet, and what to do about it.

use std::collections::BTreeMap;
use std::sync::Arc;

use clap::{Args, Subcommand};
use plumbline_common::id::RunId;
use plumbline_common::queue::{Broker, JobKind, Queue, QueueError};
use serde_json::{Value, json};

use super::queue::connect_briefly;
use super::summary::printable;
use super::{Failure, exit, print_line, queue_failure};
use crate::fleet::letters::{self, Letter};
use crate::progress::say;

/// Looks at the runs of a fleet, cancels them, and has dead jobs tried again
#[derive(Debug, Args)]
pub(super) struct FleetArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Jobs that wait, workers that are there, dead letters by run; with RUN also its results
    Status(Which),
    /// Ends a run: workers drop its jobs, its coordinator stops; what was measured is kept
    Cancel(One),
    /// Jobs that no worker got done, and why; they stay where they are
    Dead(Which),
    /// Has dead jobs tried again, of all runs or of RUN; the same `plumbline score` collects their rows
    Retry(Which),
}

#[derive(Debug, Args)]
struct Where {
    /// Broker of the fleet [default: PLUMBLINE_QUEUE__URL, or queue.url in plumbline.toml]
    #[arg(long, value_name = "URL")]
    queue: Option<String>,
    /// Print JSON on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct Which {
    #[command(flatten)]
    place: Where,
    /// A run, as `plumbline score --queue` names it
    #[arg(value_name = "RUN", value_parser = parse_run)]
    run: Option<RunId>,
}

#[derive(Debug, Args)]
struct One {
    #[command(flatten)]
    place: Where,
    /// The run, as `plumbline score --queue` names it
    #[arg(value_name = "RUN", value_parser = parse_run)]
    run: RunId,
}

fn parse_run(text: &str) -> Result<RunId, String> {
    RunId::new(text).map_err(|error| error.to_string())
}

pub(super) fn run(args: FleetArgs) -> Result<u8, Failure> {
    let runtime = super::runtime()?;
    let done = runtime.block_on(async {
        match args.action {
            Action::Status(which) => {
                let broker = connect_briefly(which.place.queue.as_deref()).await?;
                status(broker.as_ref(), which.run.as_ref(), which.place.json).await
            }
            Action::Cancel(one) => {
                let broker = connect_briefly(one.place.queue.as_deref()).await?;
                cancel(broker.as_ref(), &one.run, one.place.json).await
            }
            Action::Dead(which) => {
                let broker = connect_briefly(which.place.queue.as_deref()).await?;
                dead(broker.as_ref(), which.run.as_ref(), which.place.json).await
            }
            Action::Retry(which) => {
                let broker = connect_briefly(which.place.queue.as_deref()).await?;
                retry(&broker, which.run.as_ref(), which.place.json).await
            }
        }
    });
    runtime.shutdown_background();
    done.map(|()| exit::OK)
}

async fn status(broker: &dyn Broker, run: Option<&RunId>, json: bool) -> Result<(), Failure> {
    let jobs = Queue::Jobs(JobKind::Fused);
    let ready = broker.ready(&jobs).await.map_err(queue_failure)?;
    let consumers = broker.consumers(&jobs).await.map_err(queue_failure)?;
    let letters = letters::letters(broker, run).await.map_err(queue_failure)?;
    let mut dead: BTreeMap<String, u64> = BTreeMap::new();
    for letter in &letters {
        let run = letter.run.as_ref().map_or("", RunId::as_str);
        *dead.entry(run.to_owned()).or_default() += 1;
    }
    let results = match run {
        Some(run) => Some(results(broker, run).await?),
        None => None,
    };
    if json {
        let mut status =
            json!({ "jobs": { "ready": ready, "consumers": consumers }, "dead": dead });
        if let (Some(run), Some(results)) = (run, results) {
            status["run"] = json!(run);
            status["results"] = results.map_or(
                Value::Null,
                |(ready, consumers)| json!({ "ready": ready, "consumers": consumers }),
            );
        }
        return print_line(&status.to_string());
    }
    print_line(&format!("jobs: {ready} wait, {consumers} workers"))?;
    match (run, results) {
        (Some(run), Some(Some((ready, collectors)))) => print_line(&format!(
            "run {run}: {ready} results wait, {}",
            match collectors {
                0 => "no coordinator collects them: run its `plumbline score` again",
                _ => "a coordinator collects them",
            }
        ))?,
        (Some(run), Some(None)) => {
            print_line(&format!(
                "run {run}: not under way (finished, cancelled, or never started)"
            ))?;
        }
        _ => {}
    }
    for (run, count) in dead {
        let run = if run.is_empty() { "no run" } else { &run };
        print_line(&format!(
            "dead letters of {run}: {count} (plumbline fleet dead)"
        ))?;
    }
    Ok(())
}

/// Results that wait and who collects; none where the run is not under way.
async fn results(broker: &dyn Broker, run: &RunId) -> Result<Option<(u64, u64)>, Failure> {
    let queue = Queue::Results(run.clone());
    let state = async {
        let ready = broker.ready(&queue).await?;
        Ok((ready, broker.consumers(&queue).await?))
    };
    match state.await {
        Ok(state) => Ok(Some(state)),
        Err(QueueError::Missing { .. }) => Ok(None),
        Err(error) => Err(queue_failure(error)),
    }
}

async fn cancel(broker: &dyn Broker, run: &RunId, json: bool) -> Result<(), Failure> {
    let was_there = results(broker, run).await?.is_some();
    broker.delete(run).await.map_err(queue_failure)?;
    if json {
        return print_line(&json!({ "run": run, "was_under_way": was_there }).to_string());
    }
    say(&match was_there {
        true => format!("run {run} is cancelled: workers drop its jobs as they come to them"),
        false => format!("run {run} was not under way"),
    });
    Ok(())
}

async fn dead(broker: &dyn Broker, run: Option<&RunId>, json: bool) -> Result<(), Failure> {
    let letters = letters::letters(broker, run).await.map_err(queue_failure)?;
    if json {
        let letters = serde_json::to_string_pretty(&letters).map_err(Failure::stopped)?;
        return print_line(&letters);
    }
    if letters.is_empty() {
        say("no dead letters");
    }
    for letter in &letters {
        let Letter {
            run,
            video,
            id,
            reason,
            ..
        } = letter;
        let run = run.as_ref().map_or("(no run)", RunId::as_str);
        let video = video.as_deref().unwrap_or(id);
        print_line(&format!(
            "{run}  {}  {}",
            printable(video),
            printable(reason)
        ))?;
    }
    Ok(())
}

async fn retry(broker: &Arc<dyn Broker>, run: Option<&RunId>, json: bool) -> Result<(), Failure> {
    let (jobs, runs) = letters::retry(broker, run).await.map_err(queue_failure)?;
    if json {
        return print_line(&json!({ "jobs": jobs, "runs": runs }).to_string());
    }
    let runs: Vec<&str> = runs.iter().map(RunId::as_str).collect();
    say(&match jobs {
        0 => "no dead job to try again".to_owned(),
        _ => format!(
            "{jobs} {} back in the queue, of {}: run the same `plumbline score` again to collect; nothing else is measured again",
            if jobs == 1 { "job is" } else { "jobs are" },
            runs.join(", ")
        ),
    });
    Ok(())
}
