//! Which of the videos found are taken, and into which groups they fall.

use std::collections::BTreeSet;

use serde_json::Value;

use super::dataset::CAMERA;
use super::{CorpusError, Entry, GroupBy};

/// What is asked of a corpus beside its sources.
#[derive(Debug, Clone, Default)]
pub struct Choice {
    /// How videos are grouped.
    pub group_by: Option<GroupBy>,
    /// The cameras whose videos are taken (the column `camera`); all where none is named.
    pub cameras: Vec<String>,
}

impl Choice {
    /// Takes and groups.
    ///
    /// # Errors
    /// [`CorpusError::UnknownCamera`], [`CorpusError::UnknownColumn`].
    pub(super) fn apply(&self, entries: &mut Vec<Entry>) -> Result<(), CorpusError> {
        choose_cameras(entries, &self.cameras)?;
        match &self.group_by {
            Some(rule) => group(entries, rule),
            None => Ok(()),
        }
    }
}

/// Leaves the videos of the named cameras, each of which must be there.
fn choose_cameras(entries: &mut Vec<Entry>, cameras: &[String]) -> Result<(), CorpusError> {
    if cameras.is_empty() {
        return Ok(());
    }
    let camera = |entry: &Entry| {
        entry
            .carried
            .get(CAMERA)
            .and_then(Value::as_str)
            .map(str::to_owned)
    };
    let known: BTreeSet<String> = entries.iter().filter_map(camera).collect();
    if let Some(unknown) = cameras.iter().find(|&camera| !known.contains(camera)) {
        return Err(CorpusError::UnknownCamera {
            camera: unknown.clone(),
            known: match known.is_empty() {
                true => "no column camera (LeRobot datasets do, and lists may)".to_owned(),
                false => Vec::from_iter(known).join(", "),
            },
        });
    }
    entries.retain(|entry| camera(entry).is_some_and(|camera| cameras.contains(&camera)));
    Ok(())
}

/// Groups by a rule. Videos from elsewhere than a list's or dataset's columns have no group; a column that no
/// video has is an error.
fn group(entries: &mut [Entry], rule: &GroupBy) -> Result<(), CorpusError> {
    let mut unknown = None;
    let mut any = false;
    for entry in entries {
        match rule.group(&entry.video, &entry.carried) {
            Ok(group) => {
                any = true;
                entry.group = group;
            }
            Err(error) => unknown = unknown.or(Some(error)),
        }
    }
    match unknown {
        Some(error) if !any => Err(error),
        _ => Ok(()),
    }
}
