//! `plumbline profile`: what a profile's knobs are, and what differs between two.

use clap::{Args, Subcommand};
use comfy_table::{Table, presets};
use plumbline_worker::profile::{Profile, Rung};
use plumbline_worker::settings::Settings;
use serde_json::{Value, json};

use super::{Failure, exit, print_line};
use crate::profiles::{self, ProfileName};

/// Shows profiles: every knob, or the differences between two
#[derive(Debug, Args)]
pub(super) struct ProfileArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prints every knob as TOML: change some, and give the file to --profile
    Show {
        /// draft, standard, accurate, reference or FILE.toml
        #[arg(default_value = "standard", value_name = "PROFILE")]
        profile: ProfileName,
        /// Print JSON, with the digest
        #[arg(long)]
        json: bool,
    },
    /// Prints the knobs that two profiles have set differently
    Diff {
        /// draft, standard, accurate, reference or FILE.toml
        #[arg(value_name = "PROFILE")]
        first: ProfileName,
        /// Another
        #[arg(value_name = "OTHER")]
        second: ProfileName,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// What a rung is for (design, section 6).
fn purpose(rung: Rung) -> &'static str {
    match rung {
        Rung::Draft => "triage",
        Rung::Standard => "overnight",
        Rung::Accurate => "decisions",
        Rung::Reference => "comparison with published WorldScore numbers",
    }
}

/// What a profile of learned networks takes, beside its knobs.
fn takes(profile: &Profile) -> Vec<String> {
    let mut lines = Vec::new();
    if profile.sea_raft.is_some() || profile.droid.is_some() {
        lines.push(
            "runs learned networks: needs --models PLACE and --onnxruntime FILE (deploy/models/README.md)"
                .to_owned(),
        );
        if profile.models() == [None, None] {
            lines
                .push("the digests of the models found there become part of the digest".to_owned());
        }
    }
    if let Some(droid) = &profile.droid {
        lines.push(format!(
            "takes half a minute to a minute per frame and core, tens of minutes per clip, and up to 4 GiB for a clip of {} frames; longer ones are over_limit",
            droid.most_frames
        ));
    }
    lines
}

pub(super) fn run(args: ProfileArgs) -> Result<u8, Failure> {
    let limits = Settings::load().map_err(Failure::usage)?.decode;
    let load = |name: &ProfileName| profiles::load(name, &limits).map_err(Failure::usage);
    let text = match args.command {
        Command::Show { profile, json } => show(&load(&profile)?, json)?,
        Command::Diff {
            first,
            second,
            json,
        } => diff(&load(&first)?, &load(&second)?, json)?,
    };
    print_line(text.trim_end())?;
    Ok(exit::OK)
}

fn show(profile: &Profile, json: bool) -> Result<String, Failure> {
    let digest = profile.digest().map_err(Failure::usage)?;
    if json {
        let shown = json!({"name": profile.name(), "digest": digest, "parameters": profile});
        return serde_json::to_string_pretty(&shown).map_err(Failure::stopped);
    }
    let takes: String = takes(profile)
        .iter()
        .map(|line| format!("# {line}\n"))
        .collect();
    let knobs = profiles::to_toml(profile).map_err(Failure::usage)?;
    Ok(format!(
        "# profile {}: for {}\n# digest {digest}\n{takes}\n{knobs}",
        profile.name(),
        purpose(profile.rung),
    ))
}

fn diff(first: &Profile, second: &Profile, json: bool) -> Result<String, Failure> {
    let differences = profiles::differences(first, second).map_err(Failure::usage)?;
    if json {
        let all: serde_json::Map<_, _> = differences
            .into_iter()
            .map(|d| (d.knob, json!([d.first, d.second])))
            .collect();
        return serde_json::to_string_pretty(&all).map_err(Failure::stopped);
    }
    if differences.is_empty() {
        return Ok("no difference".to_owned());
    }
    let told = |value: Option<Value>| value.map_or("(not set)".to_owned(), |v| v.to_string());
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(["knob".to_owned(), first.name(), second.name()]);
    for d in differences {
        table.add_row([d.knob, told(d.first), told(d.second)]);
    }
    Ok(table.trim_fmt())
}
