//! What a run is called on a fleet: by what it measures, so that two runs never share a queue by mistake.

use plumbline_common::id::{NotARunId, RunId};

use crate::corpus::Entry;

/// Hexadecimal digits of the digest, alone and beside a name.
const DIGITS: usize = 32;
const DIGITS_BESIDE_NAME: usize = 12;

/// The digest of the frozen list and the profile; `name-digest` where the run has a name. The same videos
/// measured in the same way are the same run, whatever the recipe, groups and OUT; a video that changed, or
/// another profile, makes another run, so that rows of both never meet.
///
/// # Errors
/// [`NotARunId`] where the name is none.
pub(crate) fn run_name(
    name: Option<&str>,
    entries: &[Entry],
    profile_digest: &str,
) -> Result<RunId, NotARunId> {
    let mut hasher = blake3::Hasher::new();
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    part(profile_digest.as_bytes());
    for entry in entries {
        part(entry.video.as_str().as_bytes());
        let version = (
            &entry.location,
            entry.bytes,
            entry.modified_ns,
            entry
                .intrinsics()
                .map(|camera| [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::to_bits)),
        );
        // A debug text is not for ever, nor is a run.
        part(format!("{version:?}").as_bytes());
    }
    let digest = hasher.finalize().to_hex();
    let digits = |n: usize| digest.get(..n).unwrap_or_default();
    match name {
        None => RunId::new(digits(DIGITS)),
        Some(name) => RunId::new(format!("{name}-{}", digits(DIGITS_BESIDE_NAME))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::corpus::file_entry as entry;

    #[test]
    fn what_is_measured_makes_the_run() {
        let entries = [entry("a"), entry("b")];
        let run = |name, entries: &[Entry], digest| run_name(name, entries, digest).unwrap();
        let plain = run(None, &entries, "p");
        assert_eq!(plain.as_str().len(), 32);
        let mut grouped = entries.clone();
        grouped[0].group = Some("g".into());
        assert_eq!(plain, run(None, &grouped, "p"));
        let mut changed = entries.clone();
        changed[1].modified_ns = Some(3);
        assert_ne!(plain, run(None, &changed, "p"));
        assert_ne!(plain, run(None, &entries, "q"));
        assert_ne!(plain, run(None, &entries[..1], "p"));
        let named = run(Some("night_1"), &entries, "p");
        assert_eq!(named.as_str(), format!("night_1-{}", &plain.as_str()[..12]));
        assert!(run_name(Some("Night 1"), &entries, "p").is_err());
    }
}
