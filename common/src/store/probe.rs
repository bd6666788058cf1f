//! Asks a store at start for everything a run will ask of it later, so that a run does not end at its
//! first result.

use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use futures_util::TryStreamExt;

use super::{ObjectKey, ObjectStore, StoreError, fetch};

/// What a run will do with a store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// List and read.
    Read,
    /// Put and delete as well.
    ReadWrite,
}

/// Where probes are written: not a name that a run gives.
const PROBE_PREFIX: &str = ".plumbline-probe/";

/// Checks that the store answers and allows `access`.
///
/// # Errors
/// What the first thing that does not work says; [`StoreError::Unusable`] where a probe that was put
/// does not come back as it was.
pub async fn probe(store: &dyn ObjectStore, access: Access) -> Result<(), StoreError> {
    // One page at most, whatever is there: the prefix is one that only probes have.
    store.list(PROBE_PREFIX).try_next().await?;
    if access == Access::Read {
        return Ok(());
    }
    // Several processes may probe one store at once.
    static PROBES: AtomicU64 = AtomicU64::new(0);
    let nonce = format!(
        "{}-{}-{:?}",
        std::process::id(),
        PROBES.fetch_add(1, Ordering::Relaxed),
        std::time::SystemTime::now()
    );
    let key = ObjectKey::of_content(PROBE_PREFIX, nonce.as_bytes(), "txt")?;
    store.put(&key, Bytes::from(nonce.clone())).await?;
    let came_back = read_back(store, &key, nonce.as_bytes()).await;
    store.delete(&key).await?;
    came_back
}

async fn read_back(
    store: &dyn ObjectStore,
    key: &ObjectKey,
    content: &[u8],
) -> Result<(), StoreError> {
    let wrong = |what: &str| StoreError::Unusable {
        object: store.address(key),
        source: format!("the store {what}").into(),
    };
    let meta = store.head(key).await?;
    if fetch(store, &meta, content.len() as u64).await? != content {
        return Err(wrong("does not give back what was put"));
    }
    if store.get_range(&meta, 1..3).await? != content[1..3] {
        return Err(wrong("does not read ranges"));
    }
    let listed: Vec<_> = store.list(key.as_str()).try_concat().await?;
    if !listed.iter().any(|listed| listed.is_same_version(&meta)) {
        return Err(wrong("does not list what was just put"));
    }
    Ok(())
}
