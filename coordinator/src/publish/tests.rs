//! The published files as their readers see them.

mod whole;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type, UInt32Type, UInt64Type};
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use plumbline_common::id::VideoId;
use plumbline_common::row::{
    Cost, Decision, GeometryMethod, Measurement, Row, Scene, Series, Status,
};
use serde_json::{Map, Value, json};

use super::encode::{Format, to_bytes};
use super::scores::score_columns;
use super::*;
use crate::reduce::outcome::{CorpusStatistics, Population, Range, Recipe};

fn row(video: &str, carried: Value) -> Row {
    let Value::Object(carried) = carried else {
        panic!("carried columns are an object");
    };
    Row {
        video: VideoId::new(video).unwrap(),
        group: None,
        carried,
        measured: Measurement::without_score(Status::Failed, "the child ran out of memory"),
        z_reproj_px: None,
        z_aepe_worldscore_px: None,
        z_piecewise_residual: None,
        z_appearance_ratio: None,
        z_layer_acceleration_q25: None,
        z_interior_shear: None,
        z_detail_change_q25: None,
        anomaly: None,
        anomaly_lo: None,
        anomaly_hi: None,
        rank: None,
        percentile: None,
        decision: Decision::Review,
        reward: None,
        recipe: "paper".to_owned(),
        profile_digest: "d1ge57".to_owned(),
        rung: None,
        flip_probability: None,
    }
}

/// Every field set, with values that a careless writer breaks.
fn full_row(video: &str, carried: Value) -> Row {
    Row {
        group: Some("kitchen, \"left\"".to_owned()),
        measured: Measurement {
            status: Status::Scored,
            status_reason: None,
            digest: Some("ab".repeat(32)),
            bytes: Some(u64::MAX),
            frames: Some(u32::MAX),
            fps: Some(29.97),
            width: Some(640),
            height: Some(480),
            duration_s: Some(0.1 + 0.2),
            scene: Some(Scene::Parallax),
            motion_px: Some(f64::MIN_POSITIVE / 2.0),
            reproj_px: Some(1e300),
            reproj_method: Some(GeometryMethod::TwoViewGric),
            layer_residual_px: Some(0.25),
            aepe_px: Some(-0.0),
            aepe_worldscore_px: Some(1.0),
            reproj_droid_px: Some(0.5),
            worldscore_3d: Some(53.25),
            worldscore_photometric: None,
            models: Some("droid 0123".into()),
            occluded_fraction: Some(0.0),
            piecewise_residual: Some(0.1),
            appearance_ratio: Some(2.0),
            layer_acceleration: Some(0.11),
            layer_acceleration_q25: Some(0.07),
            interior_shear: Some(0.006),
            detail_change: Some(0.2),
            detail_change_q25: Some(0.1),
            contact: Some(0.03),
            peak_frame: Some(12),
            fault_frames: Some(vec![12, 3]),
            fault_kinds: Some(vec!["jump".to_owned(), "flicker".to_owned()]),
            mean_error: Some(3.0),
            max_jump: Some(4.0),
            paper_peak_frame: Some(17),
            peak_reliable: Some(false),
            series: Series::default(),
        },
        z_reproj_px: Some(1.5),
        z_aepe_worldscore_px: Some(-1.5),
        z_piecewise_residual: Some(0.25),
        z_appearance_ratio: Some(-0.25),
        z_layer_acceleration_q25: Some(0.125),
        z_interior_shear: Some(-3.0),
        z_detail_change_q25: Some(6.0),
        anomaly: Some(0.5),
        anomaly_lo: Some(0.25),
        anomaly_hi: Some(0.75),
        rank: Some(1),
        percentile: Some(50.0),
        decision: Decision::Keep,
        reward: Some(-0.5),
        ..row(video, carried)
    }
}

fn rows() -> Vec<Row> {
    vec![
        full_row(
            "a/1.mp4",
            json!({"prompt": "pick, \"up\"\nnow", "seed": 7, "ok": true, "tags": ["x", "y"],
                   "mixed": 1, "status": "mine", "weight": 1, "nothing": null}),
        ),
        row(
            "b/2.mp4",
            json!({"seed": -8, "weight": 0.1, "mixed": "one"}),
        ),
        row("c/<é>.mp4", json!({})),
    ]
}

fn jsonl(bytes: &[u8]) -> Vec<Map<String, Value>> {
    std::str::from_utf8(bytes)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// Parquet's reader wants a file.
fn opened(bytes: &[u8]) -> ParquetRecordBatchReaderBuilder<fs::File> {
    let mut file = tempfile::tempfile().unwrap();
    file.write_all(bytes).unwrap();
    ParquetRecordBatchReaderBuilder::try_new(file).unwrap()
}

fn parquet(bytes: &[u8]) -> Vec<Map<String, Value>> {
    let reader = opened(bytes).build().unwrap();
    let mut records = Vec::new();
    for batch in reader {
        let batch = batch.unwrap();
        for index in 0..batch.num_rows() {
            let record = batch
                .schema()
                .fields()
                .iter()
                .zip(batch.columns())
                .map(|(field, array)| (field.name().clone(), value(array, index)))
                .collect();
            records.push(record);
        }
    }
    records
}

fn value(array: &ArrayRef, index: usize) -> Value {
    if array.is_null(index) {
        return Value::Null;
    }
    match array.data_type() {
        DataType::Utf8 => array.as_string::<i32>().value(index).into(),
        DataType::UInt32 => array.as_primitive::<UInt32Type>().value(index).into(),
        DataType::UInt64 => array.as_primitive::<UInt64Type>().value(index).into(),
        DataType::Int64 => array.as_primitive::<Int64Type>().value(index).into(),
        DataType::Float64 => array.as_primitive::<Float64Type>().value(index).into(),
        DataType::Boolean => array.as_boolean().value(index).into(),
        DataType::List(_) => {
            let items = array.as_list::<i32>().value(index);
            (0..items.len()).map(|index| value(&items, index)).collect()
        }
        other => panic!("no column has the type {other}"),
    }
}

/// What Parquet says of a value that JSON Lines keeps as it came: texts, and integers among
/// floats, are the only differences.
fn as_in_parquet(column: &str, value: &Value) -> Value {
    match (column, value) {
        (_, Value::Null) => Value::Null,
        ("tags" | "mixed", Value::String(text)) => text.as_str().into(),
        ("tags" | "mixed", other) => other.to_string().into(),
        ("weight", number) => number.as_f64().into(),
        _ => value.clone(),
    }
}

#[test]
fn parquet_and_jsonl_say_the_same() {
    let rows = rows();
    let columns = score_columns(&rows);
    let from_jsonl = jsonl(&to_bytes(Format::Jsonl, &columns, &rows).unwrap());
    let from_parquet = parquet(&to_bytes(Format::Parquet, &columns, &rows).unwrap());
    assert_eq!(from_jsonl.len(), 3);
    assert_eq!(from_parquet.len(), 3);
    for (json, parquet) in from_jsonl.iter().zip(&from_parquet) {
        let names: Vec<_> = json.keys().collect();
        assert_eq!(names, parquet.keys().collect::<Vec<_>>());
        assert_eq!(names.len(), 54 + 8);
        for (column, value) in json {
            assert_eq!(as_in_parquet(column, value), parquet[column], "{column}");
        }
    }
    // Values that were set arrive, and values that were not are null.
    assert_eq!(from_parquet[0]["bytes"], json!(u64::MAX));
    assert_eq!(from_parquet[0]["reproj_px"], json!(1e300));
    assert_eq!(from_parquet[0]["duration_s"], json!(0.1 + 0.2));
    assert_eq!(from_parquet[0]["motion_px"], json!(f64::MIN_POSITIVE / 2.0));
    assert_eq!(from_parquet[0]["peak_reliable"], json!(false));
    assert_eq!(from_parquet[0]["carried_status"], json!("mine"));
    assert_eq!(from_parquet[0]["tags"], json!(r#"["x","y"]"#));
    assert_eq!(from_parquet[1]["seed"], json!(-8));
    assert_eq!(from_parquet[1]["anomaly"], Value::Null);
    assert_eq!(from_parquet[2]["seed"], Value::Null);
    assert!(from_jsonl[2].contains_key("nothing"), "nulls are written");
}

#[test]
fn carried_columns_stand_after_group_in_source_order() {
    let rows = rows();
    let names: Vec<_> = score_columns(&rows).into_iter().map(|c| c.name).collect();
    let expected = [
        "video",
        "group",
        "prompt",
        "seed",
        "ok",
        "tags",
        "mixed",
        "carried_status",
        "weight",
        "nothing",
        "status",
    ];
    assert_eq!(names[..expected.len()], expected);
}

#[test]
fn csv_quotes_by_rfc_4180() {
    let rows = rows();
    let columns = score_columns(&rows);
    let bytes = to_bytes(Format::Csv, &columns, &rows).unwrap();
    let text = std::str::from_utf8(&bytes).unwrap();
    assert!(text.starts_with("video,group,prompt,"));
    let line = "\r\na/1.mp4,\"kitchen, \"\"left\"\"\",\"pick, \"\"up\"\"\nnow\",7,true,\
                \"[\"\"x\"\",\"\"y\"\"]\",1,mine,1,,scored,,";
    assert!(text.contains(line), "{text}");

    let mut reader = ::csv::Reader::from_reader(bytes.as_slice());
    let header: Vec<_> = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_owned)
        .collect();
    let json = jsonl(&to_bytes(Format::Jsonl, &columns, &rows).unwrap());
    for (record, json) in reader.records().map(Result::unwrap).zip(&json) {
        for (name, field) in header.iter().zip(record.iter()) {
            let expected = match &json[name] {
                Value::Null => String::new(),
                Value::String(text) => text.clone(),
                other => other.to_string(),
            };
            assert_eq!(field, expected, "{name}");
        }
    }
}

#[test]
fn many_rows_make_bounded_row_groups() {
    let rows: Vec<_> = (0..70_000)
        .map(|index| row(&format!("v{index:05}"), json!({"seed": index})))
        .collect();
    let columns = score_columns(&rows);
    let bytes = to_bytes(Format::Parquet, &columns, &rows).unwrap();
    let groups: Vec<_> = opened(&bytes)
        .metadata()
        .row_groups()
        .iter()
        .map(|group| group.num_rows())
        .collect();
    assert_eq!(groups, [65_536, 70_000 - 65_536]);
    let back = parquet(&bytes);
    assert_eq!(back[69_999]["video"], json!("v69999"));
    assert_eq!(back[69_999]["seed"], json!(69_999));
}
