//! Copies that the next job may want too: the episodes of one file come one after another, and each would
//! fetch the whole of it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use plumbline_common::message::ObjectLocation;
use tempfile::TempPath;
use tokio::sync::OnceCell;

/// How many are kept: an episode's cameras have a file each, and jobs come episode by episode.
const MAX_KEPT: usize = 4;

type Copy = Arc<OnceCell<Arc<TempPath>>>;

/// The last few whole objects that were asked for. One that is pushed out goes when its last job is done.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// By object in the version that was listed, the latest last.
    copies: Mutex<VecDeque<(ObjectLocation, Copy)>>,
}

impl Kept {
    /// The copy of `object`, fetched by this job where no other has done it or is about to; and whether it was.
    pub(super) async fn get<E>(
        &self,
        object: &ObjectLocation,
        fetch: impl AsyncFnOnce() -> Result<TempPath, E>,
    ) -> Result<(Arc<TempPath>, bool), E> {
        let mut was_fetched = false;
        let cell = self.cell(object);
        let copy = cell.get_or_try_init(async || {
            was_fetched = true;
            fetch().await.map(Arc::new)
        });
        let copy = Arc::clone(copy.await?);
        Ok((copy, was_fetched))
    }

    /// Keeps nothing any more, to make room; whether anything was kept.
    pub(super) fn let_go(&self) -> bool {
        let copies = std::mem::take(&mut *self.lock());
        copies.iter().any(|(_, copy)| copy.initialized())
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<(ObjectLocation, Copy)>> {
        self.copies.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn cell(&self, object: &ObjectLocation) -> Copy {
        let mut copies = self.lock();
        let known = copies.iter().position(|(kept, _)| kept == object);
        let known = known.and_then(|index| copies.remove(index));
        let copy = known.map_or_else(Copy::default, |(_, copy)| copy);
        copies.push_back((object.clone(), Arc::clone(&copy)));
        if copies.len() > MAX_KEPT {
            copies.pop_front();
        }
        copy
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn object(key: &str) -> ObjectLocation {
        ObjectLocation {
            bucket: "bucket".to_owned(),
            key: key.to_owned(),
            etag: Some("1".to_owned()),
            modified_s: None,
        }
    }

    async fn get(kept: &Kept, dir: &Path, key: &str) -> (Arc<TempPath>, bool) {
        let fetch = async || -> std::io::Result<TempPath> {
            Ok(tempfile::NamedTempFile::new_in(dir)?.into_temp_path())
        };
        kept.get(&object(key), fetch).await.unwrap()
    }

    #[tokio::test]
    async fn the_latest_are_kept_and_older_ones_go_with_their_last_job() {
        let dir = tempfile::tempdir().unwrap();
        let kept = Kept::default();
        let (first, was_fetched) = get(&kept, dir.path(), "0").await;
        assert!(was_fetched);
        for key in ["1", "2", "3", "0"] {
            assert_eq!(get(&kept, dir.path(), key).await.1, key != "0");
        }
        // One more pushes out the one that was not asked for the longest, which is not the first.
        get(&kept, dir.path(), "4").await;
        assert!(!get(&kept, dir.path(), "0").await.1);
        assert!(get(&kept, dir.path(), "1").await.1);
        for key in ["5", "6", "7", "8"] {
            get(&kept, dir.path(), key).await;
        }
        assert!(first.exists());
        let path = first.to_path_buf();
        drop(first);
        assert!(!path.exists());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), MAX_KEPT);
        // For room all of them go, and there is no more to give.
        assert!(kept.let_go());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        assert!(!kept.let_go());
    }

    #[tokio::test]
    async fn a_failure_is_its_jobs_alone() {
        let dir = tempfile::tempdir().unwrap();
        let kept = Kept::default();
        let failed = kept
            .get(&object("0"), async || Err::<TempPath, _>("no"))
            .await;
        assert_eq!(failed.unwrap_err(), "no");
        assert!(get(&kept, dir.path(), "0").await.1);
        // Another version is another object.
        let newer = ObjectLocation {
            etag: Some("2".to_owned()),
            ..object("0")
        };
        let asked = kept.get(&newer, async || Err::<TempPath, _>("asked")).await;
        assert_eq!(asked.unwrap_err(), "asked");
    }
}
