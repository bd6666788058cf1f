//! Hugging Face video folders: `metadata.{csv,jsonl,parquet}` beside the videos, or above them.
//!
//! As `datasets` reads them (`folder_based_builder.py`): the columns `file_name`, `*_file_name` (and their
//! plurals, which hold lists) name files relative to the metadata's own directory; the others are columns of
//! that row. Splits are subfolders. Videos that no row names are scored as well, without columns.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::below;
use super::tree::Tree;
use crate::corpus::CorpusError;
use crate::corpus::files::is_video_name;
use crate::corpus::list::rows_of;

/// Whether a file is named like the metadata of a folder.
pub(super) fn is_metadata(file: &str) -> bool {
    let name = file.rsplit('/').next();
    matches!(
        name,
        Some("metadata.csv" | "metadata.jsonl" | "metadata.parquet")
    )
}

/// The columns of each file that metadata names.
type Columns = BTreeMap<String, Map<String, Value>>;

/// Columns by file; `None` where no column names files, so that it is another kind of metadata.
///
/// # Errors
/// [`CorpusError::List`] where it does not read, names a file twice, or one outside of its folder.
pub(super) fn read(tree: &dyn Tree, file: &str) -> Result<Option<Columns>, CorpusError> {
    let Some(content) = tree.read(file)? else {
        return Ok(None);
    };
    let wrong = |reason: String| CorpusError::List {
        path: tree.address(file),
        reason,
    };
    let directory = file.get(..file.rfind('/').map_or(0, |slash| slash + 1));
    let rows = rows_of(Path::new(file), content, &|_| true).map_err(|reason| {
        wrong(format!(
            "{reason} (a file of this name is read as the metadata of a video folder: mend it or rename it)"
        ))
    })?;
    let mut columns = BTreeMap::new();
    let mut names_files = false;
    for mut row in rows {
        let names = file_names(&row);
        names_files |= names.is_some();
        row.shift_remove("file_name");
        for name in names.unwrap_or_default() {
            if !is_video_name(Path::new(&name)) {
                continue;
            }
            let video = below(directory.unwrap_or_default(), &name).ok_or_else(|| {
                wrong(format!("{name}: leads out of the folder; name files in it"))
            })?;
            if columns.insert(video, row.clone()).is_some() {
                return Err(wrong(format!(
                    "{name} stands in it twice: name each video once"
                )));
            }
        }
    }
    Ok(names_files.then_some(columns))
}

/// The files that a row names; `None` without a column for it.
fn file_names(row: &Map<String, Value>) -> Option<Vec<String>> {
    let mut names: Option<Vec<String>> = None;
    for (column, value) in row {
        let singular = column.strip_suffix('s').unwrap_or(column);
        if singular != "file_name" && !singular.ends_with("_file_name") {
            continue;
        }
        let of_column = match value {
            Value::Array(several) => several.iter().collect(),
            one => vec![one],
        };
        let texts = of_column.into_iter().filter_map(Value::as_str);
        names
            .get_or_insert_default()
            .extend(texts.map(str::to_owned));
    }
    names
}
