//! Rows handed on one by one: a line of JSON each, whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::Write;

use plumbline_common::row::Row;

use crate::publish::encode::{self, Format};
use crate::publish::scores::score_columns;
use crate::publish::{OutDir, PublishError};
use crate::reduce::ReduceOptions;
use crate::reduce::select::KeepRule;
use crate::run::RunError;

/// The file of a watch's rows, in the order in which they became final.
pub(crate) const STREAM_FILE: &str = "stream.jsonl";

/// Where rows go.
#[derive(Debug)]
pub(super) struct Lines {
    file: File,
    to_stdout: bool,
    /// Columns that depend on the rows still to come.
    open: &'static [&'static str],
}

impl Lines {
    /// Starts the file anew.
    pub(super) fn start(
        out: &OutDir,
        to_stdout: bool,
        options: &ReduceOptions,
    ) -> Result<Self, RunError> {
        let path = out.root().join(STREAM_FILE);
        let opened = OpenOptions::new().create(true).append(true).open(path);
        let opened = opened.and_then(|file| file.set_len(0).map(|()| file));
        Ok(Self {
            file: opened.map_err(|source| PublishError::from_io(STREAM_FILE, source))?,
            to_stdout,
            open: match options.keep {
                KeepRule::AtMost(_) => &["rank"],
                KeepRule::Best(_) | KeepRule::Percent(_) => &["rank", "decision"],
            },
        })
    }

    /// Hands one row on, in one write.
    pub(super) fn push(&mut self, row: &Row) -> Result<(), RunError> {
        let rows = std::slice::from_ref(row);
        let mut columns = score_columns(rows);
        columns.retain(|column| !self.open.contains(&column.name.as_str()));
        let mut line = Vec::new();
        encode::write(Format::Jsonl, &columns, rows, &mut line).map_err(|source| {
            PublishError::Encode {
                file: STREAM_FILE.to_owned(),
                source,
            }
        })?;
        let written = self.file.write_all(&line);
        written.map_err(|source| PublishError::from_io(STREAM_FILE, source))?;
        if self.to_stdout {
            let mut stdout = std::io::stdout().lock();
            let written = stdout.write_all(&line).and_then(|()| stdout.flush());
            written.map_err(RunError::Output)?;
        }
        Ok(())
    }
}
