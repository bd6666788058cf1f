//! Videos in an object store are measured as if they were files.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "what does not work fails the test"
)]

#[cfg(test)]
mod support;

use std::fs;
use std::ops::ControlFlow;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use plumbline_common::message::{self, Job, Location, ObjectLocation, Part, PartLocation, Whole};
use plumbline_common::row::Measurement;
use plumbline_common::store::{DirStore, ObjectKey, ObjectStore};
use plumbline_worker::child::{Drawing, SlotError};
use plumbline_worker::explain::{DrawJob, Marked, Subject};
use plumbline_worker::measure::frames::FramesJob;
use plumbline_worker::measure::shape::Told;
use plumbline_worker::slam::SlamOutcome;
use support::{BUCKET, as_object, clip, fetcher, file_job, profile, slot};

#[tokio::test]
async fn an_object_and_a_file_of_the_same_bytes_give_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("objects");
    fs::create_dir(&root).unwrap();
    clip(&root.join("good.mp4"));
    let whole = fs::read(root.join("good.mp4")).unwrap();
    fs::write(root.join("cut.mp4"), &whole[..whole.len() / 2]).unwrap();
    fs::write(root.join("empty.mp4"), "").unwrap();
    fs::write(root.join("text.mp4"), "#EXTM3U\n/etc/passwd\n").unwrap();
    let fetcher = fetcher(&root, &dir.path().join("scratch")).await;
    let mut slot = slot(&fetcher);
    for (name, status) in [
        ("good.mp4", "scored"),
        ("cut.mp4", "undecodable"),
        ("empty.mp4", "undecodable"),
        ("text.mp4", "undecodable"),
    ] {
        let file = file_job(name, &root.join(name));
        let of_file = slot.measure(&file).await.unwrap();
        let of_object = slot.measure(&as_object(&file, name)).await.unwrap();
        let measured = &of_object.outcome.measurement;
        assert_eq!(
            measured.status.as_str(),
            status,
            "{:?}",
            measured.status_reason
        );
        let bytes = |row: &Measurement| message::encode(row).unwrap();
        assert!(
            bytes(measured) == bytes(&of_file.outcome.measurement),
            "{name}"
        );
        assert_eq!(of_object.outcome.thumbnails, of_file.outcome.thumbnails);
    }

    // A limit of the profile: refused before a byte is fetched, in a file's words.
    let mut limited = file_job("good.mp4", &root.join("good.mp4"));
    let mut small = profile();
    small.limits.max_bytes = 100;
    limited.profile = small.canonical().unwrap();
    let of_file = slot.measure(&limited).await.unwrap().outcome.measurement;
    let of_nothing = as_object(&limited, "not-there.mp4");
    let of_object = slot.measure(&of_nothing).await.unwrap().outcome.measurement;
    assert_eq!(of_object.status.as_str(), "over_limit");
    assert_eq!(of_object, of_file);

    // No copy is left, and nothing but the scratch directory's lock.
    let scratch = fs::read_dir(dir.path().join("scratch")).unwrap();
    let scratch: Vec<_> = scratch.map(|entry| entry.unwrap().path()).collect();
    assert_eq!(scratch.len(), 1);
    assert_eq!(fs::read_dir(&scratch[0]).unwrap().count(), 1);
    drop((slot, fetcher));
    assert!(!scratch[0].exists());
}

/// The job of the frames between two times of the file that `job` names, where it lies or as an object.
fn episode(job: &Job, whole: Whole, [from_ns, to_ns]: [i64; 2]) -> Job {
    let part = Part::Interval { from_ns, to_ns };
    Job {
        location: Location::Part(PartLocation { whole, part }),
        ..job.clone()
    }
}

/// An object in the version that lies in `root`.
async fn object(root: &Path, key: &str) -> ObjectLocation {
    let meta = DirStore::new(root)
        .head(&ObjectKey::new(key).unwrap())
        .await;
    ObjectLocation {
        bucket: BUCKET.to_owned(),
        key: key.to_owned(),
        etag: meta.unwrap().etag,
        modified_s: None,
    }
}

const HALVES_NS: [[i64; 2]; 2] = [[0, 400_000_000], [400_000_000, 800_000_000]];

/// Job by job the same rows as of the file where it lies.
#[tokio::test]
async fn a_file_of_many_episodes_is_fetched_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    clip(&path);
    let fetcher = fetcher(dir.path(), &dir.path().join("scratch")).await;
    let mut slot = slot(&fetcher);
    let job = file_job("a", &path);
    let mut measured = async |job: &Job| slot.measure(job).await.unwrap().outcome.measurement;
    let marked = object(dir.path(), "a.mp4").await;
    let mut fetched = Vec::new();
    for half in HALVES_NS {
        let of_object = episode(&job, Whole::Object(marked.clone()), half);
        fetched.push(fetcher.fetch(&of_object).await.unwrap().bytes);
        let of_object = measured(&of_object).await;
        assert!(of_object.frames.is_some(), "{of_object:?}");
        let lying = Whole::File(path.as_os_str().as_bytes().to_vec());
        assert_eq!(of_object, measured(&episode(&job, lying, half)).await);
    }
    assert_eq!(fetched, [job.bytes, 0]);
    // What may have changed unseen is fetched each time.
    let unmarked = ObjectLocation {
        etag: None,
        ..marked
    };
    let unmarked = episode(&job, Whole::Object(unmarked), HALVES_NS[0]);
    for _ in 0..2 {
        assert_eq!(fetcher.fetch(&unmarked).await.unwrap().bytes, job.bytes);
    }
}

#[tokio::test]
async fn what_is_kept_makes_room_for_what_is_needed() {
    let dir = tempfile::tempdir().unwrap();
    let (path, scratch) = (dir.path().join("a.mp4"), dir.path().join("scratch"));
    clip(&path);
    let job = file_job("a", &path);
    let fetcher = fetcher(dir.path(), &scratch).await;
    let whole = Whole::Object(object(dir.path(), "a.mp4").await);
    let [kept, again] = HALVES_NS.map(|half| episode(&job, whole.clone(), half));
    fetcher.fetch(&kept).await.unwrap();
    let own = fs::read_dir(&scratch).unwrap().next().unwrap().unwrap();
    // The next copy cannot be written, as on a full disk; the one after it can.
    fs::write(own.path().join("1"), "").unwrap();
    fetcher.fetch(&as_object(&job, "a.mp4")).await.unwrap();
    assert!(!own.path().join("0").exists());
    assert_eq!(fetcher.fetch(&again).await.unwrap().bytes, job.bytes);
}

#[tokio::test]
async fn every_question_to_a_child_works_on_an_object() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    clip(&path);
    let fetcher = fetcher(dir.path(), &dir.path().join("scratch")).await;
    let mut slot = slot(&fetcher);
    let file = file_job("a", &path);
    let object = as_object(&file, "a.mp4");

    let of_file = slot.measure_in_detail(&file).await.unwrap();
    let of_object = slot.measure_in_detail(&object).await.unwrap();
    assert_eq!(of_object.outcome.measurement, of_file.outcome.measurement);
    assert_eq!(of_object.faults, of_file.faults);
    assert_eq!(of_object.times_s.len(), 8);

    let frames = |job: &Job| FramesJob {
        job: job.clone(),
        frames: 3,
        max_side_px: 64,
    };
    let of_object = slot.frames(&frames(&object)).await.unwrap().unwrap();
    assert_eq!(of_object.frames.len(), 3);
    assert_eq!(
        of_object,
        slot.frames(&frames(&file)).await.unwrap().unwrap()
    );

    let mut draw = async |job: &Job| {
        let request = DrawJob {
            job: job.clone(),
            heat_maps: vec![(Subject::EndPointError, 3)],
            overlay: false,
            marked: Marked::default(),
        };
        let mut pictures = Vec::new();
        let mut take = |picture| {
            pictures.push(picture);
            ControlFlow::Continue(())
        };
        assert_eq!(
            slot.draw(&request, &mut take).await.unwrap(),
            Drawing::Whole
        );
        pictures
    };
    let of_object = draw(&object).await;
    assert_eq!(of_object.len(), 1);
    assert_eq!(of_object, draw(&file).await);

    let of_object = slot.shape(&object).await.unwrap();
    assert!(matches!(of_object, Told::Shape(shape) if shape.frames == 8));
    assert_eq!(of_object, slot.shape(&file).await.unwrap());

    let of_object = slot.track(&object).await.unwrap();
    match (&of_object, &slot.track(&file).await.unwrap()) {
        (SlamOutcome::Refused { reason, .. }, of_file) => {
            panic!("{reason} {of_file:?}");
        }
        (SlamOutcome::Tracked(a), SlamOutcome::Tracked(b)) => {
            assert_eq!(a.residual_px, b.residual_px);
        }
        (_, SlamOutcome::Refused { reason, .. }) => panic!("{reason}"),
    }
}

/// The middle of a long object is not read: there lies what would not decode, and what nobody reads in a file.
#[tokio::test]
async fn of_an_object_only_the_ends_are_read_for_its_header() {
    let dir = tempfile::tempdir().unwrap();
    let (path, long) = (dir.path().join("a.mp4"), dir.path().join("long.mp4"));
    clip(&path);
    let bytes = fs::read(&path).unwrap();
    let index = bytes.windows(4).position(|name| name == b"moov").unwrap() - 4;
    // A box that players skip stands before the index, which lies at the end or is moved there.
    const SKIPPED_BYTES: usize = 1 << 20;
    let mut skipped = (SKIPPED_BYTES as u32).to_be_bytes().to_vec();
    skipped.extend(b"free");
    skipped.resize(SKIPPED_BYTES, 7);
    let whole = [&bytes[..index], &skipped, &bytes[index..]].concat();
    fs::write(&long, &whole).unwrap();
    let fetcher = fetcher(dir.path(), &dir.path().join("scratch")).await;
    let mut slot = slot(&fetcher);
    let expected = slot.shape(&file_job("a", &path)).await.unwrap();
    assert!(matches!(expected, Told::Shape(_)));
    let file = file_job("long", &long);
    let object = as_object(&file, "long.mp4");
    assert_eq!(slot.shape(&file).await.unwrap(), expected);
    assert_eq!(slot.shape(&object).await.unwrap(), expected);
    // An index in the middle is not found, which says nothing of the video.
    let tail = vec![7; SKIPPED_BYTES];
    fs::write(&long, [&whole[..], &skipped[..8], &tail[8..]].concat()).unwrap();
    let file = file_job("long", &long);
    let object = as_object(&file, "long.mp4");
    assert_eq!(slot.shape(&file).await.unwrap(), expected);
    assert_eq!(slot.shape(&object).await.unwrap(), Told::Silent);
    // What is not there is refused.
    let gone = as_object(&file, "gone.mp4");
    assert_eq!(slot.shape(&gone).await.unwrap(), Told::Refused);
}

#[tokio::test]
async fn texts_name_the_object_and_are_the_same_everywhere() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    clip(&path);
    let fetcher = fetcher(dir.path(), &dir.path().join("scratch")).await;
    let mut slot = slot(&fetcher);
    let there = as_object(&file_job("a", &path), "a.mp4");
    let changed = Job {
        bytes: there.bytes - 1,
        ..there.clone()
    };
    let gone = as_object(&there, "gone.mp4");
    let no_path = as_object(&there, "../a.mp4");
    for (job, said) in [
        (
            changed,
            "s3://bucket/a.mp4: changed after the list of videos was made; run again to score what is there now",
        ),
        (
            gone,
            "s3://bucket/gone.mp4: there is no such object; it was removed, or the key is wrong",
        ),
        (
            no_path,
            "s3://bucket/../a.mp4: the key is none that the store can hold; rename the object",
        ),
    ] {
        let row = slot.measure(&job).await.unwrap().outcome.measurement;
        assert_eq!(row.status.as_str(), "failed");
        assert_eq!(row.status_reason.as_deref(), Some(said));
        assert_eq!(row.bytes, Some(job.bytes));
    }
}

#[tokio::test]
async fn without_room_for_copies_an_embedded_run_stops_rather_than_failing_videos() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    clip(&path);
    // A file where the scratch directory should be.
    let fetcher = fetcher(dir.path(), &path).await;
    let stopped = slot(&fetcher)
        .measure(&as_object(&file_job("a", &path), "a.mp4"))
        .await;
    let Err(SlotError::Fetch(error)) = stopped else {
        panic!("{stopped:?}");
    };
    assert!(error.to_string().contains("cannot be written"), "{error}");
}
