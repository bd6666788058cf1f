//! `plumbline evaluate`: the paper's tables through the command, from scores and labels written here.

use std::fmt::Write;

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Ended, Place, Started};
use serde_json::{Value, json};

fn evaluate(place: &Place, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    Started::start(command.arg("evaluate").args(words)).wait()
}

fn write(place: &Place, name: &str, text: &str) {
    std::fs::write(place.path(name), text).unwrap();
}

fn text(place: &Place, name: &str) -> String {
    std::fs::read_to_string(place.path(name)).unwrap()
}

/// Scores 0, 1, 2… of `tasks` × `per_task` videos; the video of task t at place i is `t/i`.
fn ranked(tasks: usize, per_task: usize) -> String {
    let mut scores = String::new();
    for task in 0..tasks {
        for i in 0..per_task {
            let row = json!({
                "video": format!("{task}/{i:04}"), "group": format!("task {task}"), "status": "scored", "anomaly": i,
            });
            let _ = writeln!(scores, "{row}");
        }
    }
    scores
}

fn of_set<'a>(found: &'a Value, set: &str) -> &'a Value {
    let sets = found["success"]["sets"].as_array().unwrap();
    sets.iter().find(|rate| rate["set"] == set).unwrap()
}

#[track_caller]
fn rounds_to(value: &Value, decimals: i32, expected: f64) {
    let scale = 10_f64.powi(decimals);
    let found = value.as_f64().unwrap();
    assert_eq!((found * scale).round() / scale, expected, "{found}");
}

/// Five tasks, ten videos of each per set. Low: 38 whole and 3 half successes among 50: 39.5/50 = 79%;
/// Σ(x − μ)² = 38 + 3/4 − 39.5²/50 = 7.545, √(7.545/49/50) = 5.5%. High: 32 and 2: 33/50 = 66%;
/// 32 + 2/4 − 33²/50 = 10.72, √(10.72/49/50) = 6.6%. Half a success is judged 0.5, or once each way.
#[test]
fn table_1_of_the_paper() {
    let place = Place::new();
    write(&place, "scores.jsonl", &ranked(5, 30));
    let mut labels = "video,label,judge\n".to_owned();
    for task in 0..5 {
        for i in 0..30 {
            // The k-th video of its set, over all tasks.
            let k = task * 10 + i % 10;
            let (whole, half) = match i / 10 {
                0 => (38, 3),
                1 => (35, 0),
                _ => (32, 2),
            };
            let video = format!("{task}/{i:04}");
            let judged: &[&str] = match k {
                k if k < whole => &["1"],
                k if k == whole && half > 0 => &["1", "0"],
                k if k < whole + half => &["0.5"],
                _ => &["0"],
            };
            for (judge, label) in judged.iter().enumerate() {
                let _ = writeln!(labels, "{video},{label},{judge}");
            }
        }
    }
    write(&place, "labels.csv", &labels);
    let words = [
        "scores.jsonl",
        "--labels",
        "labels.csv",
        "--out",
        "out",
        "--json",
    ];
    let found = evaluate(&place, &words)
        .expect_code(0)
        .expect_line(&["low: 79.0 ± 5.5% of 50 videos"])
        .json();
    rounds_to(&of_set(&found, "low")["percent"], 1, 79.0);
    rounds_to(&of_set(&found, "low")["standard_error"], 1, 5.5);
    rounds_to(&of_set(&found, "high")["percent"], 1, 66.0);
    rounds_to(&of_set(&found, "high")["standard_error"], 1, 6.6);
    assert_eq!(of_set(&found, "middle")["n"], 50);
    assert_eq!(of_set(&found, "all")["n"], 150);
    assert_eq!(found["success"]["judgements"], 152);
    assert!(found["success"]["auroc_failure"].is_null(), "labels of 0.5");
    let low = found["success"]["tasks"][2]["videos"]["low"]
        .as_array()
        .unwrap();
    let expected: Vec<Value> = (0..10).map(|i| json!(format!("2/{i:04}"))).collect();
    assert_eq!(*low, expected);
    let tables = text(&place, "out/evaluation.md");
    assert!(
        tables.contains("| **all tasks** | 79.0 ± 5.5 (50) | 70.0 ± "),
        "{tables}"
    );
    assert!(
        tables.contains("- low over high: +13.0 ± 8.6 points"),
        "{tables}"
    );
    assert_eq!(
        serde_json::from_str::<Value>(&text(&place, "out/evaluation.json")).unwrap(),
        found
    );

    // The same again, whatever the order of the labels; another seed draws others.
    let mut lines: Vec<&str> = labels.lines().collect();
    lines[1..].reverse();
    write(&place, "labels.csv", &lines.join("\n"));
    assert_eq!(evaluate(&place, &words).json(), found);
    let mut seeded = words.to_vec();
    seeded.extend(["--seed", "1"]);
    let other = evaluate(&place, &seeded).json();
    assert_ne!(
        other["success"]["tasks"][0]["videos"]["random"],
        found["success"]["tasks"][0]["videos"]["random"]
    );
    assert_eq!(
        other["success"]["tasks"][0]["sets"][0],
        found["success"]["tasks"][0]["sets"][0]
    );
}

/// Whole successes among 500: 331, 351, 373, 395 are 66.2, 70.2, 74.6, 79.0%, and 74.6 − 66.2 = 8.4.
#[test]
fn table_3_of_the_paper() {
    let place = Place::new();
    write(&place, "scores.jsonl", &ranked(1, 1500));
    for (low, expected, gain) in [(373, 74.6, 8.4), (395, 79.0, 12.8)] {
        let successes = [low, 351, 331];
        let mut labels = "video,label\n".to_owned();
        for i in 0..1500 {
            let label = u8::from(i % 500 < successes[i / 500]);
            let _ = writeln!(labels, "0/{i:04},{label}");
        }
        write(&place, "labels.csv", &labels);
        let words = [
            "scores.jsonl",
            "--labels",
            "labels.csv",
            "--out",
            "out",
            "--n",
            "500",
            "--json",
        ];
        let found = evaluate(&place, &words).expect_code(0).json();
        for (set, expected) in [("low", expected), ("middle", 70.2), ("high", 66.2)] {
            rounds_to(&of_set(&found, set)["percent"], 6, expected);
        }
        let over_high = &found["success"]["differences"][1];
        assert_eq!(over_high["over"], "high");
        rounds_to(&over_high["points"], 6, gain);
    }
}

/// Values that fall into 30 bins on [0, 30] as `counts` say, with one at either end.
fn values(counts: [usize; 30]) -> Vec<f64> {
    let mut values = vec![0.0];
    for (bin, &count) in counts.iter().enumerate() {
        let inside = count - usize::from(bin == 0) - usize::from(bin == 29);
        values.extend(vec![bin as f64 + 0.5; inside]);
    }
    values.push(30.0);
    values
}

/// −Σ p ln p over 100 values: (2.16, 2.88) and (1.73, 2.35); e^−2.16/(e^−2.16 + e^−2.88) = 0.67,
/// e^−1.73/(e^−1.73 + e^−2.35) = 0.65.
#[test]
fn table_2_of_the_paper() {
    let tail = |head: &[usize]| {
        let mut counts = [0; 30];
        counts[..head.len()].copy_from_slice(head);
        counts[29] = 1;
        counts
    };
    let real = [
        tail(&[23, 14, 12, 11, 11, 10, 9, 4, 3, 2]),
        tail(&[
            16, 9, 8, 7, 6, 6, 5, 5, 5, 4, 4, 4, 4, 3, 2, 2, 2, 2, 2, 1, 1, 1,
        ]),
    ];
    let generated = [
        tail(&[32, 23, 19, 10, 8, 4, 3]),
        tail(&[23, 14, 13, 10, 6, 6, 6, 5, 5, 4, 3, 2, 2]),
    ];
    let mut scores = String::new();
    for (name, [geometric, photometric]) in [("real", real), ("generated", generated)] {
        for (i, (s3, sp)) in values(geometric)
            .iter()
            .zip(values(photometric))
            .enumerate()
        {
            let anomaly = if name == "real" { i } else { i + 50 };
            let row = json!({
                "video": format!("{name}/{i}"), "status": "scored", "anomaly": anomaly, "side": name,
                "reproj_px": s3, "aepe_worldscore_px": sp,
            });
            let _ = writeln!(scores, "{row}");
        }
    }
    let _ = writeln!(
        scores,
        "{}",
        json!({"video": "z", "status": "static", "side": "real"})
    );
    let place = Place::new();
    write(&place, "scores.jsonl", &scores);
    let words = [
        "scores.jsonl",
        "--population",
        "side",
        "--out",
        "out",
        "--json",
    ];
    let found = evaluate(&place, &words).expect_code(0).json();
    let populations = found["populations"]["populations"].as_array().unwrap();
    for (population, (name, h, w)) in populations.iter().zip([
        ("generated", [1.73, 2.35], [0.65, 0.35]),
        ("real", [2.16, 2.88], [0.67, 0.33]),
    ]) {
        assert_eq!(
            (&population["population"], &population["n"]),
            (&json!(name), &json!(100))
        );
        for k in 0..2 {
            let measure = &population["measures"][k];
            rounds_to(&measure["entropy_nats"], 2, h[k]);
            rounds_to(&measure["weight"], 2, w[k]);
        }
    }
    // Of 100 × 100 pairs i + 50 > j: all j for i ≥ 50 (5000), and for i < 50 the i + 50 lower ones
    // (Σ (50 + i) = 3725), with ties i + 50 = j counting half (50 of them): 8725 + 25 of 10000.
    rounds_to(
        &found["populations"]["auroc_first_above_second"]["area"],
        6,
        0.875,
    );
    assert!(text(&place, "out/evaluation.md").contains("| real | 100 | "));
    // Where there is no report to add to, there is a page of the section alone.
    let page = text(&place, "out/report.html");
    assert!(page.contains("Populations by") && page.contains("href=\"#evaluation\""));
    assert_eq!(evaluate(&place, &words).json(), found);
    assert_eq!(text(&place, "out/report.html"), page);
    evaluate(
        &place,
        &["scores.jsonl", "--population", "no", "--out", "out"],
    )
    .expect_code(2)
    .expect_line(&["no scored row has a value in the column `no`"]);
}

#[test]
fn nothing_is_dropped_silently_and_the_report_gets_a_section() {
    let place = Place::with_clips(6);
    std::fs::write(place.video("broken.mp4"), "text").unwrap();
    place.run("out", &["--recipe", "paper"]).expect_code(3);
    let labels = "video,label,in_reality\n\
        clip-00.mp4,1,1\nclip-01.mp4,0,1\n./clip-02.mp4,1,0\nclip-03.mp4,0,0\n\
        broken.mp4,1,1\nelsewhere.mp4,1,1\nclip-04.mp4,,\n";
    write(&place, "labels.csv", labels);
    let words = [
        "out",
        "--labels",
        "labels.csv",
        "--n",
        "1",
        "--real",
        "in_reality",
        "--json",
    ];
    let found = evaluate(&place, &words).expect_code(0).json();
    let success = &found["success"];
    assert_eq!(
        (&success["compared"], &success["empty_judgements"]),
        (&json!(4), &json!(1))
    );
    assert_eq!(
        success["without_score"],
        json!([
            {"video": "broken.mp4", "reason": "undecodable"},
            {"video": "elsewhere.mp4", "reason": "not in the scores"},
        ])
    );
    assert_eq!(
        success["without_label"],
        json!(["clip-04.mp4", "clip-05.mp4"])
    );
    let all = success["real"]
        .as_array()
        .unwrap()
        .iter()
        .find(|gap| gap["set"] == "all")
        .unwrap();
    assert_eq!(
        (&all["gap_points"], &all["real"]["percent"]),
        (&json!(0.0), &json!(50.0))
    );
    // Differences 0, −1, 1, 0: standard deviation √(2/3), over √4.
    rounds_to(
        &all["standard_error"],
        6,
        (100.0 * (2.0_f64 / 3.0 / 4.0).sqrt() * 1e6).round() / 1e6,
    );
    assert_eq!(success["auroc_failure"]["positives"], 2);

    let report = || text(&place, "out/report.html");
    assert!(
        report().contains("<section id=\"evaluation\">")
            && report().contains("<section id=\"table\">")
    );
    let once = report();
    evaluate(&place, &words).expect_code(0);
    assert_eq!(report(), once, "a second evaluation replaces the first");

    // New scores know nothing of it.
    place.run("out", &["--recipe", "balanced"]);
    assert!(!place.path("out/evaluation.json").exists() && !report().contains("\"evaluation\""));
}

#[test]
fn what_cannot_be_evaluated_is_refused_with_the_remedy() {
    let place = Place::new();
    write(&place, "scores.jsonl", &ranked(1, 3));
    let refused = |labels: &str, words: &[&str], expected: &[&str]| {
        write(&place, "labels.csv", labels);
        let mut all = vec!["scores.jsonl", "--labels", "labels.csv", "--out", "out"];
        all.extend(words);
        evaluate(&place, &all).expect_code(2).expect_line(expected);
        assert!(!place.path("out").exists());
    };
    refused(
        "video,label\n0/0000,2\n",
        &[],
        &["labels.csv", "row 1", "0/0000", "from 0 (failure) to 1"],
    );
    refused(
        "video,label\n0/0000,generated\n",
        &[],
        &["labels.csv", "generated"],
    );
    refused(
        "video,success\n0/0000,1\n",
        &[],
        &["no column `label`", "found success", "--label-column"],
    );
    refused(
        "video,label\nother,1\n",
        &[],
        &["no video has both", "1 labelled, 3 scored"],
    );
    refused(
        "video,label\n0/0000,1\n",
        &["--real", "outcome"],
        &["no compared video", "`outcome`", "--real"],
    );
    refused(
        "video,label\n0/0000,1\n",
        &["--group-by", "prompt"],
        &["prompt"],
    );
    evaluate(
        &place,
        &["scores.jsonl", "--labels", "absent.csv", "--out", "out"],
    )
    .expect_code(2)
    .expect_line(&["absent.csv"]);
    evaluate(&place, &["scores.jsonl", "--labels", "labels.csv"])
        .expect_code(2)
        .expect_line(&["--out"]);
}
