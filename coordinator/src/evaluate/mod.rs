//! `plumbline evaluate`: do scores say what judges say? (Design section 8; the paper's Tables 1 to 3.)
//!
//! Per task the labelled videos are ranked by anomaly score, and the success rates of the lowest, the
//! middle, the highest and randomly drawn ones are compared (percent; standard error from the sample
//! standard deviation over √n). Where every label is 0 or 1, the area under the ROC curve says how well
//! the score foretells failure. Populations (real, generated) stand side by side with their own
//! entropies and weights. Whatever cannot be compared is counted and listed.

pub(crate) mod document;
mod input;
mod populations;
pub mod sets;

use std::num::NonZeroU16;
use std::path::PathBuf;

use serde::Serialize;

use crate::corpus::{CorpusError, GroupBy};
use crate::publish::{EVALUATION_FILES, OutDir, PublishError, REPORT_FILE};
use crate::reduce::auroc::{Auroc, auroc};
use crate::reduce::outcome::Range;
use crate::reduce_files::ReduceFilesError;
use crate::report;
use input::{Input, Judged};
pub(crate) use input::{WANTED_LABEL, share};
pub use populations::{PopulationStatistics, Populations};
use sets::{Difference, RealGap, SetRate, TaskRates};

/// A usable `plumbline evaluate`.
#[derive(Debug, Clone)]
pub struct EvaluateOptions {
    /// A file of scores, or a directory that holds them.
    pub scores: PathBuf,
    /// Judgements: one a row, any number per video.
    pub labels: Option<PathBuf>,
    /// The column of the labels that holds the judgement, in [0, 1].
    pub label_column: String,
    /// Where results go.
    pub out: PathBuf,
    /// What makes a task; the columns `task`, else `group`, where it is `None` and they exist.
    pub task: Option<GroupBy>,
    /// Videos per task in each set.
    pub per_set: usize,
    /// Seed of the random set and of the bootstrap.
    pub seed: u64,
    /// A column with the outcome in the real world, in [0, 1].
    pub real_column: Option<String>,
    /// A column that names the population of every scored row.
    pub population_column: Option<String>,
    /// Histogram bins behind the populations' entropies.
    pub bins: NonZeroU16,
    /// Histogram range behind them.
    pub range: Range,
}

/// Why there is no evaluation.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// A file does not read as a list.
    #[error(transparent)]
    List(#[from] CorpusError),
    /// The scores are not there.
    #[error(transparent)]
    Scores(#[from] ReduceFilesError),
    /// A value that is no judgement, a video named twice, a column that is missing.
    #[error("{path}: {reason}")]
    Content {
        /// The file.
        path: String,
        /// What is wrong, with the remedy.
        reason: String,
    },
    /// Nothing to compare.
    #[error(
        "no video has both a score and a label ({labelled} labelled, {scored} scored): the labels' column `video` must name videos as the scores do"
    )]
    NothingInCommon {
        /// Videos with a label.
        labelled: usize,
        /// Videos with a score.
        scored: usize,
    },
    /// Results cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// Results cannot be encoded.
    #[error("the evaluation cannot be encoded: {0}")]
    Encode(#[from] serde_json::Error),
}

impl EvaluateError {
    /// True where the caller named something unusable, rather than the machine failing.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Publish(_) | Self::Encode(_))
    }
}

/// The content of `evaluation.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// Version of the program.
    pub plumbline_version: String,
    /// The scores as named.
    pub scores: String,
    /// Rows of the scores.
    pub videos: usize,
    /// Rows with an anomaly score.
    pub scored: usize,
    /// What the labels say; absent without labels.
    pub success: Option<Success>,
    /// Populations side by side; absent where no column was named.
    pub populations: Option<Populations>,
}

impl Evaluation {
    /// What a person wants to know first, a line each.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        document::summary(self)
    }
}

/// What labels and scores say of each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Success {
    /// The labels as named.
    pub labels: String,
    /// Judgements read.
    pub judgements: usize,
    /// Rows without a judgement, such as answers that could not be read.
    pub empty_judgements: usize,
    /// Videos with a label and a score: those behind every number below.
    pub compared: usize,
    /// Videos with a label and no score, with their status.
    pub without_score: Vec<Unscored>,
    /// Videos with a score and no label.
    pub without_label: Vec<String>,
    /// Videos per task in each set, as asked for.
    pub per_set: usize,
    /// Seed of the random set.
    pub seed: u64,
    /// All tasks together.
    pub sets: Vec<SetRate>,
    /// Success rates against each other.
    pub differences: Vec<Difference>,
    /// Against the real world, where its outcomes are known.
    pub real: Vec<RealGap>,
    /// How well a high score foretells failure; only where every label is 0 or 1.
    pub auroc_failure: Option<Auroc>,
    /// Each task by itself, by name.
    pub tasks: Vec<TaskRates>,
    /// Tasks with fewer than three compared videos, which enter no set but `all`.
    pub tasks_left_out: Vec<String>,
}

/// A labelled video without a score.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unscored {
    /// The video.
    pub video: String,
    /// Its status, or that the scores do not have it.
    pub reason: String,
}

/// Evaluates, and writes `evaluation.json`, `evaluation.md` and a section of `report.html`.
///
/// # Errors
/// [`EvaluateError`].
pub fn evaluate(options: &EvaluateOptions) -> Result<Evaluation, EvaluateError> {
    let input = Input::read(options)?;
    let success = match &options.labels {
        None => None,
        Some(labels) => Some(success(labels.display().to_string(), &input, options)?),
    };
    let populations = match &options.population_column {
        None => None,
        Some(column) => Some(populations::side_by_side(&input, column, options)?),
    };
    let evaluation = Evaluation {
        plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
        scores: options.scores.display().to_string(),
        videos: input.rows.len(),
        scored: input.scored(),
        success,
        populations,
    };
    write(options, &evaluation)?;
    Ok(evaluation)
}

fn success(
    labels: String,
    input: &Input,
    options: &EvaluateOptions,
) -> Result<Success, EvaluateError> {
    let compared = input.compared(options)?;
    if compared.is_empty() {
        return Err(EvaluateError::NothingInCommon {
            labelled: input.labels.len(),
            scored: input.scored(),
        });
    }
    let rated = sets::rate(&compared, options.per_set, options.seed);
    Ok(Success {
        labels,
        judgements: input.judgements,
        empty_judgements: input.empty_judgements,
        compared: compared.len(),
        without_score: input.without_score(),
        without_label: input.without_label(),
        per_set: options.per_set,
        seed: options.seed,
        differences: sets::differences(&rated.sets),
        sets: rated.sets,
        real: rated.real,
        auroc_failure: foretells_failure(&compared, options.seed),
        tasks: rated.tasks,
        tasks_left_out: rated.left_out,
    })
}

/// The area for failed against successful videos, where every label is one or the other.
fn foretells_failure(videos: &[Judged], seed: u64) -> Option<Auroc> {
    if videos.iter().any(|v| v.label != 0.0 && v.label != 1.0) {
        return None;
    }
    let of = |label: f64| -> Vec<f64> {
        let videos = videos.iter().filter(|video| video.label == label);
        videos.map(|video| video.anomaly).collect()
    };
    auroc(&of(0.0), &of(1.0), sets::seed_of(seed, "auroc"))
}

fn write(options: &EvaluateOptions, evaluation: &Evaluation) -> Result<(), EvaluateError> {
    let out = OutDir::create(&options.out)?;
    let mut json = serde_json::to_vec_pretty(evaluation)?;
    json.push(b'\n');
    let [json_file, markdown_file] = EVALUATION_FILES;
    out.put_atomic(json_file, &json)?;
    out.put_atomic(markdown_file, document::markdown(evaluation).as_bytes())?;
    // A report that does not read is no report to add to.
    let report = std::fs::read_to_string(out.root().join(REPORT_FILE)).ok();
    let page = report::with_evaluation(report.as_deref(), evaluation);
    Ok(out.put_atomic(REPORT_FILE, page.as_bytes())?)
}
