//! Bad videos and bad names: each costs its own row, whose reason names the remedy, and nothing else.

use std::ffi::OsStr;
use std::io::ErrorKind;
use std::net::TcpListener;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;

use plumbline_tests::clips;
use plumbline_tests::run::{Place, Started};

#[test]
fn an_empty_folder_and_a_wrong_path_are_usage_errors() {
    let place = Place::new();
    place.run("out", &[]).expect_code(2).expect_line(&[
        "videos: no video found",
        "check the path",
        "mp4",
    ]);
    Started::start(&mut place.score(&["vidoes", "--out", "out"]))
        .wait()
        .expect_code(2)
        .expect_line(&["vidoes: no such file or directory", "check the path"]);
    assert!(!place.path("out").exists());
}

/// Broken and misleading files among good ones. Nothing in them is followed: no connection is made.
#[test]
fn broken_videos_become_typed_rows_with_reasons() {
    let bait = TcpListener::bind("127.0.0.1:0").unwrap();
    bait.set_nonblocking(true).unwrap();
    let url = format!("http://{}/a.ts", bait.local_addr().unwrap());
    let place = Place::with_clips(3);
    let good = place.video("clip-00.mp4");
    let playlist = |target: &str| {
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{target}\n#EXT-X-ENDLIST\n")
    };

    std::fs::write(place.video("audio.mp4"), std::fs::read(&good).unwrap()).unwrap();
    // The handler of the only track (ISO 14496-12, 8.4.3): its type, then three reserved words.
    clips::patch(&place.video("audio.mp4"), b"vide\0\0\0\0\0\0\0\0", b"soun");
    std::fs::write(
        place.video("concat.mp4"),
        format!("ffconcat version 1.0\nfile '{}'\n", good.display()),
    )
    .unwrap();
    std::fs::write(place.video("empty.mp4"), b"").unwrap();
    std::fs::write(
        place.video("hls-file.mp4"),
        playlist(&good.display().to_string()),
    )
    .unwrap();
    std::fs::write(place.video("hls-http.mp4"), playlist(&url)).unwrap();
    std::fs::write(place.video("huge.gif"), clips::huge_gif(8192)).unwrap();
    clips::write_short(&place.video("one-frame.mp4"), 0, 1);
    std::fs::write(place.video("text.mp4"), "just some text\n").unwrap();
    clips::write_short(&place.video("three-frames.mp4"), 0, 3);
    let whole = std::fs::read(&good).unwrap();
    std::fs::write(place.video("truncated.mp4"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(
        place.video("web-page.mp4"),
        "<!DOCTYPE html><html>404</html>",
    )
    .unwrap();
    std::fs::write(place.video("zeros.mp4"), [0; 4096]).unwrap();

    let cases = [
        ("audio.mp4", "undecodable", "give a file with pictures"),
        ("concat.mp4", "undecodable", "join the clips into one file"),
        ("empty.mp4", "undecodable", "copy or render it again"),
        ("hls-file.mp4", "undecodable", "download the video itself"),
        ("hls-http.mp4", "undecodable", "download the video itself"),
        ("huge.gif", "over_limit", "over the limit of 9437184"),
        ("one-frame.mp4", "too_short", "--conditioning-frames"),
        ("text.mp4", "undecodable", "give a video"),
        ("three-frames.mp4", "too_short", "3 are needed"),
        ("truncated.mp4", "undecodable", "re-copy the file"),
        ("web-page.mp4", "undecodable", "download it again"),
        ("zeros.mp4", "undecodable", "copy it again"),
    ];
    let mut ended = place.run("out", &["--recipe", "paper"]).expect_code(3);
    // The terminal shows the first ten and where the others are.
    for (video, status, remedy) in &cases[..10] {
        ended = ended.expect_line(&[&format!("{status}: {video}:"), remedy]);
    }
    ended.expect_line(&["and 2 more without a score, in manifests/review.jsonl"]);
    let published = place.published("out");
    let mut videos = vec!["clip-00.mp4", "clip-01.mp4", "clip-02.mp4"];
    videos.extend(cases.map(|(video, ..)| video));
    published.expect_whole(&videos);
    for (video, status, remedy) in cases {
        let row = published.row(video);
        assert_eq!(row["status"], status, "{video}: {}", row["status_reason"]);
        assert!(
            row["status_reason"].as_str().unwrap().contains(remedy),
            "{video}: {}",
            row["status_reason"]
        );
        assert_eq!(
            row["bytes"],
            place.video(video).metadata().unwrap().len(),
            "{video}"
        );
        assert!(row["anomaly"].is_null(), "{video}");
    }
    assert_eq!(published.corpus()["statuses"]["scored"], 3);
    let untouched = matches!(bait.accept(), Err(error) if error.kind() == ErrorKind::WouldBlock);
    assert!(
        untouched,
        "something connected to the address in a playlist"
    );
}

/// A corpus without a single score is still finished, counted and published.
#[test]
fn nothing_but_broken_videos() {
    let place = Place::new();
    for name in ["a.mp4", "b.mp4"] {
        std::fs::write(place.video(name), "text").unwrap();
    }
    let ended = place
        .run("out", &["--json"])
        .expect_code(3)
        .expect_line(&["undecodable: a.mp4", "give a video"]);
    assert_eq!(ended.json()["statuses"]["undecodable"], 2);
    place.published("out").expect_whole(&["a.mp4", "b.mp4"]);
}

#[test]
fn limits_come_from_file_and_environment() {
    let place = Place::with_clips(2);
    let limited = |row: &str| {
        let row = place.published("out").row(row);
        assert_eq!(row["status"], "over_limit", "{row:?}");
        row["status_reason"].as_str().unwrap().to_owned()
    };
    std::fs::write(
        place.path("plumbline.toml"),
        "[decode]\nmax_pixels_per_frame = 3000\n",
    )
    .unwrap();
    place.run("out", &[]).expect_code(3).expect_line(&[
        "over_limit: clip-00.mp4",
        "3072 pixels",
        "limit of 3000",
    ]);
    assert!(limited("clip-01.mp4").contains("limit of 3000"));

    let mut command = place.score(&["videos", "--out", "out", "--profile", "draft"]);
    command
        .env("PLUMBLINE_DECODE__MAX_PIXELS_PER_FRAME", "4000")
        .env("PLUMBLINE_DECODE__MAX_FRAMES", "9");
    Started::start(&mut command)
        .wait()
        .expect_code(3)
        .expect_line(&["2 measured now"]);
    assert!(limited("clip-00.mp4").contains("10 frames"));

    // The limits are part of the profile: raising them measures again.
    std::fs::remove_file(place.path("plumbline.toml")).unwrap();
    place
        .run("out", &[])
        .expect_code(0)
        .expect_line(&["2 measured now"]);
}

#[test]
fn names_of_any_kind_keep_their_place() {
    let place = Place::new();
    let names: [&[u8]; 8] = [
        b"-dash.mp4",
        b"a b.mp4",
        b"a,\"b\".mp4",
        b"line\nbreak.mp4",
        b"not-utf8-\xff.mp4",
        b"tab\t.mp4",
        "\u{fc}ber/\u{52d5}\u{753b} \u{1f916}.mp4".as_bytes(),
        b"{x}*[y]?.mp4",
    ];
    for (seed, name) in names.iter().enumerate() {
        clips::write_moving(&place.video(OsStr::from_bytes(name)), seed as u64);
    }
    std::fs::write(place.video("bad\n\u{1b}[31mname.mp4"), "text").unwrap();
    let ended = place
        .run("out", &["--group-by", "path:1"])
        .expect_code(3)
        .expect_line(&["undecodable: bad\\n\\u{1b}[31mname.mp4: not a video"]);
    assert!(
        !ended.stderr.contains('\u{1b}'),
        "a name reached the terminal as a command"
    );
    let published = place.published("out");
    let videos: Vec<String> = names
        .iter()
        .map(|name| {
            String::from_utf8(name.to_vec()).unwrap_or_else(|_| "not-utf8-%FF.mp4".to_owned())
        })
        .chain(["bad\n\u{1b}[31mname.mp4".to_owned()])
        .collect();
    published.expect_whole(&videos);
    assert_eq!(published.corpus()["statuses"]["scored"], names.len());

    // The same names typed: after `--` nothing is a flag, and an existing file is no pattern.
    for (seed, name) in [(0, "-dash.mp4"), (7, "{x}*[y]?.mp4")] {
        clips::write_moving(&place.path(name), seed);
        let words = ["--out", "typed", "--profile", "draft", "--", name];
        Started::start(&mut place.score(&words))
            .wait()
            .expect_code(0);
        place.published("typed").expect_whole(&[name]);
    }
}

/// Things that are no files, under the names of videos.
#[test]
fn pipes_directories_and_links_do_not_hang_or_vanish() {
    let place = Place::with_clips(3);
    let made = place
        .command("mkfifo")
        .arg(place.video("pipe.mp4"))
        .status()
        .unwrap();
    assert!(made.success());
    std::fs::create_dir(place.video("empty-directory.mp4")).unwrap();
    clips::write_moving(&place.video("directory.mp4/inside.mp4"), 5);
    symlink("nowhere.mp4", place.video("dangling.mp4")).unwrap();
    symlink("loop-b.mp4", place.video("loop-a.mp4")).unwrap();
    symlink("loop-a.mp4", place.video("loop-b.mp4")).unwrap();
    symlink("clip-00.mp4", place.video("twin.mp4")).unwrap();
    symlink("..", place.video("directory.mp4/up")).unwrap();

    place
        .run("out", &[])
        .expect_code(3)
        .expect_line(&[
            "failed: pipe.mp4",
            "pipe.mp4: cannot be read (not a regular file)",
            "run again",
        ])
        .expect_line(&["failed: dangling.mp4", "No such file"])
        .expect_line(&["failed: loop-a.mp4", "symbolic links"]);
    let published = place.published("out");
    published.expect_whole(&[
        "clip-00.mp4",
        "clip-01.mp4",
        "clip-02.mp4",
        "dangling.mp4",
        "directory.mp4/inside.mp4",
        "loop-a.mp4",
        "loop-b.mp4",
        "pipe.mp4",
        "twin.mp4",
    ]);
    assert_eq!(
        published.row("twin.mp4")["digest"],
        published.row("clip-00.mp4")["digest"]
    );

    // Named one by one they are no different.
    for (name, reason) in [
        ("pipe.mp4", "not a regular file"),
        ("dangling.mp4", "No such file"),
        ("loop-a.mp4", "symbolic links"),
    ] {
        let source = format!("videos/{name}");
        Started::start(&mut place.score(&[&source, "--out", "typed"]))
            .wait()
            .expect_code(3)
            .expect_line(&[name, reason]);
        place.published("typed").expect_whole(&[name]);
    }
    std::fs::write(
        place.path("list.txt"),
        "videos/pipe.mp4\nvideos/empty-directory.mp4\nvideos/clip-00.mp4\n",
    )
    .unwrap();
    Started::start(&mut place.score(&["list.txt", "--out", "listed", "--profile", "draft"]))
        .wait()
        .expect_code(3);
    let listed = place.published("listed");
    listed.expect_whole(&[
        "videos/clip-00.mp4",
        "videos/empty-directory.mp4",
        "videos/pipe.mp4",
    ]);
    assert_ne!(listed.row("videos/empty-directory.mp4")["status"], "scored");
}

/// A clip that takes too long, for whatever reason, is ended and named; a longer deadline measures it.
#[test]
fn a_passed_deadline_is_a_failed_row_that_is_tried_again() {
    let place = Place::with_clips(3);
    place
        .run("out", &["--deadline", "0.001"])
        .expect_code(3)
        .expect_line(&[
            "failed: clip-00.mp4: not measured within 0.001 s",
            "raise --deadline",
        ]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "clip-01.mp4", "clip-02.mp4"]);
    assert_eq!(published.corpus()["statuses"]["failed"], 3);
    // A deadline beyond all clocks is none.
    place
        .run("out", &["--deadline", "1e300"])
        .expect_code(0)
        .expect_line(&["3 measured now"]);
}

/// The same in the middle of a long clip, beside clips that are fast enough.
#[test]
fn a_clip_that_is_too_slow_costs_its_own_row() {
    let place = Place::with_clips(3);
    clips::write_long(&place.video("long.mp4"), 0);
    // Twenty times what a short clip takes at `standard`, and a fraction of the long one.
    let words = ["--deadline", "4", "--jobs", "1"];
    Started::start(place.score(&["videos", "--out", "out"]).args(words))
        .wait()
        .expect_code(3)
        .expect_line(&["failed: long.mp4: not measured within 4 s"]);
    let published = place.published("out");
    published.expect_whole(&["clip-00.mp4", "clip-01.mp4", "clip-02.mp4", "long.mp4"]);
    assert_eq!(published.corpus()["statuses"]["failed"], 1);
}

/// From the smallest picture to the widest that is measured, and one beyond.
#[test]
fn unusual_sizes_are_measured_or_refused_by_name() {
    let place = Place::new();
    let sizes = [(2, 2), (16, 16), (17, 33), (48, 384), (384, 48), (450, 50)];
    for (width, height) in sizes {
        let path = place.video(format!("{width}x{height}.mp4"));
        let frames: Vec<_> = (0..clips::FRAMES)
            .map(|index| clips::moving_squares(width, height, index))
            .collect();
        clips::write(&path, &frames);
    }
    place
        .run("out", &["--recipe", "paper"])
        .expect_code(3)
        .expect_line(&["over_limit: 450x50.mp4", "8:1", "crop it"]);
    let published = place.published("out");
    published.expect_whole(&sizes.map(|(width, height)| format!("{width}x{height}.mp4")));
    for (width, height) in &sizes[..5] {
        let row = published.row(&format!("{width}x{height}.mp4"));
        let judged = ["scored", "static", "collapsed"];
        assert!(
            judged.iter().any(|status| row["status"] == *status),
            "{row:?}"
        );
    }
}

/// A picture of 8192×8192 is refused by its header, whatever its bytes would decode to.
#[test]
fn a_real_8k_square_is_over_the_limit() {
    let place = Place::new();
    let side = 8192;
    let grey = plumbline_vision::image::Rgb8 {
        width: side,
        height: side,
        data: vec![90; side * side * 3],
    };
    clips::write(&place.video("huge.mp4"), &[grey]);
    place.run("out", &[]).expect_code(3).expect_line(&[
        "over_limit: huge.mp4",
        "67108864 pixels",
        "scale it down",
    ]);
    assert_eq!(
        place.published("out").row("huge.mp4")["status"],
        "over_limit"
    );
}
