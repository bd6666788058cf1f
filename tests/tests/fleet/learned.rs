//! Learned networks on a fleet: the coordinator names model sets by digest, a worker fetches them from the
//! object store, verifies and keeps them, and measures what one machine measures.

use std::path::Path;

use bytes::Bytes;
use plumbline_common::store::{ObjectKey, ObjectStore};
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::scene::Family;
use plumbline_tests::clips;
use plumbline_tests::run::Started;

use crate::setup::Fleet;

const SMALL: &str =
    "rung = \"reference\"\n[droid]\narea_px = 16384\n[droid.tracker]\nbackend_steps = [2, 2]\n";

#[tokio::test]
async fn a_worker_fetches_models_by_digest_and_measures_the_same() {
    let work = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (sets, library) = (
        work.join("models"),
        work.join("models-venv/libonnxruntime.so"),
    );
    if !(sets.join("done").is_file() && library.is_file()) {
        eprintln!("skipped: no models; deploy/test.sh makes them");
        return;
    }
    let fleet = Fleet::new("learned");
    let spec = ClipSpec {
        frames: 4,
        fps: 10.0,
        ..ClipSpec::clean(Family::Dolly, 0, 0).with_size(256, 256)
    };
    clips::write(&fleet.place.video("clip.mp4"), &clips::frames(&spec));
    fleet.upload().await;
    let store = fleet.store("models").await;
    for set in ["sea-raft-small", "droid"] {
        for file in std::fs::read_dir(sets.join(set)).unwrap() {
            let path = file.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let key = ObjectKey::new(format!("{set}/{name}")).unwrap();
            store
                .put(&key, Bytes::from(std::fs::read(&path).unwrap()))
                .await
                .unwrap();
        }
    }
    let place = fleet.address("models");
    let cache = fleet.place.path("cache");
    std::fs::write(fleet.place.path("small.toml"), SMALL).unwrap();
    let source = fleet.address("videos");
    let score = |out: &str, words: &[&str]| {
        let mut command = fleet.plumbline(&["score", &source, "--out", out]);
        command.args(["--profile", "small.toml"]).args(words);
        command.env("PLUMBLINE_MODELS__CACHE", fleet.place.path("own-cache"));
        Started::start(&mut command)
    };
    let library = library.to_str().unwrap();
    let local = ["--models", sets.to_str().unwrap(), "--onnxruntime", library];
    score("embedded", &local).wait().expect_code(0);

    let words = ["--models", &place, "--onnxruntime", library];
    let mut worker = fleet.command(plumbline_tests::binary::worker());
    worker.env("PLUMBLINE_MODELS__CACHE", &cache);
    let _worker = fleet.worker_of(worker, "first", &words);
    // The coordinator needs no library: it only names the sets.
    score("out", &["--queue", "--models", &place])
        .wait()
        .expect_code(0);
    let rows = fleet.place.published("out").rows();
    assert_eq!(rows, fleet.place.published("embedded").rows());
    assert_eq!(rows[0]["status"], "scored");
    assert!(rows[0]["worldscore_3d"].is_number());
    // By digest, whole.
    let kept: Vec<_> = std::fs::read_dir(&cache)
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    let models = rows[0]["models"].as_str().unwrap();
    assert_eq!(kept.len(), 2);
    assert!(
        kept.iter()
            .all(|name| models.contains(name.to_str().unwrap())),
        "{kept:?} {models}"
    );
}
