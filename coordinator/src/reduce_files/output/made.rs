//! The columns that the reduce makes, and each table's piece of them.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, RecordBatch, RecordBatchOptions, StringArray, UInt64Array,
};
use arrow_schema::SchemaRef;
use arrow_select::filter::filter_record_batch;
use plumbline_common::row::Decision;

use super::tables::{MANIFEST, Tables};
use crate::reduce::recipe::{BySignal, Signal};
use crate::reduce::rewards::{Spread, reward, soft_weight};
use crate::reduce::select::{Place, Standing};
use crate::reduce::{ReduceOptions, decision_name};

/// What the reduce adds to a piece of rows.
pub(super) struct Made<'a> {
    pub(super) z: BySignal<ArrayRef>,
    /// Where the videos lie, as far as anything says so.
    pub(super) paths: Option<ArrayRef>,
    pub(super) anomalies: Vec<Option<f64>>,
    pub(super) intervals: Vec<Option<(f64, f64)>>,
    pub(super) places: &'a [Option<Place>],
    pub(super) decisions: &'a [Decision],
    pub(super) groups: Vec<Option<&'a String>>,
    pub(super) recipe: &'a str,
    pub(super) options: &'a ReduceOptions,
}

pub(super) type Batch = Result<RecordBatch, arrow_schema::ArrowError>;

impl Made<'_> {
    fn standings(&self) -> impl Iterator<Item = Option<Standing>> {
        let rows = self.places.iter().zip(&self.anomalies);
        rows.map(|(place, &anomaly)| Some(self.options.standing(place.as_ref()?, anomaly?)))
    }

    fn column(&self, name: &str) -> Option<ArrayRef> {
        let floats =
            |values: Vec<Option<f64>>| -> ArrayRef { Arc::new(Float64Array::from(values)) };
        if let Some(signal) = name.strip_prefix("z_")
            && let Some(signal) = Signal::ALL.into_iter().find(|s| s.column() == signal)
        {
            return Some(Arc::clone(&self.z[signal]));
        }
        let ranked = || self.places.iter();
        Some(match name {
            "group" => Arc::new(self.groups.iter().copied().collect::<StringArray>()),
            "anomaly" => floats(self.anomalies.clone()),
            "anomaly_lo" => floats(self.intervals.iter().map(|i| i.map(|i| i.0)).collect()),
            "anomaly_hi" => floats(self.intervals.iter().map(|i| i.map(|i| i.1)).collect()),
            "rank" => Arc::new(ranked().map(|p| p.map(|p| p.rank)).collect::<UInt64Array>()),
            "percentile" => floats(self.standings().map(|s| Some(s?.percentile())).collect()),
            "decision" => Arc::new(
                self.decisions
                    .iter()
                    .map(|&d| Some(decision_name(d)))
                    .collect::<StringArray>(),
            ),
            "reward" => floats(self.anomalies.iter().map(|a| a.map(reward)).collect()),
            "recipe" => Arc::new(
                self.decisions
                    .iter()
                    .map(|_| Some(self.recipe))
                    .collect::<StringArray>(),
            ),
            _ => return None,
        })
    }

    pub(super) fn scores(&self, tables: &Tables, read: &RecordBatch) -> Batch {
        let rows = read.num_rows();
        let arrays = tables.scores.fields().iter().map(|field| {
            self.column(field.name())
                .or_else(|| read.column_by_name(field.name()).cloned())
                .unwrap_or_else(|| tables.nulls(field.data_type(), rows))
        });
        batch(&tables.scores, arrays.collect(), rows)
    }

    pub(super) fn manifest(&self, tables: &Tables, scores: &RecordBatch) -> Batch {
        let rows = scores.num_rows();
        let own = MANIFEST.iter().map(|(name, data_type)| {
            let array = match *name {
                "path" => self.paths.clone(),
                name => scores.column_by_name(name).cloned(),
            };
            array.unwrap_or_else(|| tables.nulls(data_type, rows))
        });
        let carried = tables
            .carried
            .iter()
            .map(|&index| Arc::clone(scores.column(index)));
        batch(&tables.manifest, own.chain(carried).collect(), rows)
    }

    pub(super) fn rewards(
        &self,
        tables: &Tables,
        scores: &RecordBatch,
        spread: Option<Spread>,
    ) -> Batch {
        let rows = scores.num_rows();
        let raw = || self.anomalies.iter().map(|a| a.map(reward));
        let places = || self.places.iter();
        let arrays = tables.rewards.fields().iter().map(|field| -> ArrayRef {
            match field.name().as_str() {
                "raw" => Arc::new(raw().collect::<Float64Array>()),
                "percentile" => Arc::new(
                    self.standings()
                        .map(|s| Some(s?.reward()))
                        .collect::<Float64Array>(),
                ),
                "soft" => Arc::new(
                    raw()
                        .map(|r| Some(soft_weight(r?, spread?)))
                        .collect::<Float64Array>(),
                ),
                "group_rank" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_rank))
                        .collect::<UInt64Array>(),
                ),
                "group_size" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_size))
                        .collect::<UInt64Array>(),
                ),
                "best_of_group" => Arc::new(
                    places()
                        .map(|p| p.map(|p| p.group_rank == 1))
                        .collect::<BooleanArray>(),
                ),
                name => scores
                    .column_by_name(name)
                    .cloned()
                    .unwrap_or_else(|| tables.nulls(field.data_type(), rows)),
            }
        });
        let all = batch(&tables.rewards, arrays.collect(), rows)?;
        let ranked: BooleanArray = self
            .places
            .iter()
            .map(|place| Some(place.is_some()))
            .collect();
        filter_record_batch(&all, &ranked)
    }
}

fn batch(schema: &SchemaRef, arrays: Vec<ArrayRef>, rows: usize) -> Batch {
    let options = RecordBatchOptions::new().with_row_count(Some(rows));
    RecordBatch::try_new_with_options(SchemaRef::clone(schema), arrays, &options)
}
