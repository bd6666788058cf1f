//! Scores and labels as read, and what they have in common.

use std::collections::BTreeMap;
use std::path::Path;

use plumbline_common::id::VideoId;
use plumbline_common::row::Status;
use serde_json::{Map, Value};

use super::{EvaluateError, EvaluateOptions, Unscored};
use crate::corpus::{GroupBy, read_list, read_list_columns};
use crate::reduce::recipe::{BySignal, Signal};
use crate::reduce_files;

/// What a judgement, or an outcome, has to be.
pub(crate) const WANTED_LABEL: &str =
    "give a number from 0 (failure) to 1 (success), 0.5 for half a success";

/// One row of the scores.
pub(super) struct ScoreRow {
    pub(super) anomaly: Option<f64>,
    pub(super) status: String,
    columns: Map<String, Value>,
}

impl ScoreRow {
    /// The measured values; `None` for a row that is not scored.
    pub(super) fn signals(&self) -> Option<BySignal<Option<f64>>> {
        let scored = self.status == Status::Scored.as_str();
        let column = |name: &str| self.columns.get(name).and_then(number);
        let value = |signal: Signal| {
            let preferred = signal.preferred_column().and_then(column);
            preferred.or_else(|| column(signal.column()))
        };
        scored.then(|| BySignal::from_fn(value))
    }

    /// A column as text; `None` where it is missing or empty.
    pub(super) fn text(&self, column: &str) -> Option<String> {
        self.columns.get(column).and_then(text)
    }
}

/// All judgements of one video.
#[derive(Default)]
pub(super) struct Labels {
    judged: Vec<f64>,
    real: Vec<f64>,
    columns: Map<String, Value>,
}

/// A video with a score and a label.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judged {
    pub(super) video: String,
    /// Lower is better.
    pub(super) anomaly: f64,
    /// Mean of its judgements, in [0, 1].
    pub(super) label: f64,
    /// Outcome in the real world, in [0, 1].
    pub(super) real: Option<f64>,
    pub(super) task: Option<String>,
}

pub(super) struct Input {
    /// By video.
    pub(super) rows: BTreeMap<String, ScoreRow>,
    /// By video, with at least one judgement.
    pub(super) labels: BTreeMap<String, Labels>,
    pub(super) judgements: usize,
    pub(super) empty_judgements: usize,
}

impl Input {
    pub(super) fn read(options: &EvaluateOptions) -> Result<Self, EvaluateError> {
        let mut input = Self {
            rows: read_scores(options)?,
            labels: BTreeMap::new(),
            judgements: 0,
            empty_judgements: 0,
        };
        if let Some(labels) = &options.labels {
            input.read_labels(labels, options)?;
        }
        Ok(input)
    }

    fn read_labels(&mut self, path: &Path, options: &EvaluateOptions) -> Result<(), EvaluateError> {
        let name = path.display().to_string();
        let wrong = |reason: String| EvaluateError::Content {
            path: name.clone(),
            reason,
        };
        let column = options.label_column.as_str();
        for (index, line) in read_list(path)?.into_iter().enumerate() {
            let Some(value) = line.carried.get(column) else {
                let found: Vec<&str> = line.carried.keys().map(String::as_str).collect();
                return Err(wrong(format!(
                    "there is no column `{column}` (found {}); name the judgement with --label-column",
                    found.join(", ")
                )));
            };
            let judged = |value: &Value, column: &str| {
                share(value).ok_or_else(|| {
                    let video = &line.video;
                    wrong(format!(
                        "row {}: {column} of {video} is {value}; {WANTED_LABEL}",
                        index + 1
                    ))
                })
            };
            if text(value).is_none() {
                self.empty_judgements += 1;
                continue;
            }
            let label = judged(value, column)?;
            let real = options
                .real_column
                .as_ref()
                .and_then(|column| line.carried.get(column).map(|value| (column, value)))
                .filter(|(_, value)| text(value).is_some());
            let real = real
                .map(|(column, value)| judged(value, column))
                .transpose()?;
            self.judgements += 1;
            let video = line.video.trim_start_matches("./").to_owned();
            let labels = self.labels.entry(video).or_default();
            labels.judged.push(label);
            labels.real.extend(real);
            if labels.columns.is_empty() {
                labels.columns = line.carried;
            }
        }
        Ok(())
    }

    /// Rows with a score.
    pub(super) fn scored(&self) -> usize {
        let rows = self.rows.values();
        rows.filter(|row| row.anomaly.is_some()).count()
    }

    /// Videos with a score and a label, by name.
    pub(super) fn compared(&self, options: &EvaluateOptions) -> Result<Vec<Judged>, EvaluateError> {
        let mut found = Vec::new();
        for (video, labels) in &self.labels {
            let Some(row) = self.rows.get(video) else {
                continue;
            };
            let (Some(anomaly), Some(label)) = (row.anomaly, mean(&labels.judged)) else {
                continue;
            };
            let mut columns = row.columns.clone();
            columns.extend(labels.columns.clone());
            let real = match mean(&labels.real) {
                None => carried_real(video, row, options)?,
                real => real,
            };
            found.push(Judged {
                video: video.clone(),
                anomaly,
                label,
                real,
                task: task(video, &columns, options)?,
            });
        }
        match &options.real_column {
            Some(column) if !found.is_empty() && found.iter().all(|v| v.real.is_none()) => {
                Err(EvaluateError::Content {
                    path: options.scores.display().to_string(),
                    reason: format!(
                        "no compared video has a number in the column `{column}`, neither here nor in the labels; name another one with --real"
                    ),
                })
            }
            _ => Ok(found),
        }
    }

    pub(super) fn without_score(&self) -> Vec<Unscored> {
        let reason = |video: &String| match self.rows.get(video) {
            Some(row) if row.anomaly.is_some() => None,
            Some(row) => Some(row.status.clone()),
            None => Some("not in the scores".to_owned()),
        };
        let unscored = self.labels.keys().filter_map(|video| {
            Some(Unscored {
                video: video.clone(),
                reason: reason(video)?,
            })
        });
        unscored.collect()
    }

    pub(super) fn without_label(&self) -> Vec<String> {
        let rows = self.rows.iter();
        rows.filter(|(video, row)| row.anomaly.is_some() && !self.labels.contains_key(*video))
            .map(|(video, _)| video.clone())
            .collect()
    }
}

/// The real outcome as the scores carry it.
fn carried_real(
    video: &str,
    row: &ScoreRow,
    options: &EvaluateOptions,
) -> Result<Option<f64>, EvaluateError> {
    let named = options.real_column.as_ref();
    let Some((column, value)) = named.and_then(|column| Some((column, row.columns.get(column)?)))
    else {
        return Ok(None);
    };
    match (text(value), share(value)) {
        (None, _) => Ok(None),
        (_, Some(share)) => Ok(Some(share)),
        (Some(_), None) => Err(EvaluateError::Content {
            path: options.scores.display().to_string(),
            reason: format!("{column} of {video} is {value}; {WANTED_LABEL}"),
        }),
    }
}

fn task(
    video: &str,
    columns: &Map<String, Value>,
    options: &EvaluateOptions,
) -> Result<Option<String>, EvaluateError> {
    let Some(rule) = &options.task else {
        return Ok(["task", "group"]
            .iter()
            .find_map(|column| columns.get(*column).and_then(text)));
    };
    let video = VideoId::new(video).map_err(|error| EvaluateError::Content {
        path: options.scores.display().to_string(),
        reason: error.to_string(),
    })?;
    Ok(rule.group(&video, columns)?)
}

fn read_scores(options: &EvaluateOptions) -> Result<BTreeMap<String, ScoreRow>, EvaluateError> {
    let task_column = match &options.task {
        Some(GroupBy::Column(column)) => Some(column),
        _ => None,
    };
    let named = [
        task_column,
        options.real_column.as_ref(),
        options.population_column.as_ref(),
    ];
    let wanted = |column: &str| {
        ["anomaly", "status", "group", "task"].contains(&column)
            || Signal::ALL.iter().any(|signal| {
                signal.column() == column || signal.preferred_column() == Some(column)
            })
            || named.iter().flatten().any(|named| *named == column)
    };
    let mut rows = BTreeMap::new();
    for path in reduce_files::files(std::slice::from_ref(&options.scores))? {
        for line in read_list_columns(&path, &wanted)? {
            let status = line.carried.get("status").and_then(text);
            let row = ScoreRow {
                anomaly: line.carried.get("anomaly").and_then(number),
                status: status.unwrap_or_else(|| Status::Scored.as_str().to_owned()),
                columns: line.carried,
            };
            if rows.insert(line.video.clone(), row).is_some() {
                return Err(EvaluateError::Content {
                    path: path.display().to_string(),
                    reason: format!(
                        "two rows bear the name {}; leave one of them out",
                        line.video
                    ),
                });
            }
        }
    }
    Ok(rows)
}

/// A finite number, also where a table holds it as text.
fn number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::String(text) => text.trim().parse().ok(),
        other => other.as_f64(),
    };
    number.filter(|number: &f64| number.is_finite())
}

/// A number from 0 to 1.
pub(crate) fn share(value: &Value) -> Option<f64> {
    number(value).filter(|share| (0.0..=1.0).contains(share))
}

fn text(value: &Value) -> Option<String> {
    match value {
        Value::Null => None,
        Value::String(text) if text.trim().is_empty() => None,
        Value::String(text) => Some(text.clone()),
        other => Some(other.to_string()),
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
