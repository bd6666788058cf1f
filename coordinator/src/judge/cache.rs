//! Kept answers, one file each, named by a digest of all that was asked: what was paid for once is not
//! asked again. Where the endpoint is does not matter, nor its key.

use std::path::Path;

use super::chat::ChatOptions;
use super::{JudgeOptions, Question};
use crate::publish::{OutDir, PublishError};

/// Raised when the same question begins to be asked another way.
const VERSION: &str = "plumbline judge 1";

pub(super) struct Cache {
    directory: OutDir,
}

impl Cache {
    pub(super) fn open(directory: &Path) -> Result<Self, PublishError> {
        Ok(Self {
            directory: OutDir::create(directory)?,
        })
    }

    /// An answer of an earlier run.
    pub(super) fn get(&self, key: &str) -> Option<String> {
        std::fs::read_to_string(self.directory.root().join(key)).ok()
    }

    pub(super) fn put(&self, key: &str, answer: &str) -> Result<(), PublishError> {
        self.directory.put_atomic(key, answer.as_bytes())
    }
}

/// The name of an answer.
pub(super) fn key(
    chat: &ChatOptions,
    options: &JudgeOptions,
    question: &Question,
    repeat: u32,
) -> String {
    let mut hasher = blake3::Hasher::new();
    let numbers = [options.frames, options.max_side_px, repeat].map(|n| n.to_string());
    let temperature = chat.temperature.map_or(String::new(), |t| t.to_string());
    for part in [
        VERSION,
        &question.digest,
        &question.text,
        &chat.model,
        &temperature,
    ]
    .into_iter()
    .chain(numbers.iter().map(String::as_str))
    {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    format!("{}.txt", hasher.finalize().to_hex())
}
