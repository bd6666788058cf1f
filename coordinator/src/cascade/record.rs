//! What `corpus.json` says of a cascade.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::crossed::Crossed;
use crate::reduce::outcome::Population;

/// A cascade, told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CascadeRecord {
    /// The budget as understood.
    pub budget: String,
    /// Whether the same videos give the same bits anywhere: not where the budget is in seconds.
    pub reproducible: bool,
    /// Why it ended where it did, for a person.
    pub ended: String,
    /// Videos measured at every rung, by which rungs are calibrated and flips foretold; drawn by the digest
    /// of the corpus.
    pub sample: u64,
    /// Decisions of which the top profile would decide otherwise, on average; absent where nothing is known
    /// of that.
    pub expected_flips: Option<f64>,
    /// The share of decisions expected to be the top profile's.
    pub expected_agreement: Option<f64>,
    /// The agreement measured on the sample, each part judged by a model fitted without it.
    pub measured_agreement: Option<Crossed>,
    /// The ladder, the cheapest first.
    pub profiles: Vec<RungRecord>,
}

/// A rung.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RungRecord {
    /// The profile's name.
    pub name: String,
    /// Its digest.
    pub digest: String,
    /// Every parameter.
    pub parameters: Value,
    /// Videos measured with it.
    pub measured: u64,
    /// Frames of those: what measuring costs goes with them.
    pub measured_frames: u64,
    /// Rows that are published from it.
    pub rows: u64,
    /// What its rows are scored with; absent where none is scored.
    pub calibration: Option<Population>,
}
