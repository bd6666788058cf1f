//! Datasets as sources, and lists for their trainers.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;

use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::datasets::{
    CAMERAS, Episode, episode, write_lerobot_v21, write_lerobot_v30, write_shard,
};
use plumbline_tests::published::Row;
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_vision::image::Rgb8;
use plumbline_worker::decode::{DecodeLimits, decode_video};
use serde_json::{Value, json};

const EPISODES: u64 = 4;

fn score(place: &Place, words: &[&str]) -> Ended {
    let mut command = place.score(words);
    Started::start(command.args(["--profile", "draft"])).wait()
}

fn episodes() -> Vec<Episode> {
    (0..EPISODES).map(episode).collect()
}

/// What is measured of a row's pictures: everything that is not about the file that they were in, or about
/// other rows.
fn measured(row: &Row) -> Row {
    const OF_PICTURES: [&str; 16] = [
        "status",
        "frames",
        "fps",
        "width",
        "height",
        "scene",
        "motion_px",
        "reproj_px",
        "aepe_px",
        "aepe_worldscore_px",
        "piecewise_residual",
        "appearance_ratio",
        "peak_frame",
        "mean_error",
        "max_jump",
        "fault_frames",
    ];
    let of_pictures = OF_PICTURES.map(|column| (column.to_owned(), row[column].clone()));
    of_pictures.into_iter().collect()
}

fn decoded(path: &Path) -> Vec<Rgb8> {
    let bytes = std::fs::read(path).unwrap();
    let mut frames = Vec::new();
    let mut keep = |frame: plumbline_worker::decode::DecodedFrame| {
        frames.push(frame.rgb);
        ControlFlow::Continue(())
    };
    decode_video(bytes.into(), &DecodeLimits::default(), &mut keep).unwrap();
    frames
}

/// The slow twin: the files decoded whole, cut into episodes, and each scored from pictures of its own.
#[test]
fn episodes_of_a_long_file_score_as_the_same_pictures_by_themselves() {
    let place = Place::new();
    let (set, episodes) = (place.path("set"), episodes());
    write_lerobot_v30(&set, &episodes);
    for (number, camera) in CAMERAS.iter().enumerate() {
        let mut all = Vec::new();
        for file in 0..2 {
            all.extend(decoded(
                &set.join(format!("videos/{camera}/chunk-000/file-{file:03}.mp4")),
            ));
        }
        for (index, episode) in episodes.iter().enumerate() {
            let rest = all.split_off(episode[number].len());
            let pictures = place.video(format!("episode_{index:06}/{camera}"));
            clips::write_images(&pictures, &all);
            all = rest;
        }
        assert!(all.is_empty());
    }
    score(&place, &["videos", "--out", "twin", "--sequence-fps", "10"]).expect_code(0);
    score(&place, &["set", "--out", "out", "--group-by", "task"]).expect_code(0);
    let (out, twin) = (place.published("out"), place.published("twin"));
    assert_eq!(out.rows().len(), 2 * EPISODES as usize);
    for row in out.rows() {
        let video = row["video"].as_str().unwrap();
        assert_eq!(measured(&row), measured(&twin.row(video)), "{video}");
        assert_eq!(row["frames"], row["length"]);
        assert_eq!(row["group"], row["task"]);
        assert!(row["reproj_px"].is_f64(), "{row:?}");
    }
    // Two episodes of one file are two inputs.
    let mut digests: Vec<Value> = out.rows().iter().map(|row| row["digest"].clone()).collect();
    digests.dedup();
    assert_eq!(digests.len(), 2 * EPISODES as usize);

    // Resumed, in the same bytes; one camera alone; and explained by name.
    let before = out.stable_files();
    score(&place, &["set", "--out", "out", "--group-by", "task"])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    assert!(out.stable_files() == before);
    score(&place, &["set", "--out", "out", "--camera", CAMERAS[1]])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    assert_eq!(out.rows().len(), EPISODES as usize);
    let video = format!("episode_000001/{}", CAMERAS[1]);
    let mut explain = place.command(plumbline());
    explain.args([
        "explain",
        "set",
        "--video",
        &video,
        "--out",
        "why",
        "--profile",
        "draft",
        "--json",
    ]);
    let told = Started::start(&mut explain).wait().expect_code(0).json();
    assert_eq!(
        told["measured"]["reproj_px"]
            .as_f64()
            .or(told["reproj_px"].as_f64()),
        out.row(&video)["reproj_px"].as_f64(),
        "{told}"
    );
    let mut unnamed = place.command(plumbline());
    unnamed.args(["explain", "set", "--out", "why2"]);
    Started::start(&mut unnamed)
        .wait()
        .expect_code(2)
        .expect_line(&["8 videos", "--video"]);
}

#[test]
fn both_layouts_give_the_same_episodes_and_lists_that_load() {
    let place = Place::new();
    let episodes = episodes();
    write_lerobot_v21(&place.path("v21"), &episodes);
    write_lerobot_v30(&place.path("v30"), &episodes);
    // An episode whose video is gone is a row, and an episode to look at.
    let gone = format!("videos/chunk-000/{}/episode_000002.mp4", CAMERAS[0]);
    std::fs::remove_file(place.path("v21").join(gone)).unwrap();
    // So is one that the file is too short for.
    let cut = place.path(&format!("v30/videos/{}/chunk-000/file-001.mp4", CAMERAS[0]));
    clips::write(&cut, &episodes[3][0][..6]);
    for set in ["v21", "v30"] {
        score(
            &place,
            &[set, "--out", &format!("out-{set}"), "--keep", "2"],
        )
        .expect_code(3);
    }
    let (v21, v30) = (place.published("out-v21"), place.published("out-v30"));
    let columns = |row: &Row| {
        [
            "video",
            "episode_index",
            "dataset_from_index",
            "length",
            "task",
            "camera",
        ]
        .map(|column| row[column].clone())
    };
    let told = |rows: Vec<Row>| rows.iter().map(columns).collect::<Vec<_>>();
    assert_eq!(told(v21.rows()), told(v30.rows()));
    assert_eq!(
        v21.row(&format!("episode_000002/{}", CAMERAS[0]))["status"],
        "failed"
    );
    let short = v30.row(&format!("episode_000003/{}", CAMERAS[0]));
    assert_eq!(short["status"], "undecodable");
    assert!(
        short["status_reason"]
            .as_str()
            .unwrap()
            .contains("ends after 6 frames"),
        "{short:?}"
    );

    for (published, looked_at) in [(&v21, 2), (&v30, 3)] {
        let mut listed = Vec::new();
        for decision in ["keep", "drop", "review"] {
            let text = std::fs::read(published.path(&format!("lerobot/{decision}_episodes.json")));
            let list: Vec<u64> = serde_json::from_slice(&text.unwrap()).unwrap();
            assert!(decision != "review" || list == [looked_at] || !list.contains(&looked_at));
            listed.extend(list);
        }
        listed.sort_unstable();
        assert_eq!(listed, (0..EPISODES).collect::<Vec<_>>());
        // The side-car has a row for each frame of the dataset, at its place.
        let frames = published.parquet("lerobot/rewards.parquet");
        let lengths: Vec<usize> = episodes.iter().map(|episode| episode[0].len()).collect();
        assert_eq!(frames.len(), lengths.iter().sum::<usize>());
        for (index, frame) in frames.iter().enumerate() {
            assert_eq!(frame["index"], json!(index));
            let before: usize = lengths[..frame["episode_index"].as_u64().unwrap() as usize]
                .iter()
                .sum();
            assert_eq!(frame["frame_index"], json!(index - before));
        }
    }
}

/// Two shards of three samples each, with the same clips in `videos`.
fn shards(place: &Place) {
    for shard in 0..2_u64 {
        let mut files = Vec::new();
        for sample in 0..3 {
            let (key, seed) = (format!("{sample:04}"), 3 * shard + sample);
            let clip = place.video(format!("{shard}/{key}.mp4"));
            clips::write_moving(&clip, seed);
            let fields = json!({"prompt": format!("p{}", seed % 2), "seed": seed});
            files.push((format!("{key}.json"), fields.to_string().into_bytes()));
            files.push((format!("{key}.mp4"), std::fs::read(clip).unwrap()));
        }
        let files = files
            .iter()
            .map(|(name, content)| (name.as_str(), content.clone()));
        write_shard(
            &place.path(&format!("shards/rollout-{shard:06}.tar")),
            files,
        );
    }
}

#[test]
fn members_of_shards_score_as_files_and_the_kept_load_again() {
    let place = Place::new();
    shards(&place);
    score(&place, &["videos", "--out", "files"]).expect_code(0);
    let words = [
        "shards/rollout-{000000..000001}.tar",
        "--out",
        "out",
        "--keep",
        "50%",
    ];
    score(&place, &words).expect_code(0);
    let (out, files) = (place.published("out"), place.published("files"));
    let mut named = Vec::new();
    for row in out.rows() {
        let shard: u64 = row["__shard__"].as_str().unwrap()[8..14].parse().unwrap();
        let key = row["__key__"].as_str().unwrap();
        named.push(format!("rollout-{shard:06}.tar/{key}.mp4"));
        let of_file = files.row(&format!("{shard}/{key}.mp4"));
        assert_eq!(measured(&row), measured(&of_file));
        // A member is its bytes.
        for column in ["digest", "bytes"] {
            assert_eq!(row[column], of_file[column]);
        }
        assert_eq!(
            row["prompt"],
            format!("p{}", row["seed"].as_u64().unwrap() % 2)
        );
    }
    out.expect_whole(&named.iter().map(String::as_str).collect::<Vec<_>>());
    let kept: Vec<String> = out
        .jsonl("webdataset/keep.jsonl")
        .iter()
        .flat_map(|line| {
            let keys = line["keys"].as_array().unwrap();
            keys.iter()
                .map(|key| {
                    format!(
                        "{}/{}.mp4",
                        line["shard"].as_str().unwrap(),
                        key.as_str().unwrap()
                    )
                })
                .collect::<Vec<_>>()
        })
        .collect();
    let expected = out.jsonl("manifests/keep.jsonl");
    assert_eq!(
        kept,
        expected
            .iter()
            .map(|row| row["video"].as_str().unwrap())
            .collect::<Vec<_>>()
    );

    read_back_with_webdataset(&place, &kept);

    // A shard that changed is measured anew, the other is not; a file cut short loses what is behind the cut.
    let first = place.path("shards/rollout-000000.tar");
    let bytes = std::fs::read(&first).unwrap();
    std::fs::write(&first, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let cut = score(&place, &["shards", "--out", "out"]);
    cut.expect_code(3).expect_line(&["failed", "truncated"]);
    let rows = place.published("out").rows();
    assert!(rows.iter().filter(|row| row["status"] == "failed").count() >= 1);
    assert!(rows.iter().filter(|row| row["status"] == "scored").count() >= 4);
}

/// What the library `webdataset` gives of the kept keys, as the README says; where the tests' set-up has
/// installed it.
fn read_back_with_webdataset(place: &Place, kept: &[String]) {
    const READ: &str = r#"
import glob, json, os, sys
import webdataset as wds
kept = {(line["shard"], key) for line in map(json.loads, open("out/webdataset/keep.jsonl")) for key in line["keys"]}
shards = sorted(glob.glob("shards/*.tar"))
samples = wds.WebDataset(shards, shardshuffle=False).select(
    lambda s: (os.path.basename(s["__url__"]), s["__key__"]) in kept)
for s in samples:
    print(json.dumps([os.path.basename(s["__url__"]) + "/" + s["__key__"] + ".mp4", len(s["mp4"]), json.loads(s["json"])["seed"]]))
"#;
    let Some(python) = python() else {
        eprintln!("skipped: no webdataset");
        return;
    };
    let mut command = place.command(python);
    let read = Started::start(command.args(["-c", READ])).wait();
    let samples: Vec<(String, u64, u64)> = read
        .expect_code(0)
        .stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(
        samples.iter().map(|(name, ..)| name).collect::<Vec<_>>(),
        kept.iter().collect::<Vec<_>>()
    );
    let published = place.published("out");
    for (name, bytes, seed) in samples {
        let row = published.row(&name);
        assert_eq!((&row["bytes"], &row["seed"]), (&json!(bytes), &json!(seed)));
    }
}

/// A Python that has the library.
fn python() -> Option<PathBuf> {
    let target = plumbline().parent()?.parent()?;
    let of_setup = target.join("tmp/trainers-venv/bin/python");
    let has_it = |python: &PathBuf| {
        let asked = Command::new(python)
            .args(["-c", "import webdataset"])
            .output();
        asked.is_ok_and(|asked| asked.status.success())
    };
    Some(of_setup).filter(has_it)
}

#[test]
fn a_video_folder_carries_its_metadata() {
    let place = Place::new();
    for seed in 0..4 {
        let split = ["train", "test"][seed as usize / 2];
        clips::write_moving(&place.video(format!("{split}/{seed}.mp4")), seed);
    }
    let csv = "file_name,prompt,seed\n0.mp4,pick,0\n1.mp4,push,1\ngone.mp4,push,2\n";
    std::fs::write(place.video("train/metadata.csv"), csv).unwrap();
    let rows = [json!({"file_name": "2.mp4", "prompt": "pick", "seed": "2"})];
    plumbline_tests::datasets::write_parquet(&place.video("test/metadata.parquet"), &rows);
    score(&place, &["videos", "--out", "out", "--group-by", "prompt"])
        .expect_code(3)
        .expect_line(&["failed: train/gone.mp4"]);
    let published = place.published("out");
    published.expect_whole(&[
        "test/2.mp4",
        "test/3.mp4",
        "train/0.mp4",
        "train/1.mp4",
        "train/gone.mp4",
    ]);
    assert_eq!(published.row("test/2.mp4")["group"], "pick");
    assert_eq!(published.row("train/1.mp4")["prompt"], "push");
    assert_eq!(published.row("test/3.mp4")["group"], Value::Null);
}

#[test]
fn what_cannot_be_read_so_is_refused_with_the_remedy() {
    let place = Place::new();
    std::fs::write(place.path("a.tar.gz"), b"\x1f\x8b").unwrap();
    score(&place, &["a.tar.gz", "--out", "out"])
        .expect_code(2)
        .expect_line(&["a.tar.gz", "unpack it"]);
    score(&place, &["x-{00..01}.tar", "--out", "out"])
        .expect_code(2)
        .expect_line(&["x-00.tar"]);
    write_lerobot_v30(&place.path("set"), &[episode(0), episode(1)]);
    score(&place, &["set", "--out", "out", "--camera", "top"])
        .expect_code(2)
        .expect_line(&["no such camera", CAMERAS[0]]);
    std::fs::remove_dir_all(place.path("set/meta/episodes")).unwrap();
    score(&place, &["set", "--out", "out"])
        .expect_code(2)
        .expect_line(&["meta/episodes", "is missing"]);
    assert!(!place.path("out").exists());
}
