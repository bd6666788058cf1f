//! The story of `plumbline tradeoff`: what each second buys on the user's own videos.
//!
//! A sample of them is measured at every point (profiles of the ladder, settings of its main knobs, files
//! of the user's), and so are rendered clips whose truth is known. Each point is held against the top one
//! (order, score, decisions), against labels where there are any, and against that truth, which knows
//! nothing of the top one. Out come a table, `tradeoff.parquet`, `tradeoff.json`, a page and a picture with
//! the front, and the point that a number of videos, cores and hours allows.
//!
//! Points never share statistics: each is reduced by itself. Whatever is measured is kept below OUT, so that
//! a killed command goes on where it was. `tradeoff.json` disappears first and is written last.

mod camera;
mod compare;
mod document;
mod error;
mod front;
mod grid;
mod injected;
mod judge;
mod known;
mod labels;
mod measure;
mod page;
mod picture;
mod plan;
mod rendered;
mod sample;
mod table;
mod truth;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use plumbline_common::row::{Cost, Row};
use serde::Serialize;

use crate::corpus::{self, Choice, Entry};
use crate::fanout::Slots;
use crate::lease::Lease;
use crate::profiles;
use crate::progress::say;
use crate::publish::{CORPUS_FILE, OutDir};
use crate::reduce::auroc::Auroc;
use crate::reduce::outcome::Recipe;
use crate::reduce::{self, ReduceOptions};
use crate::run::{RunError, STATE_DIRECTORY};
use crate::stop::StopSignals;

pub use compare::Agreement;
pub use error::TradeoffError;
pub use grid::{Grid, GridPoint, points};
pub use injected::FaultsFound;
pub use plan::{CostModel, Plan, Question, Shape};
pub use rendered::Rendering;
pub use table::{sentence, table, warning};
pub use truth::TruthErrors;

use error::MIN_SAMPLE;
use judge::judge;
use known::Known;
use sample::Sampled;

/// The mark of a finished command.
pub const TRADEOFF_FILE: &str = "tradeoff.json";
/// One row per point.
pub const TABLE_FILE: &str = "tradeoff.parquet";
/// The page.
pub const PAGE_FILE: &str = "tradeoff.html";
/// The front as a picture.
pub const PICTURE_FILE: &str = "tradeoff.png";
/// The points as files for `--profile`.
const PROFILE_DIRECTORY: &str = "profiles";

/// A usable `plumbline tradeoff`.
#[derive(Debug, Clone)]
pub struct TradeoffOptions {
    /// The corpus, as typed.
    pub sources: Vec<String>,
    /// Where results go.
    pub out: PathBuf,
    /// Which of its videos, and their groups: strata of the sample, and the groups of the keep rule.
    pub choice: Choice,
    /// Videos in the sample.
    pub sample: usize,
    /// Seed of the sample.
    pub seed: u64,
    /// The points; the last is the top, which the others are held against.
    pub points: Vec<GridPoint>,
    /// How rows become decisions; the digest is each point's own.
    pub reduce: ReduceOptions,
    /// Judgements, and the column they are in.
    pub labels: Option<(PathBuf, String)>,
    /// What is rendered; nothing without.
    pub rendering: Option<Rendering>,
    /// What is asked of the planner; as many videos as the corpus has without.
    pub videos: Option<u64>,
    /// Their length and size; like the sample's without.
    pub shape: Option<Shape>,
    /// Cores of the planned run.
    pub cores: u32,
    /// Hours of the planned run.
    pub hours: f64,
    /// Whether earlier measurements count.
    pub resume: bool,
    /// Who computes.
    pub slots: Slots,
}

/// A finished command.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tradeoff {
    /// What was sampled, as typed.
    pub source: Vec<String>,
    /// Videos in it.
    pub corpus_videos: usize,
    /// The sample.
    pub sample: Vec<String>,
    /// The recipe behind scores and decisions.
    pub recipe: Recipe,
    /// The keep rule as given.
    pub keep: String,
    /// Of the sample, decisions of the top point that its own intervals leave open.
    pub top_uncertain: usize,
    /// What was asked of the planner.
    pub question: Question,
    /// Wall over processor time of all measurements: 1 on an idle machine.
    pub waiting: f64,
    /// The points, the cheapest first.
    pub points: Vec<PointResult>,
    /// Name of the point that the question's hours allow, the best of the front.
    pub recommended: Option<String>,
}

/// Seconds of processor time per video, by the wall time of stages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Stages {
    /// Reading, decoding, resizing.
    pub decode: f64,
    /// Optical flow.
    pub flow: f64,
    /// End-point errors, signals, faults.
    pub signals: f64,
    /// Motion models, layers, adjustment.
    pub geometry: f64,
}

/// What a point costs and gives.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointResult {
    /// Its name.
    pub name: String,
    /// For `--profile`: the rung's name, or the file below OUT.
    pub profile: String,
    /// The profile's digest.
    pub profile_digest: String,
    /// Whether it is the top point.
    pub top: bool,
    /// Rows of the working size.
    pub working_height_px: u32,
    /// Where the flow's search stops.
    pub finest_scale: u32,
    /// Frame distances of the edges.
    pub edge_spans: Vec<u32>,
    /// Videos of the sample with a score.
    pub scored: usize,
    /// Processor time per video of the sample, seconds.
    pub cpu_s_per_video: f64,
    /// The same over the top point's.
    pub relative_cost: f64,
    /// Where it goes, seconds per video.
    pub stages_s: Stages,
    /// Whether it lies on the front of cost and Spearman's ρ.
    pub on_front: bool,
    /// Against the top point, by the recipe asked for.
    pub agreement: Agreement,
    /// Spearman's ρ against the top point by recipe.
    pub spearman_by_recipe: BTreeMap<String, Option<f64>>,
    /// AUROC for failure, where there are labels.
    pub auroc_failure: Option<Auroc>,
    /// Against rendered scenes.
    pub truth: Option<TruthErrors>,
    /// On faults injected into rendered scenes.
    pub faults: Option<FaultsFound>,
    /// How its cost follows length and size.
    pub cost_model: Option<CostModel>,
    /// What the run asked about would cost.
    pub plan: Option<Plan>,
}

/// Measures the trade-off and writes it down.
///
/// # Errors
/// [`TradeoffError`]; whatever was measured is kept and taken over by the next run.
pub async fn tradeoff(options: &TradeoffOptions) -> Result<Tradeoff, TradeoffError> {
    if options.points.len() < 2 {
        return Err(TradeoffError::OnePoint);
    }
    let out_text = options.out.to_string_lossy();
    let s3 = options.slots.fetcher.s3_options();
    let listing = corpus::freeze_anywhere(&options.sources, &options.choice, &out_text, s3).await?;
    let labels = match &options.labels {
        Some((path, column)) => labels::read(path, column)?,
        None => BTreeMap::new(),
    };
    let sample = sample::draw(&listing.entries, options.sample, options.seed);
    if sample.len() < MIN_SAMPLE {
        let readable = sample.len();
        return Err(TradeoffError::TooFew { readable });
    }
    let out = OutDir::create(&options.out)?;
    if out.root().join(CORPUS_FILE).exists() {
        let out = options.out.display().to_string();
        return Err(TradeoffError::ScoresThere { out });
    }
    let state = OutDir::create(options.out.join(STATE_DIRECTORY))?;
    let _lease = Lease::take(&state)?.ok_or_else(|| RunError::OutInUse {
        out: options.out.display().to_string(),
    })?;
    for name in [TRADEOFF_FILE, TABLE_FILE, PAGE_FILE, PICTURE_FILE] {
        out.remove(name)?;
    }
    out.sweep_partials()?;
    let measuring = async {
        let measured = measure_all(options, &sample, &state).await?;
        let found = judge(options, listing.entries.len(), &sample, &labels, measured)?;
        publish(options, &out, &found)?;
        Ok(found)
    };
    let mut stop = StopSignals::listen();
    tokio::select! {
        found = measuring => found,
        () = stop.recv() => Err(TradeoffError::Interrupted),
    }
}

/// Everything measured of one point.
struct PointMeasured {
    point: GridPoint,
    /// By the recipe asked for, and by each.
    rows: Vec<Row>,
    by_recipe: BTreeMap<String, Vec<Row>>,
    costs: Vec<Cost>,
    known: Option<Known>,
}

async fn measure_all(
    options: &TradeoffOptions,
    sample: &[Sampled],
    state: &OutDir,
) -> Result<Vec<PointMeasured>, TradeoffError> {
    let entries: Vec<Entry> = sample.iter().map(|sampled| sampled.entry.clone()).collect();
    let entries = Arc::new(entries);
    let rendered = match &options.rendering {
        None => None,
        Some(rendering) => Some(Arc::new(known::render(rendering, state).await?)),
    };
    let mut measured = Vec::new();
    for (index, point) in options.points.iter().enumerate() {
        say(&format!(
            "{} ({} of {}): {} videos",
            point.name,
            index + 1,
            options.points.len(),
            entries.len()
        ));
        let found = measure::measure(point, &entries, options, state).await?;
        let known = match &rendered {
            None => None,
            Some(rendered) => Some(known::known(point, rendered, options, state).await?),
        };
        let reduce_by = |recipe: Recipe| {
            let own = ReduceOptions {
                recipe,
                ..options.reduce.clone()
            };
            reduce::reduce(found.videos.clone(), &own).rows
        };
        measured.push(PointMeasured {
            point: point.clone(),
            rows: reduce_by(options.reduce.recipe),
            by_recipe: [Recipe::Paper, Recipe::Balanced]
                .map(|recipe| (reduce::recipe_name(recipe).to_owned(), reduce_by(recipe)))
                .into(),
            costs: found.costs,
            known,
        });
    }
    Ok(measured)
}

/// A rung by its name; everything else is written as a file.
fn profile_to_type(point: &GridPoint) -> String {
    if point.profile.name() == point.name {
        point.name.clone()
    } else {
        format!("{PROFILE_DIRECTORY}/{}.toml", point.name)
    }
}

fn publish(options: &TradeoffOptions, out: &OutDir, found: &Tradeoff) -> Result<(), TradeoffError> {
    for point in &options.points {
        let name = profile_to_type(point);
        if name != point.name {
            let knobs = profiles::to_toml(&point.profile).map_err(RunError::Profile)?;
            out.put_atomic(&name, knobs.as_bytes())?;
        }
    }
    out.put_atomic_with(TABLE_FILE, |file| document::parquet(found, file))?;
    out.put_atomic(PAGE_FILE, page::render(found).as_bytes())?;
    out.put_atomic(PICTURE_FILE, &picture::png(found)?)?;
    let json = document::json(found).map_err(RunError::Profile)?;
    out.put_atomic(TRADEOFF_FILE, json.as_bytes())?;
    Ok(())
}
