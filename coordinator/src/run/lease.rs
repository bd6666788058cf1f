//! One run at a time per OUT: an advisory lock that the system drops with the process.

use std::fs::{File, OpenOptions, TryLockError};

use crate::publish::{OutDir, PublishError};

const FILE: &str = "lock";

/// Held while a run writes; released when dropped or killed.
#[derive(Debug)]
pub(crate) struct Lease {
    _file: File,
}

impl Lease {
    /// Takes the lease; `None` while another run holds it.
    ///
    /// # Errors
    /// [`PublishError`] when the lock file cannot be used.
    pub(crate) fn take(state: &OutDir) -> Result<Option<Self>, PublishError> {
        let io_error = |source| PublishError::from_io(FILE, source);
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(state.root().join(FILE))
            .map_err(io_error)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(source)) => Err(io_error(source)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_run_is_refused_until_the_first_is_gone() {
        let dir = tempfile::tempdir().unwrap();
        let state = OutDir::create(dir.path()).unwrap();
        let first = Lease::take(&state).unwrap();
        assert!(first.is_some());
        assert!(Lease::take(&state).unwrap().is_none());
        drop(first);
        assert!(Lease::take(&state).unwrap().is_some());
    }
}
