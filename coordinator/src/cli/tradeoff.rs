//! `plumbline tradeoff`: from what was typed to points, and from points to a table and a sentence.

use std::path::PathBuf;

use clap::Args;
use plumbline_worker::profile::{Profile, Rung};

use super::measuring::{ComputingArgs, SettingArgs};
use super::summary::printable;
use super::{Failure, exit, print_text};
use crate::corpus::{Choice, CorpusError, GroupBy};
use crate::profiles::ProfileName;
use crate::progress::say;
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::select::KeepRule;
use crate::reduce::{PAPER_BINS, ReduceOptions};
use crate::run::RunError;
use crate::tradeoff::{
    self, Grid, GridPoint, PAGE_FILE, Rendering, Shape, TradeoffError, TradeoffOptions,
};

/// Measures what each second buys: profiles and knobs on a sample of your videos and on rendered scenes
#[derive(Debug, Args)]
pub(super) struct TradeoffArgs {
    /// As for `score`: videos, directories, globs, s3://BUCKET/PREFIX, or lists
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
    /// Directory for the table, the page and the picture; a command that was stopped resumes from it
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Videos measured at every point, drawn from all groups (or directories) in proportion
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(3..))]
    sample: u32,
    /// Another seed draws another sample
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Points measured: the rungs, and settings of height, finest scale and edges between them
    #[arg(long, value_enum, default_value = "knobs")]
    grid: Grid,
    /// A further point; may be given several times
    #[arg(long, value_name = "FILE.toml")]
    profile: Vec<ProfileName>,
    /// The point that the others are held against, a rung or FILE.toml
    #[arg(long, value_name = "PROFILE", default_value = "accurate")]
    top: ProfileName,
    /// Signals combined into the anomaly score
    #[arg(long, value_enum, default_value = "balanced")]
    recipe: Recipe,
    /// Which scored videos to keep, per group: a number N, a share P%, or s<=X
    #[arg(long, value_name = "RULE", default_value = "80%")]
    keep: KeepRule,
    /// Population behind the z-scores
    #[arg(long, value_enum, default_value = "corpus")]
    normalise_within: NormaliseWithin,
    /// Groups: a list's COLUMN, path:N or prefix:SEP
    #[arg(long, value_name = "RULE")]
    group_by: Option<GroupBy>,
    /// Only videos of this camera; again for more [default: all]
    #[arg(long = "camera", value_name = "KEY")]
    cameras: Vec<String>,
    /// Judgements (.csv, .jsonl or .parquet): columns `video` and `label` (0 failure, 1 success)
    #[arg(long, value_name = "LABELS")]
    labels: Option<PathBuf>,
    /// The column of the labels that holds the judgement
    #[arg(long, value_name = "COLUMN", default_value = "label")]
    label_column: String,
    /// Leave out the rendered scenes, whose truth is known
    #[arg(long)]
    no_rendered: bool,
    /// Rendered corpora (24 clips each) with known faults
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=100))]
    rendered: u16,
    /// Size of all rendered clips [default: 256x192 with faults, 640x480 for flow, pose and depth]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parse_size, conflicts_with = "no_rendered")]
    rendered_size: Option<(u32, u32)>,
    /// Videos of the run to plan [default: all of SOURCE]
    #[arg(long, value_name = "N")]
    videos: Option<u64>,
    /// Frames of each [default: like the sample's]
    #[arg(long, value_name = "N", requires = "size")]
    frames: Option<u32>,
    /// Their size [default: like the sample's]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parse_size, requires = "frames")]
    size: Option<(u32, u32)>,
    /// Cores of the run to plan, each like one of this machine's [default: this machine's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    cores: Option<u32>,
    /// Hours there are for it
    #[arg(long, value_name = "H", default_value_t = 8.0, value_parser = parse_hours)]
    hours: f64,
    /// Leading frames left out of every statistic [default: the profiles', 1]
    #[arg(long, value_name = "N")]
    conditioning_frames: Option<u32>,
    #[command(flatten)]
    settings: SettingArgs,
    /// Videos measured at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Measure everything again, whatever --out already holds
    #[arg(long)]
    no_resume: bool,
    /// Print tradeoff.json on standard output
    #[arg(long)]
    json: bool,
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once(['x', '×']);
    let sides = sides.and_then(|(w, h)| Some((w.trim().parse().ok()?, h.trim().parse().ok()?)));
    match sides {
        Some((width, height)) if width > 0 && height > 0 => Ok((width, height)),
        _ => Err("give columns and rows, such as 640x480".to_owned()),
    }
}

fn parse_hours(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hours) if hours.is_finite() && hours > 0.0 => Ok(hours),
        _ => Err("give a number of hours above 0".to_owned()),
    }
}

pub(super) fn run(args: TradeoffArgs) -> Result<u8, Failure> {
    let json = args.json;
    let options = args.into_options()?;
    let runtime = super::runtime()?;
    let found = runtime.block_on(tradeoff::tradeoff(&options));
    // Children are ended by dropping their handles, which needs the runtime no longer.
    runtime.shutdown_background();
    let found = found.map_err(|error| Failure {
        code: exit_code(&error),
        message: printable(&error.to_string()),
    })?;
    for line in tradeoff::table(&found).lines() {
        say(&printable(line));
    }
    say(&printable(&tradeoff::sentence(&found)));
    if let Some(warning) = tradeoff::warning(&found) {
        say(&format!("note: {warning}"));
    }
    say(&format!("page: {}", options.out.join(PAGE_FILE).display()));
    if json {
        let text = serde_json::to_string_pretty(&found).map_err(Failure::stopped)?;
        print_text(&text, &options.out)?;
    }
    Ok(exit::OK)
}

fn exit_code(error: &TradeoffError) -> u8 {
    match error {
        TradeoffError::Interrupted => exit::INTERRUPTED,
        TradeoffError::Corpus(CorpusError::Store(error))
        | TradeoffError::Run(RunError::Corpus(CorpusError::Store(error)))
            if error.is_transient() =>
        {
            exit::STOPPED
        }
        TradeoffError::Corpus(_)
        | TradeoffError::TooFew { .. }
        | TradeoffError::ScoresThere { .. }
        | TradeoffError::OnePoint
        | TradeoffError::Flow(_)
        | TradeoffError::Run(
            RunError::Corpus(_) | RunError::OutInUse { .. } | RunError::Profile(_),
        ) => exit::USAGE,
        _ => exit::STOPPED,
    }
}

impl TradeoffArgs {
    /// A profile with what was typed for all of them; a file's is tried first.
    fn load(&self, name: &ProfileName) -> Result<(Profile, crate::fanout::Slots), Failure> {
        let computing = ComputingArgs {
            profile: name.clone(),
            settings: self.settings.clone(),
        };
        let mut measuring = computing.usable(self.jobs)?;
        let profile = &mut measuring.profile;
        profile.conditioning_frames = self
            .conditioning_frames
            .unwrap_or(profile.conditioning_frames);
        Ok((measuring.profile, measuring.slots))
    }

    /// The points, the top one last.
    fn points(&self) -> Result<Vec<GridPoint>, Failure> {
        let mut rungs = Vec::new();
        for rung in Rung::CLASSICAL {
            rungs.push((rung, self.load(&ProfileName::Rung(rung))?.0));
        }
        let of_rung = |rung: Rung| {
            let found = rungs.iter().find(|(of, _)| *of == rung);
            found.map_or_else(|| Profile::new(rung), |(_, profile)| profile.clone())
        };
        let mut points = tradeoff::points(self.grid, &of_rung);
        for name in self.profile.iter().chain([&self.top]) {
            let point = GridPoint {
                name: name_of(name),
                profile: self.load(name)?.0,
            };
            // The top one may be of the grid, too.
            points.retain(|other| other.profile != point.profile);
            if points.iter().any(|other| other.name == point.name) {
                return Err(Failure::usage(format!(
                    "two points are named {}; rename the file of one",
                    point.name
                )));
            }
            points.push(point);
        }
        Ok(points)
    }

    fn into_options(self) -> Result<TradeoffOptions, Failure> {
        let points = self.points()?;
        let (_, slots) = self.load(&self.top)?;
        let cores = u32::try_from(slots.count).unwrap_or(u32::MAX);
        let mut rendering = Rendering {
            corpora: self.rendered.into(),
            ..Rendering::default()
        };
        if let Some((width, height)) = self.rendered_size {
            let size_px = (width as usize, height as usize);
            (rendering.corpus_size_px, rendering.scene_size_px) = (size_px, size_px);
        }
        Ok(TradeoffOptions {
            sources: self.sources,
            out: self.out,
            choice: Choice {
                group_by: self.group_by,
                cameras: self.cameras,
            },
            sample: self.sample as usize,
            seed: self.seed,
            points,
            reduce: ReduceOptions {
                recipe: self.recipe,
                bins: PAPER_BINS,
                range: Range::Full,
                keep: self.keep,
                profile_digest: String::new(),
                normalise_within: self.normalise_within,
                reference: None,
            },
            labels: self.labels.map(|path| (path, self.label_column)),
            rendering: (!self.no_rendered).then_some(rendering),
            videos: self.videos,
            shape: self
                .frames
                .zip(self.size)
                .map(|(frames, (width, height))| Shape {
                    frames,
                    width,
                    height,
                }),
            cores: self.cores.unwrap_or(cores),
            hours: self.hours,
            resume: !self.no_resume,
            slots,
        })
    }
}

/// A rung by its name, a file by its stem.
fn name_of(name: &ProfileName) -> String {
    match name {
        ProfileName::Rung(rung) => rung.as_str().to_owned(),
        ProfileName::File(path) => path
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned()),
    }
}
