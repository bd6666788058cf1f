//! Lists in the forms that trainers read, where carried columns make them meaningful.
//!
//! `episode_index` (one LeRobot dataset): `lerobot/{keep,drop,review}_episodes.json`, JSON lists as
//! `lerobot-edit-dataset --operation.episode_indices` and `lerobot-train --dataset.episodes` take them.
//! An episode seen by several cameras has several rows; the worst decision and the lowest reward of
//! them count. Where every frame's place in the dataset is known, also `lerobot/rewards.parquet`, the
//! side-car with one row per frame: `index`, `episode_index`, `frame_index` as
//! `lerobot/policies/sarm/compute_rabc_weights.py` writes them, with `reward` (raw) and `weight` (soft),
//! the column that `StaticWeights` reads beside `index` (`lerobot/utils/sample_weighting.py` of LeRobot's
//! pull request 4222, open in July 2026). A video
//! has one score, which all of its frames bear: that is a weight. It is no `progress_sparse`, whose
//! differences in time `rabc.py` weighs by: those of a constant say nothing.
//!
//! `shard` (or `__shard__`, as shards are read here, or `__url__`) and `__key__` (WebDataset): `webdataset/keep.jsonl`, the kept keys by shard,
//! a line for each run of neighbouring videos of one shard.
//!
//! Rows are noted in the order of `video`; memory grows with episodes alone (64 bytes each).

#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::sync::Arc;

use arrow_schema::{Field, Schema};
use plumbline_common::row::{Decision, Row};
use serde_json::{Value, json};

use super::encode::batches::BatchWriter;
use super::encode::{EncodeError, Format, data_type, to_batch};
use super::manifests::DECISIONS;
use super::table::Column;
use super::table::Kind::{Float64, UInt64};
use super::{OutDir, PublishError};
use crate::reduce::decision_name;
use crate::reduce::rewards::Reward;

/// The carried columns that are looked at.
pub const EPISODE_INDEX: &str = "episode_index";
/// Global index of an episode's first frame, as in LeRobot's `meta/episodes`.
pub const DATASET_FROM_INDEX: &str = "dataset_from_index";
/// Frames of an episode, as there; the measured number where it is absent.
pub const LENGTH: &str = "length";
/// Names of a shard, the first that there is.
pub const SHARD: [&str; 3] = ["shard", "__shard__", "__url__"];
/// Name of a sample in its shard.
pub const KEY: &str = "__key__";

const EPISODE_REWARDS: &str = "lerobot/rewards.parquet";
const SHARD_KEYS: &str = "webdataset/keep.jsonl";

/// Frames written at a time.
const BATCH_FRAMES: usize = 1 << 16;

/// What the lists need to know of a row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ListedRow<'a> {
    /// [`EPISODE_INDEX`].
    pub episode_index: Option<u64>,
    /// [`DATASET_FROM_INDEX`].
    pub dataset_from_index: Option<u64>,
    /// [`LENGTH`].
    pub length: Option<u64>,
    /// Frames as decoded.
    pub frames: Option<u32>,
    /// [`SHARD`].
    pub shard: Option<&'a str>,
    /// [`KEY`].
    pub key: Option<&'a str>,
    /// Raw reward and soft weight, of a row that has a score.
    pub reward: Option<(f64, f64)>,
}

#[derive(Debug, Clone, Copy)]
struct Episode {
    index: u64,
    from: Option<u64>,
    frames: Option<u64>,
    decision: Decision,
    reward: Option<(f64, f64)>,
}

/// One frame of the side-car.
struct Frame {
    index: u64,
    episode_index: u64,
    frame_index: u64,
    reward: f64,
    weight: f64,
}

/// The lists so far.
#[derive(Debug, Default)]
pub struct TrainerLists {
    episodes: Vec<Episode>,
    shards: Option<ShardKeys>,
}

/// Lines written so far, and the run of one shard that is not written yet.
#[derive(Debug)]
struct ShardKeys {
    lines: BufWriter<File>,
    shard: String,
    keys: Vec<String>,
}

/// A whole number, whichever way a table holds it: CSV as text, a column with gaps as float.
#[must_use]
pub fn whole_number(text: &str) -> Option<u64> {
    let text = text.trim();
    text.parse().ok().or_else(|| {
        let float: f64 = text.parse().ok()?;
        // Up to 2⁵³ floats are exact.
        (float.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(&float))
            .then_some(float as u64)
    })
}

impl TrainerLists {
    /// The lists of rows in memory; `rewards` are those of the rows that have a score, in their order.
    ///
    /// # Errors
    /// Where the scratch file cannot be written.
    pub fn of(out: &OutDir, rows: &[Row], rewards: &[Reward]) -> Result<Self, PublishError> {
        let mut lists = Self::default();
        let mut rewards = rewards.iter().peekable();
        for row in rows {
            let reward = rewards.next_if(|reward| reward.video == row.video);
            let whole = |column: &str| match row.carried.get(column)? {
                Value::String(text) => whole_number(text),
                other => whole_number(&other.to_string()),
            };
            let text = |column: &str| row.carried.get(column).and_then(Value::as_str);
            let listed = ListedRow {
                episode_index: whole(EPISODE_INDEX),
                dataset_from_index: whole(DATASET_FROM_INDEX),
                length: whole(LENGTH),
                frames: row.measured.frames,
                shard: SHARD.iter().find_map(|column| text(column)),
                key: text(KEY),
                reward: reward.map(|reward| (reward.raw, reward.soft)),
            };
            lists.note(out, row.decision, &listed)?;
        }
        Ok(lists)
    }

    /// Takes note of the next row, in the order of `video`.
    ///
    /// # Errors
    /// Where the scratch file cannot be written.
    pub fn note(
        &mut self,
        out: &OutDir,
        decision: Decision,
        row: &ListedRow<'_>,
    ) -> Result<(), PublishError> {
        if let Some(index) = row.episode_index {
            self.episodes.push(Episode {
                index,
                from: row.dataset_from_index,
                frames: row.length.or(row.frames.map(u64::from)),
                decision,
                reward: row.reward,
            });
        }
        if let (Some(shard), Some(key)) = (row.shard, row.key) {
            self.note_key(out, shard, key, decision)
                .map_err(|source| PublishError::from_io(SHARD_KEYS, source))?;
        }
        Ok(())
    }

    fn note_key(
        &mut self,
        out: &OutDir,
        shard: &str,
        key: &str,
        decision: Decision,
    ) -> io::Result<()> {
        let shards = match &mut self.shards {
            Some(shards) => shards,
            None => self.shards.insert(ShardKeys {
                lines: BufWriter::new(tempfile::tempfile_in(out.root())?),
                shard: String::new(),
                keys: Vec::new(),
            }),
        };
        if shards.shard != shard {
            shards.end_run()?;
            shard.clone_into(&mut shards.shard);
        }
        if decision == Decision::Keep {
            shards.keys.push(key.to_owned());
        }
        Ok(())
    }

    /// Writes the lists that there are; those of an earlier run that there are not any more go.
    ///
    /// # Errors
    /// [`PublishError`] naming the file.
    pub fn publish(mut self, out: &OutDir) -> Result<Vec<String>, PublishError> {
        let mut written = Vec::new();
        let episodes = one_each(std::mem::take(&mut self.episodes));
        for decision in DECISIONS {
            let name = format!("lerobot/{}_episodes.json", decision_name(decision));
            if episodes.is_empty() {
                out.remove(&name)?;
                continue;
            }
            let of = episodes.iter().filter(|e| e.decision == decision);
            let indices: Vec<String> = of.map(|e| e.index.to_string()).collect();
            out.put_atomic(&name, format!("[{}]\n", indices.join(", ")).as_bytes())?;
            written.push(name);
        }
        match with_places(&episodes) {
            Some(placed) => {
                out.put_atomic_with(EPISODE_REWARDS, |writer| write_frames(&placed, writer))?;
                written.push(EPISODE_REWARDS.to_owned());
            }
            None => out.remove(EPISODE_REWARDS)?,
        }
        match self.shards.take() {
            Some(shards) => {
                let mut lines = shards
                    .finish()
                    .map_err(|source| PublishError::from_io(SHARD_KEYS, source))?;
                out.put_atomic_with(SHARD_KEYS, |writer| {
                    io::copy(&mut lines, writer)?;
                    Ok(())
                })?;
                written.push(SHARD_KEYS.to_owned());
            }
            None => out.remove(SHARD_KEYS)?,
        }
        Ok(written)
    }
}

/// Episodes by index, the rows of each joined.
fn one_each(mut rows: Vec<Episode>) -> Vec<Episode> {
    // Stable: of several first frames or lengths the one of the first video counts.
    rows.sort_by_key(|row| row.index);
    rows.dedup_by(|row, episode| {
        let same = row.index == episode.index;
        if same {
            let worst = |decision| match decision {
                Decision::Drop => 2,
                Decision::Review => 1,
                Decision::Keep => 0,
            };
            if worst(row.decision) > worst(episode.decision) {
                episode.decision = row.decision;
            }
            episode.from = episode.from.or(row.from);
            episode.frames = episode.frames.or(row.frames);
            episode.reward = match (episode.reward, row.reward) {
                (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.min(b.1))),
                (a, b) => a.or(b),
            };
        }
        same
    });
    rows
}

/// The episodes that have a reward, each with its first frame and number of frames; `None` where that
/// is not known of every one. Where no column says the first frame, a dataset that is here from episode
/// 0 on without a gap is counted through.
fn with_places(episodes: &[Episode]) -> Option<Vec<(Episode, u64, u64)>> {
    let gapless = episodes
        .iter()
        .zip(0..)
        .all(|(episode, k)| episode.index == k);
    let mut counted = gapless.then_some(0_u64);
    let mut placed = Vec::new();
    for episode in episodes {
        let from = episode.from.or(counted);
        counted = counted
            .zip(episode.frames)
            .and_then(|(before, frames)| before.checked_add(frames));
        if episode.reward.is_some() {
            placed.push((*episode, from?, episode.frames?));
        }
    }
    (!placed.is_empty()).then_some(placed)
}

fn write_frames(
    episodes: &[(Episode, u64, u64)],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let columns: Vec<Column<Frame>> = vec![
        Column::field("index", UInt64, |f| f.index.into()),
        Column::field("episode_index", UInt64, |f| f.episode_index.into()),
        Column::field("frame_index", UInt64, |f| f.frame_index.into()),
        Column::field("reward", Float64, |f| f.reward.into()),
        Column::field("weight", Float64, |f| f.weight.into()),
    ];
    let fields: Vec<Field> = columns
        .iter()
        .map(|column| Field::new(&column.name, data_type(column.kind), true))
        .collect();
    let mut table = BatchWriter::new(Format::Parquet, &Arc::new(Schema::new(fields)), out)?;
    let mut frames = Vec::with_capacity(BATCH_FRAMES);
    for &(episode, from, length) in episodes {
        let Some((reward, weight)) = episode.reward else {
            continue;
        };
        for frame_index in 0..length {
            frames.push(Frame {
                index: from.saturating_add(frame_index),
                episode_index: episode.index,
                frame_index,
                reward,
                weight,
            });
            if frames.len() == BATCH_FRAMES {
                table.write(&to_batch(&columns, &frames)?)?;
                frames.clear();
            }
        }
    }
    table.write(&to_batch(&columns, &frames)?)?;
    table.finish()
}

impl ShardKeys {
    fn end_run(&mut self) -> io::Result<()> {
        if !self.keys.is_empty() {
            let line = json!({"shard": self.shard, "keys": self.keys});
            writeln!(self.lines, "{line}")?;
            self.keys.clear();
        }
        Ok(())
    }

    fn finish(mut self) -> io::Result<File> {
        self.end_run()?;
        let mut file = self
            .lines
            .into_inner()
            .map_err(io::IntoInnerError::into_error)?;
        file.rewind()?;
        Ok(file)
    }
}

/// Every file that may be written.
pub(crate) fn names() -> Vec<String> {
    let lists = DECISIONS.map(|d| format!("lerobot/{}_episodes.json", decision_name(d)));
    let files = [EPISODE_REWARDS, SHARD_KEYS].map(str::to_owned);
    lists.into_iter().chain(files).collect()
}
