//! Rows in files against rows in memory, and against themselves in any order and any parts.

mod sources;

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
        cascade: None,
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

/// Whether both places hold the same manifests, statistics and rewards.
#[track_caller]
fn assert_same_files(files: &Path, memory: &Path, of: &str) {
    for name in MANIFESTS
        .into_iter()
        .chain(["corpus.json", "rewards.jsonl"])
    {
        assert_eq!(read(files, name), read(memory, name), "{name}, {of}");
    }
}

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
            assert_same_files(&files, &memory, &format!("{n} rows, {o:?}"));
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
