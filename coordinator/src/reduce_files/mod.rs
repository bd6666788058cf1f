//! `plumbline reduce`: the reduce over rows in files, in memory that does not grow with them.
//!
//! The statistics are those of `reduce`, gone through over scratch files (`float_file`) instead of
//! vectors. Passes over the rows: sort by name if need be (`sorted`), take in (signals, groups), write out. In
//! between everything works on 8 bytes per row and signal. Memory grows with the number of groups
//! alone, since each has statistics of its own in `corpus.json` (and of episodes, where rows have an
//! `episode_index`). Same bits for any order of rows, any split into parts, any number of threads.

mod by_group;
mod columns;
pub mod error;
mod float_file;
pub mod freeze;
mod intake;
mod names;
mod output;
mod parts;
mod paths;
mod places;
mod rows;
mod scoring;
mod sorted;
mod table;
mod table_file;
#[cfg(test)]
mod tests;
mod trainer_lists;

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use arrow_array::Array;

use crate::corpus::GroupBy;
use crate::in_parallel::in_parallel;
use crate::lease::Lease;
use crate::publish::corpus::corpus_json;
use crate::publish::{self, CORPUS_FILE, CorpusFile, Format, OutDir, ProfileRecord, REPORT_FILE};
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::CorpusStatistics;
use crate::reduce::population::{Surveyed, survey};
use crate::reduce::recipe::PAPER;
use crate::reduce::rewards::Spread;
use crate::reduce::sensitivity::{self, sensitivity};
use crate::run::STATE_DIRECTORY;
use columns::Columns;
pub use error::ReduceFilesError;
use float_file::shares;
use intake::{Intake, Taken, take_in};
use output::Completion;
pub(crate) use parts::files;
use paths::Paths;
use places::Places;
use scoring::Yardsticks;
use sorted::sorted;
use table::Table;

/// What is held in memory at a time; results do not depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Rows whose scores are sorted together, 24 bytes each; two such sections are held.
    pub section_rows: u64,
    /// Rows of groups that are surveyed together, 64 bytes each.
    pub bucket_rows: u64,
    /// Bytes of rows that are sorted by name together; up to eight times as many of a large corpus.
    pub bucket_bytes: usize,
}

impl Default for Budget {
    fn default() -> Self {
        Self {
            section_rows: 1 << 20,
            bucket_rows: 1 << 20,
            bucket_bytes: 8 << 20,
        }
    }
}

/// A usable `plumbline reduce`.
#[derive(Debug, Clone)]
pub struct ReduceFilesOptions {
    /// Files of rows, or directories of them.
    pub sources: Vec<PathBuf>,
    /// Where results go.
    pub out: PathBuf,
    /// How rows are grouped; as they say themselves where it is `None`.
    pub group_by: Option<GroupBy>,
    /// How rows become decisions; the profile's digest is taken from the rows.
    pub reduce: ReduceOptions,
    /// Formats of the tables.
    pub formats: BTreeSet<Format>,
    /// Threads for the statistics, at least 1.
    pub threads: usize,
    /// What is held in memory.
    pub budget: Budget,
}

/// A finished reduce.
#[derive(Debug)]
pub struct ReducedFiles {
    /// What was published.
    pub files: Vec<String>,
    /// Rows.
    pub rows: u64,
    /// What `corpus.json` says.
    pub statistics: CorpusStatistics,
}

impl ReducedFiles {
    /// Whether every row is scored or static.
    #[must_use]
    pub fn complete(&self) -> bool {
        output::complete(&self.statistics.statuses)
    }
}

/// Reduces rows that lie in files.
///
/// # Errors
/// [`ReduceFilesError`]; `corpus.json` is then absent.
pub fn reduce_files(options: &ReduceFilesOptions) -> Result<ReducedFiles, ReduceFilesError> {
    let files = parts::files(&options.sources)?;
    refuse_own_source(&files, &options.out)?;
    let out = OutDir::create(&options.out)?;
    let state = OutDir::create(options.out.join(STATE_DIRECTORY))?;
    let scratch = state.root();
    let _lease = Lease::take(&state)?.ok_or_else(|| ReduceFilesError::OutInUse {
        out: options.out.display().to_string(),
    })?;
    out.sweep_partials()?;
    out.remove(CORPUS_FILE)?;

    let reduced = &options.reduce;
    let (intake, columns) = all_in_order(&files, options, scratch)?;
    refuse_other_profile(&intake, reduced)?;
    let corpus = survey(intake.scored, &intake.signals, reduced.bins, reduced.range)?;
    let groups = by_group::survey_groups(&intake, options, scratch)?;
    let fragility = match reduced.reference {
        // Its weights do not depend on these rows.
        Some(_) => None,
        None => {
            let left_out = left_out(&intake, &corpus, options.threads)?;
            let (bins, range) = (reduced.bins, reduced.range);
            sensitivity(&corpus, &intake.signals, &left_out, bins, range)?
        }
    };
    let yardsticks = Yardsticks::of(&corpus, &groups, &intake, reduced);
    let (anomalies, rewards) =
        scoring::score(&intake, &yardsticks, reduced, scratch, options.threads)?;
    let places = Places::rank(
        &anomalies,
        intake.groups.as_ref(),
        &reduced.keep,
        scratch,
        options.budget.section_rows,
    )?;

    let reference = reduced.reference.as_deref();
    let comparison = reference
        .map(|reference| reference.compare(reduced.recipe, &intake.signals, &anomalies))
        .transpose()?;
    let Intake {
        tables,
        rows,
        signals,
        groups: group_file,
        profile_digest,
        ..
    } = *intake;
    // The last pass has them at hand in the rows: their scratch files need not outlive this.
    drop(signals);

    let completion = Completion {
        tables: &tables,
        groups: group_file.as_ref(),
        columns: &columns,
        yardsticks: &yardsticks,
        anomalies: &anomalies,
        rewards: reduced.reward_spread().or(rewards.map(Spread::from)),
        places: &places,
        options: reduced,
    };
    let (mut files_written, tally) =
        output::write(&out, &completion, Paths::beside(&files), &options.formats)?;
    out.remove(REPORT_FILE)?;
    for name in publish::EVALUATION_FILES {
        out.remove(name)?;
    }
    for format in Format::ALL {
        out.remove(&format!("costs.{}", format.extension()))?;
    }
    let groups = groups
        .into_iter()
        .map(|(name, group)| (name, group.population))
        .collect();
    let statistics = tally.statistics(corpus.population, groups, fragility, comparison, reduced);
    let bytes = corpus_json(&corpus_file(&files, profile_digest, statistics.clone()))?;
    out.put_atomic(CORPUS_FILE, &bytes)?;
    files_written.push(publish::CORPUS_FILE.to_owned());
    Ok(ReducedFiles {
        files: files_written,
        rows,
        statistics,
    })
}

/// Every row, in the order of `video`.
fn all_in_order(
    files: &[PathBuf],
    options: &ReduceFilesOptions,
    scratch: &Path,
) -> Result<(Box<Intake>, Columns), ReduceFilesError> {
    let (tables, columns) = parts::open(files, scratch)?;
    if tables.is_empty() {
        return Err(ReduceFilesError::Empty {
            sources: files
                .iter()
                .map(|file| file.display().to_string())
                .collect::<Vec<_>>()
                .join(", "),
        });
    }
    let group_by = options.group_by.as_ref();
    let intake = match take_in(tables, &columns, group_by, scratch, options.threads)? {
        Taken::Ordered(intake) => intake,
        Taken::Unordered(tables) => {
            let bucket_bytes = options.budget.bucket_bytes;
            let sorted = sorted(&tables, &columns, scratch, bucket_bytes, options.threads)?;
            drop(tables);
            let sorted = vec![Table::Sorted(sorted)];
            match take_in(sorted, &columns, group_by, scratch, options.threads)? {
                Taken::Ordered(intake) => intake,
                // Sorting has put them in order; this cannot be.
                Taken::Unordered(_) => return Err(ReduceFilesError::Thread),
            }
        }
    };
    Ok((intake, columns))
}

fn refuse_other_profile(intake: &Intake, options: &ReduceOptions) -> Result<(), ReduceFilesError> {
    let Some(reference) = &options.reference else {
        return Ok(());
    };
    let known = |digest: &Option<String>| digest.as_deref().unwrap_or("(none)").to_owned();
    let fitted = &reference.frozen().profile_digest;
    if *fitted != intake.profile_digest {
        return Err(ReduceFilesError::ReferenceProfile {
            rows: known(&intake.profile_digest),
            fitted: known(fitted),
        });
    }
    Ok(())
}

fn refuse_own_source(files: &[PathBuf], out: &Path) -> Result<(), ReduceFilesError> {
    let Ok(target) = out.canonicalize() else {
        return Ok(());
    };
    let lies_there = |file: &PathBuf| {
        let parent = file
            .canonicalize()
            .ok()
            .and_then(|file| file.parent().map(Path::to_path_buf));
        parent.is_some_and(|parent| parent == target || parent == target.join("manifests"))
    };
    if files.iter().any(lies_there) {
        return Err(ReduceFilesError::OutIsSource {
            out: out.display().to_string(),
        });
    }
    Ok(())
}

/// The rows whose absence the weights are tried with, by name.
fn left_out(
    intake: &Intake,
    corpus: &Surveyed,
    threads: usize,
) -> Result<Vec<sensitivity::Row>, ReduceFilesError> {
    let [a, b] = PAPER.map(|signal| &intake.signals[signal]);
    let found = Mutex::new(BTreeMap::new());
    let look_through = |rows| {
        let mut others = Vec::new();
        let mut bytes = Vec::new();
        a.pieces(rows, |first, piece| {
            others.resize(piece.len(), f64::NAN);
            b.read(first, &mut others, &mut bytes)?;
            for ((row, &a), &b) in (first..).zip(piece.iter()).zip(&others) {
                let values = [a, b].map(|value| Some(value).filter(|value| !value.is_nan()));
                if sensitivity::is_left_out(corpus, &values) {
                    let video = String::new();
                    let row_left_out = sensitivity::Row { video, values };
                    let mut found = found.lock().map_err(|_| io::ErrorKind::Other)?;
                    found.insert(row, row_left_out);
                }
            }
            Ok(())
        })
    };
    in_parallel::<_, _, ReduceFilesError>(
        shares(intake.rows, threads),
        threads,
        || (),
        |(), rows| Ok(look_through(rows)?),
        |()| Ok(()),
    )?;
    let mut found: BTreeMap<u64, sensitivity::Row> =
        found.into_inner().map_err(|_| ReduceFilesError::Thread)?;
    let mut first = 0;
    for table in &intake.tables {
        for (row_group, rows) in table.row_groups().into_iter().enumerate() {
            let wanted = first..first + rows;
            first = wanted.end;
            if found.range(wanted.clone()).next().is_none() {
                continue;
            }
            let mut at = wanted.start;
            for batch in table.read(&["video"], Some(vec![row_group]), table_file::BATCH_ROWS)? {
                let batch = batch?;
                let rows = at..at + batch.num_rows() as u64;
                if let Some(videos) = rows::texts(&batch, "video") {
                    for (row, left_out) in found.range_mut(rows.clone()) {
                        let k = (row - at) as usize;
                        if videos.is_valid(k) {
                            videos.value(k).clone_into(&mut left_out.video);
                        }
                    }
                }
                at = rows.end;
            }
        }
    }
    Ok(found.into_values().collect())
}

/// The `corpus.json` of the run that the rows come from, where it lies beside them and speaks of the
/// same profile.
fn beside(files: &[PathBuf], profile_digest: Option<&String>) -> Option<CorpusFile> {
    files
        .iter()
        .filter_map(|file| std::fs::read(file.with_file_name(CORPUS_FILE)).ok())
        .filter_map(|bytes| serde_json::from_slice::<CorpusFile>(&bytes).ok())
        .find(|corpus| corpus.profile.as_ref().map(|profile| &profile.digest) == profile_digest)
}

/// `corpus.json`: profile and source are those of the run that the rows come from, where that is known.
fn corpus_file(
    files: &[PathBuf],
    profile_digest: Option<String>,
    statistics: CorpusStatistics,
) -> CorpusFile {
    match beside(files, profile_digest.as_ref()) {
        Some(corpus) => CorpusFile {
            plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
            cascade: None,
            statistics,
            ..corpus
        },
        None => CorpusFile {
            plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
            source: Vec::new(),
            profile: profile_digest.map(|digest| ProfileRecord {
                name: None,
                digest,
                parameters: serde_json::Value::Null,
            }),
            conditioning_frames: None,
            fault_calibration: None,
            cascade: None,
            statistics,
        },
    }
}
