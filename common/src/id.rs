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
