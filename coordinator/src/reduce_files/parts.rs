//! What was named on the command line, as tables of rows with one set of columns.
//!
//! Parquet is read where it lies. JSON Lines are turned into a scratch Parquet file first, line by
//! line, once every part's columns are known.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::columns::{CarriedSeen, Columns, carried_of};
use super::error::ReduceFilesError;
use super::table::Table;
use super::table_file::{BATCH_ROWS, TableFile};
use crate::publish::encode::Format;
use crate::publish::encode::batches::BatchWriter;
use crate::publish::encode::to_batch;
use crate::publish::scores::own_names;
use crate::publish::table::{CarriedColumn, Column, Seen};

/// Files that a directory is searched for first: a run's own table.
const TABLES: [&str; 2] = ["scores.parquet", "scores.jsonl"];

/// The files that the sources name: themselves, a run's scores, or all parts in a directory.
pub(crate) fn files(sources: &[PathBuf]) -> Result<Vec<PathBuf>, ReduceFilesError> {
    let mut files = Vec::new();
    for source in sources {
        let name = source.display().to_string();
        let failed = |error: std::io::Error| {
            ReduceFilesError::source(&name, format!("{error}; check the path"))
        };
        if !source.metadata().map_err(failed)?.is_dir() {
            files.push(source.clone());
            continue;
        }
        if let Some(table) = TABLES
            .iter()
            .map(|table| source.join(table))
            .find(|path| path.is_file())
        {
            files.push(table);
            continue;
        }
        let mut parts = Vec::new();
        for entry in source.read_dir().map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if format_of(&path).is_some() && path.is_file() {
                parts.push(path);
            }
        }
        if parts.is_empty() {
            return Err(ReduceFilesError::source(
                &name,
                "holds neither scores.parquet, scores.jsonl nor parts (*.parquet, *.jsonl)",
            ));
        }
        parts.sort();
        files.extend(parts);
    }
    Ok(files)
}

fn format_of(path: &Path) -> Option<Format> {
    match path.extension()?.to_str()? {
        "parquet" => Some(Format::Parquet),
        "jsonl" => Some(Format::Jsonl),
        _ => None,
    }
}

/// Opens every file; tables without rows are left out.
pub(super) fn open(
    files: &[PathBuf],
    scratch: &Path,
) -> Result<(Vec<Table>, Columns), ReduceFilesError> {
    let own = own_names();
    let mut tables = Vec::new();
    let mut texts = Vec::new();
    let mut carried: Vec<CarriedSeen> = Vec::new();
    for path in files {
        let name = path.display().to_string();
        match format_of(path) {
            Some(Format::Parquet) => {
                let table = TableFile::named(path)?;
                if table.schema().column_with_name("video").is_none() {
                    return Err(no_video(&name));
                }
                if table.rows() > 0 {
                    carried.push(carried_of(table.schema(), &own));
                    tables.push(Table::File(table));
                }
            }
            Some(Format::Jsonl) => {
                let (rows, seen) = look_through(path, &name, &own)?;
                if rows > 0 {
                    carried.push(seen);
                    texts.push((path.clone(), name));
                }
            }
            _ => {
                return Err(ReduceFilesError::source(
                    &name,
                    "rows are read from .parquet and .jsonl files; name one of those",
                ));
            }
        }
    }
    let columns = Columns::of(&carried);
    if !texts.is_empty() {
        tables.push(Table::File(to_parquet(&texts, &columns, scratch)?));
    }
    Ok((tables, columns))
}

fn no_video(name: &str) -> ReduceFilesError {
    ReduceFilesError::source(
        name,
        "there is no column `video`; name the column of videos so",
    )
}

/// The objects of a JSON Lines file with their line numbers.
fn lines(
    path: &Path,
    name: &str,
) -> Result<impl Iterator<Item = Result<Map<String, Value>, ReduceFilesError>>, ReduceFilesError> {
    let file = File::open(path).map_err(|error| ReduceFilesError::source(name, error))?;
    let name = name.to_owned();
    let lines = BufReader::with_capacity(1 << 18, file).lines().enumerate();
    Ok(lines.filter_map(move |(index, line)| {
        let failed = |error: &dyn std::fmt::Display| {
            ReduceFilesError::source(
                &name,
                format!("line {} is no JSON object ({error})", index + 1),
            )
        };
        match line {
            Err(error) => Some(Err(failed(&error))),
            Ok(line) if line.trim().is_empty() => None,
            Ok(line) => Some(serde_json::from_str(&line).map_err(|error| failed(&error))),
        }
    }))
}

/// How many rows there are, and what they carry.
fn look_through(
    path: &Path,
    name: &str,
    own: &[String],
) -> Result<(u64, CarriedSeen), ReduceFilesError> {
    let mut rows = 0;
    let mut carried: CarriedSeen = Vec::new();
    for row in lines(path, name)? {
        let row = row?;
        if !row.contains_key("video") {
            return Err(no_video(name));
        }
        rows += 1;
        for (key, value) in &row {
            if own.contains(key) {
                continue;
            }
            match carried.iter_mut().find(|(name, _)| name == key) {
                Some((_, seen)) => seen.note(value),
                None => {
                    let mut seen = Seen::default();
                    seen.note(value);
                    carried.push((key.clone(), seen));
                }
            }
        }
    }
    Ok((rows, carried))
}

/// All JSON Lines in one scratch table, one after the other.
fn to_parquet(
    texts: &[(PathBuf, String)],
    columns: &Columns,
    scratch: &Path,
) -> Result<TableFile, ReduceFilesError> {
    let table: Vec<Column<Map<String, Value>>> = columns
        .all
        .iter()
        .map(|column| {
            let carried = CarriedColumn {
                key: column.name.clone(),
                name: column.name.clone(),
                kind: column.kind,
            };
            Column::carried(&carried, |row| row)
        })
        .collect();
    let mut file = tempfile::tempfile_in(scratch)?;
    let mut writer = BatchWriter::new(Format::Parquet, columns.schema(), &mut file)?;
    let mut records = Vec::with_capacity(BATCH_ROWS);
    for (path, name) in texts {
        for row in lines(path, name)? {
            records.push(row?);
            if records.len() == BATCH_ROWS {
                writer.write(&to_batch(&table, &records)?)?;
                records.clear();
            }
        }
    }
    writer.write(&to_batch(&table, &records)?)?;
    writer.finish()?;
    let names: Vec<&str> = texts.iter().map(|(_, name)| name.as_str()).collect();
    TableFile::scratch(&names.join(", "), file)
}
