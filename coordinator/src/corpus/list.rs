//! Lists of videos: `.txt` (a path a line), `.csv`, `.jsonl` and `.parquet` (column `video`, other
//! columns carried through). Relative paths are relative to the list's own directory.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::file::reader::ChunkReader;
use serde_json::{Map, Value};

use super::CorpusError;

/// The column that names the video.
const VIDEO_COLUMN: &str = "video";

/// One line of a list.
#[derive(Debug, PartialEq)]
pub struct Line {
    /// The video as written.
    pub video: String,
    /// The other columns, in their order.
    pub carried: Map<String, Value>,
}

/// Whether a path's extension says that it is a list.
pub(super) fn is_list(path: &Path) -> bool {
    matches!(
        extension(path).as_deref(),
        Some("txt" | "csv" | "jsonl" | "parquet")
    )
}

/// The video's name in the run.
pub(super) fn name_of(written: &str) -> &str {
    written.trim_start_matches("./")
}

/// Reads a list, in its order.
///
/// # Errors
/// [`CorpusError::List`] naming file, line and remedy.
pub fn read(path: &Path) -> Result<Vec<Line>, CorpusError> {
    read_columns(path, &|_| true)
}

/// Reads a list with those of its columns that are `wanted`: a table of scores has dozens.
///
/// # Errors
/// As [`read`].
pub(crate) fn read_columns(
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Vec<Line>, CorpusError> {
    let wanted = |column: &str| column == VIDEO_COLUMN || wanted(column);
    let open = || File::open(path).map_err(|error| unreadable(&error));
    let lines = match extension(path).as_deref() {
        Some("csv") => open().and_then(|file| read_csv(file, &wanted, split_row)),
        Some("jsonl") => read_text(path).and_then(|text| parse_jsonl(&text, &wanted, split_row)),
        Some("parquet") => open().and_then(|file| read_parquet(file, &wanted, split_row)),
        _ => read_text(path).map(|text| parse_txt(&text)),
    };
    lines.map_err(|reason| CorpusError::List {
        path: path.display().to_string(),
        reason,
    })
}

/// The rows of a table in memory, `.csv`, `.jsonl` or `.parquet` by its name, with those of its columns that are
/// `wanted`.
///
/// # Errors
/// Where and why it does not read.
pub(super) fn rows_of(
    name: &Path,
    content: Vec<u8>,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Vec<Map<String, Value>>, String> {
    let as_it_is = |row, _at: &str| Ok(row);
    match extension(name).as_deref() {
        Some("csv") => read_csv(&content[..], wanted, as_it_is),
        Some("parquet") => read_parquet(Bytes::from(content), wanted, as_it_is),
        _ => parse_jsonl(&text(content)?, wanted, as_it_is),
    }
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

/// Says what to do where a list cannot be opened or read.
fn unreadable(error: &std::io::Error) -> String {
    format!("cannot be read ({error}); check that the file exists and may be read")
}

fn read_text(path: &Path) -> Result<String, String> {
    text(std::fs::read(path).map_err(|error| unreadable(&error))?)
}

fn text(bytes: Vec<u8>) -> Result<String, String> {
    let text =
        String::from_utf8(bytes).map_err(|_| "is not UTF-8 text: save it as UTF-8".to_owned())?;
    // Some editors begin UTF-8 files with a byte order mark.
    Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned())
}

fn parse_txt(text: &str) -> Vec<Line> {
    text.lines()
        .map(|line| line.trim_end_matches('\r'))
        .filter(|line| !line.trim().is_empty())
        .map(|line| Line {
            video: line.to_owned(),
            carried: Map::new(),
        })
        .collect()
}

/// What is made of a row, said to stand at a place.
type Make<T> = fn(Map<String, Value>, &str) -> Result<T, String>;

fn parse_jsonl<T>(
    text: &str,
    wanted: &dyn Fn(&str) -> bool,
    make: Make<T>,
) -> Result<Vec<T>, String> {
    let numbered = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    numbered
        .map(|(index, line)| {
            let at = format!("line {}", index + 1);
            let mut row: Map<String, Value> = serde_json::from_str(line)
                .map_err(|error| format!("{at} is not a JSON object ({error})"))?;
            row.retain(|column, _| wanted(column));
            make(row, &at)
        })
        .collect()
}

fn read_csv<T>(
    file: impl Read,
    wanted: &dyn Fn(&str) -> bool,
    make: Make<T>,
) -> Result<Vec<T>, String> {
    let mut reader = csv::Reader::from_reader(file);
    let header = reader.headers().map_err(|error| error.to_string())?.clone();
    reader
        .records()
        .enumerate()
        .map(|(index, record)| {
            let record = record.map_err(|error| error.to_string())?;
            let cells = record.iter().map(|cell| match cell {
                "" => Value::Null,
                text => Value::String(text.to_owned()),
            });
            let row = header.iter().zip(cells);
            let row = row.filter(|(column, _)| wanted(column));
            let row = row
                .map(|(column, cell)| (column.to_owned(), cell))
                .collect();
            make(row, &format!("row {}", index + 1))
        })
        .collect()
}

/// Through Arrow's own JSON writer, so that every column type becomes the JSON value users expect.
fn read_parquet<T>(
    file: impl ChunkReader + 'static,
    wanted: &dyn Fn(&str) -> bool,
    make: Make<T>,
) -> Result<Vec<T>, String> {
    let reader = ParquetRecordBatchReaderBuilder::try_new(file)
        .and_then(|builder| {
            let fields = builder.schema().fields().iter().enumerate();
            let roots = fields.filter(|(_, field)| wanted(field.name()));
            let roots: Vec<usize> = roots.map(|(index, _)| index).collect();
            let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
            builder.with_projection(mask).build()
        })
        .map_err(|error| error.to_string())?;
    let mut json = Vec::new();
    let mut writer = arrow_json::WriterBuilder::new()
        .with_explicit_nulls(true)
        .build::<_, arrow_json::writer::LineDelimited>(&mut json);
    for batch in reader {
        let batch = batch.map_err(|error| error.to_string())?;
        writer.write(&batch).map_err(|error| error.to_string())?;
    }
    writer.finish().map_err(|error| error.to_string())?;
    drop(writer);
    parse_jsonl(&String::from_utf8_lossy(&json), &|_| true, make)
}

fn split_row(mut row: Map<String, Value>, at: &str) -> Result<Line, String> {
    match row.shift_remove(VIDEO_COLUMN) {
        Some(Value::String(video)) if !video.is_empty() => Ok(Line {
            video,
            carried: row,
        }),
        Some(_) => Err(format!(
            "{at}: the column `{VIDEO_COLUMN}` must hold a path"
        )),
        None => Err(format!(
            "{at}: there is no column `{VIDEO_COLUMN}`; name the column of paths so (found {})",
            row.keys().cloned().collect::<Vec<_>>().join(", ")
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_named(name: &str, content: &[u8]) -> Result<Vec<Line>, CorpusError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        read(&path)
    }

    #[test]
    fn txt_keeps_spaces_and_drops_blank_lines() {
        let lines = read_named("l.txt", b"a b.mp4\r\n\n -x.mp4\n").unwrap();
        let videos: Vec<_> = lines.iter().map(|line| line.video.as_str()).collect();
        assert_eq!(videos, ["a b.mp4", " -x.mp4"]);
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_first_line() {
        for (name, content) in [
            ("l.txt", "\u{feff}a.mp4\r\n"),
            ("l.csv", "\u{feff}video\r\na.mp4\r\n"),
            ("l.jsonl", "\u{feff}{\"video\":\"a.mp4\"}\r\n"),
        ] {
            let lines = read_named(name, content.as_bytes()).unwrap();
            assert_eq!(lines[0].video, "a.mp4", "{name}");
        }
    }

    #[test]
    fn csv_and_jsonl_carry_columns_in_order() {
        let csv = read_named("l.csv", b"task,video,seed\npick,\"a,b.mp4\",3\n,c.mp4,\n").unwrap();
        assert_eq!(csv[0].video, "a,b.mp4");
        assert_eq!(
            serde_json::to_string(&csv[0].carried).unwrap(),
            r#"{"task":"pick","seed":"3"}"#
        );
        assert_eq!(csv[1].carried["task"], Value::Null);
        let jsonl = read_named("l.jsonl", b"{\"z\":1,\"video\":\"a.mp4\",\"a\":true}\n").unwrap();
        assert_eq!(
            serde_json::to_string(&jsonl[0].carried).unwrap(),
            r#"{"z":1,"a":true}"#
        );
    }

    #[test]
    fn parquet_carries_columns() {
        use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
        let columns: [(&str, ArrayRef); 2] = [
            (
                "video",
                std::sync::Arc::new(StringArray::from(vec!["a.mp4"])),
            ),
            ("seed", std::sync::Arc::new(Int64Array::from(vec![Some(7)]))),
        ];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let mut bytes = Vec::new();
        let mut writer =
            parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let lines = read_named("l.parquet", &bytes).unwrap();
        assert_eq!(
            (lines[0].video.as_str(), &lines[0].carried["seed"]),
            ("a.mp4", &Value::from(7))
        );
    }

    #[test]
    fn columns_that_nobody_wants_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        for (name, content) in [
            ("l.csv", "a,video,b\n1,x.mp4,2\n"),
            ("l.jsonl", "{\"a\":\"1\",\"video\":\"x.mp4\",\"b\":\"2\"}\n"),
        ] {
            let path = dir.path().join(name);
            std::fs::write(&path, content).unwrap();
            let lines = read_columns(&path, &|column| column == "b").unwrap();
            let carried = serde_json::to_string(&lines[0].carried).unwrap();
            assert_eq!(
                (lines[0].video.as_str(), carried.as_str()),
                ("x.mp4", r#"{"b":"2"}"#)
            );
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let no_column = read_named("l.csv", b"path,x\na,1\n")
            .unwrap_err()
            .to_string();
        assert!(
            no_column.contains("l.csv") && no_column.contains("found path, x"),
            "{no_column}"
        );
        let bad_line = read_named("l.jsonl", b"{\"video\":\"a\"}\n[1]\n")
            .unwrap_err()
            .to_string();
        assert!(bad_line.contains("line 2"), "{bad_line}");
        assert!(read_named("l.parquet", b"not parquet").is_err());
        assert!(
            read_named("l.txt", b"\xff\xfe")
                .unwrap_err()
                .to_string()
                .contains("UTF-8")
        );
    }
}
