//! A publication as a whole: which files there are, and what they must not contradict.

use super::*;

fn corpus() -> CorpusFile {
    let population = Population {
        too_few: true,
        n: 1,
        signals: BTreeMap::new(),
        weights: BTreeMap::from([("reproj_px".to_owned(), 0.1 + 0.2)]),
    };
    CorpusFile {
        plumbline_version: "0.1.0".to_owned(),
        source: vec!["rollouts/".to_owned()],
        profile: Some(ProfileRecord {
            name: Some("standard".to_owned()),
            digest: "d1ge57".to_owned(),
            parameters: json!({"working_height_px": 256}),
        }),
        conditioning_frames: Some(1),
        fault_calibration: None,
        cascade: None,
        statistics: CorpusStatistics {
            degenerate: false,
            uncertain_decisions: None,
            statuses: BTreeMap::from([("scored".to_owned(), 1)]),
            decisions: BTreeMap::from([("keep".to_owned(), 1)]),
            recipe: Recipe::Paper,
            bins: 30,
            range: Range::Full,
            normalised_within: crate::reduce::outcome::NormaliseWithin::Corpus,
            keep: "80%".to_owned(),
            corpus: population.clone(),
            groups: BTreeMap::from([("kitchen".to_owned(), population)]),
            sensitivity: None,
            reference: None,
            warnings: Vec::new(),
        },
    }
}

fn rewards() -> Vec<Reward> {
    vec![Reward {
        video: VideoId::new("a/1.mp4").unwrap(),
        group: Some("kitchen".to_owned()),
        raw: -0.5,
        percentile: 50.0,
        soft: 0.5,
        group_rank: 1,
        group_size: 1,
    }]
}

fn publish_into(out: &OutDir, formats: &[Format]) -> Result<Vec<String>, PublishError> {
    let rows = rows();
    let locations: Vec<_> = rows
        .iter()
        .map(|row| format!("/data/{}", row.video))
        .collect();
    let costs = [CostRow {
        video: rows[0].video.clone(),
        cost: Cost {
            total_s: 1.5,
            ..Cost::default()
        },
        attempts: 2,
        worker: "w1".to_owned(),
        rung: None,
    }];
    let run = Publication {
        rows: &rows,
        locations: &locations,
        costs: &costs,
        rewards: &rewards(),
        report_html: Some("<!doctype html>"),
        corpus: &corpus(),
    };
    publish(out, &run, &BTreeSet::from_iter(formats.iter().copied()))
}

fn files(out: &OutDir) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for folder in ["", "manifests/"] {
        for entry in fs::read_dir(out.root().join(folder)).unwrap() {
            let entry = entry.unwrap();
            if entry.file_type().unwrap().is_file() {
                let name = format!("{folder}{}", entry.file_name().to_str().unwrap());
                files.insert(name, fs::read(entry.path()).unwrap());
            }
        }
    }
    files
}

#[test]
fn two_runs_are_byte_identical_and_corpus_json_comes_last() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let one = OutDir::create(one.path()).unwrap();
    let two = OutDir::create(two.path()).unwrap();
    let written = publish_into(&one, &Format::ALL).unwrap();
    publish_into(&two, &Format::ALL).unwrap();
    assert_eq!(files(&one), files(&two));
    assert_eq!(written.last().map(String::as_str), Some("corpus.json"));
    let mut sorted = written;
    sorted.sort();
    assert_eq!(sorted, files(&one).into_keys().collect::<Vec<_>>());
    assert_eq!(sorted.len(), 3 + 2 + 6 + 2 + 1 + 1);
}

#[test]
fn manifests_split_the_rows_and_share_one_schema() {
    let root = tempfile::tempdir().unwrap();
    let out = OutDir::create(root.path()).unwrap();
    publish_into(&out, &[Format::Parquet]).unwrap();
    let files = files(&out);
    let keep = jsonl(&files["manifests/keep.jsonl"]);
    let review = jsonl(&files["manifests/review.jsonl"]);
    assert_eq!((keep.len(), review.len()), (1, 2));
    assert!(files["manifests/drop.jsonl"].is_empty());
    assert_eq!(keep[0]["path"], json!("/data/a/1.mp4"));
    assert_eq!(keep[0]["tags"], json!(["x", "y"]));
    assert_eq!(review[0]["status"], json!("failed"));
    assert_eq!(
        review[0]["status_reason"],
        json!("the child ran out of memory")
    );
    let names: Vec<_> = keep[0].keys().map(String::as_str).collect();
    assert_eq!(
        names[..9],
        [
            "video",
            "path",
            "group",
            "anomaly",
            "rank",
            "decision",
            "status",
            "status_reason",
            "prompt"
        ]
    );
    let schema = |name: &str| opened(&files[name]).schema().clone();
    assert_eq!(
        schema("manifests/keep.parquet"),
        schema("manifests/drop.parquet")
    );
    assert_eq!(
        schema("manifests/keep.parquet"),
        schema("manifests/review.parquet")
    );
}

#[test]
fn rewards_and_costs_follow_the_formats() {
    let root = tempfile::tempdir().unwrap();
    let out = OutDir::create(root.path()).unwrap();
    publish_into(&out, &[Format::Csv]).unwrap();
    let names: Vec<_> = files(&out).into_keys().collect();
    assert_eq!(
        names,
        [
            "corpus.json",
            "costs.jsonl",
            "manifests/drop.jsonl",
            "manifests/keep.jsonl",
            "manifests/review.jsonl",
            "report.html",
            "rewards.parquet",
            "scores.csv",
        ]
    );
    let rewards = parquet(&files(&out)["rewards.parquet"]);
    assert_eq!(rewards[0]["soft"], json!(0.5));
    assert_eq!(rewards[0]["group_size"], json!(1));
    let costs = jsonl(&files(&out)["costs.jsonl"]);
    assert_eq!(
        Value::Object(costs[0].clone()),
        json!({"video": "a/1.mp4", "total_s": 1.5, "cpu_s": 0.0, "fetch_s": 0.0, "decode_s": 0.0, "flow_s": 0.0,
               "signals_s": 0.0, "geometry_s": 0.0, "flow_pairs": 0,
               "flow_pairs_saved": 0, "frames_repeated": 0, "photometric_s": 0.0, "tracking_s": 0.0,
               "edge_updates": 0, "peak_memory_mib": 0, "adjustment_steps": 0, "depth_cells": 0,
               "depth_cells_saved": 0, "attempts": 2, "worker": "w1"})
    );
}

#[test]
fn tables_of_an_earlier_run_do_not_stay_to_contradict() {
    let root = tempfile::tempdir().unwrap();
    let out = OutDir::create(root.path()).unwrap();
    publish_into(&out, &Format::ALL).unwrap();
    publish_into(&out, &[Format::Jsonl]).unwrap();
    let names: Vec<_> = files(&out).into_keys().collect();
    assert!(!names.iter().any(|name| name == "scores.csv"), "{names:?}");
    assert!(!names.iter().any(|name| name == "scores.parquet"));
}

#[test]
fn a_failed_publication_is_not_marked_as_finished() {
    let root = tempfile::tempdir().unwrap();
    let out = OutDir::create(root.path()).unwrap();
    publish_into(&out, &[Format::Jsonl]).unwrap();
    fs::remove_file(root.path().join("rewards.parquet")).unwrap();
    fs::create_dir(root.path().join("rewards.parquet")).unwrap();
    let error = publish_into(&out, &[Format::Jsonl]).unwrap_err();
    assert!(error.to_string().contains("rewards.parquet"), "{error}");
    assert!(!root.path().join("corpus.json").exists());
}

#[test]
fn corpus_json_reads_back_and_refuses_what_is_not_finite() {
    let mut file = corpus();
    let bytes = corpus::corpus_json(&file).unwrap();
    let back: CorpusFile = serde_json::from_slice(&bytes).unwrap();
    assert_eq!(back, file);
    let value: Value = serde_json::from_slice(&bytes).unwrap();
    assert_eq!(value["recipe"], json!("paper"), "statistics are flattened");
    assert!(bytes.ends_with(b"}\n"));

    file.statistics.groups.values_mut().for_each(|population| {
        population
            .weights
            .insert("aepe_worldscore_px".to_owned(), f64::NAN);
    });
    let error = corpus::corpus_json(&file).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("groups.kitchen.weights.aepe_worldscore_px"),
        "{error}"
    );
}

#[test]
fn rows_without_locations_are_refused_before_anything_is_written() {
    let root = tempfile::tempdir().unwrap();
    let out = OutDir::create(root.path()).unwrap();
    let run = Publication {
        rows: &rows(),
        locations: &[],
        costs: &[],
        rewards: &[],
        report_html: None,
        corpus: &corpus(),
    };
    let error = publish(&out, &run, &BTreeSet::from([Format::Jsonl])).unwrap_err();
    assert!(matches!(error, PublishError::Locations { rows: 3, .. }));
    assert_eq!(fs::read_dir(root.path()).unwrap().count(), 0);
}
