//! OUT while a run works in it, and what it keeps there to go on later.

use std::path::{Path, PathBuf};

use super::{RunError, ScoreOptions};
use crate::collect::{Journal, JournalError};
use crate::corpus::Entry;
use crate::lease::Lease;
use crate::publish::{self, OutDir};

/// Where a run keeps what it needs to resume, below OUT.
pub(crate) const STATE_DIRECTORY: &str = ".plumbline";

/// The frozen list of videos, below [`STATE_DIRECTORY`].
pub(crate) const FROZEN_FILE: &str = "corpus.jsonl";

/// What is measured, beside it.
pub(crate) const JOURNAL_FILE: &str = "journal";

/// What the run is called on a fleet, beside it.
pub(super) const RUN_FILE: &str = "run";

/// OUT, held against other runs.
pub(crate) struct Workplace {
    pub(crate) out: OutDir,
    pub(crate) state: OutDir,
    _lease: Lease,
}

impl Workplace {
    /// Takes it, and the mark of a finished run away.
    pub(crate) fn take(root: &Path) -> Result<Self, RunError> {
        let out = OutDir::create(root)?;
        let state = OutDir::create(root.join(STATE_DIRECTORY))?;
        let lease = Lease::take(&state)?.ok_or_else(|| RunError::OutInUse {
            out: root.display().to_string(),
        })?;
        out.sweep_partials()?;
        out.remove(publish::CORPUS_FILE)?;
        Ok(Self {
            out,
            state,
            _lease: lease,
        })
    }

    pub(crate) fn journal(
        &self,
        options: &ScoreOptions,
        resume: bool,
        entries: &[Entry],
    ) -> Result<Journal, JournalError> {
        let digest = &options.reduce.profile_digest;
        Journal::open(&self.journal_path(), resume, entries, digest)
    }

    pub(super) fn journal_path(&self) -> PathBuf {
        self.state.root().join(JOURNAL_FILE)
    }
}

/// The journal of a profile below the run's own; what an earlier run with that profile alone has measured is
/// taken over.
pub(super) fn journal_below(
    top: &Path,
    digest: &str,
    resume: bool,
) -> Result<PathBuf, JournalError> {
    let path = path_below(top, digest);
    if resume && top.exists() && !path.exists() {
        std::fs::copy(top, &path).map_err(|source| JournalError::Io {
            path: path.clone(),
            source,
        })?;
    }
    Ok(path)
}

/// Where that journal lies.
pub(crate) fn path_below(top: &Path, digest: &str) -> PathBuf {
    let short = digest.get(..12).unwrap_or(digest);
    top.with_file_name(format!("journal-{short}"))
}

/// The frozen list beside the journal, for a person who asks what a run was about.
pub(crate) fn write_frozen(state: &OutDir, entries: &[Entry]) -> Result<(), RunError> {
    state.put_atomic_with(FROZEN_FILE, |writer| {
        for entry in entries {
            serde_json::to_writer(&mut *writer, entry)?;
            writer.write_all(b"\n")?;
        }
        Ok(())
    })?;
    Ok(())
}
