//! Facts of a batch of rows, whatever columns it has: status, group, values, what is refused.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::builder::StringBuilder;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type};
use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray};
use plumbline_common::id::VideoId;
use plumbline_common::row::Status;
use serde_json::{Map, Value};

use super::error::ReduceFilesError;
use crate::corpus::GroupBy;
use crate::reduce::recipe::Signal;
use crate::reduce::reject::{CHECKED_COLUMNS, rejection};

/// Statuses of a batch, with what is not a finite number turned to null and its rows to `failed`.
pub(super) struct Checked {
    pub(super) batch: RecordBatch,
    pub(super) statuses: Vec<Status>,
    /// Rows with a value that is not finite.
    pub(super) rejected: Vec<usize>,
}

/// Checks a batch that has `status`, `status_reason` and the measured columns.
pub(super) fn check(batch: RecordBatch, file: &str) -> Result<Checked, ReduceFilesError> {
    let mut statuses = statuses(&batch, file)?;
    let mut first: HashMap<usize, &str> = HashMap::new();
    let mut arrays: Vec<ArrayRef> = batch.columns().to_vec();
    let schema = batch.schema();
    for name in CHECKED_COLUMNS {
        let Some((index, _)) = schema.column_with_name(name) else {
            continue;
        };
        let Some(values) = arrays[index].as_primitive_opt::<Float64Type>() else {
            continue;
        };
        if values.values().iter().all(|value| value.is_finite()) {
            continue;
        }
        let finite: Float64Array = values.iter().map(|v| v.filter(|v| v.is_finite())).collect();
        for row in (0..values.len()).filter(|&row| values.is_valid(row) && finite.is_null(row)) {
            first.entry(row).or_insert(name);
        }
        arrays[index] = Arc::new(finite);
    }
    let mut rejected: Vec<usize> = first.keys().copied().collect();
    rejected.sort_unstable();
    let mut batch = batch;
    if !rejected.is_empty() {
        if let Some((index, _)) = schema.column_with_name("status_reason") {
            let reasons = arrays[index].as_string_opt::<i32>().cloned();
            let mut builder = StringBuilder::new();
            for (row, &status) in statuses.iter().enumerate() {
                let old = reasons
                    .as_ref()
                    .filter(|r| r.is_valid(row))
                    .map(|r| r.value(row).to_owned());
                builder.append_option(match first.get(&row) {
                    Some(column) => Some(rejection(column, status, old)),
                    None => old,
                });
            }
            arrays[index] = Arc::new(builder.finish());
        }
        for &row in &rejected {
            statuses[row] = Status::Failed;
        }
        batch = RecordBatch::try_new(Arc::clone(&schema), arrays)
            .map_err(|error| ReduceFilesError::source(file, error))?;
    }
    let stated = texts(&batch, "status").is_some_and(|names| names.null_count() == 0);
    // A row that says nothing of itself is a measured one.
    if let Some((index, _)) = schema.column_with_name("status")
        && (!stated || !rejected.is_empty())
    {
        let names: StringArray = statuses
            .iter()
            .map(|status| Some(status.as_str()))
            .collect();
        let mut arrays = batch.columns().to_vec();
        arrays[index] = Arc::new(names);
        batch = RecordBatch::try_new(schema, arrays)
            .map_err(|error| ReduceFilesError::source(file, error))?;
    }
    Ok(Checked {
        batch,
        statuses,
        rejected,
    })
}

impl Checked {
    /// The values of a signal: NaN where a row is not scored or lacks it; no −0.
    pub(super) fn signal(&self, signal: Signal) -> Vec<f64> {
        let column = floats(&self.batch, signal.column());
        let preferred = signal.preferred_column();
        let preferred = preferred.and_then(|name| floats(&self.batch, name));
        let statuses = self.statuses.iter().enumerate();
        statuses
            .map(|(row, &status)| {
                let value = float_at(preferred, row).or_else(|| float_at(column, row));
                let value = value.filter(|_| status == Status::Scored);
                // + 0 turns −0 into 0.
                value.map_or(f64::NAN, |value| value + 0.0)
            })
            .collect()
    }
}

fn statuses(batch: &RecordBatch, file: &str) -> Result<Vec<Status>, ReduceFilesError> {
    let Some(names) = texts(batch, "status") else {
        return Ok(vec![Status::Scored; batch.num_rows()]);
    };
    let mut last = Status::Scored;
    names
        .iter()
        .map(|name| {
            // Most rows are like the one before.
            let Some(name) = name else {
                return Ok(Status::Scored);
            };
            if name != last.as_str() {
                let found = Status::ALL
                    .into_iter()
                    .find(|status| status.as_str() == name);
                last = found.ok_or_else(|| {
                    let known = Status::ALL.map(Status::as_str).join(", ");
                    ReduceFilesError::source(
                        file,
                        format!("the status '{name}' is none of {known}"),
                    )
                })?;
            }
            Ok(last)
        })
        .collect()
}

pub(super) fn texts<'a>(batch: &'a RecordBatch, column: &str) -> Option<&'a StringArray> {
    batch.column_by_name(column)?.as_string_opt::<i32>()
}

pub(super) fn floats<'a>(batch: &'a RecordBatch, column: &str) -> Option<&'a Float64Array> {
    batch
        .column_by_name(column)?
        .as_primitive_opt::<Float64Type>()
}

/// The value of a row, where there is one.
pub(super) fn float_at(values: Option<&Float64Array>, row: usize) -> Option<f64> {
    values
        .filter(|values| values.is_valid(row))
        .map(|values| values.value(row))
}

fn count_at(batch: &RecordBatch, column: &str, row: usize) -> Option<u32> {
    let counts = batch
        .column_by_name(column)?
        .as_primitive_opt::<UInt32Type>()?;
    counts.is_valid(row).then(|| counts.value(row))
}

/// Width, height and frames per second of a row.
pub(super) fn shape_at(batch: &RecordBatch, row: usize) -> Option<(u32, u32, f64)> {
    Some((
        count_at(batch, "width", row)?,
        count_at(batch, "height", row)?,
        float_at(floats(batch, "fps"), row)?,
    ))
}

/// The names of a batch.
pub(super) fn videos<'a>(
    batch: &'a RecordBatch,
    file: &str,
) -> Result<&'a StringArray, ReduceFilesError> {
    let videos = batch
        .column_by_name("video")
        .and_then(|array| array.as_string_opt::<i32>());
    let videos =
        videos.filter(|videos| videos.null_count() == 0 && videos.iter().all(|v| v != Some("")));
    videos.ok_or_else(|| {
        ReduceFilesError::source(file, "the column `video` must name a video in every row")
    })
}

/// The groups of a batch: by the rule, or as the rows have them.
pub(super) fn groups(
    batch: &RecordBatch,
    rule: Option<&GroupBy>,
    file: &str,
) -> Result<Option<StringArray>, ReduceFilesError> {
    let Some(rule) = rule else {
        return Ok(texts(batch, "group")
            .filter(|groups| groups.null_count() < groups.len())
            .cloned());
    };
    let videos = videos(batch, file)?;
    let column = match rule {
        GroupBy::Column(name) => Some(name.as_str()),
        GroupBy::Path(_) | GroupBy::Prefix(_) => None,
    };
    // As text: what arrow says of a number is what JSON says of it.
    let values = match column.and_then(|name| batch.column_by_name(name)) {
        None => None,
        Some(array) => Some(
            arrow_cast::cast(array, &arrow_schema::DataType::Utf8)
                .map_err(|error| ReduceFilesError::source(file, error))?,
        ),
    };
    let mut found = StringBuilder::new();
    for (row, video) in videos.iter().enumerate() {
        let mut carried = Map::new();
        if let (Some(name), Some(values)) = (column, &values) {
            let values = values.as_string::<i32>();
            let value = values.is_valid(row).then(|| Value::from(values.value(row)));
            carried.insert(name.to_owned(), value.unwrap_or_default());
        } else if column.is_some() {
            // Says which columns there are.
            carried.extend(
                batch
                    .schema()
                    .fields()
                    .iter()
                    .map(|f| (f.name().clone(), Value::Null)),
            );
        }
        let video = VideoId::new(video.unwrap_or_default())
            .map_err(|error| ReduceFilesError::source(file, error))?;
        found.append_option(rule.group(&video, &carried)?);
    }
    Ok(Some(found.finish()))
}
