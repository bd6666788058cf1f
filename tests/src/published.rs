//! What a run published, read back the way a user's tools read it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};

use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::{Map, Value};

/// One row by column name.
pub type Row = Map<String, Value>;

/// The names of the manifests.
pub const MANIFESTS: [&str; 3] = ["keep", "drop", "review"];

/// An OUT.
#[derive(Debug)]
pub struct Published {
    directory: PathBuf,
}

impl Published {
    /// The OUT at `directory`.
    pub fn new(directory: PathBuf) -> Self {
        Self { directory }
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    /// Whether it is there as a finished run.
    pub fn is_finished(&self) -> bool {
        self.path("corpus.json").exists()
    }

    /// The run's journal.
    pub fn journal(&self) -> PathBuf {
        self.path(".plumbline/journal")
    }

    /// `corpus.json`.
    pub fn corpus(&self) -> Value {
        serde_json::from_slice(&self.read("corpus.json")).expect("corpus.json is JSON")
    }

    /// `scores.jsonl`.
    pub fn rows(&self) -> Vec<Row> {
        self.jsonl("scores.jsonl")
    }

    /// The row of one video.
    #[track_caller]
    pub fn row(&self, video: &str) -> Row {
        let mut rows = self.rows();
        rows.retain(|row| row["video"] == video);
        assert_eq!(rows.len(), 1, "rows of {video:?}");
        rows.swap_remove(0)
    }

    /// A JSON Lines table.
    pub fn jsonl(&self, name: &str) -> Vec<Row> {
        let text = String::from_utf8(self.read(name)).expect("UTF-8");
        let lines = text
            .lines()
            .map(|line| serde_json::from_str(line).expect("a JSON object a line"));
        lines.collect()
    }

    /// A CSV table; an empty cell is a missing value.
    pub fn csv(&self, name: &str) -> Vec<BTreeMap<String, String>> {
        let mut reader = csv::Reader::from_path(self.path(name)).expect("the table opens");
        let rows = reader
            .deserialize()
            .map(|row| row.expect("a row under the header"));
        rows.collect()
    }

    /// A Parquet table.
    pub fn parquet(&self, name: &str) -> Vec<Row> {
        let file = File::open(self.path(name)).expect("the table opens");
        let reader =
            ParquetRecordBatchReaderBuilder::try_new(file).and_then(|builder| builder.build());
        let mut json = Vec::new();
        let mut writer = arrow_json::WriterBuilder::new()
            .with_explicit_nulls(true)
            .build::<_, arrow_json::writer::LineDelimited>(&mut json);
        for batch in reader.expect("Parquet") {
            writer.write(&batch.expect("a batch")).expect("JSON");
        }
        writer.finish().expect("JSON");
        drop(writer);
        let text = String::from_utf8(json).expect("UTF-8");
        let lines = text
            .lines()
            .map(|line| serde_json::from_str(line).expect("a JSON object a line"));
        lines.collect()
    }

    /// Every file that must not differ between two runs on the same input: all but what they cost and
    /// the report that shows it.
    pub fn stable_files(&self) -> BTreeMap<String, Vec<u8>> {
        let mut files = BTreeMap::new();
        for directory in ["", "manifests"] {
            let entries = std::fs::read_dir(self.directory.join(directory)).expect("OUT lists");
            for entry in entries.map(|entry| entry.expect("entry")) {
                let name = Path::new(directory)
                    .join(entry.file_name())
                    .display()
                    .to_string();
                let differs = name.starts_with("costs.") || name == "report.html";
                if entry.path().is_file() && !differs {
                    let bytes = self.read(&name);
                    files.insert(name, bytes);
                }
            }
        }
        files
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Fails unless the run is finished and holds every one of `videos` exactly once, in every table
    /// and in exactly one manifest, with statistics that add up and `corpus.json` written last.
    #[track_caller]
    pub fn expect_whole<S: AsRef<str>>(&self, videos: &[S]) -> &Self {
        let mut expected: Vec<&str> = videos.iter().map(AsRef::as_ref).collect();
        expected.sort_unstable();
        let rows = self.rows();
        assert_eq!(names(&rows), expected, "scores.jsonl");
        assert_eq!(self.parquet("scores.parquet"), rows, "scores.parquet");
        let csv = self.csv("scores.csv");
        assert_eq!(csv.len(), rows.len(), "scores.csv");
        for (cells, row) in csv.iter().zip(&rows) {
            assert_eq!(cells.len(), row.len(), "columns of scores.csv");
            for (name, value) in row {
                assert_eq!(cells[name], csv_text(value), "{name} of {}", row["video"]);
            }
        }
        self.expect_manifests(&rows);
        self.expect_sums(&rows);
        self.expect_corpus_last();
        self
    }

    /// Fails unless the run is finished and its scores hold every one of `videos` exactly once.
    #[track_caller]
    pub fn expect_rows<S: AsRef<str>>(&self, videos: &[S]) -> &Self {
        assert!(self.is_finished(), "no corpus.json");
        let mut expected: Vec<&str> = videos.iter().map(AsRef::as_ref).collect();
        expected.sort_unstable();
        let rows = self.rows();
        let mut found = names(&rows);
        found.sort_unstable();
        assert_eq!(found, expected, "scores.jsonl");
        self
    }

    #[track_caller]
    fn expect_manifests(&self, rows: &[Row]) {
        let mut listed = BTreeMap::new();
        for manifest in MANIFESTS {
            let lines = self.jsonl(&format!("manifests/{manifest}.jsonl"));
            assert_eq!(
                self.parquet(&format!("manifests/{manifest}.parquet")),
                lines,
                "{manifest}"
            );
            for line in lines {
                let video = line["video"].as_str().expect("a name").to_owned();
                assert_eq!(line["decision"], manifest, "{video}");
                let path = line["path"].as_str().expect("a path");
                assert!(Path::new(path).is_absolute(), "{path}");
                assert!(
                    listed.insert(video.clone(), manifest).is_none(),
                    "{video} is listed twice"
                );
            }
        }
        let decided: BTreeMap<String, &str> = rows
            .iter()
            .map(|row| {
                let decision = row["decision"].as_str().expect("a decision");
                let manifest = MANIFESTS
                    .iter()
                    .find(|name| **name == decision)
                    .expect("a manifest");
                (row["video"].as_str().expect("a name").to_owned(), *manifest)
            })
            .collect();
        assert_eq!(listed, decided, "manifests partition the rows");
    }

    #[track_caller]
    fn expect_sums(&self, rows: &[Row]) {
        let corpus = self.corpus();
        for (counts, column) in [("statuses", "status"), ("decisions", "decision")] {
            let mut total = 0;
            for (name, count) in corpus[counts].as_object().expect("counts") {
                let found = rows.iter().filter(|row| row[column] == *name).count();
                assert_eq!(*count, found, "{counts}.{name}");
                total += found;
            }
            assert_eq!(total, rows.len(), "{counts}");
        }
        assert_eq!(corpus["corpus"]["n"], corpus["statuses"]["scored"]);
        for row in rows {
            let is_scored = row["status"] == "scored";
            assert_eq!(row["status_reason"].is_null(), is_scored, "{row:?}");
            assert!(is_scored || row["anomaly"].is_null(), "{row:?}");
            assert_eq!(
                row["decision"] == "review",
                row["anomaly"].is_null(),
                "{row:?}"
            );
        }
    }

    #[track_caller]
    fn expect_corpus_last(&self) {
        let modified = |name: &str| {
            let metadata = std::fs::metadata(self.path(name));
            metadata
                .and_then(|metadata| metadata.modified())
                .expect("a time")
        };
        let last = modified("corpus.json");
        let others = self
            .stable_files()
            .into_keys()
            .chain(["report.html".to_owned()]);
        for name in others {
            assert!(
                modified(&name) <= last,
                "{name} was written after corpus.json"
            );
        }
    }
}

/// The names of rows, in their order.
pub fn names(rows: &[Row]) -> Vec<&str> {
    rows.iter()
        .map(|row| row["video"].as_str().expect("a name"))
        .collect()
}

/// A number of a row; fails where it is missing.
#[track_caller]
pub fn number(row: &Row, column: &str) -> f64 {
    row[column]
        .as_f64()
        .unwrap_or_else(|| panic!("{column} of {} is {}", row["video"], row[column]))
}

/// The values of a column of names.
pub fn values(rows: &[Row], column: &str) -> BTreeSet<String> {
    rows.iter().map(|row| csv_text(&row[column])).collect()
}

/// A cell as CSV writes it.
fn csv_text(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
