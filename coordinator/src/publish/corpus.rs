//! `corpus.json`: what was scored, by what, and the statistics behind the scores. Written last, it
//! is the mark of a finished run. Every number in it is finite.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cascade::record::CascadeRecord;
use crate::publish::error::PublishError;
use crate::reduce::drift::Drift;
use crate::reduce::outcome::{CorpusStatistics, Population, SignalStatistics};
use crate::thresholds::FaultCalibration;

/// The profile that measured the corpus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProfileRecord {
    /// Its name; `None` where only the digest is known.
    pub name: Option<String>,
    /// BLAKE3 of its canonical form, hex.
    pub digest: String,
    /// Every parameter.
    pub parameters: Value,
}

/// The content of `corpus.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorpusFile {
    /// Version of the program.
    pub plumbline_version: String,
    /// The sources as given.
    pub source: Vec<String>,
    /// What measured it; `None` where the rows do not say.
    pub profile: Option<ProfileRecord>,
    /// Leading frames left out of every statistic; `None` where that is not known.
    pub conditioning_frames: Option<u32>,
    /// Where the fault thresholds come from, if not from the profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault_calibration: Option<FaultCalibration>,
    /// The ladder and what it was climbed for, where the run was a cascade; `profile` is then its top.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cascade: Option<CascadeRecord>,
    /// What the reduce says.
    #[serde(flatten)]
    pub statistics: CorpusStatistics,
}

/// The bytes of `corpus.json`: readable, with a final line end.
///
/// # Errors
/// [`PublishError::NotFinite`] naming the first number that is infinite or NaN: JSON would turn it
/// into a null that looks like a missing value. [`PublishError::Encode`] otherwise.
pub fn corpus_json(corpus: &CorpusFile) -> Result<Vec<u8>, PublishError> {
    if let Some(field) = first_not_finite(&corpus.statistics) {
        return Err(PublishError::NotFinite { field });
    }
    let mut bytes = serde_json::to_vec_pretty(corpus).map_err(|source| PublishError::Encode {
        file: "corpus.json".to_owned(),
        source: source.into(),
    })?;
    bytes.push(b'\n');
    Ok(bytes)
}

fn first_not_finite(statistics: &CorpusStatistics) -> Option<String> {
    let corpus = std::iter::once(("corpus".to_owned(), &statistics.corpus));
    let groups = statistics
        .groups
        .iter()
        .map(|(name, population)| (format!("groups.{name}"), population));
    for (name, population) in corpus.chain(groups) {
        if let Some(field) = in_population(population) {
            return Some(format!("{name}.{field}"));
        }
    }
    if let Some(reference) = &statistics.reference {
        let numbers = |d: &Drift| [d.psi, d.psi_by_chance, d.ks, d.ks_p].into_iter().flatten();
        let all = reference.drift.values().flat_map(numbers);
        if all
            .chain(reference.weights.values().copied())
            .any(|value| !value.is_finite())
        {
            return Some("reference".to_owned());
        }
    }
    let sensitivity = statistics.sensitivity.as_ref()?;
    let weights = sensitivity
        .freedman_diaconis
        .values()
        .chain(sensitivity.winsorised.values())
        .chain(std::iter::once(&sensitivity.leave_one_out_max_change));
    weights
        .copied()
        .any(|value| !value.is_finite())
        .then(|| "sensitivity".to_owned())
}

fn in_population(population: &Population) -> Option<String> {
    for (name, weight) in &population.weights {
        if !weight.is_finite() {
            return Some(format!("weights.{name}"));
        }
    }
    population
        .signals
        .iter()
        .find(|(_, signal)| !all_finite(signal))
        .map(|(name, _)| format!("signals.{name}"))
}

fn all_finite(signal: &SignalStatistics) -> bool {
    let SignalStatistics {
        n: _,
        min,
        max,
        mean,
        std,
        median,
        mad,
        edges,
        counts: _,
        entropy_nats,
        degenerate: _,
        range_overflow: _,
    } = signal;
    [min, max, mean, std, median, mad, entropy_nats]
        .into_iter()
        .flatten()
        .chain(edges)
        .all(|value| value.is_finite())
}
