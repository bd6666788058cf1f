//! REF.json: frozen corpus statistics as `plumbline reference fit` writes them and `--reference` reads
//! them. Statistics belong to the profile that measured their rows; those of another are refused.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use plumbline_worker::profile::Profile;
use serde::{Deserialize, Serialize};

use crate::publish::{OutDir, ProfileRecord, PublishError};
use crate::reduce::outcome::Recipe;
use crate::reduce::recipe_name;
use crate::reduce::reference::{Frozen, Reference};

/// The form of the file that this build writes and reads; raised when scores are made otherwise of the
/// same statistics, too.
const FORMAT: u32 = 1;

/// Differing parameters that a message names.
const NAMED: usize = 5;

/// The content of REF.json.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceFile {
    /// Form of the file.
    format: u32,
    /// BLAKE3 of everything else, hex: a changed file is none.
    digest: String,
    /// Version of the program that wrote it.
    plumbline_version: String,
    /// What measured the rows; `None` where only its digest is known, or nothing.
    profile: Option<ProfileRecord>,
    /// The statistics.
    statistics: Frozen,
}

/// Why a reference is not used, or not written. Each text names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    /// The file does not read.
    #[error("{}: {source}; give a file that `plumbline reference fit` wrote", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is none.
    #[error(
        "{}: not a reference ({reason}); give a file that `plumbline reference fit SCORES` wrote", path.display()
    )]
    Form {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// It was measured otherwise.
    #[error(
        "{}: fitted on rows of another profile ({difference}), whose signals differ; score with the same --profile and options, or fit it again on rows of this one", path.display()
    )]
    Profile {
        /// The file.
        path: PathBuf,
        /// In what.
        difference: String,
    },
    /// It cannot score by the recipe.
    #[error(
        "{}: no signal of the recipe {recipe} told its rows apart, so that it cannot score by it; choose another --recipe, or fit it on rows that have those signals", path.display()
    )]
    Recipe {
        /// The file.
        path: PathBuf,
        /// The recipe.
        recipe: &'static str,
    },
    /// The file has no name.
    #[error("--out {}: name a file", path.display())]
    NoName {
        /// As typed.
        path: PathBuf,
    },
    /// Statistics or a profile cannot be written down.
    #[error("the reference cannot be encoded: {0}")]
    Encode(#[from] serde_json::Error),
    /// The file cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
}

impl ReferenceFile {
    /// A file of frozen statistics.
    ///
    /// # Errors
    /// [`ReferenceError::Encode`].
    pub fn new(statistics: Frozen, profile: Option<ProfileRecord>) -> Result<Self, ReferenceError> {
        let mut file = Self {
            format: FORMAT,
            digest: String::new(),
            plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
            profile,
            statistics,
        };
        file.digest = file.digest_of_rest()?;
        Ok(file)
    }

    /// The statistics.
    #[must_use]
    pub fn statistics(&self) -> &Frozen {
        &self.statistics
    }

    /// The name of its content.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    fn digest_of_rest(&self) -> Result<String, serde_json::Error> {
        let rest = Self {
            digest: String::new(),
            ..self.clone()
        };
        let bytes = serde_json::to_vec(&rest)?;
        Ok(blake3::hash(&bytes).to_hex().to_string())
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// [`ReferenceError`].
    pub fn write(&self, path: &Path) -> Result<(), ReferenceError> {
        let (directory, name) = directory_and_name(path)?;
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(OutDir::create(directory)?.put_atomic(name, &bytes)?)
    }
}

/// Where a file to be written lies, and its name.
///
/// # Errors
/// [`ReferenceError::NoName`].
pub fn directory_and_name(path: &Path) -> Result<(&Path, &str), ReferenceError> {
    let name = path.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| ReferenceError::NoName {
        path: path.to_path_buf(),
    })?;
    let directory = path.parent().filter(|d| !d.as_os_str().is_empty());
    Ok((directory.unwrap_or(Path::new(".")), name))
}

/// Reads a reference and checks that it can score by the recipe, and what the profile measures (where
/// rows that exist are scored, their own profile is checked against [`Frozen::profile_digest`]).
///
/// # Errors
/// [`ReferenceError`].
pub fn load(
    path: &Path,
    recipe: Recipe,
    profile: Option<&Profile>,
) -> Result<Arc<Reference>, ReferenceError> {
    let bytes = std::fs::read(path).map_err(|source| ReferenceError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    let form = |reason: String| ReferenceError::Form {
        path: path.to_path_buf(),
        reason,
    };
    let file: ReferenceFile =
        serde_json::from_slice(&bytes).map_err(|error| form(error.to_string()))?;
    if file.format != FORMAT {
        return Err(form(format!("form {}, not {FORMAT}", file.format)));
    }
    if file.digest_of_rest()? != file.digest {
        return Err(form("it was changed after it was written".to_owned()));
    }
    if let Some(profile) = profile {
        let difference = file.difference_from(profile)?;
        if let Some(difference) = difference {
            return Err(ReferenceError::Profile {
                path: path.to_path_buf(),
                difference,
            });
        }
    }
    let reference = Reference::new(file.statistics, file.digest).map_err(form)?;
    if reference.scores(recipe).is_none() {
        return Err(ReferenceError::Recipe {
            path: path.to_path_buf(),
            recipe: recipe_name(recipe),
        });
    }
    Ok(Arc::new(reference))
}

impl ReferenceFile {
    /// In what the profile behind the rows differs; `None` where it is the same.
    fn difference_from(&self, profile: &Profile) -> Result<Option<String>, serde_json::Error> {
        let digest = profile.digest()?;
        let Some(fitted) = &self.statistics.profile_digest else {
            return Ok(Some("its rows do not say which".to_owned()));
        };
        if *fitted == digest {
            return Ok(None);
        }
        let start = |digest: &str| digest.get(..12).unwrap_or(digest).to_owned();
        let digests = format!("{}, not {}", start(fitted), start(&digest));
        let wanted = serde_json::to_value(profile)?;
        let parameters = self.profile.as_ref().map(|profile| &profile.parameters);
        let differing: Vec<String> = parameters
            .and_then(|parameters| parameters.as_object())
            .zip(wanted.as_object())
            .map(|(theirs, ours)| {
                let differs = |(name, value): &(&String, &serde_json::Value)| {
                    theirs.get(*name) != Some(*value)
                };
                let short = |value: Option<&serde_json::Value>| match value {
                    Some(value) if !value.is_object() && !value.is_array() => format!(" {value}"),
                    _ => String::new(),
                };
                ours.iter()
                    .filter(differs)
                    .take(NAMED)
                    .map(|(name, value)| {
                        let (theirs, ours) = (short(theirs.get(name)), short(Some(value)));
                        match theirs == ours {
                            true => name.clone(),
                            false => format!("{name}{theirs}, not{ours}"),
                        }
                    })
                    .collect()
            })
            .unwrap_or_default();
        Ok(Some(if differing.is_empty() {
            digests
        } else {
            format!("{}: {digests}", differing.join("; "))
        }))
    }
}
