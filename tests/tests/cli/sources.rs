//! Sources and groups: directories, several of them, globs, lists with columns of their own.

use std::collections::BTreeSet;

use plumbline_tests::clips;
use plumbline_tests::published::{MANIFESTS, names, values};
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::Value;

fn tasks() -> Place {
    let place = Place::new();
    let names = [
        "pick/a__0.mp4",
        "pick/a__1.mp4",
        "pick/b__0.mp4",
        "push/a__2.mp4",
        "push/c.mp4",
    ];
    for (seed, name) in names.iter().enumerate() {
        clips::write_moving(&place.video(name), seed as u64);
    }
    place
}

fn score(place: &Place, words: &[&str]) -> Ended {
    Started::start(
        place
            .score(words)
            .args(["--profile", "draft", "--out", "out"]),
    )
    .wait()
}

fn set(values: &[&str]) -> BTreeSet<String> {
    values.iter().map(|value| (*value).to_owned()).collect()
}

#[test]
fn groups_by_directory_and_by_prefix_choose_within_themselves() {
    let place = tasks();
    place
        .run("out", &["--group-by", "path:1", "--keep", "1"])
        .expect_code(0)
        .expect_line(&["pick", "3"]);
    let published = place.published("out");
    assert_eq!(values(&published.rows(), "group"), set(&["pick", "push"]));
    let kept = published.jsonl("manifests/keep.jsonl");
    assert_eq!(values(&kept, "group"), set(&["pick", "push"]));
    assert_eq!(kept.len(), 2, "one of each");
    assert_eq!(published.corpus()["groups"]["pick"]["n"], 3);

    place
        .run("out", &["--group-by", "prefix:__"])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    let rows = place.published("out").rows();
    assert_eq!(values(&rows, "group"), set(&["", "a", "b"]));
}

#[test]
fn several_sources_are_named_below_their_common_parent() {
    let place = tasks();
    score(
        &place,
        &["videos/push", "videos/pick", "videos/pick/b__0.mp4"],
    )
    .expect_code(0);
    place.published("out").expect_whole(&[
        "pick/a__0.mp4",
        "pick/a__1.mp4",
        "pick/b__0.mp4",
        "push/a__2.mp4",
        "push/c.mp4",
    ]);
}

#[test]
fn a_glob_and_a_single_video() {
    let place = tasks();
    score(&place, &["videos/*/a__*.mp4"]).expect_code(0);
    place
        .published("out")
        .expect_whole(&["pick/a__0.mp4", "pick/a__1.mp4", "push/a__2.mp4"]);
    // Another corpus into the same OUT: what both have is not measured again.
    score(&place, &["videos/push/c.mp4"])
        .expect_code(0)
        .expect_line(&["1 measured now"]);
    place.published("out").expect_whole(&["c.mp4"]);
}

#[test]
fn a_directory_of_numbered_images_is_a_video() {
    let place = Place::with_clips(1);
    clips::write_images(&place.video("images/walk"), &clips::frames(&clips::spec(1)));
    std::fs::write(place.video("images/one.png"), "a lone picture is no video").unwrap();
    score(&place, &["videos", "--sequence-fps", "5"])
        .expect_code(0)
        .expect_line(&["passed over", "1 .png"]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "images/walk"]);
    let row = published.row("images/walk");
    assert_eq!((&row["fps"], &row["frames"]), (&5.0.into(), &10.into()));

    // Adding a frame changes the video.
    let picture = place.video("images/walk/frame_0000.png");
    std::fs::copy(picture, place.video("images/walk/frame_0010.png")).unwrap();
    score(&place, &["videos/images/walk", "--sequence-fps", "5"])
        .expect_code(0)
        .expect_line(&["1 measured now"]);
    assert_eq!(place.published("out").row("walk")["frames"], 11);
}

#[test]
fn an_out_inside_the_source_is_not_scored() {
    let place = Place::with_clips(2);
    score(&place, &["."]).expect_code(0);
    std::fs::copy(
        place.video("clip-00.mp4"),
        place.path("out/manifests/left-here.mp4"),
    )
    .unwrap();
    score(&place, &["."])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    std::fs::remove_file(place.path("out/manifests/left-here.mp4")).unwrap();
    place
        .published("out")
        .expect_whole(&["videos/clip-00.mp4", "videos/clip-01.mp4"]);
}

#[test]
fn a_csv_list_carries_its_columns_everywhere() {
    let place = tasks();
    std::fs::write(
        place.path("list.csv"),
        "seed,video,task,status\n7,videos/pick/a__0.mp4,\"pick, red\",ok\n8,videos/push/c.mp4,push,\n,videos/gone.mp4,push,ok\n",
    )
    .unwrap();
    score(&place, &["list.csv", "--group-by", "task"])
        .expect_code(3)
        .expect_line(&["failed: videos/gone.mp4", "No such file", "run again"]);
    let published = place.published("out");
    published.expect_whole(&[
        "videos/gone.mp4",
        "videos/pick/a__0.mp4",
        "videos/push/c.mp4",
    ]);
    let row = published.row("videos/pick/a__0.mp4");
    assert_eq!(
        (&row["seed"], &row["task"], &row["group"]),
        (&"7".into(), &"pick, red".into(), &"pick, red".into())
    );
    assert_eq!(
        (&row["status"], &row["carried_status"]),
        (&"scored".into(), &"ok".into())
    );
    assert_eq!(published.row("videos/gone.mp4")["seed"], Value::Null);
    let manifests = MANIFESTS.map(|name| published.jsonl(&format!("manifests/{name}.jsonl")));
    assert_eq!(values(&manifests.concat(), "seed"), set(&["", "7", "8"]));
}

#[test]
fn a_jsonl_list_keeps_the_types_of_its_columns() {
    let place = tasks();
    let lines = [
        r#"{"video":"videos/pick/a__0.mp4","seed":7,"real":false,"tags":["x"]}"#,
        r#"{"video":"videos/push/c.mp4","seed":-8,"real":true,"tags":null}"#,
    ];
    std::fs::write(place.path("list.jsonl"), lines.join("\n")).unwrap();
    score(&place, &["list.jsonl", "--group-by", "real"]).expect_code(0);
    let published = place.published("out");
    let row = published.row("videos/push/c.mp4");
    assert_eq!(
        (&row["seed"], &row["real"], &row["group"]),
        (&(-8).into(), &true.into(), &"true".into())
    );
    let parquet = published.parquet("scores.parquet");
    assert_eq!(
        (&parquet[1]["seed"], &parquet[1]["real"]),
        (&(-8).into(), &true.into())
    );
    assert_eq!(
        names(&parquet),
        ["videos/pick/a__0.mp4", "videos/push/c.mp4"]
    );
}

#[test]
fn a_list_gives_each_video_its_camera() {
    let place = tasks();
    let list = |focal: &str| {
        let text = format!(
            "video,fx,fy,cx,cy\nvideos/push/c.mp4,{focal},{focal},64,48\nvideos/pick/a__0.mp4,,,,\n"
        );
        std::fs::write(place.path("list.csv"), text).unwrap();
        score(&place, &["list.csv"]).expect_code(0)
    };
    list("90").expect_line(&["2 measured now"]);
    let row = place.published("out").row("videos/push/c.mp4");
    assert_eq!((&row["fx"], &row["cy"]), (&"90".into(), &"48".into()));
    list("90").expect_line(&["0 measured now"]);
    // Another camera is another measurement, of this video alone.
    list("120").expect_line(&["1 measured now"]);
}

#[test]
fn a_wrong_list_is_told_by_line_and_remedy() {
    let place = tasks();
    for (name, content, words) in [
        (
            "a.csv",
            "path,x\nvideos/push/c.mp4,1\n",
            ["a.csv", "name the column of paths so (found path, x)"],
        ),
        (
            "b.jsonl",
            "{\"video\":\"a.mp4\"}\n{oops\n",
            ["b.jsonl", "line 2"],
        ),
        (
            "c.txt",
            "videos/push/c.mp4\nvideos/push/c.mp4\n",
            ["c.txt", "name each video once"],
        ),
        ("d.csv", "video,task\nvideos/push/c.mp4\n", ["d.csv", "2"]),
        (
            "g.csv",
            "video,fx,fy,cx,cy\nvideos/push/c.mp4,585,wide,320,240\n",
            ["g.csv", "videos/push/c.mp4: the columns fx, fy, cx and cy"],
        ),
        ("e.parquet", "no parquet", ["e.parquet", "arquet"]),
        ("f.txt", "\n\n", ["f.txt", "no video found"]),
    ] {
        std::fs::write(place.path(name), content).unwrap();
        score(&place, &[name]).expect_code(2).expect_line(&words);
        assert!(!place.path("out").exists(), "{name}");
    }
    score(&place, &["videos", "--group-by", "tsak"])
        .expect_code(2)
        .expect_line(&["tsak", "path:N"]);
}
