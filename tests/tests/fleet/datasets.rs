//! Datasets in a bucket: their parts are read by range or interval, and give what files give.

use bytes::Bytes;
use plumbline_common::store::{ObjectKey, ObjectStore};
use plumbline_tests::clips;
use plumbline_tests::datasets::{episode, write_lerobot_v30, write_shard};
use plumbline_tests::published::Row;
use plumbline_tests::run::Started;
use serde_json::Value;

use crate::setup::Fleet;

#[tokio::test]
async fn parts_of_objects_score_as_parts_of_files_whoever_measures() {
    let fleet = Fleet::new("datasets");
    let videos = fleet.place.path("videos");
    write_lerobot_v30(&videos.join("arm"), &[episode(0), episode(1), episode(2)]);
    let clip = |seed| {
        let path = fleet.place.path(&format!("{seed}.mp4"));
        clips::write_moving(&path, seed);
        std::fs::read(path).unwrap()
    };
    // Made once: an encoder does not give the same bytes twice.
    let [third, fourth] = [clip(3), clip(4)];
    let member = |key: &'static str, clip: &Vec<u8>| [(key, clip.clone())];
    // Longer than what is read ahead while headers are looked for.
    let padding = ("0001.bin", vec![1_u8; 200_000]);
    let samples = [padding]
        .into_iter()
        .chain(member("0001.mp4", &third))
        .chain(member("0002.mp4", &fourth));
    write_shard(&videos.join("rollout-000.tar"), samples);
    fleet.upload().await;

    let score = |source: &str, out: &str, words: &[&str]| {
        let mut command = fleet.plumbline(&["score", source, "--out", out, "--profile", "draft"]);
        Started::start(command.args(words)).wait().expect_code(0)
    };
    let address = fleet.address("videos");
    score("videos", "local", &[]);
    score(&address, "embedded", &[]);
    let _first = fleet.worker("first", &[]);
    let _second = fleet.worker("second", &[]);
    score(&address, "out", &["--queue"]);
    let [local, embedded, out] = ["local", "embedded", "out"].map(|out| fleet.place.published(out));
    assert_eq!(local.rows().len(), 3 * 2 + 2);
    assert_eq!(out.rows(), local.rows());
    assert!(out.stable_files() == embedded.stable_files());
    for row in out.jsonl("costs.jsonl") {
        assert!(
            row["worker"] == "first" || row["worker"] == "second",
            "{row:?}"
        );
    }
    // Nothing has changed, so that nothing is measured.
    score(&address, "embedded", &[]).expect_line(&["0 measured now"]);

    // A shard of another version is never mixed with what was listed: its members are measured anew.
    let store = fleet.store("videos").await;
    let key = ObjectKey::new("rollout-000.tar").unwrap();
    let moved = fleet.place.path("moved.tar");
    write_shard(
        &moved,
        member("0001.mp4", &fourth)
            .into_iter()
            .chain(member("0002.mp4", &third)),
    );
    store
        .put(&key, Bytes::from(std::fs::read(moved).unwrap()))
        .await
        .unwrap();
    score(&address, "embedded", &[]).expect_line(&["2 measured now"]);
    let after = fleet.place.published("embedded");
    let digests = |rows: Vec<Row>| -> Vec<Value> {
        let members = rows.into_iter().filter(|row| !row["__key__"].is_null());
        members.map(|row| row["digest"].clone()).collect()
    };
    let mut before = digests(out.rows());
    before.reverse();
    assert_eq!(digests(after.rows()), before);
}
