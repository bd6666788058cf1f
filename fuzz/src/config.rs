//! Profiles and settings in TOML.

use figment::Figment;
use figment::providers::{Format, Serialized, Toml};
use plumbline_coordinator::profiles::{self, ProfileName};
use plumbline_worker::decode::DecodeLimits;
use plumbline_worker::settings::Settings;

pub(crate) fn target(bytes: &[u8]) {
    let load = |bytes| {
        let path = crate::as_file("profile.toml", bytes);
        profiles::load(&ProfileName::File(path), &DecodeLimits::default())
    };
    if let Ok(profile) = load(bytes) {
        // A number that is not finite has no canonical form, and such a profile is refused before it is used.
        if let Ok(text) = profiles::to_toml(&profile) {
            let again = load(text.as_bytes()).expect("what `profile show` prints is a profile");
            assert_eq!(again, profile);
        }
    }
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    let settings: Result<Settings, _> = Figment::from(Serialized::defaults(Settings::default()))
        .merge(Toml::string(text))
        .extract();
    if let Ok(settings) = settings {
        let _checked = settings.validate();
        let _usable = (settings.store.s3_options(), settings.queue.amqp_options());
    }
}
