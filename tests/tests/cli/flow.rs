//! `plumbline flow`: files in both formats, errors against ground truth, and refusals that name the file
//! and the remedy.

use std::path::Path;

use plumbline_tests::binary::plumbline;
use plumbline_tests::clips;
use plumbline_tests::run::{Ended, Place, Started};
use plumbline_vision::flow::Flow;
use plumbline_vision::flow::file::{KnownFlow, kitti, middlebury};
use plumbline_vision::image::Rgb8;

const WIDTH: usize = 96;
const HEIGHT: usize = 64;

/// `flow` with these words, to its end.
fn flow(place: &Place, words: &[&str]) -> Ended {
    let mut command = place.command(plumbline());
    Started::start(command.arg("flow").args(words)).wait()
}

fn write_picture(path: &Path, picture: &Rgb8) {
    let (width, height) = (picture.width as u32, picture.height as u32);
    image::RgbImage::from_raw(width, height, picture.data.clone())
        .unwrap()
        .save(path)
        .unwrap();
}

/// Two pictures whose squares move one pixel to the left, and their ground truth, which is unknown in the
/// last column.
fn moving_pair() -> (Place, KnownFlow) {
    let place = Place::new();
    for (index, name) in ["a.png", "b.png"].into_iter().enumerate() {
        let picture = clips::moving_squares(WIDTH, HEIGHT, index);
        write_picture(&place.path(name), &picture);
    }
    let mut truth = KnownFlow::dense(Flow {
        width: WIDTH,
        height: HEIGHT,
        data: vec![[-1.0, 0.0]; WIDTH * HEIGHT],
    });
    for row in 0..HEIGHT {
        let last = row * WIDTH + WIDTH - 1;
        truth.known[last] = false;
        truth.flow.data[last] = [0.0; 2];
    }
    std::fs::write(place.path("gt.flo"), middlebury::encode(&truth).unwrap()).unwrap();
    std::fs::write(place.path("gt.png"), kitti::encode(&truth).unwrap()).unwrap();
    (place, truth)
}

#[test]
fn both_formats_hold_the_flow_and_the_error_is_that_of_the_file() {
    let (place, truth) = moving_pair();
    let ended = flow(
        &place,
        &[
            "a.png",
            "b.png",
            "--out",
            "made/here/f.flo",
            "--gt",
            "gt.flo",
            "--preset",
            "ultrafast",
            "--finest-scale",
            "0",
            "--repeat",
            "3",
            "--json",
        ],
    )
    .expect_code(0)
    .expect_line(&["f.flo", "96x64", "ultrafast at finest scale 0"])
    .expect_line(&["time per pair", "of 3"])
    .expect_line(&["end-point error", "px", "known pixels"]);
    let result = ended.json();
    assert_eq!(
        (result["width"].as_u64(), result["height"].as_u64()),
        (Some(96), Some(64))
    );
    assert!(result["pair_ms_min"].as_f64() <= result["pair_ms_median"].as_f64());
    assert!(result["pair_ms_min"].as_f64() > Some(0.0));

    // The error, recomputed from the file in plain words.
    let found = middlebury::decode(&std::fs::read(place.path("made/here/f.flo")).unwrap()).unwrap();
    assert!(found.known.iter().all(|&known| known));
    let errors: Vec<f64> = found
        .flow
        .data
        .iter()
        .zip(&truth.known)
        .filter(|&(_, &known)| known)
        .map(|(v, _)| f64::from(v[0] + 1.0).hypot(f64::from(v[1])))
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let accuracy = &result["accuracy"];
    assert_eq!(
        accuracy["known_pixels"].as_u64(),
        Some(((WIDTH - 1) * HEIGHT) as u64)
    );
    // Two ways to a length: the last bits may differ.
    assert!((accuracy["mean_epe_px"].as_f64().unwrap() - mean).abs() < 1e-9);
    let above =
        |limit: f64| errors.iter().filter(|&&e| e > limit).count() as f64 / errors.len() as f64;
    assert_eq!(accuracy["outlier_share_1px"].as_f64(), Some(above(1.0)));
    assert_eq!(accuracy["outlier_share_3px"].as_f64(), Some(above(3.0)));
    // The motion is found, not only written: standing still would be 1 px off.
    assert!(mean < 0.3, "{mean} px");

    // KITTI's png in and out: the same flow, to its resolution.
    let ended = flow(
        &place,
        &[
            "a.png",
            "b.png",
            "--out",
            "f.png",
            "--gt",
            "gt.png",
            "--preset",
            "ultrafast",
            "--finest-scale",
            "0",
            "--json",
        ],
    )
    .expect_code(0);
    assert_eq!(ended.json()["accuracy"], *accuracy);
    let coarse = kitti::decode(&std::fs::read(place.path("f.png")).unwrap()).unwrap();
    for (a, b) in coarse
        .flow
        .data
        .iter()
        .flatten()
        .zip(found.flow.data.iter().flatten())
    {
        assert!((a - b).abs() <= 0.5 / 64.0);
    }
}

#[test]
fn without_json_nothing_goes_to_standard_output() {
    let (place, _) = moving_pair();
    let ended = flow(&place, &["a.png", "b.png", "--out", "f.flo"]).expect_code(0);
    assert_eq!(ended.stdout, "");
    assert!(!ended.stderr.contains("end-point error"));
}

#[test]
fn unusable_pictures_are_refused_by_name_and_nothing_is_written() {
    let (place, _) = moving_pair();
    write_picture(&place.path("small.png"), &clips::moving_squares(64, 64, 0));
    write_picture(&place.path("line.png"), &clips::moving_squares(1, 50, 0));
    std::fs::write(place.path("text.png"), "no picture").unwrap();
    std::fs::write(place.path("empty.png"), "").unwrap();
    let whole = std::fs::read(place.path("a.png")).unwrap();
    std::fs::write(place.path("half.png"), &whole[..whole.len() / 2]).unwrap();
    let cases: [(&str, &str, &[&str]); 8] = [
        (
            "a.png",
            "small.png",
            &["a.png is 96x64", "small.png is 64x64", "one size"],
        ),
        (
            "line.png",
            "line.png",
            &["line.png", "1x50", "at least 8x8"],
        ),
        (
            "text.png",
            "b.png",
            &["text.png", "not a png or jpeg", "convert it"],
        ),
        ("empty.png", "b.png", &["empty.png", "empty"]),
        ("a.png", "half.png", &["half.png", "does not decode"]),
        (
            "a.png",
            "gone.png",
            &["gone.png", "check that the file exists"],
        ),
        ("videos", "b.png", &["videos", "no regular file"]),
        ("/dev/zero", "b.png", &["/dev/zero", "no regular file"]),
    ];
    for (first, second, words) in cases {
        flow(&place, &[first, second, "--out", "f.flo"])
            .expect_code(2)
            .expect_line(words);
        assert!(!place.path("f.flo").exists());
    }
    flow(&place, &["a.png", "b.png", "--out", "f.txt"])
        .expect_code(2)
        .expect_line(&["f.txt", ".flo", ".png"]);
    // The limit on a picture's size holds here too.
    let mut command = place.command(plumbline());
    command
        .args(["flow", "a.png", "b.png", "--out", "f.flo"])
        .env("PLUMBLINE_DECODE__MAX_PIXELS_PER_FRAME", "6000");
    Started::start(&mut command)
        .wait()
        .expect_code(2)
        .expect_line(&[
            "a.png has 6144 pixels",
            "limit of 6000",
            "max_pixels_per_frame",
        ]);
}

#[test]
fn unusable_ground_truth_is_refused_by_name() {
    let (place, truth) = moving_pair();
    let whole = std::fs::read(place.path("gt.flo")).unwrap();
    let header = |width: i32, height: i32| {
        [&b"PIEH"[..], &width.to_le_bytes(), &height.to_le_bytes()].concat()
    };
    let other = KnownFlow::dense(Flow {
        width: 8,
        height: 8,
        data: vec![[0.0; 2]; 64],
    });
    let cases: [(&str, Vec<u8>, &[&str]); 6] = [
        (
            "cut.flo",
            whole[..whole.len() - 1].to_vec(),
            &["bytes where", "copy it again"],
        ),
        (
            "huge.flo",
            header(i32::MAX, i32::MAX),
            &["2147483647x2147483647", "damaged or no flow"],
        ),
        (
            "negative.flo",
            header(-1, 5),
            &["-1x5", "damaged or no flow"],
        ),
        (
            "text.flo",
            b"hello, world".to_vec(),
            &["no Middlebury .flo", "KITTI 16-bit png"],
        ),
        (
            "other.flo",
            middlebury::encode(&other).unwrap(),
            &["8x8", "96x64", "this very pair"],
        ),
        (
            "picture.png",
            std::fs::read(place.path("a.png")).unwrap(),
            &["no KITTI flow", "16-bit RGB"],
        ),
    ];
    for (name, bytes, words) in cases {
        std::fs::write(place.path(name), bytes).unwrap();
        let words = [&[name][..], words].concat();
        flow(&place, &["a.png", "b.png", "--out", "f.flo", "--gt", name])
            .expect_code(2)
            .expect_line(&words);
        assert!(!place.path("f.flo").exists());
    }

    // No pixel known: a flow, and no error that would be a sentinel.
    let mut unknown = truth;
    unknown.known.fill(false);
    unknown.flow.data.fill([0.0; 2]);
    std::fs::write(
        place.path("none.flo"),
        middlebury::encode(&unknown).unwrap(),
    )
    .unwrap();
    let ended = flow(
        &place,
        &[
            "a.png", "b.png", "--out", "f.flo", "--gt", "none.flo", "--json",
        ],
    )
    .expect_code(0)
    .expect_line(&["knows no pixel"]);
    assert!(ended.json()["accuracy"].is_null());
}
