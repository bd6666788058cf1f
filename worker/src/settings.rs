//! Settings that are not part of a score's definition: defaults < `plumbline.toml` in the working
//! directory < environment (`PLUMBLINE_COMPUTE__DEADLINE_S=60`) < flags.

use figment::Figment;
use figment::providers::{Env, Format, Serialized, Toml};
use plumbline_common::queue::AmqpOptions;
use plumbline_common::store::S3Options;
use serde::{Deserialize, Serialize};

use crate::child::ComputeLimits;
use crate::decode::DecodeLimits;
use crate::learned::ModelSettings;

/// The settings file looked for in the working directory.
const FILE: &str = "plumbline.toml";

/// Prefix of environment variables; `__` goes one section down.
const ENV_PREFIX: &str = "PLUMBLINE_";

/// All sections.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// What one video may cost in its compute child.
    pub compute: ComputeLimits,
    /// How large a video may be; part of the profile's digest, since it decides what is scored.
    pub decode: DecodeLimits,
    /// Where objects are.
    pub store: StoreSettings,
    /// The broker.
    pub queue: QueueSettings,
    /// Learned networks.
    pub models: ModelSettings,
}

/// An S3-compatible service; what is not said here comes from the vendor's environment
/// (`AWS_ENDPOINT_URL`, `AWS_REGION`), as credentials always do.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StoreSettings {
    /// Its address, such as `http://127.0.0.1:9000`.
    pub endpoint: Option<String>,
    /// Its region.
    pub region: Option<String>,
}

impl StoreSettings {
    /// How the service is spoken to.
    #[must_use]
    pub fn s3_options(&self) -> S3Options {
        S3Options {
            endpoint: self.endpoint.clone(),
            region: self.region.clone(),
            ..S3Options::default()
        }
    }
}

/// A broker, beside its address.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QueueSettings {
    /// Address of the broker for `plumbline-worker`, in the place of `--queue`: an address holds a
    /// password, which everybody on a machine may see in a command line.
    pub url: Option<String>,
    /// What the names of queues begin with: fleets that share a broker differ in it.
    pub namespace: String,
}

impl Default for QueueSettings {
    fn default() -> Self {
        Self {
            url: None,
            namespace: AmqpOptions::default().namespace,
        }
    }
}

impl QueueSettings {
    /// How the broker is spoken to.
    #[must_use]
    pub fn amqp_options(&self) -> AmqpOptions {
        AmqpOptions {
            namespace: self.namespace.clone(),
            ..AmqpOptions::default()
        }
    }
}

/// Why the settings are unusable.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// File or environment do not parse, or name an unknown setting.
    #[error("settings ({FILE} or {ENV_PREFIX}*): {0}")]
    Read(#[from] Box<figment::Error>),
    /// A value makes no sense.
    #[error("settings: {name} must be {wanted}, not {found}")]
    Value {
        /// The setting.
        name: &'static str,
        /// What is allowed.
        wanted: &'static str,
        /// What was given.
        found: f64,
    },
}

impl Settings {
    /// Reads file and environment over the defaults.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn load() -> Result<Self, SettingsError> {
        let settings: Self = Figment::from(Serialized::defaults(Self::default()))
            .merge(Toml::file(FILE))
            .merge(
                Env::prefixed(ENV_PREFIX)
                    .split("__")
                    .filter(|key| key.as_str().contains('.')),
            )
            .extract()
            .map_err(Box::new)?;
        settings.validate()?;
        Ok(settings)
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`SettingsError::Value`].
    pub fn validate(&self) -> Result<(), SettingsError> {
        const MIN_MEMORY_MIB: u64 = 320;
        let ComputeLimits {
            deadline_s,
            learned_deadline_s,
            memory_mib,
        } = self.compute;
        for (name, found) in [
            ("compute.deadline_s", deadline_s),
            ("compute.learned_deadline_s", learned_deadline_s),
        ] {
            if !(found.is_finite() && found > 0.0) {
                let wanted = "above 0";
                return Err(SettingsError::Value {
                    name,
                    wanted,
                    found,
                });
            }
        }
        if memory_mib < MIN_MEMORY_MIB {
            return Err(SettingsError::Value {
                name: "compute.memory_mib",
                wanted: "320 or more",
                found: memory_mib as f64,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(
    clippy::result_large_err,
    reason = "the closure's type is figment::Jail's"
)]
mod tests {
    use super::*;

    #[test]
    fn environment_beats_file_beats_defaults() {
        figment::Jail::expect_with(|jail| {
            jail.create_file(
                FILE,
                "[compute]\ndeadline_s = 5.0\nmemory_mib = 512\n[store]\nregion = \"r\"\n",
            )?;
            jail.set_env("PLUMBLINE_COMPUTE__DEADLINE_S", "7.5");
            jail.set_env("PLUMBLINE_STORE__ENDPOINT", "http://127.0.0.1:9000");
            jail.set_env("PLUMBLINE_QUEUE__NAMESPACE", "night");
            let settings = Settings::load().map_err(|error| error.to_string())?;
            assert_eq!(settings.compute.deadline_s, 7.5);
            assert_eq!(settings.compute.memory_mib, 512);
            assert_eq!(settings.decode, DecodeLimits::default());
            let s3 = settings.store.s3_options();
            assert_eq!(s3.endpoint.as_deref(), Some("http://127.0.0.1:9000"));
            assert_eq!(s3.region.as_deref(), Some("r"));
            assert_eq!(settings.queue.amqp_options().namespace, "night");
            Ok(())
        });
    }

    #[test]
    fn a_misspelt_or_senseless_setting_is_refused() {
        figment::Jail::expect_with(|jail| {
            jail.create_file(FILE, "[compute]\ndeadline = 5.0\n")?;
            assert!(
                Settings::load()
                    .unwrap_err()
                    .to_string()
                    .contains("deadline")
            );
            jail.create_file(FILE, "[compute]\ndeadline_s = 0.0\n")?;
            assert!(
                Settings::load()
                    .unwrap_err()
                    .to_string()
                    .contains("above 0")
            );
            Ok(())
        });
    }
}
