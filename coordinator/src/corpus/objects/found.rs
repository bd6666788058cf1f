//! The videos among listed objects, those of datasets among them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use plumbline_common::id::VideoId;
use plumbline_common::store::{ObjectMeta, ObjectStore};
use serde_json::{Map, Value};
use tokio::runtime::Handle;
use tokio::task::spawn_blocking;

use super::Address;
use crate::corpus::dataset::{self, Datasets, Marks, ObjectTree, Placed, place_object};
use crate::corpus::files::{ignore, is_video_name};
use crate::corpus::{CorpusError, Entry, Ignored};

/// A video found in a store, before it has a name.
#[derive(Debug)]
pub(in crate::corpus) struct FoundObject {
    /// Its address; of one in a dataset the address that it would have as an object, from which it is named.
    address: String,
    placed: Placed,
    pub(in crate::corpus) carried: Map<String, Value>,
}

impl FoundObject {
    /// Named by what follows `root`.
    pub(in crate::corpus) fn into_entry(self, root: &str) -> Result<Entry, CorpusError> {
        let name = self.address.strip_prefix(root).unwrap_or(&self.address);
        let video = VideoId::new(name).map_err(|error| CorpusError::List {
            path: self.address.clone(),
            reason: error.to_string(),
        })?;
        Ok(self.placed.into_entry(video, self.carried))
    }
}

/// The videos below a prefix.
pub(in crate::corpus) struct Below {
    /// The prefix.
    pub(in crate::corpus) root: Address,
    pub(in crate::corpus) objects: Vec<FoundObject>,
    /// Addresses of the LeRobot datasets among them.
    pub(in crate::corpus) lerobot: Vec<String>,
    pub(in crate::corpus) ignored: Ignored,
}

impl Below {
    /// Whether the object of this name below the root is a LeRobot dataset's own.
    pub(super) fn is_of_lerobot(&self, name: &str) -> bool {
        let address = format!("{}{name}", self.root);
        let mut datasets = self.lerobot.iter();
        datasets.any(|dataset| {
            let below = address.strip_prefix(dataset.trim_end_matches('/'));
            below.is_some_and(|below| below.starts_with('/'))
        })
    }
}

/// Whether an object's name says that it is a video or of a dataset: others need not be remembered.
pub(super) fn is_looked_at(name: &str) -> bool {
    is_video_name(Path::new(name))
        || Marks::default().note(name)
        || name.starts_with("meta/")
        || name.contains("/meta/")
}

/// The videos among listed objects, those of datasets among them; `named` ones count whatever their extension.
pub(super) async fn sorted_out(
    root: Address,
    store: Arc<dyn ObjectStore>,
    listed: BTreeMap<String, ObjectMeta>,
    named: bool,
) -> Result<Below, CorpusError> {
    let mut marks = Marks::default();
    let marked: BTreeSet<String> = listed
        .keys()
        .filter(|name| marks.note(name))
        .cloned()
        .collect();
    let tree = ObjectTree {
        store,
        bucket: root.bucket.clone(),
        prefix: root.key.clone(),
        listed,
        runtime: Handle::current(),
    };
    let (tree, datasets) = if marks.is_empty() {
        (tree, Datasets::default())
    } else {
        let reading = spawn_blocking(move || {
            let datasets = dataset::read(&tree, &marks)?;
            Ok::<_, CorpusError>((tree, datasets))
        });
        reading.await.map_err(|error| CorpusError::List {
            path: root.to_string(),
            reason: format!("was not read to its end ({error}); run again"),
        })??
    };
    let mut below = Below {
        objects: Vec::new(),
        lerobot: datasets
            .whole
            .iter()
            .map(|directory| format!("{root}{directory}"))
            .collect(),
        ignored: Ignored::new(),
        root,
    };
    for (name, meta) in tree.listed {
        if datasets.owns(&name) {
            continue;
        }
        let path = Path::new(&name);
        if is_video_name(path) || named && !marked.contains(&name) {
            below.objects.push(FoundObject {
                address: format!("{}{name}", below.root),
                placed: place_object(&below.root.bucket, meta),
                carried: Map::new(),
            });
        } else {
            ignore(&mut below.ignored, path);
        }
    }
    below
        .objects
        .extend(datasets.samples.into_iter().map(|sample| FoundObject {
            address: format!("{}{}", below.root, sample.name),
            placed: sample.placed,
            carried: sample.carried,
        }));
    Ok(below)
}
