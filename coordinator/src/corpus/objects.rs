//! Videos in object stores: what lies below `s3://bucket/prefix`, and the objects that lists name.

mod found;

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::Arc;

use async_trait::async_trait;
use futures_util::{StreamExt, TryStreamExt, stream};
use plumbline_common::id::VideoId;
use plumbline_common::message::ObjectLocation;
use plumbline_common::store::{
    self, Access, ObjectKey, ObjectMeta, ObjectStore, S3Options, StoreError,
};
use serde_json::{Map, Value};

use super::dataset::{self, place_missing, place_object};
use super::files::ignore;
use super::{CorpusError, Entry, list};
pub(super) use found::{Below, FoundObject};
use found::{is_looked_at, sorted_out};

/// Objects of a list looked up at once: enough to hide the way to the store, few enough for any store.
const LOOK_UPS: usize = 64;

/// Sources looked at once: one may be one of a thousand numbered shards.
const SOURCES_AT_ONCE: usize = 16;

/// Largest list read from a store, bytes: ten million lines.
const MAX_LIST_BYTES: u64 = 1 << 30;

/// Opens object stores by the name of their bucket.
#[async_trait]
pub trait Buckets: Send + Sync {
    /// The whole bucket.
    ///
    /// # Errors
    /// [`StoreError`].
    async fn open(&self, bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError>;
}

#[async_trait]
impl Buckets for S3Options {
    async fn open(&self, bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
        store::open(&format!("s3://{bucket}"), self).await
    }
}

/// The stores opened so far, each asked once whether it can be read.
pub(super) struct OpenStores<'a> {
    buckets: &'a dyn Buckets,
    open: HashMap<String, Arc<dyn ObjectStore>>,
}

impl<'a> OpenStores<'a> {
    pub(super) fn of(buckets: &'a dyn Buckets) -> Self {
        Self {
            buckets,
            open: HashMap::new(),
        }
    }

    async fn get(&mut self, bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
        if let Some(store) = self.open.get(bucket) {
            return Ok(Arc::clone(store));
        }
        let store = self.buckets.open(bucket).await?;
        store::probe(store.as_ref(), Access::Read).await?;
        self.open.insert(bucket.to_owned(), Arc::clone(&store));
        Ok(store)
    }
}

/// `s3://bucket/key`; the key may be empty, a prefix or a whole key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Address {
    bucket: String,
    key: String,
}

impl Address {
    /// `None` for what is no such address.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let rest = text.strip_prefix("s3://")?;
        let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
        Some(Self {
            bucket: bucket.to_owned(),
            key: key.to_owned(),
        })
    }

    /// The prefix that this names, with a slash at its end; empty for a whole bucket.
    fn as_prefix(&self) -> String {
        match self.key.trim_end_matches('/') {
            "" => String::new(),
            key => format!("{key}/"),
        }
    }

    /// The prefix that the object lies below, with a slash at its end or empty.
    fn parent(&self) -> &str {
        let end = self.key.rfind('/').map_or(0, |slash| slash + 1);
        self.key.get(..end).unwrap_or_default()
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "s3://{}/{}", self.bucket, self.key)
    }
}

/// What a source in an object store is.
pub(super) enum Looked {
    /// Videos.
    Objects(Below),
    /// A list of videos.
    Lines(Vec<ObjectLine>),
}

/// An object that a list names.
pub(super) struct ObjectLine {
    /// The list.
    pub(super) list: String,
    /// The video's name.
    pub(super) name: String,
    /// Where it is.
    pub(super) address: Address,
    /// The list's other columns.
    pub(super) carried: Map<String, Value>,
}

/// Looks at sources, several at once, and gives what they are in their order.
pub(super) async fn look_at_all(
    addresses: Vec<Address>,
    out: &str,
    stores: &mut OpenStores<'_>,
) -> Result<Vec<Looked>, CorpusError> {
    let mut with_stores = Vec::with_capacity(addresses.len());
    for address in addresses {
        let store = stores.get(&address.bucket).await?;
        with_stores.push((address, store));
    }
    stream::iter(with_stores)
        .map(async |(address, store)| look(&address, out, store).await)
        .buffered(SOURCES_AT_ONCE)
        .try_collect()
        .await
}

/// Looks at a source: an object of that name (a video, or a list), or all below the prefix. As in a
/// directory, what begins with a dot is passed over, and so is what lies below `out`.
async fn look(
    address: &Address,
    out: &str,
    store: Arc<dyn ObjectStore>,
) -> Result<Looked, CorpusError> {
    if let Some(meta) = single(address, store.as_ref()).await? {
        if dataset::is_compressed_shard(Path::new(&address.key)) {
            return Err(CorpusError::Compressed {
                shard: address.to_string(),
            });
        }
        if list::is_list(Path::new(&address.key)) {
            return Ok(Looked::Lines(
                read_list(address, &meta, store.as_ref()).await?,
            ));
        }
        let parent = Address {
            bucket: address.bucket.clone(),
            key: address.parent().to_owned(),
        };
        let name = address
            .key
            .strip_prefix(&parent.key)
            .unwrap_or_default()
            .to_owned();
        let one = BTreeMap::from([(name, meta)]);
        return Ok(Looked::Objects(sorted_out(parent, store, one, true).await?));
    }
    let prefix = address.as_prefix();
    let out = Address::parse(out).filter(|out| out.bucket == address.bucket);
    // Of OUT only what is a part of the source; where it is the whole, nothing can be told apart.
    let out = out.map(|out| out.as_prefix());
    let out = out.filter(|out| out.len() > prefix.len());
    let root = Address {
        bucket: address.bucket.clone(),
        key: prefix.clone(),
    };
    let mut passed_over = Vec::new();
    let mut listed = BTreeMap::new();
    let mut pages = store.list(&prefix);
    while let Some(page) = pages.try_next().await? {
        for meta in page {
            let key = meta.key.as_str();
            let name = key.strip_prefix(&prefix).unwrap_or(key);
            let is_folder_mark = name.is_empty() || name.ends_with('/');
            let is_hidden = name.split('/').any(|part| part.starts_with('.'));
            let in_out = out.as_ref().is_some_and(|out| key.starts_with(out));
            if is_folder_mark || is_hidden || in_out {
                continue;
            }
            if is_looked_at(name) {
                listed.insert(name.to_owned(), meta);
            } else {
                passed_over.push(name.to_owned());
            }
        }
    }
    let mut below = sorted_out(root, store, listed, false).await?;
    let others = passed_over.iter().filter(|name| !below.is_of_lerobot(name));
    let others: Vec<_> = others.map(Path::new).collect();
    for other in others {
        ignore(&mut below.ignored, other);
    }
    Ok(Looked::Objects(below))
}

/// The object of exactly this name, if there is one: the first that a listing gives. Not asked for by name,
/// since some services answer with a failure where only objects below it are.
async fn single(
    address: &Address,
    store: &dyn ObjectStore,
) -> Result<Option<ObjectMeta>, StoreError> {
    if address.key.is_empty() || address.key.ends_with('/') {
        return Ok(None);
    }
    let first_page = store.list(&address.key).try_next().await?;
    let first = first_page.and_then(|page| page.into_iter().next());
    Ok(first.filter(|meta| meta.key.as_str() == address.key))
}

/// A list in the store; what it names without `s3://` lies beside it.
async fn read_list(
    address: &Address,
    meta: &ObjectMeta,
    store: &dyn ObjectStore,
) -> Result<Vec<ObjectLine>, CorpusError> {
    let not_kept = |error: std::io::Error| CorpusError::List {
        path: address.to_string(),
        reason: format!("cannot be copied to a temporary file ({error}); make room"),
    };
    let scratch = tempfile::tempdir().map_err(not_kept)?;
    let extension = Path::new(&address.key).extension().unwrap_or_default();
    let file = scratch.path().join("list").with_extension(extension);
    store::fetch_to_file(store, meta, MAX_LIST_BYTES, &file).await?;
    let lines = list::read(&file).map_err(|error| match error {
        CorpusError::List { reason, .. } => CorpusError::List {
            path: address.to_string(),
            reason,
        },
        other => other,
    })?;
    lines
        .into_iter()
        .map(|line| {
            let name = list::name_of(&line.video).to_owned();
            let beside = || Address {
                bucket: address.bucket.clone(),
                key: format!("{}{name}", address.parent()),
            };
            let object = match (Address::parse(&line.video), line.video.contains("://")) {
                (Some(object), _) => object,
                (None, false) => beside(),
                (None, true) => {
                    return Err(CorpusError::UnknownStore {
                        source_text: line.video,
                    });
                }
            };
            Ok(ObjectLine {
                list: address.to_string(),
                name,
                address: object,
                carried: line.carried,
            })
        })
        .collect()
}

/// Looks objects up that lists name, in the lists' order. One that is not there, or may not be looked
/// at, becomes a row; a store that does not answer is an error.
pub(super) async fn look_up(
    lines: Vec<ObjectLine>,
    stores: &mut OpenStores<'_>,
) -> Result<Vec<(ObjectLine, Entry)>, CorpusError> {
    let mut with_stores = Vec::with_capacity(lines.len());
    for line in lines {
        let store = stores.get(&line.address.bucket).await?;
        with_stores.push((line, store));
    }
    stream::iter(with_stores)
        .map(async |(line, store)| {
            let entry = look_up_one(&line, store.as_ref()).await?;
            Ok((line, entry))
        })
        .buffered(LOOK_UPS)
        .try_collect()
        .await
}

async fn look_up_one(line: &ObjectLine, store: &dyn ObjectStore) -> Result<Entry, CorpusError> {
    let video = VideoId::new(line.name.as_str()).map_err(|error| CorpusError::List {
        path: line.list.clone(),
        reason: error.to_string(),
    })?;
    let found = match ObjectKey::new(line.address.key.as_str()) {
        Ok(key) => store.head(&key).await,
        Err(no_key) => Err(no_key.into()),
    };
    let placed = match found {
        Ok(meta) => place_object(&line.address.bucket, meta),
        Err(error) => {
            let object = ObjectLocation {
                bucket: line.address.bucket.clone(),
                key: line.address.key.clone(),
                etag: None,
                modified_s: None,
            };
            place_missing(object, error)?
        }
    };
    Ok(placed.into_entry(video, line.carried.clone()))
}

/// The longest address ending with a slash that all of these begin with.
pub(super) fn common_parent<'a>(roots: impl Iterator<Item = &'a Address>) -> String {
    let mut common: Option<String> = None;
    for root in roots {
        let root = root.to_string();
        common = Some(match common {
            None => root,
            Some(mut parent) => {
                while !root.starts_with(&parent) {
                    let cut = parent.trim_end_matches('/').rfind('/');
                    parent.truncate(cut.map_or(0, |slash| slash + 1));
                }
                parent
            }
        });
    }
    common.unwrap_or_default()
}

#[cfg(test)]
mod tests;
