//! A finished run into files: scores, costs, manifests, rewards, report, and last `corpus.json`.
//!
//! Bytes are built apart ([`encode`]) from where they are put ([`OutDir`]). Equal rows give equal
//! bytes in every file but `costs.*` (and a report that shows costs). What may fail is the disk:
//! [`PublishError`] names the file and the remedy, and no partial file is left.

pub mod corpus;
pub mod costs;
pub mod encode;
pub mod error;
pub mod manifests;
pub mod out_dir;
pub mod rewards;
pub mod scores;
pub mod table;
pub mod trainer_lists;

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use plumbline_common::row::Row;

pub use corpus::{CorpusFile, ProfileRecord};
pub use costs::CostRow;
pub use encode::Format;
pub use error::PublishError;
pub use out_dir::OutDir;

use crate::reduce::decision_name;
use crate::reduce::rewards::Reward;
use manifests::DECISIONS;
use table::Column;
use trainer_lists::TrainerLists;

/// The name of the file that marks a finished run.
pub const CORPUS_FILE: &str = "corpus.json";
/// The name of the report.
pub const REPORT_FILE: &str = "report.html";
/// What `evaluate` may have left beside a run: tables that new scores would contradict.
pub const EVALUATION_FILES: [&str; 2] = ["evaluation.json", "evaluation.md"];

/// Everything that a run publishes.
#[derive(Debug, Clone, Copy)]
pub struct Publication<'a> {
    /// One row per input video, in the order of `video`.
    pub rows: &'a [Row],
    /// Absolute path or URI per row.
    pub locations: &'a [String],
    /// What each measurement cost.
    pub costs: &'a [CostRow],
    /// Rewards of the scored rows.
    pub rewards: &'a [Reward],
    /// The rendered report, where one is wanted.
    pub report_html: Option<&'a str>,
    /// What goes into `corpus.json`.
    pub corpus: &'a CorpusFile,
}

/// Publishes a run and returns the names of its files, in the order written.
///
/// `scores` come in every format of `formats`. Manifests are always JSON Lines and rewards always
/// Parquet, each with the other beside it where that format is asked for; costs follow `formats`,
/// as JSON Lines where neither is. Lists for trainers have forms of their own. An older `corpus.json` goes first, so that an interrupted
/// publication is never taken for a finished one, and tables of an earlier run in formats that
/// this run does not write go too: they would contradict it.
///
/// # Errors
/// [`PublishError`] at the first file that cannot be written; `corpus.json` is then absent.
pub fn publish(
    out: &OutDir,
    run: &Publication<'_>,
    formats: &BTreeSet<Format>,
) -> Result<Vec<String>, PublishError> {
    if run.rows.len() != run.locations.len() {
        return Err(PublishError::Locations {
            rows: run.rows.len(),
            locations: run.locations.len(),
        });
    }
    // Checked before anything is touched: a run whose statistics cannot be told is not published.
    let corpus = corpus::corpus_json(run.corpus)?;
    out.remove(CORPUS_FILE)?;
    for name in EVALUATION_FILES {
        out.remove(name)?;
    }

    let also = |format| {
        let mut set = formats.clone();
        set.remove(&Format::Csv);
        set.insert(format);
        set
    };
    let mut costs = formats.clone();
    costs.remove(&Format::Csv);
    if costs.is_empty() {
        costs.insert(Format::Jsonl);
    }

    let mut written = Vec::new();
    let columns = scores::score_columns(run.rows);
    put_table(out, "scores", &columns, run.rows, formats, &mut written)?;
    let columns = costs::cost_columns(run.costs);
    put_table(out, "costs", &columns, run.costs, &costs, &mut written)?;
    let columns = manifests::manifest_columns(run.rows);
    for decision in DECISIONS {
        let stem = format!("manifests/{}", decision_name(decision));
        let rows = manifests::manifest_rows(decision, run.rows, run.locations);
        let formats = also(Format::Jsonl);
        put_table(out, &stem, &columns, &rows, &formats, &mut written)?;
    }
    let columns = rewards::reward_columns();
    let formats = also(Format::Parquet);
    put_table(
        out,
        "rewards",
        &columns,
        run.rewards,
        &formats,
        &mut written,
    )?;
    written.extend(TrainerLists::of(out, run.rows, run.rewards)?.publish(out)?);
    match run.report_html {
        Some(report) => {
            out.put_atomic(REPORT_FILE, report.as_bytes())?;
            written.push(REPORT_FILE.to_owned());
        }
        None => out.remove(REPORT_FILE)?,
    }
    out.put_atomic(CORPUS_FILE, &corpus)?;
    written.push(CORPUS_FILE.to_owned());
    Ok(written)
}

/// Writes one table in each of `formats`, and removes what an earlier run left in the others.
fn put_table<R>(
    out: &OutDir,
    stem: &str,
    columns: &[Column<R>],
    records: &[R],
    formats: &BTreeSet<Format>,
    written: &mut Vec<String>,
) -> Result<(), PublishError> {
    for format in Format::ALL {
        let name = format!("{stem}.{}", format.extension());
        if formats.contains(&format) {
            out.put_atomic_with(&name, |writer| {
                encode::write(format, columns, records, writer)
            })?;
            written.push(name);
        } else {
            out.remove(&name)?;
        }
    }
    Ok(())
}
