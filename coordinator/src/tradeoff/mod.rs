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

mod compare;
mod document;
mod front;
mod grid;
mod injected;
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

use plumbline_common::id::VideoId;
use plumbline_common::row::{Cost, Row, Scene, Status};
use plumbline_sample::SampleError;
use plumbline_vision::flow::FlowError;
use plumbline_worker::explain::DrawError;
use serde::{Deserialize, Serialize};

use crate::corpus::{self, Entry, GroupBy};
use crate::fanout::Slots;
use crate::lease::Lease;
use crate::picture::PngError;
use crate::profiles;
use crate::progress::say;
use crate::publish::{CORPUS_FILE, OutDir, PublishError};
use crate::reduce::auroc::Auroc;
use crate::reduce::outcome::Recipe;
use crate::reduce::{self, ReduceOptions};
use crate::run::{RunError, STATE_DIRECTORY};
use crate::sample::WriteSampleError;
use crate::stop::StopSignals;

pub use compare::Agreement;
pub use grid::{Grid, GridPoint, points};
pub use injected::FaultsFound;
pub use plan::{CostModel, Plan, Question, Shape};
pub use rendered::Rendering;
pub use table::{sentence, table, warning};
pub use truth::TruthErrors;

use compare::{compare, foretells, uncertain};
use front::{Bought, front};
use plan::{Spent, Working};
use rendered::RenderedClip;
use sample::Sampled;
use truth::FlowPair;

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
    /// How videos are grouped: strata of the sample, and the groups of the keep rule.
    pub group_by: Option<GroupBy>,
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

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum TradeoffError {
    /// The corpus, OUT, or a measurement.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Labels, or the list of videos.
    #[error(transparent)]
    Corpus(#[from] corpus::CorpusError),
    /// Too few videos can be read.
    #[error(
        "{readable} of the videos can be read, and {MIN_SAMPLE} are needed to compare orders; give more"
    )]
    TooFew {
        /// Readable videos in the sample.
        readable: usize,
    },
    /// OUT belongs to a run of `score`.
    #[error("{out}: holds the results of a score run; choose another --out")]
    ScoresThere {
        /// OUT.
        out: String,
    },
    /// Nothing to compare.
    #[error(
        "one point alone compares with nothing: add --profile FILE.toml, or leave out --grid none"
    )]
    OnePoint,
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// A rendered clip cannot be written.
    #[error(transparent)]
    Render(WriteSampleError),
    /// A rendered scene has no truth.
    #[error("a scene of known truth does not render ({0}); report this defect")]
    Scene(#[from] SampleError),
    /// A point's flow does not work on a rendered scene.
    #[error("a profile's flow fails on a rendered scene: {0}; change its knobs")]
    Flow(#[from] FlowError),
    /// The picture cannot be drawn.
    #[error(transparent)]
    Draw(#[from] DrawError),
    /// The picture does not encode.
    #[error(transparent)]
    Png(#[from] PngError),
    /// A step broke down.
    #[error("a step broke down ({0}); what was measured is kept, and this is a defect to report")]
    Finishing(#[from] tokio::task::JoinError),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted: what was measured is kept; run the same command again to go on")]
    Interrupted,
}

/// Fewer have no order worth comparing.
const MIN_SAMPLE: usize = 3;

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
    let group_by = options.group_by.as_ref();
    let listing = corpus::freeze_anywhere(&options.sources, group_by, &out_text, s3).await?;
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

/// What rendered clips say of a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Known {
    truth: TruthErrors,
    faults: FaultsFound,
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
        Some(rendering) => Some(Arc::new(render(rendering, state).await?)),
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
            Some(rendered) => Some(known(point, rendered, options, state).await?),
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

/// Rendered clips and pairs.
struct Rendered {
    with_faults: Vec<RenderedClip>,
    scenes: Vec<RenderedClip>,
    pairs: Vec<FlowPair>,
    /// Of all specifications.
    digest: String,
}

async fn render(rendering: &Rendering, state: &OutDir) -> Result<Rendered, TradeoffError> {
    say("rendering clips whose truth is known");
    let (rendering, root) = (*rendering, state.root().to_path_buf());
    tokio::task::spawn_blocking(move || {
        let (with_faults, scenes) = (rendering.with_faults(), rendering.scenes());
        let specs = serde_json::to_vec(&(&with_faults, &scenes)).map_err(RunError::Profile)?;
        Ok(Rendered {
            pairs: truth::flow_pairs(&scenes)?,
            with_faults: rendered::write(with_faults, &root)?,
            scenes: rendered::write(scenes, &root)?,
            digest: blake3::hash(&specs).to_hex().to_string(),
        })
    })
    .await?
}

/// What rendered clips say of a point: taken over from an earlier run, or found and kept.
async fn known(
    point: &GridPoint,
    rendered: &Arc<Rendered>,
    options: &TradeoffOptions,
    state: &OutDir,
) -> Result<Known, TradeoffError> {
    let profile = rendered::profile_for(&point.profile);
    let digest = profile.digest().map_err(RunError::Profile)?;
    let name = format!(
        "known/{}-{}-{}.json",
        env!("CARGO_PKG_VERSION"),
        measure::short(&rendered.digest),
        measure::short(&digest)
    );
    if options.resume {
        let kept = std::fs::read(state.root().join(&name)).ok();
        if let Some(known) = kept.and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
            return Ok(known);
        }
    }
    let known = Known {
        truth: truth::errors(rendered, &profile, options).await?,
        faults: injected::find(&rendered.with_faults, &profile, options).await?,
    };
    let bytes = serde_json::to_vec(&known).map_err(RunError::Profile)?;
    state.put_atomic(&name, &bytes)?;
    Ok(known)
}

/// Points side by side, the cheapest first, and the plan. The last point measured is the top.
fn judge(
    options: &TradeoffOptions,
    corpus_videos: usize,
    sample: &[Sampled],
    labels: &BTreeMap<VideoId, f64>,
    measured: Vec<PointMeasured>,
) -> Result<Tradeoff, TradeoffError> {
    let question = Question {
        videos: options.videos.unwrap_or(corpus_videos as u64),
        shape: options.shape,
        cores: options.cores,
        hours: options.hours,
    };
    let keep = &options.reduce.keep;
    let Some(top) = measured.last() else {
        return Err(TradeoffError::OnePoint);
    };
    let top_cpu_s = cpu_s_per_video(&top.costs);
    let top_uncertain = uncertain(&top.rows, keep).iter().filter(|&&u| u).count();
    let mut points = Vec::new();
    for (index, of) in measured.iter().enumerate() {
        let profile = &of.point.profile;
        let working = Working {
            height_px: profile.working_height_px,
            conditioning_frames: profile.conditioning_frames,
        };
        let spent = spent(sample, of);
        let cpu_s = cpu_s_per_video(&of.costs);
        points.push(PointResult {
            name: of.point.name.clone(),
            profile: profile_to_type(&of.point),
            profile_digest: profile.digest().map_err(RunError::Profile)?,
            top: index + 1 == measured.len(),
            working_height_px: profile.working_height_px,
            finest_scale: profile.flow.finest_scale,
            edge_spans: profile.edge_spans.clone(),
            scored: of.rows.iter().filter(|row| row.anomaly.is_some()).count(),
            cpu_s_per_video: cpu_s,
            relative_cost: if top_cpu_s > 0.0 {
                cpu_s / top_cpu_s
            } else {
                1.0
            },
            stages_s: stages(&of.costs, cpu_s),
            on_front: false,
            agreement: compare(&of.rows, &top.rows, keep),
            spearman_by_recipe: of
                .by_recipe
                .iter()
                .map(|(recipe, rows)| {
                    let found = compare(rows, &top.by_recipe[recipe], keep).spearman;
                    (recipe.clone(), found)
                })
                .collect(),
            auroc_failure: foretells(&of.rows, labels),
            truth: of.known.as_ref().map(|known| known.truth),
            faults: of.known.as_ref().map(|known| known.faults.clone()),
            cost_model: plan::fit(&spent, working),
            plan: plan::plan(&spent, working, &question),
        });
    }
    let bought: Vec<Bought> = points
        .iter()
        .map(|point| Bought {
            cost: point.cpu_s_per_video,
            good: point.agreement.spearman.unwrap_or(-1.0),
        })
        .collect();
    for (point, on_front) in points.iter_mut().zip(front(&bought)) {
        point.on_front = on_front || point.top;
    }
    points.sort_by(|a, b| a.cpu_s_per_video.total_cmp(&b.cpu_s_per_video));
    let recommended = recommend(&points, &question).map(|point| point.name.clone());
    Ok(Tradeoff {
        source: options.sources.clone(),
        corpus_videos,
        sample: sample
            .iter()
            .map(|s| s.entry.video.as_str().to_owned())
            .collect(),
        recipe: options.reduce.recipe,
        keep: keep.to_string(),
        top_uncertain,
        question,
        waiting: waiting(&measured),
        points,
        recommended,
    })
}

/// Of the front's points that are done in time even at the upper end of their interval, the one with the
/// fewest flips; of equals the nearest in order, then the cheapest.
fn recommend<'a>(points: &'a [PointResult], question: &Question) -> Option<&'a PointResult> {
    const HOUR_S: f64 = 3600.0;
    let in_time = points.iter().filter(|point| {
        let plan = point.plan.filter(|_| point.on_front);
        plan.is_some_and(|plan| plan.wall_interval_90_s.1 <= question.hours * HOUR_S)
    });
    in_time.min_by(|a, b| {
        let spearman = |point: &PointResult| point.agreement.spearman.unwrap_or(-1.0);
        let flips = |point: &PointResult| point.agreement.flips.count();
        (flips(a).cmp(&flips(b)))
            .then(spearman(b).total_cmp(&spearman(a)))
            .then(a.cpu_s_per_video.total_cmp(&b.cpu_s_per_video))
    })
}

/// How long measurements took by the clock, over what they computed.
fn waiting(measured: &[PointMeasured]) -> f64 {
    let costs = || measured.iter().flat_map(|point| &point.costs);
    let cpu_s: f64 = costs().map(|cost| cost.cpu_s).sum();
    let total_s: f64 = costs().map(|cost| cost.total_s).sum();
    if cpu_s > 0.0 { total_s / cpu_s } else { 1.0 }
}

fn cpu_s_per_video(costs: &[Cost]) -> f64 {
    costs.iter().map(|cost| cost.cpu_s).sum::<f64>() / costs.len().max(1) as f64
}

/// Stages are timed by the clock; processor time is shared out among them in proportion.
fn stages(costs: &[Cost], cpu_s_per_video: f64) -> Stages {
    let sum = |of: fn(&Cost) -> f64| costs.iter().map(of).sum::<f64>();
    let total = sum(|cost| cost.total_s);
    let share = |of: fn(&Cost) -> f64| {
        if total > 0.0 {
            cpu_s_per_video * sum(of) / total
        } else {
            0.0
        }
    };
    Stages {
        decode: share(|cost| cost.decode_s),
        flow: share(|cost| cost.flow_s),
        signals: share(|cost| cost.signals_s),
        geometry: share(|cost| cost.geometry_s),
    }
}

fn spent(sample: &[Sampled], of: &PointMeasured) -> Vec<Spent> {
    let rows = sample.iter().zip(&of.rows).zip(&of.costs);
    rows.map(|((sampled, row), cost)| {
        let m = &row.measured;
        Spent {
            shape: match (m.frames, m.width, m.height) {
                (Some(frames), Some(width), Some(height)) => Some(Shape {
                    frames,
                    width,
                    height,
                }),
                _ => None,
            },
            parallax: m.scene == Some(Scene::Parallax) && m.status != Status::Failed,
            weight: sampled.weight,
            cpu_s: cost.cpu_s,
        }
    })
    .collect()
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
