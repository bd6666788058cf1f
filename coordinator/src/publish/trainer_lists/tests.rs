//! Lists for trainers, read back.

use super::*;

fn out() -> (tempfile::TempDir, OutDir) {
    let dir = tempfile::tempdir().unwrap();
    let out = OutDir::create(dir.path()).unwrap();
    (dir, out)
}

fn read(out: &OutDir, name: &str) -> Option<String> {
    std::fs::read_to_string(out.root().join(name)).ok()
}

fn episode(index: u64, from: Option<u64>, frames: u32, raw: f64) -> ListedRow<'static> {
    ListedRow {
        episode_index: Some(index),
        dataset_from_index: from,
        frames: Some(frames),
        reward: Some((raw, raw / 10.0)),
        ..ListedRow::default()
    }
}

#[test]
fn the_worst_camera_of_an_episode_decides() {
    use Decision::{Drop, Keep, Review};
    let (_dir, out) = out();
    let mut lists = TrainerLists::default();
    let mut note = |decision, row: &ListedRow<'_>| lists.note(&out, decision, row).unwrap();
    // Videos sort by name, not by number.
    note(Keep, &episode(10, None, 4, 5.0));
    note(Keep, &episode(2, None, 4, 3.0));
    note(Drop, &episode(2, None, 4, 1.0));
    note(Keep, &episode(3, None, 4, 3.0));
    note(
        Review,
        &ListedRow {
            reward: None,
            ..episode(3, None, 4, 0.0)
        },
    );
    note(Keep, &ListedRow::default());
    let written = lists.publish(&out).unwrap();
    let list = |decision: &str| read(&out, &format!("lerobot/{decision}_episodes.json"));
    assert_eq!(list("keep").as_deref(), Some("[10]\n"));
    assert_eq!(list("drop").as_deref(), Some("[2]\n"));
    assert_eq!(list("review").as_deref(), Some("[3]\n"));
    // Episodes 0 and 1 are not here: nobody knows where the others start.
    assert_eq!(written.len(), 3);
    TrainerLists::default().publish(&out).unwrap();
    assert!(names().iter().all(|name| !out.root().join(name).exists()));
}

#[test]
fn frames_are_placed_by_column_or_by_counting() {
    use arrow_array::cast::AsArray;
    use arrow_array::types::{Float64Type, UInt64Type};
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    let frames = |rows: &[ListedRow<'_>]| -> Vec<(u64, u64, u64, f64)> {
        let (_dir, out) = out();
        let mut lists = TrainerLists::default();
        for row in rows {
            lists.note(&out, Decision::Keep, row).unwrap();
        }
        lists.publish(&out).unwrap();
        let Ok(file) = File::open(out.root().join(EPISODE_REWARDS)) else {
            return Vec::new();
        };
        let mut reader = ParquetRecordBatchReaderBuilder::try_new(file)
            .unwrap()
            .build()
            .unwrap();
        let batch = reader.next().unwrap().unwrap();
        let whole = |k: usize| batch.column(k).as_primitive::<UInt64Type>().clone();
        let weight = batch.column(4).as_primitive::<Float64Type>();
        (0..batch.num_rows())
            .map(|i| {
                (
                    whole(0).value(i),
                    whole(1).value(i),
                    whole(2).value(i),
                    weight.value(i),
                )
            })
            .collect()
    };
    let counted = [
        episode(0, None, 2, 5.0),
        ListedRow {
            reward: None,
            ..episode(1, None, 3, 0.0)
        },
        ListedRow {
            length: Some(1),
            ..episode(2, None, 9, 3.0)
        },
    ];
    // Episode 1 has no reward, but its frames count.
    let expected = [(0, 0, 0, 0.5), (1, 0, 1, 0.5), (5, 2, 0, 0.3)];
    assert_eq!(frames(&counted), expected);
    assert_eq!(frames(&[episode(7, Some(100), 1, 2.0)]), [(100, 7, 0, 0.2)]);
    assert!(frames(&[episode(7, None, 1, 2.0)]).is_empty());
}

#[test]
fn keys_come_by_shard() {
    let (_dir, out) = out();
    let mut lists = TrainerLists::default();
    let rows = [
        ("a.tar", "1", Decision::Keep),
        ("a.tar", "2", Decision::Drop),
        ("a.tar", "3\"", Decision::Keep),
        ("b.tar", "1", Decision::Review),
        ("c.tar", "9", Decision::Keep),
    ];
    for (shard, key, decision) in rows {
        let row = ListedRow {
            shard: Some(shard),
            key: Some(key),
            ..ListedRow::default()
        };
        lists.note(&out, decision, &row).unwrap();
    }
    assert_eq!(lists.publish(&out).unwrap(), [SHARD_KEYS]);
    let expected = "{\"shard\":\"a.tar\",\"keys\":[\"1\",\"3\\\"\"]}\n{\"shard\":\"c.tar\",\"keys\":[\"9\"]}\n";
    assert_eq!(read(&out, SHARD_KEYS).as_deref(), Some(expected));
}

#[test]
fn whole_numbers_in_every_dress() {
    assert_eq!(whole_number("12"), Some(12));
    assert_eq!(whole_number(" 12.0"), Some(12));
    for text in ["", "-1", "1.5", "x", "NaN", "1e300"] {
        assert_eq!(whole_number(text), None, "{text}");
    }
}
