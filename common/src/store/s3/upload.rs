//! Large files in parts, one part in memory at a time.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use aws_sdk_s3::types::{CompletedMultipartUpload, CompletedPart};
use bytes::Bytes;
use tokio::task::spawn_blocking;

use super::S3Store;
use super::failure::{Failure, from_sdk};
use crate::store::error::Source;
use crate::store::{ObjectKey, ObjectStore, StoreError};

/// Most parts of one object, as S3 has it.
const MAX_PARTS: u64 = 10_000;

pub(super) async fn put_file(
    store: &S3Store,
    key: &ObjectKey,
    file: &Path,
) -> Result<(), StoreError> {
    let unreadable = |source: Source| StoreError::Unusable {
        object: file.display().to_string(),
        source,
    };
    let path = file.to_path_buf();
    let opened = spawn_blocking(move || -> std::io::Result<(File, u64)> {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        Ok((file, bytes))
    });
    let (opened, bytes) = opened
        .await
        .map_err(|panic| unreadable(panic.into()))?
        .map_err(|source| unreadable(source.into()))?;
    let part_bytes = store.part_bytes.max(bytes.div_ceil(MAX_PARTS));
    let read = async |start: u64| {
        let length = part_bytes.min(bytes - start);
        let file = opened
            .try_clone()
            .map_err(|source| unreadable(source.into()))?;
        let part = spawn_blocking(move || {
            let mut part = vec![0; length as usize];
            file.read_exact_at(&mut part, start).map(|()| part)
        });
        part.await
            .map_err(|panic| unreadable(panic.into()))?
            .map(Bytes::from)
            .map_err(|source| unreadable(source.into()))
    };
    if bytes <= part_bytes {
        return store.put(key, read(0).await?).await;
    }

    let upload = Upload::start(store, key).await?;
    let mut parts = Vec::new();
    for start in (0..bytes).step_by(part_bytes as usize) {
        let part = match read(start).await {
            Ok(content) => upload.put_part(parts.len() as i32 + 1, content).await,
            Err(error) => Err(error),
        };
        match part {
            Ok(part) => parts.push(part),
            Err(error) => {
                upload.abort().await;
                return Err(error);
            }
        }
    }
    match upload.complete(parts, bytes).await {
        Ok(()) => Ok(()),
        Err(error) => {
            upload.abort().await;
            Err(error)
        }
    }
}

/// An upload under way: invisible until it is complete.
struct Upload<'a> {
    store: &'a S3Store,
    key: &'a ObjectKey,
    id: String,
}

impl<'a> Upload<'a> {
    async fn start(store: &'a S3Store, key: &'a ObjectKey) -> Result<Self, StoreError> {
        let id = store
            .retried(key.as_str(), || async {
                let started = store
                    .client
                    .create_multipart_upload()
                    .bucket(&store.bucket)
                    .key(store.full_key(key))
                    .send()
                    .await
                    .map_err(from_sdk)?;
                started
                    .upload_id
                    .ok_or_else(|| Failure::Final("the upload has no id".into()))
            })
            .await?;
        Ok(Self { store, key, id })
    }

    async fn put_part(&self, number: i32, content: Bytes) -> Result<CompletedPart, StoreError> {
        let put = self
            .store
            .retried(self.key.as_str(), || async {
                self.store
                    .client
                    .upload_part()
                    .bucket(&self.store.bucket)
                    .key(self.store.full_key(self.key))
                    .upload_id(&self.id)
                    .part_number(number)
                    .body(content.clone().into())
                    .send()
                    .await
                    .map_err(from_sdk)
            })
            .await?;
        Ok(CompletedPart::builder()
            .part_number(number)
            .set_e_tag(put.e_tag)
            .build())
    }

    async fn complete(&self, parts: Vec<CompletedPart>, bytes: u64) -> Result<(), StoreError> {
        let parts = CompletedMultipartUpload::builder()
            .set_parts(Some(parts))
            .build();
        let completed = self
            .store
            .retried(self.key.as_str(), || async {
                self.store
                    .client
                    .complete_multipart_upload()
                    .bucket(&self.store.bucket)
                    .key(self.store.full_key(self.key))
                    .upload_id(&self.id)
                    .multipart_upload(parts.clone())
                    .send()
                    .await
                    .map_err(from_sdk)
            })
            .await;
        match completed {
            // An attempt whose answer was lost may have completed it: the upload is then gone.
            Err(StoreError::NotFound { .. }) if self.store.head(self.key).await?.bytes == bytes => {
                Ok(())
            }
            completed => completed.map(|_| ()),
        }
    }

    /// Frees what was put; a part that stays is only storage, so a failure is told and no more.
    async fn abort(&self) {
        let aborted = self
            .store
            .client
            .abort_multipart_upload()
            .bucket(&self.store.bucket)
            .key(self.store.full_key(self.key))
            .upload_id(&self.id)
            .send()
            .await;
        if let Err(error) = aborted {
            tracing::warn!(
                object = self.store.address(self.key),
                error = %aws_sdk_s3::error::DisplayErrorContext(&error),
                "an unfinished upload stays; set a lifecycle rule for incomplete uploads"
            );
        }
    }
}
