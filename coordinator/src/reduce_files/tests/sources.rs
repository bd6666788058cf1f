//! Rows that others wrote, rows that are refused, and rows as a reference.

use super::*;

fn refusal(o: &ReduceFilesOptions) -> String {
    let error = reduce_files(o).unwrap_err();
    assert!(error.is_usage() && !o.out.join("corpus.json").exists());
    error.to_string()
}

#[test]
fn what_is_wrong_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| -> PathBuf {
        let path = dir.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let out = dir.path().join("out");
    let o = reduce_options(Recipe::Paper, "40%");
    let refused = |path: &Path| refusal(&options(&[path], &out, &o));
    assert!(refused(&file("a.jsonl", "{\"video\":\"x\"}\nnonsense\n")).contains("line 2"));
    assert!(refused(&file("b.jsonl", "{\"path\":\"x\"}\n")).contains("column `video`"));
    assert!(
        refused(&file("c.jsonl", "{\"video\":\"x\"}\n{\"video\":\"x\"}\n")).contains("x: two rows")
    );
    assert!(refused(&file("d.jsonl", "{\"video\":null}\n")).contains("every row"));
    assert!(
        refused(&file("e.jsonl", "{\"video\":\"x\",\"status\":\"fine\"}\n"))
            .contains("none of scored")
    );
    assert!(refused(&file("f.parquet", "PAR1")).contains("f.parquet"));
    assert!(refused(&file("g.csv", "video\n")).contains(".parquet and .jsonl"));
    assert!(refused(&file("h.jsonl", "\n")).contains("no row found"));
    assert!(refused(&dir.path().join("absent")).contains("check the path"));
    let profiles =
        "{\"video\":\"x\",\"profile_digest\":\"p\"}\n{\"video\":\"y\",\"profile_digest\":\"q\"}\n";
    assert!(refused(&file("i.jsonl", profiles)).contains("two profiles (p and q)"));
    let own = file("scores.jsonl", "{\"video\":\"x\"}\n");
    assert!(refusal(&options(&[&own], dir.path(), &o)).contains("choose another --out"));
}

/// What a cascade said of its rows is no longer true of them, and nobody's column.
#[test]
fn columns_of_a_cascade_are_not_carried() {
    let dir = tempfile::tempdir().unwrap();
    let rows = dir.path().join("rows.jsonl");
    let row = |video: &str| {
        let row = json!({"video": video, "reproj_px": 1.0, "rung": "accurate", "flip_probability": 0.0, "seed": 7});
        row.to_string()
    };
    write_part(&rows, &[row("a"), row("b")]);
    let out = dir.path().join("out");
    reduce_files(&options(
        &[&rows],
        &out,
        &reduce_options(Recipe::Paper, "40%"),
    ))
    .unwrap();
    let scores = read(&out, "scores.jsonl");
    assert!(scores.contains("\"seed\":7"));
    assert!(!scores.contains("rung") && !scores.contains("flip_probability"));
}

/// Foreign rows: only names and measures, single precision, a NaN, groups by a column.
#[test]
fn foreign_parquet_is_read_by_name() {
    use arrow_array::{ArrayRef, Float32Array, Int32Array, RecordBatch, StringArray};
    use std::sync::Arc;
    let columns: [(&str, ArrayRef); 4] = [
        (
            "video",
            Arc::new(StringArray::from(vec!["d", "a", "c", "b"])),
        ),
        ("task", Arc::new(Int32Array::from(vec![1, 1, 2, 2]))),
        (
            "reproj_px",
            Arc::new(Float32Array::from(vec![1.0, 2.0, f32::NAN, 4.0])),
        ),
        (
            "aepe_worldscore_px",
            Arc::new(Float32Array::from(vec![
                Some(1.0),
                Some(5.0),
                Some(2.0),
                None,
            ])),
        ),
    ];
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rows.parquet");
    let mut writer = parquet::arrow::ArrowWriter::try_new(
        fs::File::create(&path).unwrap(),
        batch.schema(),
        None,
    )
    .unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    let out = dir.path().join("out");
    let mut o = options(&[&path], &out, &reduce_options(Recipe::Paper, "1"));
    o.group_by = Some("task".parse().unwrap());
    let found = reduce_files(&o).unwrap();
    assert!(!found.complete());
    assert_eq!(
        (
            found.statistics.statuses["scored"],
            found.statistics.statuses["failed"]
        ),
        (3, 1)
    );
    assert!(
        found
            .statistics
            .warnings
            .iter()
            .any(|w| w.starts_with("1 measurements held"))
    );
    let review: Value = serde_json::from_str(&read(&out, "manifests/review.jsonl")).unwrap();
    assert_eq!(
        (review["video"].as_str(), review["task"].as_i64()),
        (Some("c"), Some(2))
    );
    assert!(
        review["status_reason"]
            .as_str()
            .unwrap()
            .starts_with("reproj_px is not a finite number")
    );
    let keep = read(&out, "manifests/keep.jsonl");
    let kept: Vec<Value> = keep
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(
        kept.iter()
            .map(|row| row["group"].as_str().unwrap())
            .collect::<Vec<_>>(),
        ["2", "1"]
    );
    o.group_by = Some("nonsense".parse().unwrap());
    assert!(refusal(&o).contains("--group-by nonsense"));
}

/// Frozen from files in any order, a reference has the bits of one frozen in memory; rows scored
/// against it agree in files and in memory, in any order and any parts.
#[test]
fn references_agree_in_files_and_memory_whatever_the_order() {
    use crate::reduce::reference::tests::{against, freeze as freeze_in_memory};
    let dir = tempfile::tempdir().unwrap();
    let o = reduce_options(Recipe::Paper, "40%");
    let lines = lines_of(300, 11);
    let mut references = Vec::new();
    for (seed, parts) in [(1, 1), (2, 7)] {
        let source = dir.path().join(format!("reference-{seed}"));
        fs::create_dir(&source).unwrap();
        let shuffled = shuffled(lines.clone(), seed);
        for (k, lines) in shuffled.chunks(shuffled.len().div_ceil(parts)).enumerate() {
            write_part(&source.join(format!("part-{k}.jsonl")), lines);
        }
        let of_files = options(&[&source], dir.path(), &o);
        let (frozen, profile) = freeze::freeze(&of_files, dir.path()).unwrap();
        assert!(profile.is_none());
        references.push(frozen);
    }
    let reference = freeze_in_memory(&corpus(300, 11), &o);
    assert_eq!(references, [reference.clone(), reference.clone()]);

    for recipe in [Recipe::Paper, Recipe::Balanced] {
        let o = against(&reference, &reduce_options(recipe, "40%"));
        let (memory, files) = (dir.path().join("memory"), dir.path().join("files"));
        scored(corpus(90, 3), &o, &memory);
        let rows = rows_with_paths(&memory);
        let change = |options: &mut ReduceFilesOptions| options.reduce = o.clone();
        let whole = in_parts(&rows, 1, 0, change);
        for (seed, parts) in [(4, 1), (5, 13)] {
            assert_eq!(in_parts(&rows, parts, seed, change), whole);
        }
        let part = memory.join("part.jsonl");
        write_part(&part, &rows);
        reduce_files(&options(&[&part], &files, &o)).unwrap();
        assert_same_files(&files, &memory, &format!("{recipe:?}"));
    }
    let mut other = reference;
    other.profile_digest = Some("other".to_owned());
    let o = against(&other, &o);
    let part = dir.path().join("memory/part.jsonl");
    let refused = reduce_files(&options(&[&part], &dir.path().join("out"), &o)).unwrap_err();
    assert!(
        refused.is_usage() && refused.to_string().contains("d1ge57"),
        "{refused}"
    );
}

#[test]
fn too_few_rows_are_no_reference() {
    let dir = tempfile::tempdir().unwrap();
    let part = dir.path().join("part.jsonl");
    write_part(&part, &lines_of(2, 1));
    let o = options(&[&part], dir.path(), &reduce_options(Recipe::Paper, "1"));
    let refused = freeze::freeze(&o, dir.path()).unwrap_err().to_string();
    assert!(refused.contains("at least 3"), "{refused}");
}
