//! Names of things that cross process borders: videos, digests.

use serde::{Deserialize, Serialize};

/// A video's name in one run: its path below SOURCE (or its key), with `/` between parts.
///
/// Invariants: not empty; unique in a frozen corpus; valid UTF-8 (bytes of a file name that are not
/// are percent-encoded when the corpus is listed); only a name, never opened as a path.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct VideoId(String);

/// Why a text is no video id.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("a video id must not be empty")]
pub struct EmptyVideoId;

impl VideoId {
    /// Takes a name.
    ///
    /// # Errors
    /// [`EmptyVideoId`] when it is empty.
    pub fn new(name: impl Into<String>) -> Result<Self, EmptyVideoId> {
        let name = name.into();
        if name.is_empty() {
            return Err(EmptyVideoId);
        }
        Ok(Self(name))
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl std::fmt::Display for VideoId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// A run's name on a fleet: part of queue names and object keys.
///
/// Invariants: 1 to [`RunId::MAX_BYTES`] of `a`–`z`, `0`–`9`, `-` and `_`, not beginning with `-`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RunId(String);

/// Why a text is no run id.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{name:?} is no name for a run: use 1 to {} of a-z, 0-9, '-' and '_', not beginning with '-'",
    RunId::MAX_BYTES
)]
pub struct NotARunId {
    /// The text.
    pub name: String,
}

impl RunId {
    /// Longest run id, in bytes: a digest in hex fits.
    pub const MAX_BYTES: usize = 64;

    /// Takes a name.
    ///
    /// # Errors
    /// [`NotARunId`].
    pub fn new(name: impl Into<String>) -> Result<Self, NotARunId> {
        let name = name.into();
        let allowed = |byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_');
        let usable = (1..=Self::MAX_BYTES).contains(&name.len())
            && name.bytes().all(allowed)
            && !name.starts_with('-');
        if usable {
            Ok(Self(name))
        } else {
            Err(NotARunId { name })
        }
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for RunId {
    type Error = NotARunId;

    fn try_from(name: String) -> Result<Self, NotARunId> {
        Self::new(name)
    }
}

impl From<RunId> for String {
    fn from(run: RunId) -> Self {
        run.0
    }
}

impl std::fmt::Display for RunId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_ids_are_safe_in_keys_and_queue_names() {
        let longest = "f".repeat(RunId::MAX_BYTES);
        for name in ["a", "night_2026-11-25", longest.as_str()] {
            assert_eq!(RunId::new(name).unwrap().as_str(), name);
        }
        let too_long = "f".repeat(RunId::MAX_BYTES + 1);
        for name in [
            "",
            "-a",
            "A",
            "a/b",
            "..",
            "a.b",
            "a\n",
            "ü",
            too_long.as_str(),
        ] {
            assert!(RunId::new(name).is_err(), "{name}");
            let wire = rmp_serde::to_vec(name).unwrap();
            assert!(rmp_serde::from_slice::<RunId>(&wire).is_err(), "{name}");
        }
    }
}
