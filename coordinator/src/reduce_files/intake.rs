//! The first pass: every row's signals into scratch files by row index, groups into numbers, and
//! whether the rows are in order.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use arrow_array::Array;
use plumbline_common::row::Status;

use super::columns::Columns;
use super::error::ReduceFilesError;
use super::float_file::FloatFile;
use super::rows::{check, groups, texts, videos};
use super::table::Table;
use super::table_file::BATCH_ROWS;
use crate::corpus::GroupBy;
use crate::in_parallel::in_parallel;
use crate::reduce::recipe::{BySignal, Signal};
use crate::reduce::reject::CHECKED_COLUMNS;

/// The number of a row without a group.
pub(super) const NO_GROUP: u32 = u32::MAX;

/// Everything that the later passes need of the rows, by row index.
#[derive(Debug)]
pub(super) struct Intake {
    pub(super) tables: Vec<Table>,
    pub(super) rows: u64,
    pub(super) scored: u64,
    /// NaN where a row is not scored or lacks the signal.
    pub(super) signals: BySignal<FloatFile>,
    /// Present where any row has a group.
    pub(super) groups: Option<GroupFile>,
    pub(super) profile_digest: Option<String>,
}

/// Group numbers by row index.
#[derive(Debug)]
pub(super) struct GroupFile {
    file: File,
    /// By number.
    pub(super) names: Vec<String>,
    /// Rows by number.
    pub(super) rows: Vec<u64>,
    /// Scored rows by number.
    pub(super) scored: Vec<u64>,
}

impl GroupFile {
    /// Reads the group numbers of rows, from a row on.
    pub(super) fn read(&self, row: u64, numbers: &mut [u32]) -> io::Result<()> {
        let mut bytes = vec![0; numbers.len() * 4];
        self.file.read_exact_at(&mut bytes, row * 4)?;
        for (number, bytes) in numbers.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *number = u32::from_le_bytes(*bytes);
        }
        Ok(())
    }
}

/// One row group of one table.
struct Work {
    table: usize,
    row_group: usize,
    first_row: u64,
}

/// What a row group says of the order of its rows.
#[derive(Default)]
struct Span {
    ascending: bool,
    first: String,
    last: String,
}

#[derive(Default)]
struct Shared {
    spans: BTreeMap<u64, Span>,
    scored: u64,
    numbers: HashMap<String, u32>,
    group_rows: Vec<u64>,
    group_scored: Vec<u64>,
    any_group: bool,
    profile_digest: Option<String>,
}

/// What the first pass found.
pub(super) enum Taken {
    /// Rows in order.
    Ordered(Box<Intake>),
    /// The tables have to be sorted first.
    Unordered(Vec<Table>),
}

/// Takes all rows in.
pub(super) fn take_in(
    mut tables: Vec<Table>,
    columns: &Columns,
    group_by: Option<&GroupBy>,
    scratch: &Path,
    threads: usize,
) -> Result<Taken, ReduceFilesError> {
    sort_tables(&mut tables)?;
    let mut work = Vec::new();
    let mut rows = 0;
    for (table, file) in tables.iter().enumerate() {
        for (row_group, count) in file.row_groups().into_iter().enumerate() {
            work.push(Work {
                table,
                row_group,
                first_row: rows,
            });
            rows += count;
        }
    }
    let mut files = Vec::new();
    for _ in Signal::ALL {
        files.push(FloatFile::create(scratch, rows, threads)?);
    }
    let mut files = files.into_iter();
    // As many as there are signals.
    let signals = BySignal::try_from_fn(|_| files.next().ok_or(ReduceFilesError::Thread))?;
    let group_file = tempfile::tempfile_in(scratch)?;
    let names = names_to_read(columns, group_by);

    let shared = Mutex::new(Shared::default());
    // Set where nothing is left to find: rows that are not in order are taken in again, sorted.
    let unordered = AtomicBool::new(false);
    in_parallel::<_, _, ReduceFilesError>(
        work,
        threads,
        || (),
        |(), work| {
            if unordered.load(Ordering::Relaxed) {
                return Ok(());
            }
            let taken = Taking {
                table: &tables[work.table],
                columns,
                names: &names,
                group_by,
                signals: &signals,
                group_file: &group_file,
                shared: &shared,
            };
            if !taken.row_group(&work)? {
                unordered.store(true, Ordering::Relaxed);
            }
            Ok(())
        },
        |()| Ok(()),
    )?;
    let shared = shared.into_inner().map_err(|_| ReduceFilesError::Thread)?;
    if !in_order(&shared.spans)? {
        return Ok(Taken::Unordered(tables));
    }
    let groups = shared.any_group.then(|| {
        let mut names = vec![String::new(); shared.numbers.len()];
        for (name, number) in shared.numbers {
            names[number as usize] = name;
        }
        GroupFile {
            file: group_file,
            names,
            rows: shared.group_rows,
            scored: shared.group_scored,
        }
    });
    Ok(Taken::Ordered(Box::new(Intake {
        tables,
        rows,
        scored: shared.scored,
        signals,
        groups,
        profile_digest: shared.profile_digest,
    })))
}

/// Tables by their first row: parts of one run that are in order need no sorting.
fn sort_tables(tables: &mut [Table]) -> Result<(), ReduceFilesError> {
    if tables.len() == 1 {
        return Ok(());
    }
    let mut firsts = HashMap::new();
    for table in tables.iter() {
        if let Some(batch) = table.read(&["video"], None, 1)?.next() {
            let batch = batch?;
            let first = texts(&batch, "video")
                .filter(|v| v.is_valid(0))
                .map(|v| v.value(0).to_owned());
            firsts.insert(table.name().to_owned(), first);
        }
    }
    tables.sort_by(|a, b| {
        firsts
            .get(a.name())
            .cmp(&firsts.get(b.name()))
            .then(a.name().cmp(b.name()))
    });
    Ok(())
}

fn names_to_read<'a>(columns: &'a Columns, group_by: Option<&GroupBy>) -> Vec<&'a str> {
    columns
        .all
        .iter()
        .map(|column| column.name.as_str())
        .filter(|name| {
            let grouping = match group_by {
                None => *name == "group",
                Some(GroupBy::Column(column)) => name == column,
                Some(GroupBy::Path(_) | GroupBy::Prefix(_)) => false,
            };
            ["video", "status", "profile_digest"].contains(name)
                || CHECKED_COLUMNS.contains(name)
                || grouping
        })
        .collect()
}

/// True where all row groups ascend, each above the one before.
fn in_order(spans: &BTreeMap<u64, Span>) -> Result<bool, ReduceFilesError> {
    let spans: Vec<&Span> = spans.values().collect();
    if spans.iter().any(|span| !span.ascending) {
        return Ok(false);
    }
    for pair in spans.windows(2) {
        if pair[0].last >= pair[1].first {
            return Ok(false);
        }
    }
    Ok(true)
}

struct Taking<'a> {
    table: &'a Table,
    columns: &'a Columns,
    names: &'a [&'a str],
    group_by: Option<&'a GroupBy>,
    signals: &'a BySignal<FloatFile>,
    group_file: &'a File,
    shared: &'a Mutex<Shared>,
}

impl Taking<'_> {
    /// Takes one row group in; says whether its rows are in order.
    fn row_group(&self, work: &Work) -> Result<bool, ReduceFilesError> {
        let file = self.table.name();
        let mut row = work.first_row;
        let mut span = Span {
            ascending: true,
            ..Span::default()
        };
        for batch in self
            .table
            .read(self.names, Some(vec![work.row_group]), BATCH_ROWS)?
        {
            let batch = self.columns.conform(&batch?, self.names, file)?;
            let checked = check(batch, file)?;
            let batch = &checked.batch;
            let names = videos(batch, file)?;
            let mut last = span.last.as_str();
            for video in names.iter().flatten() {
                span.ascending &= last < video;
                last = video;
            }
            if row == work.first_row && !names.is_empty() {
                names.value(0).clone_into(&mut span.first);
            }
            span.last = last.to_owned();
            for signal in Signal::ALL {
                self.signals[signal].write(row, &checked.signal(signal))?;
            }
            let groups = groups(batch, self.group_by, file)?;
            self.share(row, &checked, groups.as_ref())?;
            row += batch.num_rows() as u64;
        }
        let ascending = span.ascending;
        let mut shared = self.shared.lock().map_err(|_| ReduceFilesError::Thread)?;
        shared.spans.insert(work.first_row, span);
        Ok(ascending)
    }

    /// What concerns more than one row group.
    fn share(
        &self,
        row: u64,
        checked: &super::rows::Checked,
        groups: Option<&arrow_array::StringArray>,
    ) -> Result<(), ReduceFilesError> {
        let scored = |k: usize| checked.statuses[k] == Status::Scored;
        let mut guard = self.shared.lock().map_err(|_| ReduceFilesError::Thread)?;
        let shared = &mut *guard;
        shared.scored += checked
            .statuses
            .iter()
            .filter(|&&s| s == Status::Scored)
            .count() as u64;
        if let Some(digests) = texts(&checked.batch, "profile_digest") {
            let known = &mut shared.profile_digest;
            for digest in digests.iter().flatten() {
                match known {
                    None => *known = Some(digest.to_owned()),
                    Some(known) if known == digest => {}
                    Some(known) => {
                        let (first, second) = if known.as_str() < digest {
                            (known.clone(), digest.to_owned())
                        } else {
                            (digest.to_owned(), known.clone())
                        };
                        return Err(ReduceFilesError::Profiles { first, second });
                    }
                }
            }
        }
        let rows = checked.statuses.len();
        let mut numbers = vec![NO_GROUP; rows];
        if let Some(groups) = groups {
            shared.any_group |= groups.null_count() < rows;
            let mut last: Option<(&str, u32)> = None;
            for (k, group) in groups.iter().enumerate() {
                let Some(group) = group else { continue };
                let number = match last {
                    Some((name, number)) if name == group => number,
                    _ => match shared.numbers.get(group) {
                        Some(&number) => number,
                        None => {
                            let number = shared.group_scored.len() as u32;
                            shared.numbers.insert(group.to_owned(), number);
                            shared.group_rows.push(0);
                            shared.group_scored.push(0);
                            number
                        }
                    },
                };
                last = Some((group, number));
                numbers[k] = number;
                shared.group_rows[number as usize] += 1;
                shared.group_scored[number as usize] += u64::from(scored(k));
            }
        }
        drop(guard);
        let mut bytes = vec![0; numbers.len() * 4];
        for (bytes, number) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(&numbers) {
            *bytes = number.to_le_bytes();
        }
        Ok(self.group_file.write_all_at(&bytes, row * 4)?)
    }
}
