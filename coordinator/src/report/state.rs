//! What a report tells that no other file of a run holds: its command and options, and the reference it
//! was scored against. Kept in the run's state directory, so that `plumbline report` can tell it again.

use serde::{Deserialize, Serialize};

use crate::publish::{OutDir, PublishError};
use crate::reduce::reference::Frozen;

/// Its name in the state directory.
pub const STATE_FILE: &str = "report.json";

/// See the module.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ReportState {
    /// Options of the run, as name and value.
    pub options: Vec<(String, String)>,
    /// Statistics that the rows were scored against in place of their own.
    pub reference: Option<Frozen>,
}

impl ReportState {
    /// Writes it down.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn write(&self, state: &OutDir) -> Result<(), PublishError> {
        state.put_atomic_with(STATE_FILE, |writer| {
            Ok(serde_json::to_writer(writer, self)?)
        })
    }

    /// What was written, or nothing where it does not read: a report can do without.
    #[must_use]
    pub fn read(state: &std::path::Path) -> Self {
        let bytes = std::fs::read(state.join(STATE_FILE)).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }
}

/// A command line to be read by others: what may be a password in an address is left out.
#[must_use]
pub fn told_command(words: impl Iterator<Item = String>) -> String {
    words
        .map(|word| quoted(&without_password(&word)))
        .collect::<Vec<_>>()
        .join(" ")
}

/// `amqp://user:secret@host` as `amqp://user:***@host`.
fn without_password(word: &str) -> String {
    let Some((scheme, rest)) = word.split_once("://") else {
        return word.to_owned();
    };
    // The last one: a password may hold others, unescaped.
    let Some(at) = rest.rfind('@') else {
        return word.to_owned();
    };
    match rest.get(..at).and_then(|user| user.split_once(':')) {
        Some((user, _)) => format!(
            "{scheme}://{user}:***{}",
            rest.get(at..).unwrap_or_default()
        ),
        None => word.to_owned(),
    }
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:=,@%+*".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_told_without_its_passwords() {
        let words = [
            "score",
            "my videos",
            "--queue",
            "amqp://user:p@ss/w@host:5672/%2f",
            "--keep=s<=1",
            "s3://bucket/a@b",
        ];
        assert_eq!(
            told_command(words.iter().map(|&word| word.to_owned())),
            "score 'my videos' --queue amqp://user:***@host:5672/%2f '--keep=s<=1' s3://bucket/a@b"
        );
    }
}
