//! Kills, signals and repeats: whatever interrupts a run, the bytes in the end are the same.

use std::collections::BTreeMap;
use std::time::Duration;

use plumbline_tests::clips;
use plumbline_tests::process::{Process, children_of, wait_until};
use plumbline_tests::run::{Ended, Place, Started};
use rustix::process::Signal;

/// Enough that a run can be caught half-way.
const VIDEOS: u64 = 8;

/// Long for a process that has only to notice that its parent is gone.
const PATIENCE: Duration = Duration::from_secs(20);

/// At `standard`, which takes a few tenths of a second a clip.
fn start(place: &Place, out: &str, jobs: &str) -> Started {
    Started::start(&mut place.score(&["videos", "--out", out, "--json", "--jobs", jobs]))
}

/// A run of one slot that has measured at least one video and is not done, and its compute child.
fn half_way(place: &Place, out: &str) -> (Started, Process) {
    let mut run = start(place, out, "1");
    let journal = place.published(out).journal();
    wait_until("a first record", PATIENCE, || {
        assert!(
            run.is_running(),
            "the run ended before it could be interrupted"
        );
        journal.metadata().is_ok_and(|metadata| metadata.len() > 0)
    });
    let children = children_of(run.pid());
    assert_eq!(children.len(), 1, "one slot, one compute child");
    (run, children[0])
}

fn reference(place: &Place) -> BTreeMap<String, Vec<u8>> {
    start(place, "reference", "2").wait().expect_code(0);
    place.published("reference").stable_files()
}

#[track_caller]
fn expect_same(place: &Place, out: &str, reference: &BTreeMap<String, Vec<u8>>) {
    let found = place.published(out).stable_files();
    assert!(
        found.keys().eq(reference.keys()),
        "{:?} {:?}",
        found.keys(),
        reference.keys()
    );
    for name in [
        "scores.jsonl",
        "scores.csv",
        "scores.parquet",
        "corpus.json",
        "manifests/keep.jsonl",
    ] {
        assert!(reference.contains_key(name), "{name}");
    }
    for (name, bytes) in reference {
        assert!(found[name] == *bytes, "{name} of {out} differs");
    }
}

/// Interrupts a run, looks at what is left, and finishes it.
fn interrupt(signal: Signal, check: impl FnOnce(Ended) -> Ended) {
    let place = Place::with_clips(VIDEOS);
    let reference = reference(&place);
    let (run, child) = half_way(&place, "out");
    run.signal(signal);
    check(run.wait());
    wait_until("the compute child is gone", PATIENCE, || !child.is_alive());
    assert!(
        !place.published("out").is_finished(),
        "an interrupted run looks finished"
    );

    let resumed = start(&place, "out", "2").wait().expect_code(0);
    let measured_now = resumed.json()["measured_now"].as_u64().unwrap();
    assert!(
        (1..VIDEOS).contains(&measured_now),
        "{measured_now} of {VIDEOS} measured after the interruption"
    );
    let earlier = format!(
        "{} of {VIDEOS} videos were measured by an earlier run",
        VIDEOS - measured_now
    );
    resumed.expect_line(&[&earlier]);
    expect_same(&place, "out", &reference);
}

#[test]
fn a_killed_run_resumes_to_the_same_bytes() {
    interrupt(Signal::KILL, |ended| ended.expect_signal(Signal::KILL));
}

#[test]
fn ctrl_c_says_how_far_it_got_and_is_resumable() {
    interrupt(Signal::INT, |ended| {
        let ended = ended.expect_code(130).expect_line(&[
            "interrupted:",
            "of 8 videos are measured and kept",
            "run the same command again",
        ]);
        assert_eq!(ended.stdout, "");
        ended
    });
}

#[test]
fn sigterm_is_as_gentle_as_ctrl_c() {
    interrupt(Signal::TERM, |ended| {
        ended
            .expect_code(130)
            .expect_line(&["interrupted:", "run the same command again"])
    });
}

/// Nobody waits for the end of a long clip: not the run that is interrupted, not the compute process
/// whose run is killed.
#[test]
fn a_long_clip_holds_nothing_up() {
    const PROMPT: Duration = Duration::from_secs(5);
    let place = Place::new();
    clips::write_long(&place.video("long.mp4"), 0);
    for signal in [Signal::INT, Signal::KILL] {
        let words = ["videos", "--out", "out", "--profile", "accurate"];
        let mut run = Started::start(&mut place.score(&words));
        let mut child = None;
        wait_until("a compute child at work", PATIENCE, || {
            child = children_of(run.pid()).first().copied();
            child.is_some_and(Process::has_worked)
        });
        run.signal(signal);
        wait_until("the run ends", PROMPT, || !run.is_running());
        wait_until("the compute child ends", PROMPT, || {
            !child.is_some_and(Process::is_alive)
        });
        let ended = run.wait();
        if signal == Signal::INT {
            ended
                .expect_code(130)
                .expect_line(&["interrupted: 0 of 1 videos"]);
        }
    }
}

#[test]
fn one_job_two_jobs_and_measuring_again_give_the_same_bytes() {
    let place = Place::with_clips(VIDEOS);
    let reference = reference(&place);
    start(&place, "one", "1").wait().expect_code(0);
    expect_same(&place, "one", &reference);

    // Over a finished run: its mark goes at once and comes back last.
    let mut again = place.score(&["videos", "--out", "one", "--no-resume", "--json"]);
    let again = Started::start(&mut again);
    wait_until("corpus.json goes first", PATIENCE, || {
        !place.published("one").is_finished()
    });
    let again = again.wait().expect_code(0);
    assert_eq!(again.json()["measured_now"], VIDEOS);
    expect_same(&place, "one", &reference);
}

#[test]
fn a_second_run_into_the_same_out_is_refused() {
    let place = Place::with_clips(VIDEOS);
    let (first, _) = half_way(&place, "out");
    // Held still, so that it cannot end first.
    first.signal(Signal::STOP);
    let second = start(&place, "out", "1").wait();
    first.signal(Signal::CONT);
    second
        .expect_code(2)
        .expect_line(&["another plumbline run", "choose another --out"]);
    first.wait().expect_code(0);
    expect_same(&place, "out", &reference(&place));
}

#[test]
fn another_recipe_measures_nothing_again() {
    let place = Place::with_clips(4);
    let balanced = place.run("out", &["--json"]).expect_code(0).json();
    assert_eq!(
        (&balanced["recipe"], &balanced["measured_now"]),
        (&"balanced".into(), &4.into())
    );
    let paper = place
        .run(
            "out",
            &["--json", "--recipe", "paper", "--bins", "5", "--keep", "1"],
        )
        .expect_code(0)
        .json();
    assert_eq!(
        (&paper["recipe"], &paper["measured_now"]),
        (&"paper".into(), &0.into())
    );
    place.published("out").expect_whole(&[
        "clip-00.mp4",
        "clip-01.mp4",
        "clip-02.mp4",
        "clip-03.mp4",
    ]);
    assert_eq!(
        place.published("out").jsonl("manifests/keep.jsonl").len(),
        1
    );
    // Another profile is another measurement.
    let standard = start(&place, "out", "2").wait().expect_code(0).json();
    assert_eq!(standard["measured_now"], 4);
}

#[test]
fn a_changed_video_is_measured_again_and_a_removed_one_is_gone() {
    let place = Place::with_clips(4);
    place.run("out", &[]).expect_code(0);
    let before = place.published("out").row("clip-01.mp4");
    clips::write_moving(&place.video("clip-01.mp4"), 77);
    std::fs::remove_file(place.video("clip-03.mp4")).unwrap();
    let changed = place.run("out", &["--json"]).expect_code(0).json();
    assert_eq!(changed["measured_now"], 1);
    place
        .published("out")
        .expect_whole(&["clip-00.mp4", "clip-01.mp4", "clip-02.mp4"]);
    assert_ne!(
        place.published("out").row("clip-01.mp4")["digest"],
        before["digest"]
    );
}

/// What a crash of the machine may leave: the journal's last record cut off, or an earlier one damaged,
/// after which nothing is trusted.
#[test]
fn a_damaged_journal_is_measured_again_from_the_damage_on() {
    let place = Place::with_clips(4);
    place.run("out", &[]).expect_code(0);
    let reference = place.published("out").stable_files();
    let journal = place.published("out").journal();
    let whole = std::fs::read(&journal).unwrap();

    std::fs::write(&journal, &whole[..whole.len() - 5]).unwrap();
    assert_eq!(
        place.run("out", &["--json"]).expect_code(0).json()["measured_now"],
        1
    );
    expect_same(&place, "out", &reference);

    let mut flipped = whole;
    // Inside the first record.
    flipped[40] ^= 1;
    std::fs::write(&journal, flipped).unwrap();
    assert_eq!(
        place.run("out", &["--json"]).expect_code(0).json()["measured_now"],
        4
    );
    expect_same(&place, "out", &reference);
}
