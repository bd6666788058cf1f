//! Fault thresholds as a file: what `plumbline reference fit --faults` writes and `--fault-thresholds`
//! reads. Thresholds belong to what measured them; those of another profile or version are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use plumbline_vision::faults::{FaultKind, FaultThresholds};
use plumbline_worker::profile::{MEASURE_VERSION, Profile};
use serde::{Deserialize, Serialize};

/// The form of the file that this build writes and reads.
const FORMAT: u32 = 1;

/// The content of a thresholds file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdsFile {
    /// Form of the file.
    pub format: u32,
    /// Version of the program that fitted them.
    pub plumbline_version: String,
    /// `MEASURE_VERSION` of that program.
    pub measure_version: u32,
    /// The profile's name.
    pub profile: String,
    /// Digest of everything in the profile that fault scores depend on.
    pub fault_scores_digest: String,
    /// Share of clean clips that stay below, 0..=1.
    pub quantile: f64,
    /// Clean clips that were used.
    pub clips: usize,
    /// The thresholds; null where a kind could not be fitted.
    pub thresholds: FaultThresholds,
    /// What each was fitted on, by kind.
    pub kinds: BTreeMap<String, KindFit>,
}

/// What one threshold was fitted on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KindFit {
    /// Clips that the detector could judge.
    pub clips: usize,
    /// Median of their largest scores.
    pub median: Option<f64>,
    /// The largest of all.
    pub largest: Option<f64>,
}

/// Where a run's fault thresholds come from, for `corpus.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FaultCalibration {
    /// Clean clips behind them.
    pub clips: usize,
    /// Share of those that stay below.
    pub quantile: f64,
    /// BLAKE3 of the file, hex.
    pub digest: String,
}

/// Why thresholds are not used. Each text names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum ThresholdsError {
    /// The file does not read.
    #[error("{}: {source}; give a file that `plumbline reference fit --faults` wrote", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is none.
    #[error(
        "{}: not a thresholds file ({reason}); give one that `plumbline reference fit --faults` wrote", path.display()
    )]
    Form {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// They belong to something else.
    #[error(
        "{}: fitted for {fitted}, but this run measures with {wanted}, whose fault scores differ; fit them again with `plumbline reference fit --faults ... --profile {profile}`", path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// What they were fitted for.
        fitted: String,
        /// What is measured.
        wanted: String,
        /// Its profile's name.
        profile: &'static str,
    },
    /// The profile cannot be written down.
    #[error("the profile cannot be encoded: {0}")]
    Profile(#[from] serde_json::Error),
}

impl ThresholdsFile {
    /// A file of thresholds for this build and profile.
    ///
    /// # Errors
    /// [`ThresholdsError::Profile`].
    pub fn new(
        profile: &Profile,
        quantile: f64,
        clips: usize,
        thresholds: FaultThresholds,
        kinds: BTreeMap<String, KindFit>,
    ) -> Result<Self, ThresholdsError> {
        Ok(Self {
            format: FORMAT,
            plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
            measure_version: MEASURE_VERSION,
            profile: profile.rung.as_str().to_owned(),
            fault_scores_digest: profile.fault_scores_digest()?,
            quantile,
            clips,
            thresholds,
            kinds,
        })
    }
}

/// Reads thresholds and checks them against the profile that will measure.
///
/// # Errors
/// [`ThresholdsError`].
pub fn load(
    path: &Path,
    profile: &Profile,
) -> Result<(FaultThresholds, FaultCalibration), ThresholdsError> {
    let bytes = std::fs::read(path).map_err(|source| ThresholdsError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    let form = |reason: String| ThresholdsError::Form {
        path: path.to_path_buf(),
        reason,
    };
    let file: ThresholdsFile =
        serde_json::from_slice(&bytes).map_err(|error| form(error.to_string()))?;
    if file.format != FORMAT {
        return Err(form(format!("form {}, not {FORMAT}", file.format)));
    }
    for kind in FaultKind::ALL {
        if let Some(threshold) = file.thresholds.of(kind)
            && !(threshold.is_finite() && threshold >= 0.0)
        {
            let kind = kind.as_str();
            return Err(form(format!("{kind} = {threshold} has no meaning")));
        }
    }
    let described = |version: u32, profile: &str, digest: &str| {
        let digest = digest.get(..12).unwrap_or(digest);
        format!("profile {profile}, measure version {version}, parameters {digest}")
    };
    let digest = profile.fault_scores_digest()?;
    if file.measure_version != MEASURE_VERSION || file.fault_scores_digest != digest {
        return Err(ThresholdsError::Other {
            path: path.to_path_buf(),
            fitted: described(
                file.measure_version,
                &file.profile,
                &file.fault_scores_digest,
            ),
            wanted: described(MEASURE_VERSION, profile.rung.as_str(), &digest),
            profile: profile.rung.as_str(),
        });
    }
    let calibration = FaultCalibration {
        clips: file.clips,
        quantile: file.quantile,
        digest: blake3::hash(&bytes).to_hex().to_string(),
    };
    Ok((file.thresholds, calibration))
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_worker::profile::Rung;

    fn written(profile: &Profile, change: impl Fn(&mut ThresholdsFile)) -> tempfile::NamedTempFile {
        let mut file =
            ThresholdsFile::new(profile, 0.99, 30, FaultThresholds::DRAFT, BTreeMap::new())
                .unwrap();
        change(&mut file);
        let place = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(place.path(), serde_json::to_vec(&file).unwrap()).unwrap();
        place
    }

    #[test]
    fn thresholds_come_back_for_the_same_scores_whatever_else_differs() {
        let profile = Profile::new(Rung::Draft);
        let file = written(&profile, |_| {});
        let mut other = profile.clone();
        other.warmup_frames = 3;
        other.limits.max_frames = 9;
        other.fault_thresholds = FaultThresholds::STANDARD_RECORDED;
        for profile in [profile, other] {
            let (thresholds, calibration) = load(file.path(), &profile).unwrap();
            assert_eq!(thresholds, FaultThresholds::DRAFT);
            assert_eq!((calibration.clips, calibration.quantile), (30, 0.99));
        }
    }

    #[test]
    fn others_are_refused_with_the_reason() {
        let draft = Profile::new(Rung::Draft);
        let file = written(&draft, |_| {});
        let refused = |profile: &Profile| load(file.path(), profile).unwrap_err().to_string();
        let standard = refused(&Profile::new(Rung::Standard));
        assert!(standard.contains("fitted for profile draft"), "{standard}");
        assert!(standard.contains("--profile standard"), "{standard}");
        let mut other = draft.clone();
        other.faults.margin_cells += 1;
        assert!(refused(&other).contains("parameters"));

        let older = written(&draft, |file| file.measure_version += 1);
        assert!(matches!(
            load(older.path(), &draft),
            Err(ThresholdsError::Other { .. })
        ));
        let senseless = written(&draft, |file| file.thresholds.jump = Some(-1.0));
        let error = load(senseless.path(), &draft).unwrap_err().to_string();
        assert!(error.contains("jump = -1"), "{error}");
    }
}
