//! The machine says no: permissions, a full disk, lost compute processes, little memory.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::process::{children_of, is_root, wait_until};
use plumbline_tests::run::{Place, Started};

const PATIENCE: Duration = Duration::from_secs(20);

fn set_mode(path: &Path, mode: u32) {
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
}

/// `plumbline` as somebody whom permissions stop; `None` where that cannot be had.
fn without_privileges(place: &Place) -> Option<Command> {
    if !is_root() {
        return Some(place.command(plumbline()));
    }
    let nobody = || {
        let mut command = place.command("setpriv");
        command
            .args(["--reuid=65534", "--regid=65534", "--clear-groups"])
            .arg(plumbline());
        command
    };
    set_mode(place.root(), 0o777);
    let works = nobody()
        .arg("--version")
        .output()
        .is_ok_and(|output| output.status.success());
    if !works {
        eprintln!("skipped: the tests run as root, and setpriv cannot give that up here");
    }
    works.then(nobody)
}

#[test]
fn unreadable_videos_and_directories_are_named_with_the_remedy() {
    let place = Place::with_clips(2);
    clips::write_moving(&place.video("secret.mp4"), 2);
    set_mode(&place.video("secret.mp4"), 0o000);
    let Some(mut command) = without_privileges(&place) else {
        return;
    };
    command.args(["score", "videos", "--out", "out", "--profile", "draft"]);
    Started::start(&mut command)
        .wait()
        .expect_code(3)
        .expect_line(&[
            "failed: secret.mp4",
            "Permission denied",
            "check that the file exists and may be read",
        ]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "clip-01.mp4", "secret.mp4"]);
    assert_eq!(published.row("secret.mp4")["status"], "failed");

    // Mended, it is measured; the others are not measured again.
    set_mode(&place.video("secret.mp4"), 0o644);
    Started::start(&mut command)
        .wait()
        .expect_code(0)
        .expect_line(&["1 measured now"]);

    // What is in an unreadable directory cannot be counted: no run that would miss it.
    std::fs::create_dir(place.video("closed")).unwrap();
    set_mode(&place.video("closed"), 0o000);
    let ended = Started::start(&mut command).wait();
    set_mode(&place.video("closed"), 0o755);
    ended.expect_code(2).expect_line(&[
        "closed: cannot be listed",
        "mend its permissions or leave it out",
    ]);
}

#[test]
fn an_out_that_cannot_be_written_is_named() {
    let place = Place::with_clips(1);
    let Some(mut command) = without_privileges(&place) else {
        return;
    };
    std::fs::create_dir(place.path("closed")).unwrap();
    set_mode(&place.path("closed"), 0o555);
    command.args(["score", "videos", "--out", "closed/out"]);
    Started::start(&mut command)
        .wait()
        .expect_code(1)
        .expect_line(&["closed/out", "writable", "choose another --out"]);

    std::fs::write(place.path("file"), "mine").unwrap();
    place
        .run("file", &[])
        .expect_code(2)
        .expect_line(&["file", "choose another --out"]);
    assert_eq!(std::fs::read(place.path("file")).unwrap(), b"mine");
}

/// The run is done when its summary is printed: what is lost is the print, not the results.
#[test]
fn a_full_standard_output_is_told_apart_from_a_full_out() {
    let place = Place::with_clips(2);
    let mut command = place.command("sh");
    command
        .args(["-c", "exec \"$@\" > /dev/full", "sh"])
        .arg(plumbline());
    command.args([
        "score",
        "videos",
        "--out",
        "out",
        "--profile",
        "draft",
        "--json",
    ]);
    Started::start(&mut command)
        .wait()
        .expect_code(1)
        .expect_line(&[
            "standard output",
            "No space left",
            "the results are whole, in out",
        ]);
    place
        .published("out")
        .expect_whole(&["clip-00.mp4", "clip-01.mp4"]);
}

/// A disk that fills while videos are measured, then one that fills while results are published.
/// A limit on file sizes stands in for it, which needs no privileges.
#[test]
fn a_full_disk_stops_the_run_and_room_lets_it_go_on() {
    let place = Place::with_clips(6);
    place.run("reference", &[]).expect_code(0);
    let reference = place.published("reference");
    let bytes_of = |path: &Path| path.metadata().unwrap().len();
    let (journal, report) = (
        bytes_of(&reference.journal()),
        bytes_of(&reference.path("report.html")),
    );

    let limited = |limit_bytes: u64| {
        // POSIX counts in blocks of 512 bytes. Ignoring the signal leaves the error.
        let script = format!("trap '' XFSZ; ulimit -f {}; exec \"$@\"", limit_bytes / 512);
        let mut command = place.command("sh");
        command.args(["-c", &script, "sh"]).arg(plumbline());
        command.args([
            "score",
            "videos",
            "--out",
            "out",
            "--profile",
            "draft",
            "--jobs",
            "1",
        ]);
        Started::start(&mut command).wait()
    };
    limited(journal / 2).expect_code(1).expect_line(&[
        "out/.plumbline/journal",
        "measured so far is kept",
        "make room",
        "run the same command again",
    ]);
    assert!(!place.published("out").is_finished());

    assert!(
        journal < report,
        "the report is not the largest file: {journal} {report}"
    );
    limited((journal + report) / 2)
        .expect_code(1)
        .expect_line(&["videos were measured by an earlier run"])
        .expect_line(&[
            "no space left to write report.html",
            "free some space",
            "run again to resume",
        ]);
    assert!(!place.published("out").is_finished());
    assert!(
        !place.published("out").path("report.html").exists(),
        "half a report"
    );

    place
        .run("out", &[])
        .expect_code(0)
        .expect_line(&["0 measured now"]);
    assert_eq!(
        place.published("out").stable_files(),
        reference.stable_files()
    );
}

/// The same on a file system that is really full, where the tests may mount one.
#[test]
fn a_full_file_system_stops_the_run_and_room_lets_it_go_on() {
    let place = Place::with_clips(6);
    std::fs::create_dir(place.path("small")).unwrap();
    let in_private_mounts = |script: &str| {
        let mut command = place.command("unshare");
        command
            .args(["--mount", "sh", "-c", script, "sh"])
            .arg(plumbline());
        command
    };
    let mount = "mount -t tmpfs -o size=48k none small";
    if !in_private_mounts(mount)
        .output()
        .is_ok_and(|output| output.status.success())
    {
        eprintln!("skipped: no file system can be mounted here");
        return;
    }
    let score = "\"$plumbline\" score videos --out small/out --profile draft";
    let script = format!(
        "plumbline=$1
        {mount}
        {score}; echo \"first: $?\" >&2
        ls small/out/corpus.json
        mount -o remount,size=16m small
        {score} && cp -r small/out out"
    );
    Started::start(&mut in_private_mounts(&script))
        .wait()
        .expect_code(0)
        .expect_line(&["first: 1"])
        .expect_line(&[
            "No space left on device",
            "make room",
            "run the same command again",
        ])
        .expect_line(&["corpus.json", "No such file"])
        .expect_line(&["videos were measured by an earlier run"]);
    place.run("reference", &[]).expect_code(0);
    assert_eq!(
        place.published("out").stable_files(),
        place.published("reference").stable_files()
    );
}

#[test]
fn a_killed_compute_process_costs_a_retry_and_no_row() {
    let place = Place::with_clips(8);
    let words = ["videos", "--jobs", "1", "--out"];
    Started::start(place.score(&words).arg("reference"))
        .wait()
        .expect_code(0);
    let run = Started::start(place.score(&words).arg("out"));
    let journal = place.published("out").journal();
    wait_until("a first record", PATIENCE, || {
        journal.metadata().is_ok_and(|metadata| metadata.len() > 0)
    });
    let children = children_of(run.pid());
    assert_eq!(children.len(), 1);
    children[0].kill();
    run.wait().expect_code(0);
    assert_eq!(
        place.published("out").stable_files(),
        place.published("reference").stable_files()
    );
    let attempts = place.published("out").jsonl("costs.jsonl");
    let total: u64 = attempts
        .iter()
        .map(|row| row["attempts"].as_u64().unwrap())
        .sum();
    assert_eq!(total, 8 + 1, "one video was measured twice: {attempts:?}");
}

/// Videos whose compute process dies again and again: failed rows, never an endless loop.
#[test]
fn compute_processes_that_always_die_give_failed_rows() {
    let place = Place::with_clips(3);
    let mut run = Started::start(&mut place.score(&["videos", "--out", "out", "--jobs", "1"]));
    while run.is_running() {
        children_of(run.pid())
            .into_iter()
            .for_each(|child| child.kill());
    }
    run.wait().expect_code(3).expect_line(&[
        "the compute process died 2 times",
        "signal 9",
        "--memory",
    ]);
    let videos = ["clip-00.mp4", "clip-01.mp4", "clip-02.mp4"];
    place.published("out").expect_whole(&videos);

    // The cause is gone: what failed is measured.
    Started::start(&mut place.score(&["videos", "--out", "out"]))
        .wait()
        .expect_code(0);
    place.published("out").expect_whole(&videos);
}

/// The least memory that is allowed is enough for small clips, and too little for a large one, which
/// costs its own row.
#[test]
fn a_memory_limit_costs_rows_and_not_the_run() {
    let place = Place::with_clips(2);
    let wide = 4000;
    let grey = plumbline_vision::image::Rgb8 {
        width: wide,
        height: wide / 2,
        data: vec![90; wide * wide / 2 * 3],
    };
    clips::write(
        &place.video("large.mp4"),
        &[grey.clone(), grey.clone(), grey.clone(), grey],
    );
    let ended = place.run("out", &["--memory", "320"]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "clip-01.mp4", "large.mp4"]);
    assert_eq!(
        published.row("clip-00.mp4")["status"],
        "scored",
        "{}",
        ended.stderr
    );
    assert_eq!(published.row("large.mp4")["status"], "failed");
    ended.expect_code(3).expect_line(&["large.mp4", "memory"]);

    // With room it is measured, and is what it is: a wall that never moves.
    place
        .run("roomy", &[])
        .expect_code(0)
        .expect_line(&["static: large.mp4"]);
}

/// What decodes hostile bytes knows no password, and the kernel filters its calls.
#[test]
fn compute_processes_are_given_no_secrets_and_no_way_out() {
    let place = Place::new();
    clips::write_long(&place.video("long.mp4"), 0);
    let mut command = place.score(&["videos", "--out", "out"]);
    command
        .env("AWS_SECRET_ACCESS_KEY", "hush")
        .env("PLUMBLINE_QUEUE__URL", "amqp://me:hush@localhost")
        .env("JUDGE_API_KEY", "hush")
        .env("HARMLESS", "known");
    let run = Started::start(&mut command);
    let (mut environment, mut status) = (Vec::new(), Vec::new());
    wait_until("a compute child", PATIENCE, || {
        let child = children_of(run.pid()).first().copied();
        let at_work = child.filter(|child| child.has_worked());
        let shown = |what| {
            at_work
                .and_then(|child| std::fs::read(format!("/proc/{}/{what}", child.pid)).ok())
                .unwrap_or_default()
        };
        (environment, status) = (shown("environ"), shown("status"));
        !environment.is_empty() && !status.is_empty()
    });
    let status = String::from_utf8_lossy(&status);
    assert!(status.contains("NoNewPrivs:\t1\n"), "{status}");
    if Path::new("/proc/sys/kernel/seccomp").exists() {
        // 2: by a filter of its own.
        assert!(status.contains("Seccomp:\t2\n"), "{status}");
    } else {
        eprintln!("skipped: this kernel filters no calls");
    }
    let environment = String::from_utf8_lossy(&environment);
    assert!(environment.contains("HARMLESS=known"), "{environment}");
    assert!(!environment.contains("hush"), "{environment}");
}
