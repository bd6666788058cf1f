//! A process' own directory for copies of objects. What a killed process left is removed by the next one
//! beside it: whoever lives holds a lock that the system drops with the process.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use plumbline_common::store::StoreError;
use tempfile::{TempDir, TempPath};

/// How the directories are called.
const PREFIX: &str = "plumbline-scratch-";

/// The file that its owner keeps locked.
const LOCK_FILE: &str = "lock";

/// Removed with everything in it when dropped.
#[derive(Debug)]
pub(super) struct Scratch {
    directory: TempDir,
    /// Dropped, and so unlocked, after the directory.
    _lock: File,
    copies: AtomicU64,
}

impl Scratch {
    /// Makes one below `parent`, which is made where it is missing, and removes abandoned ones.
    pub(super) async fn below(parent: &Path) -> Result<Self, StoreError> {
        let parent = parent.to_path_buf();
        let name = parent.display().to_string();
        let made = tokio::task::spawn_blocking(move || {
            fs::create_dir_all(&parent)?;
            sweep(&parent)?;
            Self::make(&parent)
        });
        let made = made
            .await
            .unwrap_or_else(|panic| Err(io::Error::other(panic)));
        made.map_err(|source| StoreError::LocalFile { file: name, source })
    }

    fn make(parent: &Path) -> io::Result<Self> {
        let directory = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        let lock = File::create_new(directory.path().join(LOCK_FILE))?;
        lock.try_lock()?;
        Ok(Self {
            directory,
            _lock: lock,
            copies: AtomicU64::new(0),
        })
    }

    /// Where the next copy goes: an absolute path, since a child looks for it.
    pub(super) fn new_path(&self) -> Result<TempPath, StoreError> {
        let number = self.copies.fetch_add(1, Ordering::Relaxed);
        let path = self.directory.path().join(number.to_string());
        TempPath::try_from_path(&path).map_err(|source| StoreError::LocalFile {
            file: path.display().to_string(),
            source,
        })
    }
}

/// Removes what nobody holds. A directory without a lock file is one that is being made, or was killed while
/// it was; the latter costs an empty directory.
fn sweep(parent: &Path) -> io::Result<()> {
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        if !entry
            .file_name()
            .as_encoded_bytes()
            .starts_with(PREFIX.as_bytes())
        {
            continue;
        }
        let Ok(lock) = File::open(entry.path().join(LOCK_FILE)) else {
            continue;
        };
        if lock.try_lock().is_ok()
            && let Err(error) = fs::remove_dir_all(entry.path())
        {
            tracing::warn!(directory = %entry.path().display(), %error, "abandoned scratch files stay");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_the_dead_left_goes_and_what_the_living_hold_stays() {
        let parent = tempfile::tempdir().unwrap();
        let living = Scratch::below(parent.path()).await.unwrap();
        let copy = living.new_path().unwrap();
        fs::write(&copy, "x").unwrap();
        // As a killed process leaves it: the lock is gone, the files are not.
        let dead = parent.path().join(format!("{PREFIX}dead"));
        fs::create_dir(&dead).unwrap();
        fs::write(dead.join(LOCK_FILE), "").unwrap();
        fs::write(dead.join("0"), "x").unwrap();
        let other = parent.path().join("not-ours");
        fs::create_dir(&other).unwrap();

        let second = Scratch::below(parent.path()).await.unwrap();
        assert!(!dead.exists());
        assert!(copy.exists() && other.exists());
        drop((copy, living));
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 2);
        drop(second);
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    }
}
