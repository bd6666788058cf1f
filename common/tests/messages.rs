//! Messages that older programs wrote must decode for ever: their bytes lie in `fixtures/`, one file per
//! message and wire version, and are never changed. A new field needs `#[serde(default)]`, or a new
//! wire version. [`write_fixtures`] writes those that are missing; it replaces none.

use std::path::PathBuf;

use plumbline_common::id::{RunId, VideoId};
use plumbline_common::message::{
    self, FleetJob, FleetResult, Job, Location, MAX_MESSAGE_BYTES, MessageError, ObjectLocation,
    Outcome, Part, PartLocation, Thumbnails, WIRE_VERSION, Whole,
};
use plumbline_common::row::{Cost, GeometryMethod, Measurement, Scene, Series, Status};
use serde::Serialize;

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/{name}.msgpack"))
}

#[expect(clippy::unwrap_used, reason = "a fixed name")]
fn file_job() -> Job {
    Job {
        video: VideoId::new("task/ünï \"1\"\n.mp4").unwrap(),
        location: Location::File(b"/data/\xff.mp4".to_vec()),
        bytes: u64::MAX,
        modified_ns: -1,
        profile: b"{\"rung\":\"standard\"}".to_vec(),
    }
}

fn images_job() -> Job {
    Job {
        location: Location::ImageSequence(b"/data/frames".to_vec()),
        modified_ns: 1_700_000_000_123_456_789,
        ..file_job()
    }
}

#[expect(clippy::unwrap_used, reason = "a fixed name")]
fn object_job(etag: Option<&str>, modified_s: Option<i64>) -> FleetJob {
    FleetJob {
        run: RunId::new("night-1_a").unwrap(),
        job: Job {
            location: Location::Object(ObjectLocation {
                bucket: "b".to_owned(),
                key: "a//../ünï \"1\"\n.mp4".to_owned(),
                etag: etag.map(str::to_owned),
                modified_s,
            }),
            ..file_job()
        },
    }
}

fn member_job() -> Job {
    Job {
        location: Location::Part(PartLocation {
            whole: Whole::File(b"/data/\xff.tar".to_vec()),
            part: Part::Bytes {
                offset: u64::MAX,
                bytes: 1,
            },
        }),
        ..file_job()
    }
}

#[expect(clippy::unwrap_used, reason = "an object")]
fn episode_job() -> FleetJob {
    let object = object_job(Some("e"), None);
    let whole = object.job.location.object().cloned().map(Whole::Object);
    FleetJob {
        job: Job {
            location: Location::Part(PartLocation {
                whole: whole.unwrap(),
                part: Part::Interval {
                    from_ns: -50_000_000,
                    to_ns: i64::MAX,
                },
            }),
            ..object.job
        },
        run: object.run,
    }
}

fn answered() -> FleetResult {
    FleetResult {
        run: object_job(None, None).run,
        outcome: failed(),
        attempts: 3,
        worker: "host-1/7".to_owned(),
    }
}

fn scored() -> Outcome {
    Outcome {
        video: file_job().video,
        measurement: Measurement {
            status_reason: None,
            digest: Some("ab".repeat(32)),
            bytes: Some(12),
            frames: Some(3),
            fps: Some(29.97),
            width: Some(320),
            height: Some(240),
            duration_s: Some(0.1),
            scene: Some(Scene::StaticCamera),
            motion_px: Some(1.5),
            reproj_px: Some(f64::MIN_POSITIVE),
            reproj_method: Some(GeometryMethod::TwoViewGric),
            aepe_worldscore_px: Some(0.1 + 0.2),
            fault_frames: Some(vec![2]),
            fault_kinds: Some(vec!["jump".to_owned()]),
            series: Series {
                first_frame: 1,
                aepe_px: vec![Some(0.25), None],
                reproj_cells: vec![7, 0],
                ..Series::default()
            },
            ..Measurement::without_score(Status::Scored, "")
        },
        cost: Cost {
            total_s: 1.25,
            ..Cost::default()
        },
        thumbnails: Some(Thumbnails {
            frame_jpeg: vec![0xff, 0xd8],
            heat_jpeg: vec![],
        }),
    }
}

fn failed() -> Outcome {
    Outcome {
        measurement: Measurement::without_score(Status::Failed, "the deadline passed"),
        cost: Cost::default(),
        thumbnails: None,
        ..scored()
    }
}

#[test]
fn messages_of_version_1_decode_for_ever() {
    let bytes = |name| std::fs::read(fixture(name)).unwrap();
    let job = |name| message::decode::<Job>(&bytes(name)).unwrap();
    let outcome = |name| message::decode::<Outcome>(&bytes(name)).unwrap();
    assert_eq!(job("job-file-v1"), file_job());
    assert_eq!(job("job-images-v1"), images_job());
    assert_eq!(outcome("outcome-scored-v1"), scored());
    assert_eq!(outcome("outcome-failed-v1"), failed());
    let fleet_job = |name| message::decode::<FleetJob>(&bytes(name)).unwrap();
    assert_eq!(job("job-member-v1"), member_job());
    assert_eq!(fleet_job("fleet-job-episode-v1"), episode_job());
    let whole = object_job(Some("\"e-1\""), Some(-1));
    assert_eq!(fleet_job("fleet-job-object-v1"), whole);
    let listed_bare = object_job(None, None);
    assert_eq!(fleet_job("fleet-job-bare-object-v1"), listed_bare);
    let result = message::decode::<FleetResult>(&bytes("fleet-result-v1")).unwrap();
    assert_eq!(result, answered());
}

/// By the ids collectors recognise work across restarts and versions: they must never change.
#[test]
fn a_job_and_its_result_have_one_name_for_ever() {
    let name = "night-1_a/087312c9dc2c41d63940b35ce809501e044c5df25b17871ed1edb8343766046a";
    assert_eq!(object_job(None, None).message_id(), name);
    assert_eq!(answered().message_id(), name);
}

#[test]
#[ignore = "writes the fixtures that are missing"]
fn write_fixtures() {
    fn write(name: &str, message: &impl Serialize) {
        use std::io::Write;
        let path = fixture(&format!("{name}-v{WIRE_VERSION}"));
        let Ok(mut file) = std::fs::File::create_new(path) else {
            return;
        };
        file.write_all(&message::encode(message).unwrap()).unwrap();
    }
    write("job-file", &file_job());
    write("job-images", &images_job());
    write("job-member", &member_job());
    write("fleet-job-episode", &episode_job());
    write("outcome-scored", &scored());
    write("outcome-failed", &failed());
    let whole = object_job(Some("\"e-1\""), Some(-1));
    write("fleet-job-object", &whole);
    write("fleet-job-bare-object", &object_job(None, None));
    write("fleet-result", &answered());
}

#[test]
fn no_prefix_and_no_flipped_bit_of_a_message_panics() {
    let bytes = message::encode(&scored()).unwrap();
    for cut in 0..bytes.len() {
        assert!(
            message::decode::<Outcome>(&bytes[..cut]).is_err(),
            "cut at {cut}"
        );
    }
    for bit in 0..bytes.len() * 8 {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        // A flipped bit of a number is another number: the frames and queues around it check.
        let _typed_either_way = message::decode::<Outcome>(&damaged);
    }
}

#[test]
fn a_length_that_lies_costs_no_memory() {
    // A map of 4 billion entries, a string of 4 GiB, an array of the same: announced, not there.
    for lie in [[0xdf_u8], [0xdb], [0xdd], [0xc6]] {
        let mut bytes = vec![WIRE_VERSION];
        bytes.extend(lie);
        bytes.extend([0xff; 4]);
        let decoded = message::decode::<Job>(&bytes);
        assert!(
            matches!(decoded, Err(MessageError::Decode(_))),
            "{decoded:?}"
        );
    }
}

#[test]
fn versions_to_come_and_sizes_beyond_the_limit_are_typed() {
    let mut future = message::encode(&file_job()).unwrap();
    future[0] = WIRE_VERSION + 1;
    let decoded = message::decode::<Job>(&future);
    assert!(
        matches!(decoded, Err(MessageError::Version { found }) if found == WIRE_VERSION + 1),
        "{decoded:?}"
    );
    let mut large = scored();
    large.thumbnails = Some(Thumbnails {
        frame_jpeg: vec![0; MAX_MESSAGE_BYTES],
        heat_jpeg: vec![],
    });
    let encoded = message::encode(&large);
    assert!(matches!(encoded, Err(MessageError::TooLarge { .. })));
}
