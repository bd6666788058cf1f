//! Profiles of a user's own: a rung of the ladder with some knobs changed in a TOML file.
//!
//! A file names the rung it starts from (`rung`, default `standard`) and the knobs it changes; what
//! `plumbline profile show` prints is such a file. Misspelt knobs are refused. What a combination of
//! knobs does cannot be read off it, so a changed profile is tried on a rendered clip before it is used
//! ([`tried`]): a profile that cannot measure that one is refused, with the reason its row would have.

mod knobs;
mod tried;

use std::path::{Path, PathBuf};

use figment::Figment;
use figment::providers::{Format, Serialized, Toml};
use plumbline_vision::faults::FaultThresholds;
use plumbline_worker::decode::DecodeLimits;
use plumbline_worker::profile::{MEASURE_VERSION, Profile, Rung};

pub use knobs::{Difference, differences, to_toml};
pub use tried::tried;

/// Which profile, as typed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProfileName {
    /// A rung as it is.
    Rung(Rung),
    /// A file with changes.
    File(PathBuf),
}

impl std::str::FromStr for ProfileName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(rung) = Rung::ALL.into_iter().find(|rung| rung.as_str() == text) {
            return Ok(Self::Rung(rung));
        }
        match Path::new(text).extension() {
            Some(extension) if extension.eq_ignore_ascii_case("toml") => {
                Ok(Self::File(text.into()))
            }
            _ => Err(format!(
                "a profile is {}, or a file FILE.toml",
                Rung::ALL.map(Rung::as_str).join(", ")
            )),
        }
    }
}

/// Why a profile is unusable.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file is not there.
    #[error("{}: no such file; `plumbline profile show` prints one to start from", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// The file does not parse, or names a knob that there is none of.
    #[error("{}: {source}; `plumbline profile show` prints every knob", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<figment::Error>,
    },
    /// The file was made for another build, where the same knobs gave other numbers.
    #[error(
        "{}: written for measure version {found}, and this build has {MEASURE_VERSION}; take the line out and check the knobs against `plumbline profile show`",
        path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The version it names.
        found: u32,
    },
    /// A knob has no form that could be hashed.
    #[error("the profile cannot be written down: {0}")]
    Encode(#[from] serde_json::Error),
    /// The knobs do not work together.
    #[error("this profile cannot measure a plain clip of moving boxes: {reason}; change its knobs")]
    Unusable {
        /// The reason that the clip's row has.
        reason: String,
    },
    /// It could not be tried.
    #[error("the profile cannot be tried: {0}")]
    NotTried(String),
}

/// The profile of a name. `limits` are those of the settings; a file's own go before them.
///
/// # Errors
/// [`ProfileError`], but for `Unusable` and `NotTried`.
pub fn load(name: &ProfileName, limits: &DecodeLimits) -> Result<Profile, ProfileError> {
    let path = match name {
        ProfileName::Rung(rung) => return Ok(with_limits(*rung, limits)),
        ProfileName::File(path) => path,
    };
    if !path.is_file() {
        return Err(ProfileError::Missing { path: path.clone() });
    }
    let unreadable = |source| ProfileError::Read {
        path: path.clone(),
        source: Box::new(source),
    };
    let file = Figment::from(Toml::file_exact(path));
    let rung = match file.find_value("rung") {
        Ok(rung) => rung.deserialize().map_err(unreadable)?,
        Err(error) if error.missing() => Rung::Standard,
        Err(error) => return Err(unreadable(error)),
    };
    let base = with_limits(rung, limits);
    let changed = Figment::from(Serialized::defaults(&base)).merge(&file);
    let mut profile: Profile = changed.extract().map_err(unreadable)?;
    if profile.measure_version != MEASURE_VERSION {
        return Err(ProfileError::Version {
            path: path.clone(),
            found: profile.measure_version,
        });
    }
    // A rung's thresholds were fitted to the scores that it gives.
    if profile.fault_thresholds == base.fault_thresholds
        && profile.fault_scores_digest()? != base.fault_scores_digest()?
    {
        profile.fault_thresholds = FaultThresholds::UNCALIBRATED;
    }
    Ok(profile)
}

fn with_limits(rung: Rung, limits: &DecodeLimits) -> Profile {
    Profile {
        limits: limits.clone(),
        ..Profile::new(rung)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loaded(text: &str) -> Result<Profile, ProfileError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("my.toml");
        std::fs::write(&path, text).unwrap();
        load(&ProfileName::File(path), &DecodeLimits::default())
    }

    #[test]
    fn what_show_prints_loads_as_the_same_profile() {
        for rung in Rung::ALL {
            let profile = Profile::new(rung);
            let back = loaded(&to_toml(&profile).unwrap()).unwrap();
            assert_eq!(back, profile);
            assert_eq!(back.digest().unwrap(), profile.digest().unwrap());
        }
    }

    #[test]
    fn a_file_changes_what_it_names_and_nothing_else() {
        let text = "rung = \"draft\"\nworking_height_px = 192\n[flow]\nfinest_scale = 1\n";
        let profile = loaded(text).unwrap();
        let mut expected = Profile::new(Rung::Draft);
        expected.working_height_px = 192;
        expected.flow.finest_scale = 1;
        assert_eq!(profile, expected);
        assert_eq!(loaded("").unwrap(), Profile::new(Rung::Standard));
    }

    #[test]
    fn thresholds_of_a_rung_go_with_its_scores() {
        let same_scores = loaded("[verdict]\nmin_frames = 5\n").unwrap();
        let standard = Profile::new(Rung::Standard);
        assert_eq!(same_scores.fault_thresholds, standard.fault_thresholds);
        let others = loaded("working_height_px = 200\n").unwrap();
        assert_eq!(others.fault_thresholds, FaultThresholds::UNCALIBRATED);
        let own = "working_height_px = 200\n[fault_thresholds]\njump = 0.5\n";
        assert_eq!(loaded(own).unwrap().fault_thresholds.jump, Some(0.5));
    }

    #[test]
    fn misspelt_knobs_wrong_types_and_other_versions_are_refused() {
        for (text, told) in [
            ("working_height = 1\n", "working_height"),
            ("[flow]\nfinest = 1\n", "finest"),
            ("working_height_px = \"tall\"\n", "working_height_px"),
            ("rung = \"best\"\n", "best"),
            ("measure_version = 1\n", "measure version 1"),
            ("not toml", "my.toml"),
        ] {
            let error = loaded(text).unwrap_err().to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
        let missing = load(
            &ProfileName::File("no/such.toml".into()),
            &DecodeLimits::default(),
        );
        assert!(matches!(missing, Err(ProfileError::Missing { .. })));
    }

    #[test]
    fn names_are_rungs_or_toml_files() {
        assert_eq!("draft".parse(), Ok(ProfileName::Rung(Rung::Draft)));
        assert_eq!("a/b.TOML".parse(), Ok(ProfileName::File("a/b.TOML".into())));
        let error = "best".parse::<ProfileName>().unwrap_err();
        assert!(error.contains("accurate"), "{error}");
    }
}
