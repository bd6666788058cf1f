//! Objects, or long parts of them, range by range: a broken connection costs one range, and memory is bounded.

use std::ops::Range;
use std::path::Path;

use bytes::Bytes;
use futures_util::{Stream, TryStreamExt, stream};
use tokio::fs::File;
use tokio::io::{AsyncSeekExt, AsyncWriteExt};

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
    let not_written = not_written(file);
    let mut out = create(file).await?;
    let mut ranges = std::pin::pin!(ranges(store, meta, range));
    while let Some(range) = ranges.try_next().await? {
        out.write_all(&range).await.map_err(not_written)?;
    }
    out.flush().await.map_err(not_written)
}

/// The first and the last `end_bytes` of some bytes of an object, at their places in a new file of as many
/// bytes; what lies between is empty (a hole, where the file system has such).
///
/// # Errors
/// As [`fetch_to_file`].
pub async fn fetch_ends_to_file(
    store: &dyn ObjectStore,
    meta: &ObjectMeta,
    range: Range<u64>,
    end_bytes: u64,
    file: &Path,
) -> Result<(), StoreError> {
    let not_written = not_written(file);
    let mut out = create(file).await?;
    let bytes = range.end - range.start;
    out.set_len(bytes).await.map_err(not_written)?;
    let head = 0..end_bytes.min(bytes);
    let tail = head.end.max(bytes.saturating_sub(end_bytes))..bytes;
    for part in [head, tail].into_iter().filter(|part| !part.is_empty()) {
        let there = range.start + part.start..range.start + part.end;
        let read = store.get_range(meta, there).await?;
        let at = std::io::SeekFrom::Start(part.start);
        out.seek(at).await.map_err(not_written)?;
        out.write_all(&read).await.map_err(not_written)?;
    }
    out.flush().await.map_err(not_written)
}

async fn create(file: &Path) -> Result<File, StoreError> {
    File::create_new(file).await.map_err(not_written(file))
}

fn not_written(file: &Path) -> impl Fn(std::io::Error) -> StoreError + Copy {
    |source| StoreError::LocalFile {
        file: file.display().to_string(),
        source,
    }
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
