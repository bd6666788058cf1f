//! `plumbline report`: the report of a finished run once more, from what lies in OUT.
//!
//! Rows come from `scores.*`, statistics from `corpus.json`; series and pictures from the run's journal,
//! where there is one. Nothing else in OUT is changed.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use plumbline_common::id::VideoId;
use plumbline_common::row::{Measurement, Row, Series, Status};
use serde_json::{Map, Value};

use crate::collect::{Journal, JournalError};
use crate::corpus::{CorpusError, Entry, read_list};
use crate::heat_maps;
use crate::lease::Lease;
use crate::publish::scores::own_names;
use crate::publish::{CORPUS_FILE, CorpusFile, CostRow, OutDir, PublishError, REPORT_FILE};
use crate::reduce_files::{self, ReduceFilesError};
use crate::report::player::Viewpoint;
use crate::report::state::ReportState;
use crate::report::{self, CostSummary, DEFAULT_RANKED, ReportInput, beside};
use crate::run::{FROZEN_FILE, JOURNAL_FILE, STATE_DIRECTORY, path_below};

/// Why there is no report. Each text names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum RebuildError {
    /// No finished run.
    #[error("{}: {reason}; give the OUT of a finished `plumbline score` or `plumbline reduce`", file.display())]
    NoRun {
        /// The file looked for.
        file: PathBuf,
        /// Why it does not do.
        reason: String,
    },
    /// In a store.
    #[error("{out}: a report is rebuilt in a directory; copy the run there and back")]
    ObjectStore {
        /// As typed.
        out: String,
    },
    /// Another run is at work there.
    #[error("{}: another run is using it; wait for it", out.display())]
    OutInUse {
        /// OUT.
        out: PathBuf,
    },
    /// There are no rows.
    #[error(transparent)]
    Scores(#[from] ReduceFilesError),
    /// They do not read.
    #[error(transparent)]
    List(#[from] CorpusError),
    /// A row is none of ours.
    #[error("{}: {video}: no row that plumbline wrote ({source}); make the scores again", file.display())]
    Row {
        /// The table.
        file: PathBuf,
        /// Whose row.
        video: String,
        /// Why.
        source: serde_json::Error,
    },
    /// The journal does not read.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// Files cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
}

impl RebuildError {
    /// True where the caller named something unusable, rather than the machine failing.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Journal(_) | Self::Publish(_))
    }
}

/// Builds `report.html` of the run in `out`, and what lies beside it; gives its path.
///
/// # Errors
/// [`RebuildError`]; the earlier report is then still there.
pub fn rebuild(out: &Path) -> Result<PathBuf, RebuildError> {
    if out.to_string_lossy().contains("://") {
        return Err(RebuildError::ObjectStore {
            out: out.display().to_string(),
        });
    }
    let corpus = read_corpus(&out.join(CORPUS_FILE))?;
    let place = OutDir::create(out)?;
    let state = OutDir::create(out.join(STATE_DIRECTORY))?;
    let _lease = Lease::take(&state)?.ok_or_else(|| RebuildError::OutInUse {
        out: out.to_path_buf(),
    })?;

    let mut rows = read_rows(out)?;
    let entries = read_entries(&state.root().join(FROZEN_FILE));
    let entry_of: HashMap<&VideoId, &Entry> =
        entries.iter().map(|entry| (&entry.video, entry)).collect();
    let journals = open_journals(state.root(), &entries, &corpus)?;
    let costs = take_series(&mut rows, &journals)?;
    let thumbnails = |video: &VideoId| {
        let mut dearest_first = journals.iter().rev();
        dearest_first.find_map(|measured| measured.journal.read(video).ok()??.outcome.thumbnails)
    };
    let told = ReportState::read(state.root());
    let viewpoint = Viewpoint::of(&out.to_string_lossy());
    let (beside, _) = beside::write(&place, &rows, &thumbnails)?;
    let title = match corpus.source.as_slice() {
        [] => out.display().to_string(),
        sources => sources.join(", "),
    };
    let page = report::render(&ReportInput {
        title: &title,
        corpus: &corpus,
        rows: &rows,
        thumbnails: &thumbnails,
        heat_maps: &heat_maps::there_already(&rows, &place),
        beside: &beside,
        player: &|video| viewpoint.address(&entry_of.get(video)?.location),
        reference: told.reference.as_ref(),
        costs: (!journals.is_empty()).then(|| CostSummary::of(&costs)),
        options: &told.options,
        ranked: DEFAULT_RANKED,
    });
    let path = out.join(REPORT_FILE);
    let page = match std::fs::read_to_string(&path) {
        Ok(earlier) => report::keeping_evaluation(&earlier, page),
        Err(_) => page,
    };
    place.put_atomic(REPORT_FILE, page.as_bytes())?;
    Ok(path)
}

fn read_corpus(file: &Path) -> Result<CorpusFile, RebuildError> {
    let failed = |reason: String| RebuildError::NoRun {
        file: file.to_path_buf(),
        reason,
    };
    let bytes = std::fs::read(file).map_err(|error| failed(error.to_string()))?;
    serde_json::from_slice(&bytes).map_err(|error| failed(error.to_string()))
}

/// The rows of the run's table, without series.
fn read_rows(out: &Path) -> Result<Vec<Row>, RebuildError> {
    let own = own_names();
    let mut rows = Vec::new();
    for file in reduce_files::files(&[out.to_path_buf()])? {
        for line in read_list(&file)? {
            let video = line.video.clone();
            let row = to_row(&line.video, line.carried, &own);
            rows.push(row.map_err(|source| RebuildError::Row {
                file: file.clone(),
                video,
                source,
            })?);
        }
    }
    Ok(rows)
}

/// A row of `scores.*`, whose columns are named as the fields of [`Row`] and [`Measurement`] are.
fn to_row(
    video: &str,
    columns: Map<String, Value>,
    own: &[String],
) -> Result<Row, serde_json::Error> {
    let fields = serde_json::to_value(Measurement::without_score(Status::Failed, ""))?;
    let (mut row, mut measured, mut carried) = (Map::new(), Map::new(), Map::new());
    measured.insert(
        "series".to_owned(),
        serde_json::to_value(Series::default())?,
    );
    // Texts that may be missing where rows come from elsewhere.
    for name in ["recipe", "profile_digest"] {
        row.insert(name.to_owned(), Value::from(""));
    }
    for (name, value) in columns {
        match (fields.get(&name).is_some(), own.contains(&name)) {
            (true, _) => measured.insert(name, value),
            (_, true) if value.is_null() && row.contains_key(&name) => None,
            (_, true) => row.insert(name, value),
            _ => carried.insert(name, value),
        };
    }
    row.insert("video".to_owned(), video.into());
    row.insert("carried".to_owned(), carried.into());
    row.insert("measured".to_owned(), measured.into());
    serde_json::from_value(row.into())
}

/// The frozen list; empty where there is none, as in the OUT of a reduce.
fn read_entries(file: &Path) -> Vec<Entry> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect()
}

/// What one profile measured.
struct Measured {
    /// Its name, in a cascade.
    rung: Option<String>,
    digest: String,
    journal: Journal,
}

/// The journals that are there, the cheapest profile's first.
fn open_journals(
    state: &Path,
    entries: &[Entry],
    corpus: &CorpusFile,
) -> Result<Vec<Measured>, JournalError> {
    let Some(profile) = &corpus.profile else {
        return Ok(Vec::new());
    };
    let profiles: Vec<(Option<String>, &str)> = match &corpus.cascade {
        None => vec![(None, &profile.digest)],
        Some(cascade) => {
            let rungs = cascade.profiles.iter();
            rungs
                .map(|rung| (Some(rung.name.clone()), rung.digest.as_str()))
                .collect()
        }
    };
    let top = state.join(JOURNAL_FILE);
    let mut journals = Vec::new();
    for (rung, digest) in profiles {
        let path = match digest == profile.digest {
            true => top.clone(),
            false => path_below(&top, digest),
        };
        if path.is_file() {
            journals.push(Measured {
                rung,
                digest: digest.to_owned(),
                journal: Journal::open(&path, true, entries, digest)?,
            });
        }
    }
    Ok(journals)
}

/// Puts series into the rows, each from the journal of the profile that it was scored with; gives what
/// every measurement cost.
fn take_series(rows: &mut [Row], journals: &[Measured]) -> Result<Vec<CostRow>, JournalError> {
    let mut costs = Vec::new();
    for row in rows {
        for measured in journals {
            let Some(record) = measured.journal.read(&row.video)? else {
                continue;
            };
            costs.push(CostRow::of(&record, measured.rung.clone()));
            if measured.digest == row.profile_digest {
                row.measured.series = record.outcome.measurement.series;
            }
        }
    }
    Ok(costs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::encode::{self, Format};
    use crate::publish::scores::score_columns;
    use crate::reduce::outcome::Recipe;
    use crate::report::fixture::{corpus_of, rollouts};

    /// Every column that is published comes back, in every format that holds types.
    #[test]
    fn rows_come_back_as_they_were_published() {
        let mut rows = rollouts(60, 3);
        corpus_of(&mut rows, Recipe::Paper);
        for (index, row) in rows.iter_mut().enumerate() {
            row.measured.series = Series::default();
            row.measured.fault_frames = Some(vec![3, 1]);
            row.measured.fault_kinds = Some(vec!["jump".to_owned(), "freeze".to_owned()]);
            row.measured.worldscore_3d = Some(61.5);
            row.rung = (index % 3 > 0).then(|| "draft".to_owned());
            row.flip_probability = (index % 2 > 0).then_some(0.25);
            row.carried.insert("seed".to_owned(), index.into());
        }
        for format in [Format::Jsonl, Format::Parquet] {
            let dir = tempfile::tempdir().unwrap();
            let out = OutDir::create(dir.path()).unwrap();
            let columns = score_columns(&rows);
            let name = format!("scores.{}", format.extension());
            out.put_atomic_with(&name, |writer| {
                encode::write(format, &columns, &rows, writer)
            })
            .unwrap();
            assert_eq!(read_rows(dir.path()).unwrap(), rows, "{name}");
        }
    }
}
