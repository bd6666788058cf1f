//! Objects, or long parts of them, range by range: a broken connection costs one range, and memory is bounded.

use std::ops::Range;
use std::path::Path;

use bytes::Bytes;
use futures_util::{Stream, TryStreamExt, stream};
use tokio::io::AsyncWriteExt;

use super::{ObjectMeta, ObjectStore, StoreError};

/// Bytes asked for at once: long enough that a round trip does not count, short enough to try again.
const RANGE_BYTES: u64 = 8 << 20;

/// Reads an object into memory.
///
/// # Errors
/// [`StoreError::TooLarge`] before the first byte is asked for, where it has more than `max_bytes`;
/// else as [`ObjectStore::get_range`].
pub async fn fetch(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    max_bytes: u64,
) -> Result<Vec<u8>, StoreError> {
    check_size(store, meta, meta.bytes, max_bytes)?;
    let whole = Vec::with_capacity(usize::try_from(meta.bytes).unwrap_or(0));
    ranges(store, meta, 0..meta.bytes)
        .try_fold(whole, async |mut whole, range| {
            whole.extend_from_slice(&range);
            Ok(whole)
        })
        .await
}

/// Reads an object into a new file, some bytes in memory at a time. On failure the file is incomplete and
/// the caller's to remove.
///
/// # Errors
/// As [`fetch`]; [`StoreError::LocalFile`] where the file cannot be written.
pub async fn fetch_to_file(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    max_bytes: u64,
    file: &Path,
) -> Result<(), StoreError> {
    fetch_range_to_file(store, meta, 0..meta.bytes, max_bytes, file).await
}

/// The same of some bytes of an object; `range` lies within it.
///
/// # Errors
/// As [`fetch_to_file`].
pub async fn fetch_range_to_file(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    range: Range<u64>,
    max_bytes: u64,
    file: &Path,
) -> Result<(), StoreError> {
    check_size(store, meta, range.end - range.start, max_bytes)?;
    let not_written = |source: std::io::Error| StoreError::LocalFile {
        file: file.display().to_string(),
        source,
    };
    let mut out = tokio::fs::File::create_new(file)
        .await
        .map_err(not_written)?;
    let mut ranges = std::pin::pin!(ranges(store, meta, range));
    while let Some(range) = ranges.try_next().await? {
        out.write_all(&range).await.map_err(not_written)?;
    }
    out.flush().await.map_err(not_written)
}

fn check_size(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    bytes: u64,
    max_bytes: u64,
) -> Result<(), StoreError> {
    if bytes > max_bytes {
        return Err(StoreError::TooLarge {
            object: store.address(&meta.key),
            bytes,
            limit: max_bytes,
        });
    }
    Ok(())
}

fn ranges(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    range: Range<u64>,
) -> impl Stream<Item = Result<Bytes, StoreError>> {
    stream::try_unfold(range, async move |rest| {
        if rest.is_empty() {
            return Ok(None);
        }
        let end = rest.end.min(rest.start + RANGE_BYTES);
        let range = store.get_range(meta, rest.start..end).await?;
        Ok(Some((range, end..rest.end)))
    })
}
