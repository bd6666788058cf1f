//! `plumbline tradeoff`: from a handful of clips to the table, the page and the plan.

use std::path::Path;

use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::Value;

/// A name that a page, a terminal and a file system must survive.
const HOSTILE: &str = "<img src=x onerror=alert(1)>&\"'";

/// Points that take no time: coarse flow at small heights. The finest looks across frames, too, without
/// which no broken frame is seen.
fn write_points(place: &Place) {
    for (name, height, scale, spans) in [
        ("low", 32, 1, "[1]"),
        (HOSTILE, 48, 0, "[1]"),
        ("high", 64, 0, "[1, 2]"),
    ] {
        let step = height / 16;
        let text = format!(
            "rung = \"draft\"\nworking_height_px = {height}\nedge_spans = {spans}\n[flow]\nfinest_scale = {scale}\n[grid]\nstep = {step}\n"
        );
        std::fs::write(place.path(&format!("{name}.toml")), text).unwrap();
    }
}

/// The three points on the sample, `high` at the top.
fn tradeoff(place: &Place, out: &str, words: &[&str]) -> Ended {
    let hostile = format!("{HOSTILE}.toml");
    let mut command = place.command(plumbline());
    command.args([
        "tradeoff", "videos", "--out", out, "--json", "--grid", "none",
    ]);
    command.args([
        "--profile",
        "low.toml",
        "--profile",
        &hostile,
        "--top",
        "high.toml",
    ]);
    Started::start(command.args(words)).wait()
}

/// Without what differs from run to run: times, and what follows from them.
fn without_times(mut value: Value) -> Value {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(fields) => {
                fields.retain(|name, _| {
                    let timed = [
                        "cpu_s_per_video",
                        "relative_cost",
                        "stages_s",
                        "cost_model",
                        "plan",
                        "on_front",
                        "recommended",
                        "waiting",
                    ];
                    !timed.contains(&name.as_str())
                });
                fields.values_mut().for_each(strip);
            }
            Value::Array(items) => items.iter_mut().for_each(strip),
            _ => {}
        }
    }
    if let Some(points) = value["points"].as_array_mut() {
        points.sort_by_key(|point| point["name"].to_string());
    }
    strip(&mut value);
    value
}

fn point<'a>(told: &'a Value, name: &str) -> &'a Value {
    let points = told["points"].as_array().unwrap();
    points.iter().find(|point| point["name"] == name).unwrap()
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Points are told apart, the top agrees with itself, the plan is the sample's cost times the number, a
/// second run measures nothing, and other numbers of jobs give everything but times alike.
#[test]
fn the_table_the_page_and_the_plan_of_a_small_sample() {
    let place = Place::new();
    write_points(&place);
    for seed in 0..8 {
        let directory = if seed < 6 { "a" } else { "b" };
        clips::write_moving(&place.video(format!("{directory}/{seed}.mp4")), seed);
    }
    std::fs::write(
        place.path("labels.csv"),
        "video,label\na/0.mp4,0\na/1.mp4,1\na/2.mp4,0\na/3.mp4,1\nb/6.mp4,1\nb/7.mp4,0\n",
    )
    .unwrap();
    let words = [
        "--no-rendered",
        "--sample",
        "6",
        "--keep",
        "50%",
        "--labels",
        "labels.csv",
        "--videos",
        "1000",
        "--cores",
        "4",
        "--hours",
        "10",
    ];
    let ended = tradeoff(&place, "out", &words).expect_code(0);
    let told = ended.json();
    let ended = ended.expect_line(&["for 1,000 videos, 4 cores and 10 hours use"]);
    assert_eq!(
        (
            &told["corpus_videos"],
            &told["sample"].as_array().unwrap().len()
        ),
        (&8.into(), &6)
    );
    // Both directories are in the sample.
    let sampled = told["sample"].to_string();
    assert!(
        sampled.contains("\"a/") && sampled.contains("\"b/"),
        "{sampled}"
    );

    let top = point(&told, "high");
    assert_eq!(top["top"], true);
    assert_eq!(top["relative_cost"], 1.0);
    let agreement = &top["agreement"];
    assert_eq!(
        (&agreement["spearman"], &agreement["kendall"]),
        (&1.0.into(), &1.0.into())
    );
    assert_eq!(agreement["score_error_p95"], 0.0);
    for kind in ["keep_to_drop", "drop_to_keep", "review"] {
        assert_eq!(agreement["flips"][kind], 0);
    }
    let low = point(&told, "low");
    let spearman = low["agreement"]["spearman"].as_f64().unwrap();
    assert!((-1.0..1.0).contains(&spearman), "{spearman}");
    assert!(low["auroc_failure"]["area"].is_f64());
    for point in told["points"].as_array().unwrap() {
        let each_s = point["cpu_s_per_video"].as_f64().unwrap();
        let planned_s = point["plan"]["cpu_s"].as_f64().unwrap();
        // Proportional shares of 6 and 2 videos are 4.5 and 1.5, so that weights are near 1.
        assert!((planned_s / (1000.0 * each_s) - 1.0).abs() < 0.5);
        assert!(point["plan"]["wall_s"].as_f64().unwrap() > planned_s / 4.0);
        assert!(point["truth"].is_null() && point["faults"].is_null());
    }

    let out = place.path("out");
    assert_eq!(
        text(&out.join("tradeoff.json")).trim_end(),
        ended.stdout.trim_end()
    );
    let rows = place.published("out").parquet("tradeoff.parquet");
    assert_eq!(rows.len(), 3);
    assert_eq!(
        rows[0]["cpu_s_per_video"],
        told["points"][0]["cpu_s_per_video"]
    );
    assert!(rows.iter().all(|row| row["spearman_reproj_px"].is_f64()));
    let page = text(&out.join("tradeoff.html"));
    assert!(page.contains("&lt;img src=x onerror=alert(1)&gt;&amp;"));
    assert!(!page.contains("<img") && !page.contains("http://") && !page.contains("https://"));
    let picture = image::open(out.join("tradeoff.png")).unwrap();
    assert_eq!(picture.width(), 1240);
    // Points are files that the same command takes.
    let written = out.join("profiles").join(format!("{HOSTILE}.toml"));
    assert!(text(&written).contains("working_height_px = 48"));

    let again = tradeoff(&place, "out", &words).expect_code(0).json();
    assert_eq!(again, told, "a second run takes every measurement over");
    let mut alone = words.to_vec();
    alone.extend(["--jobs", "1"]);
    let other = tradeoff(&place, "other", &alone).expect_code(0).json();
    assert_eq!(without_times(other), without_times(told));
}

/// Rendered scenes at a small size: finer flow is nearer to the truth, faults are told from clean clips.
#[test]
fn rendered_scenes_are_a_yardstick_of_their_own() {
    let place = Place::with_clips(3);
    write_points(&place);
    let words = ["--rendered", "1", "--rendered-size", "80x60"];
    let told = tradeoff(&place, "out", &words).expect_code(0).json();
    let (low, high) = (point(&told, "low"), point(&told, "high"));
    let epe_px = |point: &Value| point["truth"]["flow_epe_px"].as_f64().unwrap();
    assert!(
        epe_px(high) < epe_px(low),
        "{} {}",
        epe_px(high),
        epe_px(low)
    );
    assert_eq!(high["truth"]["travelling"], 2);
    let noise = &high["faults"]["kinds"]["noise_frame"];
    assert_eq!(
        (&noise["auroc"], &noise["temporal_hit"]),
        (&1.0.into(), &1.0.into())
    );
    assert!(high["faults"]["auroc"].as_f64().unwrap() > 0.5);
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let place = Place::with_clips(3);
    write_points(&place);
    let run = |words: &[&str]| {
        let mut command = place.command(plumbline());
        Started::start(command.arg("tradeoff").args(words)).wait()
    };
    run(&[
        "videos", "--out", "out", "--grid", "none", "--top", "low.toml",
    ])
    .expect_code(2)
    .expect_line(&["one point", "--profile"]);
    std::fs::copy(place.path("low.toml"), place.path("draft.toml")).unwrap();
    run(&["videos", "--out", "out", "--profile", "draft.toml"])
        .expect_code(2)
        .expect_line(&["two points", "draft"]);
    std::fs::remove_file(place.video("clip-00.mp4")).unwrap();
    tradeoff(&place, "out", &[])
        .expect_code(2)
        .expect_line(&["2 of the videos"]);
    clips::write_moving(&place.video("clip-00.mp4"), 0);
    place.run("out", &[]).expect_code(0);
    let scores = std::fs::read(place.path("out/corpus.json")).unwrap();
    tradeoff(&place, "out", &["--no-rendered"])
        .expect_code(2)
        .expect_line(&["score run", "--out"]);
    assert_eq!(
        std::fs::read(place.path("out/corpus.json")).unwrap(),
        scores
    );
}
