//! `plumbline judge`: labels from a vision-language model.

use std::path::PathBuf;

use clap::Args;
use plumbline_worker::fetch::Fetcher;
use plumbline_worker::profile::{Profile, Rung};
use plumbline_worker::settings::Settings;
use serde_json::json;

use super::summary::printable;
use super::{Failure, exit, print_json};
use crate::fanout::Slots;
use crate::judge::{
    self, ChatOptions, DEFAULT_PROMPT, JudgeError, JudgeOptions, Judged, Prompt, Verdict,
};
use crate::progress::say;

/// Reasons shown on the terminal; the labels have them all.
const SHOWN: usize = 10;

/// Asks a vision-language model whether videos succeed, and writes the labels that `evaluate` reads
#[derive(Debug, Args)]
pub(super) struct JudgeArgs {
    /// Videos, directories, globs or lists, as for `score`
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
    /// File for the labels
    #[arg(long, value_name = "LABELS.csv")]
    out: PathBuf,
    /// Base address of an OpenAI-compatible server, such as `https://api.openai.com/v1`
    #[arg(long, value_name = "URL")]
    endpoint: String,
    /// The model's name there
    #[arg(long, value_name = "NAME")]
    model: String,
    /// Environment variable that holds the key (unset: none is sent)
    #[arg(long, value_name = "VARIABLE", default_value = "OPENAI_API_KEY")]
    key_env: String,
    /// What the robot should do, for every video
    #[arg(long, value_name = "TEXT")]
    task: Option<String>,
    /// The list's column that holds each video's task
    #[arg(long, value_name = "COLUMN")]
    task_column: Option<String>,
    /// A file with another question; {task} and {frames} are filled in
    #[arg(long, value_name = "FILE")]
    prompt: Option<PathBuf>,
    /// Frames shown, spread evenly over the video
    #[arg(long, value_name = "K", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=64))]
    frames: u32,
    /// Longer side of a shown frame, at most, px
    #[arg(long, value_name = "PX", default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=2048))]
    max_side: u32,
    /// Judgements per video
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeats: u32,
    /// Sampling temperature [default: the server's]
    #[arg(long, value_name = "T")]
    temperature: Option<f64>,
    /// Questions under way at once
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=256))]
    concurrency: u16,
    /// Time for one attempt, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 120.0)]
    timeout: f64,
    /// Attempts per question
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=20))]
    attempts: u32,
    /// Wait after a failed attempt, doubled each time, seconds; a server's Retry-After comes first
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    backoff: f64,
    /// Make at most so many calls
    #[arg(long, value_name = "N")]
    max_calls: Option<u64>,
    /// Ask nothing more once so many tokens are used
    #[arg(long, value_name = "N")]
    max_tokens: Option<u64>,
    /// Directory of kept answers, which are not asked for again [default: LABELS.csv.answers]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Print the summary as JSON on standard output
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: JudgeArgs) -> Result<u8, Failure> {
    let json = args.json;
    let options = args.into_options()?;
    let runtime = super::runtime()?;
    let judged = runtime.block_on(judge::judge(&options));
    runtime.shutdown_background();
    let judged = judged.map_err(|error| Failure {
        code: match &error {
            JudgeError::Interrupted => exit::INTERRUPTED,
            error if error.is_usage() => exit::USAGE,
            _ => exit::STOPPED,
        },
        message: printable(&error.to_string()),
    })?;
    tell(&judged, &options);
    if json {
        let count = |status: &str| {
            let judgements = judged.judgements.iter();
            judgements.filter(|j| j.verdict.status() == status).count()
        };
        let statuses: serde_json::Map<String, serde_json::Value> = judged
            .judgements
            .iter()
            .map(|j| {
                (
                    j.verdict.status().to_owned(),
                    json!(count(j.verdict.status())),
                )
            })
            .collect();
        let summary = json!({
            "labels": options.out.to_string_lossy(),
            "judgements": judged.judgements.len(),
            "statuses": statuses,
            "calls": judged.spent.calls,
            "tokens": judged.spent.tokens,
            "from_earlier_runs": judged.cached,
        });
        print_json(&summary, &options.out)?;
    }
    Ok(if judged.judgements.iter().all(is_judged) {
        exit::OK
    } else {
        exit::INCOMPLETE
    })
}

fn is_judged(judgement: &judge::Judgement) -> bool {
    matches!(judgement.verdict, Verdict::Judged { .. })
}

fn tell(judged: &Judged, options: &JudgeOptions) {
    let others: Vec<_> = judged.judgements.iter().filter(|j| !is_judged(j)).collect();
    for other in others.iter().take(SHOWN) {
        say(&printable(&format!(
            "{}: {}, repeat {}: {}",
            other.verdict.status(),
            other.video,
            other.repeat,
            other.verdict.text()
        )));
    }
    if others.len() > SHOWN {
        say(&format!(
            "and {} more without a judgement",
            others.len() - SHOWN
        ));
    }
    say(&format!(
        "{} judgements, {} without; {} calls, {} tokens; {} answers of earlier runs",
        judged.judgements.len() - others.len(),
        others.len(),
        judged.spent.calls,
        judged.spent.tokens,
        judged.cached
    ));
    say(&format!("labels: {}", options.out.display()));
}

impl JudgeArgs {
    fn into_options(self) -> Result<JudgeOptions, Failure> {
        let settings = Settings::load().map_err(Failure::usage)?;
        let mut profile = Profile::new(Rung::Standard);
        profile.limits = settings.decode;
        let usable = self.timeout > 0.0 && self.backoff >= 0.0;
        if !(usable && self.timeout.is_finite() && self.backoff.is_finite()) {
            return Err(Failure::usage(
                "--timeout must be above 0 and --backoff not below 0",
            ));
        }
        let key = std::env::var(&self.key_env)
            .ok()
            .filter(|key| !key.is_empty());
        if key.is_some() && !keeps_secrets(&self.endpoint) {
            return Err(Failure::usage(format!(
                "{}: the key in {} would be sent unencrypted; use https, or unset the variable",
                self.endpoint, self.key_env
            )));
        }
        let template = match &self.prompt {
            None => DEFAULT_PROMPT.to_owned(),
            Some(path) => std::fs::read_to_string(path).map_err(|error| {
                Failure::usage(format!("{}: {error}; check the path", path.display()))
            })?,
        };
        let cache = self.cache.unwrap_or_else(|| {
            let mut name = self.out.clone().into_os_string();
            name.push(".answers");
            name.into()
        });
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Ok(JudgeOptions {
            sources: self.sources,
            out: self.out,
            cache,
            prompt: Prompt {
                template,
                task: self.task,
                task_column: self.task_column,
            },
            frames: self.frames,
            max_side_px: self.max_side,
            repeats: self.repeats,
            concurrency: self.concurrency.into(),
            chat: ChatOptions {
                endpoint: self.endpoint,
                model: self.model,
                key,
                temperature: self.temperature,
                timeout_s: self.timeout,
                attempts: self.attempts,
                backoff_s: self.backoff,
                max_calls: self.max_calls,
                max_tokens: self.max_tokens,
            },
            profile,
            slots: Slots {
                program: std::env::current_exe().map_err(Failure::stopped)?,
                count: cores.min(self.concurrency.into()),
                limits: settings.compute,
                fetcher: Fetcher::new(settings.store.s3_options(), std::env::temp_dir()),
            },
        })
    }
}

/// Whether a key sent to this address stays between the two: encrypted, or on this machine.
fn keeps_secrets(endpoint: &str) -> bool {
    let Some(rest) = endpoint.strip_prefix("http://") else {
        return true;
    };
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    ["localhost", "127.0.0.1", "[::1]"].iter().any(|local| {
        host.strip_prefix(local)
            .is_some_and(|port| port.is_empty() || port.starts_with(':'))
    })
}

#[cfg(test)]
mod tests {
    use super::keeps_secrets;

    #[test]
    fn keys_travel_encrypted_or_not_at_all() {
        for endpoint in [
            "https://x.org/v1",
            "http://localhost:8000/v1",
            "http://127.0.0.1",
            "http://[::1]:1/v1",
        ] {
            assert!(keeps_secrets(endpoint), "{endpoint}");
        }
        for endpoint in [
            "http://x.org/v1",
            "http://localhost.x.org",
            "http://127.0.0.1@x.org/",
        ] {
            assert!(!keeps_secrets(endpoint), "{endpoint}");
        }
    }
}
