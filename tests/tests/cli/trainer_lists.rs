//! Lists for trainers, from a list of videos that names episodes and shards.

use std::fmt::Write;

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Place, Started};
use serde_json::{Value, json};

const CLIPS: u64 = 6;

const FILES: [&str; 5] = [
    "lerobot/keep_episodes.json",
    "lerobot/drop_episodes.json",
    "lerobot/review_episodes.json",
    "lerobot/rewards.parquet",
    "webdataset/keep.jsonl",
];

fn episodes(place: &Place, decision: &str) -> Vec<Value> {
    let text =
        std::fs::read_to_string(place.path(&format!("out/lerobot/{decision}_episodes.json")));
    serde_json::from_str(&text.unwrap()).unwrap()
}

#[test]
fn episodes_frames_and_shards_follow_the_decisions() {
    let place = Place::with_clips(CLIPS);
    std::fs::write(place.video("broken.mp4"), "text").unwrap();
    // Episodes run against the order of names.
    let mut list = "video,episode_index,length,shard,__key__,prompt\n".to_owned();
    for clip in 0..CLIPS {
        let episode = CLIPS - 1 - clip;
        let _ = writeln!(
            list,
            "videos/clip-{clip:02}.mp4,{episode},5,{}.tar,k{clip},p{}",
            clip / 3,
            clip % 2
        );
    }
    let _ = writeln!(list, "videos/broken.mp4,{CLIPS},5,0.tar,kb,p0");
    std::fs::write(place.path("list.csv"), list).unwrap();
    let words = [
        "list.csv",
        "--out",
        "out",
        "--profile",
        "draft",
        "--recipe",
        "paper",
        "--group-by",
        "prompt",
        "--keep",
        "2",
    ];
    Started::start(&mut place.score(&words))
        .wait()
        .expect_code(3);

    let published = place.published("out");
    let rows = published.rows();
    for decision in ["keep", "drop", "review"] {
        let of = rows.iter().filter(|row| row["decision"] == decision);
        let mut expected: Vec<u64> = of
            .map(|row| row["episode_index"].as_str().unwrap().parse().unwrap())
            .collect();
        expected.sort_unstable();
        assert_eq!(episodes(&place, decision), expected, "{decision}");
    }
    assert_eq!(
        (episodes(&place, "keep").len(), episodes(&place, "review")),
        (4, vec![json!(CLIPS)])
    );

    // Best of each prompt, and one row per frame with the soft weight of its video.
    let rewards = published.parquet("rewards.parquet");
    let best = rewards
        .iter()
        .filter(|reward| reward["best_of_group"] == true);
    assert_eq!(
        best.map(|reward| reward["group"].clone())
            .collect::<Vec<_>>()
            .len(),
        2
    );
    assert!(
        rewards
            .iter()
            .all(|r| r["best_of_group"] == (r["group_rank"] == 1))
    );
    let frames = published.parquet("lerobot/rewards.parquet");
    assert_eq!(frames.len() as u64, CLIPS * 5);
    for (index, frame) in frames.iter().enumerate() {
        let (episode, clip) = (index / 5, CLIPS as usize - 1 - index / 5);
        assert_eq!(
            (
                &frame["index"],
                &frame["episode_index"],
                &frame["frame_index"]
            ),
            (&json!(index), &json!(episode), &json!(index % 5))
        );
        let reward = rewards
            .iter()
            .find(|r| r["video"] == format!("videos/clip-{clip:02}.mp4"))
            .unwrap();
        assert_eq!(
            (&frame["reward"], &frame["weight"]),
            (&reward["raw"], &reward["soft"])
        );
    }
    let mut kept: Vec<String> = Vec::new();
    for line in published.jsonl("webdataset/keep.jsonl") {
        for key in line["keys"].as_array().unwrap() {
            kept.push(format!(
                "{}/{}",
                line["shard"].as_str().unwrap(),
                key.as_str().unwrap()
            ));
        }
    }
    let expected = published.jsonl("manifests/keep.jsonl");
    let expected: Vec<String> = expected
        .iter()
        .map(|row| {
            format!(
                "{}/{}",
                row["shard"].as_str().unwrap(),
                row["__key__"].as_str().unwrap()
            )
        })
        .collect();
    assert_eq!(kept, expected);

    // The same from the rows alone; and gone where no column says them any more.
    let mut reduce = place.command(plumbline());
    reduce.args([
        "reduce", "out", "--out", "again", "--recipe", "paper", "--keep", "2",
    ]);
    Started::start(&mut reduce).wait().expect_code(3);
    for file in FILES {
        let read = |out: &str| std::fs::read(place.path(out).join(file)).unwrap();
        assert_eq!(read("again"), read("out"), "{file}");
    }
    place.run("out", &["--recipe", "paper"]).expect_code(3);
    assert!(FILES.iter().all(|file| !published.path(file).exists()));
}
