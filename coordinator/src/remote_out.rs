//! An OUT in an object store: made whole in a directory of this machine, then uploaded, `corpus.json` last.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use futures_util::{StreamExt, TryStreamExt, stream};
use plumbline_common::store::{self, Access, ObjectKey, ObjectStore, S3Options, StoreError};
use tempfile::TempDir;

use crate::heat_maps;
use crate::publish::{self, Format};
use crate::report::beside;
use crate::run::RunError;

/// Files uploaded at once.
const UPLOADS: usize = 8;

/// OUT, and where it is made.
pub(crate) struct RemoteOut {
    store: Arc<dyn ObjectStore>,
    staging: TempDir,
}

impl RemoteOut {
    /// Opens OUT where it is an `s3://` address, and asks the store whether a run can be kept there.
    pub(crate) async fn open(out: &str, s3: &S3Options) -> Result<Option<Self>, RunError> {
        if !out.starts_with("s3://") {
            return Ok(None);
        }
        let store = store::open(out, s3).await?;
        store::probe(&*store, Access::ReadWrite).await?;
        Self::of(store).map(Some)
    }

    fn of(store: Arc<dyn ObjectStore>) -> Result<Self, RunError> {
        let staging = tempfile::Builder::new().prefix("plumbline-out-").tempdir();
        let staging = staging.map_err(|source| StoreError::LocalFile {
            file: std::env::temp_dir().display().to_string(),
            source,
        })?;
        Ok(Self { store, staging })
    }

    pub(crate) fn store(&self) -> &Arc<dyn ObjectStore> {
        &self.store
    }

    /// The directory in which OUT is made.
    pub(crate) fn staging(&self) -> &Path {
        self.staging.path()
    }

    /// Takes the mark of a finished run away.
    pub(crate) async fn withdraw(&self) -> Result<(), RunError> {
        Ok(self.store.delete(&key(publish::CORPUS_FILE)?).await?)
    }

    /// Uploads `files`, of which `corpus.json` marks the finished run, and removes what an earlier run
    /// published and this one did not.
    pub(crate) async fn upload(&self, files: &[String]) -> Result<(), RunError> {
        self.withdraw().await?;
        let written: BTreeSet<&str> = files.iter().map(String::as_str).collect();
        let mut pages = self.store.list("");
        while let Some(page) = pages.try_next().await? {
            for meta in page {
                let name = meta.key.as_str();
                if is_published_name(name) && !written.contains(name) {
                    self.store.delete(&meta.key).await?;
                }
            }
        }
        let others = written.iter().filter(|name| **name != publish::CORPUS_FILE);
        stream::iter(others)
            .map(|name| self.upload_one(name))
            .buffer_unordered(UPLOADS)
            .try_collect::<()>()
            .await?;
        self.upload_one(publish::CORPUS_FILE).await
    }

    async fn upload_one(&self, name: &str) -> Result<(), RunError> {
        let file = self.staging().join(name);
        Ok(self.store.put_file(&key(name)?, &file).await?)
    }
}

fn key(name: &str) -> Result<ObjectKey, StoreError> {
    Ok(ObjectKey::new(name)?)
}

/// Whether runs publish files of this name; whatever else lies in OUT is somebody's own.
fn is_published_name(name: &str) -> bool {
    let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
    let is_table = Format::ALL
        .iter()
        .any(|format| format.extension() == extension);
    let tables = [
        "scores",
        "costs",
        "rewards",
        "manifests/keep",
        "manifests/drop",
        "manifests/review",
    ];
    (is_table && tables.contains(&stem))
        || name == publish::REPORT_FILE
        || publish::EVALUATION_FILES.contains(&name)
        || publish::trainer_lists::names()
            .iter()
            .any(|list| list == name)
        || heat_maps::is_ours(name)
        || beside::is_ours(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use plumbline_common::store::DirStore;

    #[tokio::test]
    async fn an_upload_leaves_this_run_and_what_is_not_ours() {
        let dir = tempfile::tempdir().unwrap();
        let store: Arc<dyn ObjectStore> = Arc::new(DirStore::new(dir.path()));
        for old in [
            "scores.csv",
            "corpus.json",
            "heatmaps/a-0123456789abcdef.png",
            "videos/0123456789abcdef-heat.jpg",
            "lerobot/keep_episodes.json",
            "evaluation.md",
            "mine.csv",
            ".plumbline/runs/r/parts/x.parquet",
        ] {
            let content = Bytes::from_static(b"old");
            store.put(&key(old).unwrap(), content).await.unwrap();
        }
        let out = RemoteOut::of(Arc::clone(&store)).unwrap();
        let files = ["scores.jsonl", "manifests/keep.jsonl", "corpus.json"];
        std::fs::create_dir(out.staging().join("manifests")).unwrap();
        for file in files {
            std::fs::write(out.staging().join(file), b"new").unwrap();
        }
        out.withdraw().await.unwrap();
        assert!(!dir.path().join("corpus.json").exists());
        out.upload(&files.map(str::to_owned)).await.unwrap();
        let listed: Vec<_> = store.list("").try_concat().await.unwrap();
        let names: Vec<&str> = listed.iter().map(|meta| meta.key.as_str()).collect();
        assert_eq!(
            names,
            [
                ".plumbline/runs/r/parts/x.parquet",
                "corpus.json",
                "manifests/keep.jsonl",
                "mine.csv",
                "scores.jsonl"
            ]
        );
        assert_eq!(
            std::fs::read(dir.path().join("corpus.json")).unwrap(),
            b"new"
        );
    }
}
