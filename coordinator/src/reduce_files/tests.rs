//! Rows in files against rows in memory, and against themselves in any order and any parts.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use plumbline_common::id::VideoId;
use plumbline_common::row::{Measurement, Status};
use proptest::prelude::*;
use serde_json::{Map, Value, json};

use super::*;
use crate::publish::{Publication, publish};
use crate::reduce::outcome::{NormaliseWithin, Range, Recipe};
use crate::reduce::{MeasuredVideo, reduce};

/// Everything is cut as small as it goes, so that few rows take every path.
const SMALL: Budget = Budget {
    section_rows: 7,
    bucket_rows: 11,
    bucket_bytes: 4096,
};

fn options(sources: &[&Path], out: &Path, reduced: &ReduceOptions) -> ReduceFilesOptions {
    ReduceFilesOptions {
        sources: sources.iter().map(|path| path.to_path_buf()).collect(),
        out: out.to_owned(),
        group_by: None,
        reduce: reduced.clone(),
        formats: Format::ALL.into(),
        threads: 2,
        budget: SMALL,
    }
}

fn reduce_options(recipe: Recipe, keep: &str) -> ReduceOptions {
    ReduceOptions {
        recipe,
        bins: crate::reduce::PAPER_BINS,
        range: Range::Full,
        keep: keep.parse().unwrap(),
        profile_digest: "d1ge57".to_owned(),
        normalise_within: NormaliseWithin::Corpus,
        reference: None,
    }
}

/// A number from a seed, in [0, 1).
fn draw(seed: u64, k: u64) -> f64 {
    let mixed = (seed ^ k.wrapping_mul(0x9E37_79B9_7F4A_7C15)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    ((mixed ^ (mixed >> 32)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Rows of every kind: ties, missing signals, several statuses, groups and none, carried columns.
fn corpus(n: u64, seed: u64) -> Vec<MeasuredVideo> {
    (0..n)
        .map(|i| {
            let value = |k: u64| {
                let u = draw(seed, i * 16 + k);
                // A third of the values are one of four, so that scores tie.
                let v = if u < 0.33 {
                    (u * 12.0).floor()
                } else {
                    u * 8.0 - 4.0
                };
                (draw(seed, i * 16 + k + 8) > 0.1).then_some(v)
            };
            let scored = draw(seed, i * 16 + 7) > 0.15;
            let status = if scored {
                Status::Scored
            } else {
                Status::ALL[1 + (i % 6) as usize]
            };
            let mut m = Measurement::without_score(status, "why \"not\"");
            if scored {
                m.status_reason = None;
            }
            (m.reproj_px, m.aepe_worldscore_px) = (value(0), value(1));
            (m.piecewise_residual, m.appearance_ratio) = (value(2), value(3));
            (m.layer_acceleration, m.interior_shear) = (value(4), value(5));
            m.fps = Some(10.0);
            m.frames = (i % 5 > 0).then_some(3);
            (m.width, m.height) = (Some(64), Some(48));
            m.fault_frames = (i % 3 == 0).then(|| vec![3, i as u32]);
            m.fault_kinds = (i % 3 == 0).then(|| vec!["jump".to_owned(), "flicker".to_owned()]);
            let mut carried = Map::new();
            carried.insert("seed".to_owned(), json!(i));
            carried.insert(
                "prompt".to_owned(),
                json!(format!("pick\tthe \u{1F34E} {i}")),
            );
            carried.insert(
                "weight".to_owned(),
                if i % 2 == 0 {
                    json!(0.1 * i as f64)
                } else {
                    Value::Null
                },
            );
            // What trainers' lists are made of: two cameras per episode, as a CSV list has them.
            let episode = (i % 11 != 3).then(|| (i / 2).to_string());
            carried.insert("episode_index".to_owned(), json!(episode));
            carried.insert("dataset_from_index".to_owned(), json!(i / 2 * 3));
            carried.insert("length".to_owned(), json!(3.0));
            carried.insert("shard".to_owned(), json!(format!("{}.tar", i % 4)));
            carried.insert(
                "__key__".to_owned(),
                json!((i % 7 > 0).then(|| format!("k{i}"))),
            );
            MeasuredVideo {
                video: VideoId::new(format!("dir/v{:05}", i * 7919 % 10_007)).unwrap(),
                group: [Some("a"), Some("b\"quoted\""), None]
                    [(draw(seed, i * 16 + 15) * 3.0) as usize]
                    .map(str::to_owned),
                carried,
                measurement: m,
            }
        })
        .collect()
}

fn corpus_file(statistics: CorpusStatistics) -> CorpusFile {
    CorpusFile {
        plumbline_version: env!("CARGO_PKG_VERSION").to_owned(),
        source: vec!["rollouts".to_owned()],
        profile: Some(ProfileRecord {
            name: Some("standard".to_owned()),
            digest: "d1ge57".to_owned(),
            parameters: json!({"working_height_px": 256}),
        }),
        conditioning_frames: Some(1),
        fault_calibration: None,
        statistics,
    }
}

/// Scores in memory and publishes, as `plumbline score` does; locations are /data/VIDEO.
fn scored(videos: Vec<MeasuredVideo>, reduced: &ReduceOptions, out: &Path) {
    let found = reduce(videos, reduced);
    let locations: Vec<String> = found
        .rows
        .iter()
        .map(|row| format!("/data/{}", row.video))
        .collect();
    let publication = Publication {
        rows: &found.rows,
        locations: &locations,
        costs: &[],
        rewards: &found.rewards,
        report_html: None,
        corpus: &corpus_file(found.statistics),
    };
    publish(
        &OutDir::create(out).unwrap(),
        &publication,
        &BTreeSet::from(Format::ALL),
    )
    .unwrap();
}

/// The rows that `score` published, each with its path.
fn rows_with_paths(out: &Path) -> Vec<String> {
    let text = fs::read_to_string(out.join("scores.jsonl")).unwrap();
    let with_path = |line: &str| {
        let mut row: Map<String, Value> = serde_json::from_str(line).unwrap();
        let path = format!("/data/{}", row["video"].as_str().unwrap());
        row.insert("path".to_owned(), path.into());
        serde_json::to_string(&row).unwrap()
    };
    text.lines().map(with_path).collect()
}

fn write_part(path: &Path, lines: &[String]) {
    fs::write(
        path,
        lines
            .iter()
            .map(|line| format!("{line}\n"))
            .collect::<String>(),
    )
    .unwrap();
}

fn read(out: &Path, name: &str) -> String {
    String::from_utf8_lossy(&fs::read(out.join(name)).unwrap()).into_owned()
}

const MANIFESTS: [&str; 3] = [
    "manifests/keep.jsonl",
    "manifests/drop.jsonl",
    "manifests/review.jsonl",
];

/// `reduce` of what `score` published gives what `score` published, byte for byte, in every setting.
#[test]
fn files_and_memory_agree() {
    for (recipe, within, keep, range) in [
        (Recipe::Paper, NormaliseWithin::Corpus, "30%", Range::Full),
        (Recipe::Balanced, NormaliseWithin::Corpus, "5", Range::Full),
        (
            Recipe::Paper,
            NormaliseWithin::Group,
            "s<=0.25",
            Range::Winsorised,
        ),
        (
            Recipe::Balanced,
            NormaliseWithin::Group,
            "100%",
            Range::Full,
        ),
    ] {
        for n in [1, 2, 40, 150] {
            let mut o = reduce_options(recipe, keep);
            (o.normalise_within, o.range) = (within, range);
            let dir = tempfile::tempdir().unwrap();
            let (memory, files) = (dir.path().join("memory"), dir.path().join("files"));
            scored(corpus(n, n), &o, &memory);
            let part = memory.join("part.jsonl");
            let rows = rows_with_paths(&memory);
            write_part(&part, &rows);
            let found = reduce_files(&options(&[&part], &files, &o)).unwrap();
            assert_eq!(found.rows, n);
            for name in MANIFESTS
                .into_iter()
                .chain(["corpus.json", "rewards.jsonl"])
            {
                assert_eq!(
                    read(&files, name),
                    read(&memory, name),
                    "{name}, {n} rows, {o:?}"
                );
            }
            assert_eq!(
                trainer_lists(&files),
                trainer_lists(&memory),
                "{n} rows, {o:?}"
            );
            // The rows themselves: the same with their path after the group.
            let with_path: Vec<Value> = rows
                .iter()
                .map(|row| serde_json::from_str(row).unwrap())
                .collect();
            let found: Vec<Value> = read(&files, "scores.jsonl")
                .lines()
                .map(|row| serde_json::from_str(row).unwrap())
                .collect();
            assert_eq!(found, with_path);
        }
    }
}

/// The lists for trainers that there are.
fn trainer_lists(out: &Path) -> Vec<(String, Vec<u8>)> {
    let names = crate::publish::trainer_lists::names().into_iter();
    let found: Vec<_> = names
        .filter_map(|name| Some((name.clone(), fs::read(out.join(name)).ok()?)))
        .collect();
    assert!(found.len() >= 3, "every corpus has episodes");
    found
}

/// Every table of a directory, whatever format, by name.
fn tables(out: &Path) -> Vec<(String, Vec<u8>)> {
    let mut names: Vec<String> = ["scores", "rewards"].map(str::to_owned).into();
    names.extend(MANIFESTS.map(|name| name.trim_end_matches(".jsonl").to_owned()));
    let mut found = vec![(
        "corpus.json".to_owned(),
        fs::read(out.join("corpus.json")).unwrap(),
    )];
    found.extend(trainer_lists(out));
    for name in names {
        for format in Format::ALL {
            let name = format!("{name}.{}", format.extension());
            if let Ok(bytes) = fs::read(out.join(&name)) {
                found.push((name, bytes));
            }
        }
    }
    found
}

fn shuffled(mut lines: Vec<String>, seed: u64) -> Vec<String> {
    for i in (1..lines.len()).rev() {
        lines.swap(i, (draw(seed, i as u64) * (i + 1) as f64) as usize);
    }
    lines
}

/// Reduces the rows in `parts` files, shuffled by `seed`, and gives every file.
fn in_parts(
    lines: &[String],
    parts: usize,
    seed: u64,
    change: impl FnOnce(&mut ReduceFilesOptions),
) -> Vec<(String, Vec<u8>)> {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("parts");
    fs::create_dir(&source).unwrap();
    let lines = shuffled(lines.to_vec(), seed);
    for (k, lines) in lines.chunks(lines.len().div_ceil(parts)).enumerate() {
        write_part(&source.join(format!("part-{k:04}.jsonl")), lines);
    }
    let out = dir.path().join("out");
    let mut o = options(&[&source], &out, &reduce_options(Recipe::Paper, "40%"));
    change(&mut o);
    reduce_files(&o).unwrap();
    tables(&out)
}

fn lines_of(n: u64, seed: u64) -> Vec<String> {
    let dir = tempfile::tempdir().unwrap();
    scored(
        corpus(n, seed),
        &reduce_options(Recipe::Balanced, "50%"),
        dir.path(),
    );
    rows_with_paths(dir.path())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Any order, any split, one thread or two, much memory or little: the same bytes in every file.
    #[test]
    fn order_parts_and_threads_do_not_matter(
        n in 1_u64..120, seed in any::<u64>(), parts in 1_usize..40, threads in 1_usize..=2,
        balanced in any::<bool>(), grouped in any::<bool>(), large in any::<bool>(),
    ) {
        let lines = lines_of(n, seed);
        let change = |o: &mut ReduceFilesOptions| {
            o.reduce.recipe = if balanced { Recipe::Balanced } else { Recipe::Paper };
            if grouped {
                o.reduce.normalise_within = NormaliseWithin::Group;
            }
        };
        let whole = in_parts(&lines, 1, 0, change);
        let split = in_parts(&lines, parts, seed, |o| {
            change(o);
            o.threads = threads;
            if large {
                o.budget = Budget::default();
            }
        });
        prop_assert_eq!(whole.len(), split.len());
        for ((name, whole), (_, split)) in whole.iter().zip(&split) {
            prop_assert_eq!(
                String::from_utf8_lossy(whole), String::from_utf8_lossy(split), "{}", name
            );
        }
    }
}

#[test]
fn a_thousand_parts_are_one_corpus() {
    let lines = lines_of(1000, 5);
    let whole = in_parts(&lines, 1, 1, |_| {});
    assert!(in_parts(&lines, 1000, 7, |o| o.threads = 1) == whole);
}

/// Parquet in, as `score` writes it, whole or in parts: the same as JSON Lines.
#[test]
fn parquet_and_json_lines_agree() {
    let dir = tempfile::tempdir().unwrap();
    let o = reduce_options(Recipe::Paper, "40%");
    scored(corpus(60, 3), &o, &dir.path().join("memory"));
    let run = |source: &str, out: &str| {
        let out = dir.path().join(out);
        reduce_files(&options(&[&dir.path().join(source)], &out, &o)).unwrap();
        tables(&out)
    };
    // A directory names its scores.parquet.
    assert!(run("memory", "a") == run("memory/scores.jsonl", "b"));
}

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
        for name in MANIFESTS
            .into_iter()
            .chain(["corpus.json", "rewards.jsonl"])
        {
            assert_eq!(
                read(&files, name),
                read(&memory, name),
                "{name}, {recipe:?}"
            );
        }
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
