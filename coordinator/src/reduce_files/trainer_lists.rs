//! Lists for trainers from rows in files: the same as from rows in memory.

use std::borrow::Cow;

use arrow_array::cast::AsArray;
use arrow_array::types::UInt32Type;
use arrow_array::{Array, RecordBatch, StringArray};
use arrow_schema::DataType;
use plumbline_common::row::Decision;

use super::columns::Columns;
use super::error::ReduceFilesError;
use super::rows::texts;
use crate::publish::OutDir;
use crate::publish::trainer_lists::{
    DATASET_FROM_INDEX, EPISODE_INDEX, KEY, LENGTH, ListedRow, SHARD, TrainerLists, whole_number,
};
use crate::reduce::rewards::{Spread, reward, soft_weight};

/// The lists so far; nothing is looked at where no column makes one.
pub(super) struct Lists<'a> {
    out: &'a OutDir,
    wanted: bool,
    pub(super) lists: TrainerLists,
}

impl<'a> Lists<'a> {
    pub(super) fn of(out: &'a OutDir, columns: &Columns) -> Self {
        let has = |name| columns.all.iter().any(|c| c.carried && c.name == name);
        Self {
            out,
            wanted: has(EPISODE_INDEX) || has(KEY),
            lists: TrainerLists::default(),
        }
    }

    /// Takes note of completed rows.
    pub(super) fn note(
        &mut self,
        scores: &RecordBatch,
        decisions: &[Decision],
        anomalies: &[Option<f64>],
        rewards: Option<Spread>,
    ) -> Result<(), ReduceFilesError> {
        if !self.wanted {
            return Ok(());
        }
        let [episode, from, length] = [
            as_text(scores, EPISODE_INDEX)?,
            as_text(scores, DATASET_FROM_INDEX)?,
            as_text(scores, LENGTH)?,
        ];
        let key = texts(scores, KEY);
        let shards = SHARD.map(|column| texts(scores, column));
        let frames = scores
            .column_by_name("frames")
            .and_then(|frames| frames.as_primitive_opt::<UInt32Type>());
        for (row, (&decision, anomaly)) in decisions.iter().zip(anomalies).enumerate() {
            let whole = |texts: &Option<Cow<'_, StringArray>>| {
                whole_number(text_at(texts.as_deref(), row)?)
            };
            let listed = ListedRow {
                episode_index: whole(&episode),
                dataset_from_index: whole(&from),
                length: whole(&length),
                frames: frames
                    .filter(|frames| frames.is_valid(row))
                    .map(|frames| frames.value(row)),
                shard: shards.iter().find_map(|&texts| text_at(texts, row)),
                key: text_at(key, row),
                reward: anomaly
                    .map(reward)
                    .zip(rewards)
                    .map(|(raw, spread)| (raw, soft_weight(raw, spread))),
            };
            self.lists.note(self.out, decision, &listed)?;
        }
        Ok(())
    }
}

fn text_at(texts: Option<&StringArray>, row: usize) -> Option<&str> {
    let texts = texts.filter(|texts| texts.is_valid(row))?;
    Some(texts.value(row))
}

/// A column as text, as JSON would write its numbers.
fn as_text<'a>(
    batch: &'a RecordBatch,
    column: &str,
) -> Result<Option<Cow<'a, StringArray>>, ReduceFilesError> {
    if let Some(texts) = texts(batch, column) {
        return Ok(Some(Cow::Borrowed(texts)));
    }
    let Some(array) = batch.column_by_name(column) else {
        return Ok(None);
    };
    let cast = arrow_cast::cast(array, &DataType::Utf8)
        .map_err(|error| ReduceFilesError::source(column, error))?;
    Ok(cast.as_string_opt::<i32>().cloned().map(Cow::Owned))
}
