//! What the reduce says of a whole corpus: the content of `corpus.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::drift::Comparison;

/// z-scores of fewer rows mean nothing: of two they are always −1 and 1.
pub const FEWEST_ROWS: u64 = 3;

/// Which signals are combined into the anomaly score.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Recipe {
    /// The paper's two measures, z-scored and weighed by entropy.
    Paper,
    /// The motion-balanced families {P, T} and {accs, Sd, sh}: mean of their means of robust z.
    Balanced,
}

/// The range that a histogram spans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// From the smallest to the largest value, as published.
    Full,
    /// From the 0.5% to the 99.5% quantile, and from 20 values on without at least one at either end;
    /// values beyond fall into the outer bins.
    Winsorised,
}

/// The population whose statistics make a row's z-scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum NormaliseWithin {
    /// The whole corpus.
    Corpus,
    /// The row's own group: for groups of different cameras, sizes or frame rates.
    Group,
}

/// The statistics of one signal over the scored rows that have it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SignalStatistics {
    /// Rows behind the statistics.
    pub n: u64,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// μ.
    pub mean: Option<f64>,
    /// σ, population (ddof 0).
    pub std: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Median absolute deviation, unscaled.
    pub mad: Option<f64>,
    /// Histogram edges, `bins + 1` of them, ascending.
    pub edges: Vec<f64>,
    /// Histogram counts.
    pub counts: Vec<u64>,
    /// H = −Σ p ln p, nats.
    pub entropy_nats: Option<f64>,
    /// True where the spread that its z-score divides by is zero (σ for the paper's signals, MAD for
    /// those with a robust z), so that the signal says nothing and weighs nothing.
    pub degenerate: bool,
    /// True where max − min is beyond the largest float; bins are then equal in another unit.
    #[serde(default)]
    pub range_overflow: bool,
}

/// Entropy weights of the paper's two signals under other choices of histogram.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeightSensitivity {
    /// Weights by signal with Freedman-Diaconis bins.
    pub freedman_diaconis: BTreeMap<String, f64>,
    /// How many bins those are; absent for a signal whose middle half is one value.
    #[serde(default)]
    pub freedman_diaconis_bins: BTreeMap<String, u16>,
    /// Weights by signal with the 0.5–99.5% winsorised range.
    pub winsorised: BTreeMap<String, f64>,
    /// The largest change of any weight when one row is left out (above 2000 rows: one of the
    /// extreme rows, since the others hardly matter).
    pub leave_one_out_max_change: f64,
    /// The row whose absence changes them most.
    pub leave_one_out_video: Option<String>,
}

/// Statistics and weights of one population (the whole corpus, or one group).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Population {
    /// Scored rows.
    pub n: u64,
    /// True with fewer than 3 of them: z-scores of two rows are always −1 and 1.
    #[serde(default)]
    pub too_few: bool,
    /// By column name, every signal of every recipe.
    pub signals: BTreeMap<String, SignalStatistics>,
    /// Entropy weights of the paper's two signals, by column name; they sum to 1, or are empty.
    pub weights: BTreeMap<String, f64>,
}

impl CorpusStatistics {
    /// The entropy weights that rows were scored with.
    #[must_use]
    pub fn weights(&self) -> &BTreeMap<String, f64> {
        match &self.reference {
            Some(reference) => &reference.weights,
            None => &self.corpus.weights,
        }
    }
}

/// `corpus.json` without what the run adds (version, source, profile).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorpusStatistics {
    /// Rows by status name; every status is present.
    pub statuses: BTreeMap<String, u64>,
    /// Rows by decision name.
    pub decisions: BTreeMap<String, u64>,
    /// The recipe behind `anomaly`.
    pub recipe: Recipe,
    /// Histogram bins.
    pub bins: u32,
    /// Histogram range.
    pub range: Range,
    /// What z-scores and weights come from.
    pub normalised_within: NormaliseWithin,
    /// The keep rule as given.
    pub keep: String,
    /// True where no signal of the recipe tells the scored rows apart, so that every score is 0 and
    /// ranks follow names.
    #[serde(default)]
    pub degenerate: bool,
    /// Rows that are kept or dropped although their interval reaches across the cut of their group;
    /// absent where no row has an interval.
    #[serde(default)]
    pub uncertain_decisions: Option<u64>,
    /// The whole corpus.
    pub corpus: Population,
    /// Each group on its own, for comparison side by side (empty without groups).
    pub groups: BTreeMap<String, Population>,
    /// How fragile the weights are; absent with fewer than 3 scored rows.
    pub sensitivity: Option<WeightSensitivity>,
    /// The frozen reference that rows were scored against, instead of `normalised_within`, and how the
    /// corpus compares with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Comparison>,
    /// What a reader must know: degenerate signals, fragile weights, too few rows.
    pub warnings: Vec<String>,
}
