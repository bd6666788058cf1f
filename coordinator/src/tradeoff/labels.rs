//! Judgements of videos, as `plumbline evaluate` reads them.

use std::collections::BTreeMap;
use std::path::Path;

use plumbline_common::id::VideoId;
use serde_json::Value;

use crate::corpus::{CorpusError, read_list};
use crate::evaluate::{WANTED_LABEL, share};

/// The mean label of each video, in [0, 1].
///
/// # Errors
/// [`CorpusError::List`] naming the file, the row and the remedy.
pub(super) fn read(path: &Path, column: &str) -> Result<BTreeMap<VideoId, f64>, CorpusError> {
    let wrong = |reason: String| CorpusError::List {
        path: path.display().to_string(),
        reason,
    };
    let mut labels: BTreeMap<VideoId, Vec<f64>> = BTreeMap::new();
    for (index, line) in read_list(path)?.into_iter().enumerate() {
        let value = match line.carried.get(column) {
            Some(Value::Null) => continue,
            Some(Value::String(text)) if text.trim().is_empty() => continue,
            Some(value) => value,
            None => {
                return Err(wrong(format!(
                    "there is no column `{column}`; name the judgement with --label-column"
                )));
            }
        };
        let label = share(value).ok_or_else(|| {
            wrong(format!(
                "row {}: {column} is {value}; {WANTED_LABEL}",
                index + 1
            ))
        })?;
        let video = VideoId::new(line.video.trim_start_matches("./"))
            .map_err(|error| wrong(format!("row {}: {error}", index + 1)))?;
        labels.entry(video).or_default().push(label);
    }
    let mean = |labels: Vec<f64>| labels.iter().sum::<f64>() / labels.len() as f64;
    Ok(labels
        .into_iter()
        .map(|(video, own)| (video, mean(own)))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(text: &str) -> Result<BTreeMap<VideoId, f64>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("labels.csv");
        std::fs::write(&path, text).unwrap();
        read(&path, "label").map_err(|error| error.to_string())
    }

    #[test]
    fn judgements_of_a_video_are_averaged_and_empty_ones_left_out() {
        let found = labels("video,label\n./a.mp4,1\na.mp4,0\nb.mp4,\nc.mp4,0.5\n").unwrap();
        let values: Vec<_> = found.iter().map(|(v, l)| (v.as_str(), *l)).collect();
        assert_eq!(values, [("a.mp4", 0.5), ("c.mp4", 0.5)]);
    }

    #[test]
    fn what_is_no_judgement_is_named() {
        for (text, told) in [
            ("video,label\na.mp4,2\n", "row 1"),
            ("video,label\na.mp4,bad\n", "row 1"),
            ("video,other\na.mp4,1\n", "--label-column"),
        ] {
            let error = labels(text).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
