//! `plumbline judge` against a stub of the protocol. No real model was ever asked.

use std::collections::BTreeMap;
use std::time::Duration;

use plumbline_tests::binary::plumbline;
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_tests::stub_chat::{Answer, StubChat};
use serde_json::{Value, json};

const KEY: &str = "sk-not-to-be-seen";

/// Judges `videos` into labels.csv, one frame and one judgement each, without waiting between attempts.
fn judge(place: &Place, stub: &StubChat, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    command
        .args([
            "judge",
            "videos",
            "--out",
            "labels.csv",
            "--model",
            "stub",
            "--key-env",
            "STUB_KEY",
        ])
        .args([
            "--endpoint",
            &stub.endpoint,
            "--backoff",
            "0",
            "--task",
            "lift the box",
            "--json",
        ])
        .args(words)
        .env("STUB_KEY", KEY);
    Started::start(&mut command).wait()
}

fn labels(place: &Place) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(place.path("labels.csv")).unwrap();
    reader.deserialize().map(Result::unwrap).collect()
}

fn statuses(place: &Place) -> Vec<String> {
    labels(place)
        .into_iter()
        .map(|row| row["status"].clone())
        .collect()
}

const ONCE: [&str; 4] = ["--repeats", "1", "--frames", "1"];

#[test]
fn frames_and_task_go_out_and_labels_that_evaluate_reads_come_back() {
    let place = Place::with_clips(3);
    std::fs::write(place.video("broken.mp4"), "text").unwrap();
    // Half the judgements of a video say 1, half 0.5, whichever comes first.
    let stub = StubChat::start(|number, _| {
        let score = if number % 2 == 0 { "1" } else { "0.5" };
        Answer::says(&format!(
            "{{\"score\": {score}, \"reason\": \"so, \\\"it\\\" seems\"}}"
        ))
    });
    let words = [
        "--repeats",
        "2",
        "--frames",
        "3",
        "--max-side",
        "48",
        "--concurrency",
        "1",
    ];
    let told = judge(&place, &stub, &words).expect_code(3).json();
    assert_eq!((&told["calls"], &told["tokens"]), (&json!(6), &json!(60)));
    assert_eq!(told["statuses"], json!({"judged": 6, "unreadable": 2}));

    let asked = stub.asked();
    assert_eq!(asked.len(), 6);
    for asked in &asked {
        assert_eq!(asked.line, "POST /v1/chat/completions HTTP/1.1");
        assert_eq!(
            asked.authorization.as_deref(),
            Some(format!("Bearer {KEY}").as_str())
        );
        assert_eq!(
            (&asked.body["model"], asked.body.get("temperature")),
            (&json!("stub"), None)
        );
        let content = asked.body["messages"][0]["content"].as_array().unwrap();
        let text = content[0]["text"].as_str().unwrap();
        assert!(
            text.contains("lift the box") && text.contains("3 frames"),
            "{text}"
        );
        assert_eq!(content.len(), 4);
        for part in &content[1..] {
            let url = part["image_url"]["url"].as_str().unwrap();
            let jpeg = decode_base64(url.strip_prefix("data:image/jpeg;base64,").unwrap());
            let picture = image::load_from_memory(&jpeg).unwrap();
            assert_eq!(picture.width().max(picture.height()), 48);
        }
        assert_ne!(content[1], content[3], "first and last frame differ");
    }
    let rows = labels(&place);
    let first: Vec<&str> = ["video", "repeat", "status"]
        .iter()
        .map(|c| rows[0][*c].as_str())
        .collect();
    assert_eq!(first, ["broken.mp4", "0", "unreadable"]);
    assert!(rows[0]["label"].is_empty() && rows[2]["label"] != rows[3]["label"]);

    // Nothing is asked twice, and the labels are the same bytes.
    let before = std::fs::read(place.path("labels.csv")).unwrap();
    let again = judge(&place, &stub, &words).expect_code(3).json();
    assert_eq!(
        (&again["calls"], &again["from_earlier_runs"]),
        (&json!(0), &json!(6))
    );
    assert_eq!(std::fs::read(place.path("labels.csv")).unwrap(), before);
    // Another question is another answer.
    let mut other = words.to_vec();
    other.extend(["--temperature", "0.5"]);
    assert_eq!(
        judge(&place, &stub, &other).expect_code(3).json()["calls"],
        6
    );
    assert_eq!(stub.asked()[6].body["temperature"], 0.5);

    place.run("out", &["--recipe", "paper"]).expect_code(3);
    let mut command = place.command(plumbline());
    command.args([
        "evaluate",
        "out",
        "--labels",
        "labels.csv",
        "--n",
        "1",
        "--json",
    ]);
    let found = Started::start(&mut command).wait().expect_code(0).json();
    let success = &found["success"];
    assert_eq!(success["compared"], 3);
    assert_eq!(
        (&success["judgements"], &success["empty_judgements"]),
        (&json!(6), &json!(2))
    );
    assert_eq!(success["sets"][4]["percent"], 75.0);
}

#[test]
fn what_may_pass_is_tried_again_and_the_server_says_when() {
    let place = Place::with_clips(1);
    let stub = StubChat::start(|number, _| match number {
        0 => Answer::status(429, "{\"error\": \"slower\"}").header("Retry-After: 1"),
        1 => Answer::status(500, "oops"),
        2 => Answer::status(200, "{\"choices\": ["),
        3 => Answer::status(200, "{\"choices\": []}"),
        _ => Answer::says("0.5"),
    });
    let told = judge(&place, &stub, &ONCE).expect_code(0).json();
    assert_eq!(told["calls"], 5);
    assert_eq!(labels(&place)[0]["label"], "0.5");
    let asked = stub.asked();
    // No wait but the one that was asked for; a sleep is never shorter.
    assert!(asked[1].at - asked[0].at >= Duration::from_secs(1));

    let stub = StubChat::start(|_, _| Answer::status(503, "down").header("Retry-After: 86400"));
    let fresh = ["--cache", "fresh"];
    let words: Vec<&str> = ONCE.into_iter().chain(fresh).collect();
    assert_eq!(
        judge(&place, &stub, &words).expect_code(3).json()["calls"],
        1
    );
    assert!(
        labels(&place)[0]["answer"].contains("86400 s"),
        "{:?}",
        labels(&place)
    );

    let stub = StubChat::start(|_, _| Answer::says("1").after(Duration::from_secs(20)));
    let slow: Vec<&str> = words
        .iter()
        .copied()
        .chain(["--timeout", "0.5", "--attempts", "2"])
        .collect();
    assert_eq!(
        judge(&place, &stub, &slow).expect_code(3).json()["calls"],
        2
    );
    let row = labels(&place).remove(0);
    assert_eq!(
        (row["status"].as_str(), row["label"].as_str()),
        ("failed", "")
    );
    assert!(row["answer"].contains("timeout"), "{row:?}");
}

#[test]
fn refusals_and_words_that_are_no_judgement_are_told_and_the_key_is_not() {
    let place = Place::with_clips(2);
    let stub = StubChat::start(|_, _| Answer::status(401, &format!("no such key: {KEY}")));
    // Nobody else is let in after that.
    let one_by_one = [&ONCE, ["--concurrency", "1"].as_slice()].concat();
    let ended = judge(&place, &stub, &one_by_one)
        .expect_code(3)
        .expect_line(&["refused", "status 401", "***"]);
    assert_eq!(
        (statuses(&place), stub.asked().len()),
        (vec!["refused".to_owned(); 2], 1)
    );
    let files = [
        std::fs::read_to_string(place.path("labels.csv")).unwrap(),
        ended.stdout,
        ended.stderr,
    ];
    assert!(files.iter().all(|text| !text.contains(KEY)));

    let stub = StubChat::start(|_, _| Answer::says("It looks fine to me."));
    judge(&place, &stub, &ONCE)
        .expect_code(3)
        .expect_line(&["unparsable", "It looks fine to me."]);
    assert_eq!(statuses(&place), ["unparsable", "unparsable"]);
    // An answer was paid for; it is read again, not asked for again.
    judge(&place, &stub, &ONCE).expect_code(3);
    assert_eq!(stub.asked().len(), 2);
}

#[test]
fn limits_on_calls_and_tokens_hold_and_a_later_run_goes_on() {
    let place = Place::with_clips(3);
    let stub = StubChat::start(|_, _| Answer::says("{\"score\": 1}"));
    let with = |words: &[&'static str]| [&ONCE, ["--concurrency", "1"].as_slice(), words].concat();
    let told = judge(&place, &stub, &with(&["--max-calls", "1"]))
        .expect_code(3)
        .json();
    assert_eq!(told["statuses"], json!({"judged": 1, "over_budget": 2}));
    let told = judge(&place, &stub, &with(&["--max-tokens", "10"]))
        .expect_code(3)
        .json();
    assert_eq!(
        (&told["statuses"]["judged"], &told["from_earlier_runs"]),
        (&json!(2), &json!(1))
    );
    let told = judge(&place, &stub, &with(&[])).expect_code(0).json();
    assert_eq!((&told["calls"], stub.asked().len()), (&json!(1), 3));
}

#[test]
fn a_list_gives_each_video_its_task_and_another_prompt_is_asked_word_for_word() {
    let place = Place::with_clips(2);
    let list = "video,instruction\nvideos/clip-00.mp4,open the drawer\nvideos/clip-01.mp4,fold the cloth\n";
    std::fs::write(place.path("list.csv"), list).unwrap();
    std::fs::write(place.path("prompt.txt"), "Rate {task}, {frames} pictures.").unwrap();
    let stub = StubChat::start(|_, _| Answer::says("0"));
    let mut command = place.command(plumbline());
    command.args([
        "judge",
        "list.csv",
        "--out",
        "labels.csv",
        "--endpoint",
        &stub.endpoint,
        "--model",
        "m",
    ]);
    command.args([
        "--task-column",
        "instruction",
        "--prompt",
        "prompt.txt",
        "--key-env",
        "NO_SUCH_KEY",
    ]);
    Started::start(command.args(ONCE)).wait().expect_code(0);
    let mut texts: Vec<Value> = stub
        .asked()
        .iter()
        .map(|asked| asked.body["messages"][0]["content"][0]["text"].clone())
        .collect();
    texts.sort_by_key(Value::to_string);
    assert_eq!(
        texts,
        [
            "Rate fold the cloth, 1 pictures.",
            "Rate open the drawer, 1 pictures."
        ]
    );
    assert!(
        stub.asked()
            .iter()
            .all(|asked| asked.authorization.is_none())
    );
}

#[test]
fn unusable_words_are_refused_before_anything_is_asked() {
    let place = Place::with_clips(1);
    let refused = |words: &[&str], expected: &[&str]| {
        let mut command = place.command(plumbline());
        command.args([
            "judge",
            "videos",
            "--out",
            "labels.csv",
            "--model",
            "m",
            "--key-env",
            "STUB_KEY",
        ]);
        Started::start(command.args(words).env("STUB_KEY", KEY))
            .wait()
            .expect_code(2)
            .expect_line(expected);
        assert!(!place.path("labels.csv").exists());
    };
    refused(
        &["--endpoint", "http://example.org/v1", "--task", "t"],
        &["STUB_KEY", "unencrypted"],
    );
    refused(&["--endpoint", "http://localhost:1/v1"], &["--task"]);
    refused(
        &["--endpoint", "http://localhost:1/v1", "--task-column", "no"],
        &["clip-00.mp4", "`no`"],
    );
    refused(
        &[
            "--endpoint",
            "http://localhost:1/v1",
            "--prompt",
            "absent.txt",
        ],
        &["absent.txt"],
    );
}

/// Standard base64, by its definition.
fn decode_base64(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        b'/' => 63,
        _ => panic!("{c} is not base64"),
    };
    let digits: Vec<u8> = text.trim_end_matches('=').bytes().map(value).collect();
    let mut bytes = Vec::new();
    for group in digits.chunks(4) {
        let bits = group
            .iter()
            .fold(0_u32, |bits, &digit| bits << 6 | u32::from(digit))
            << (6 * (4 - group.len()));
        bytes.extend(&bits.to_be_bytes()[1..group.len()]);
    }
    bytes
}
