//! Object sources over directories in the place of buckets.

use std::collections::BTreeMap;
use std::path::PathBuf;

use plumbline_common::store::DirStore;
use tempfile::TempDir;

use super::*;
use plumbline_common::message::Location;

use crate::corpus::{Choice, Listing, freeze, freeze_anywhere};

/// Directories in the place of buckets.
struct Directories(TempDir);

#[async_trait]
impl Buckets for Directories {
    async fn open(&self, bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
        Ok(Arc::new(DirStore::new(self.0.path().join(bucket))))
    }
}

impl Directories {
    fn with<Key: AsRef<str>>(keys: &[Key]) -> Self {
        let directories = Self(tempfile::tempdir().unwrap());
        for key in keys {
            directories.put(key.as_ref(), b"x");
        }
        directories
    }

    fn put(&self, key: &str, content: &[u8]) {
        let path = self.0.path().join(key);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }

    async fn freeze(&self, sources: &[&str], out: &str) -> Result<Listing, CorpusError> {
        let sources: Vec<String> = sources.iter().map(|&source| source.to_owned()).collect();
        freeze_anywhere(&sources, &Choice::default(), out, self).await
    }
}

fn names(listing: &Listing) -> Vec<&str> {
    let entries = listing.entries.iter();
    entries.map(|entry| entry.video.as_str()).collect()
}

#[tokio::test]
async fn a_prefix_is_listed_as_a_directory_is_walked() {
    let stores = Directories::with(&[
        "b/p/b.mp4",
        "b/p/a/c d.MOV",
        "b/p/a/.hidden.mp4",
        "b/p/.plumbline/x.mp4",
        "b/p/out/x.mp4",
        "b/p/notes.txt",
        "b/p/frames/0001.png",
        "b/p/frames/0002.png",
        "b/p2/not-below.mp4",
        "b/p/a/ü.webm",
    ]);
    for source in ["s3://b/p", "s3://b/p/"] {
        let listing = stores.freeze(&[source], "s3://b/p/out").await.unwrap();
        assert_eq!(names(&listing), ["a/c d.MOV", "a/ü.webm", "b.mp4"]);
        let ignored = BTreeMap::from([("txt".to_owned(), 1), ("png".to_owned(), 2)]);
        assert_eq!(listing.ignored, ignored);
        let first = &listing.entries[0];
        assert_eq!(first.address(), "s3://b/p/a/c d.MOV");
        assert_eq!(first.bytes, Some(1));
        let Location::Object(object) = &first.location else {
            panic!("{first:?}");
        };
        assert!(object.etag.is_some() || object.modified_s.is_some());
    }
}

#[tokio::test]
async fn the_same_files_have_the_same_names_in_a_directory_and_in_a_bucket() {
    let keys = ["real/x/a.mp4", "generated/a.mp4", "generated/b.gif"];
    let stores = Directories::with(&keys.map(|key| ["b/set/", key].concat()));
    let there = stores.0.path().join("b/set");
    for sources in [
        vec![""],
        vec!["real", "generated"],
        vec!["generated/a.mp4"],
        vec!["generated/a.mp4", "generated"],
        vec!["real/x", "generated/b.gif"],
    ] {
        let in_bucket: Vec<String> = sources.iter().map(|s| format!("s3://b/set/{s}")).collect();
        let in_bucket: Vec<&str> = in_bucket.iter().map(String::as_str).collect();
        let in_directory: Vec<String> = sources
            .iter()
            .map(|source| there.join(source).display().to_string())
            .collect();
        let objects = stores.freeze(&in_bucket, "out").await.unwrap();
        let files = freeze(&in_directory, &Choice::default(), &PathBuf::from("out")).unwrap();
        assert_eq!(names(&objects), names(&files), "{sources:?}");
    }
}

#[tokio::test]
async fn groups_are_directories_below_the_source() {
    let stores = Directories::with(&["b/p/pick/a.mp4", "b/p/place/x/a.mp4"]);
    let sources = ["s3://b/p".to_owned()];
    let choice = Choice {
        group_by: Some("path:1".parse().unwrap()),
        ..Choice::default()
    };
    let listing = freeze_anywhere(&sources, &choice, "out", &stores)
        .await
        .unwrap();
    let groups: Vec<_> = listing.entries.iter().map(|e| e.group.as_deref()).collect();
    assert_eq!(groups, [Some("pick"), Some("place")]);
}

#[tokio::test]
async fn lists_name_objects_wherever_they_lie() {
    let stores = Directories::with(&["b/p/a.mp4", "c/x/y.bin"]);
    let list = "video,task\ns3://b/p/a.mp4,pick\ns3://c/x/y.bin,place\ns3://b/p/gone.mp4,pick\n";
    stores.put("local/list.csv", list.as_bytes());
    stores.put("b/lists/list.csv", list.as_bytes());
    let local = stores.0.path().join("local/list.csv");
    for source in [local.to_str().unwrap(), "s3://b/lists/list.csv"] {
        let listing = stores.freeze(&[source], "out").await.unwrap();
        assert_eq!(
            names(&listing),
            ["s3://b/p/a.mp4", "s3://b/p/gone.mp4", "s3://c/x/y.bin"]
        );
        let [a, gone, y] = &listing.entries[..] else {
            panic!("{listing:?}");
        };
        assert_eq!((a.bytes, a.problem.as_deref()), (Some(1), None));
        assert_eq!(y.carried["task"], "place");
        assert_eq!(gone.bytes, None);
        assert!(gone.problem.as_deref().unwrap().contains("no such object"));
    }
    // Beside the list, as files are.
    stores.put("b/p/list.txt", b"./a.mp4\n");
    let listing = stores.freeze(&["s3://b/p/list.txt"], "out").await.unwrap();
    assert_eq!(names(&listing), ["a.mp4"]);
    assert_eq!(listing.entries[0].address(), "s3://b/p/a.mp4");
    stores.put("b/p/list.txt", b"a.mp4\n./a.mp4\n");
    let twice = stores.freeze(&["s3://b/p/list.txt"], "out").await;
    assert!(twice.unwrap_err().to_string().contains("twice"));
}

#[tokio::test]
async fn what_is_not_there_is_named() {
    let stores = Directories::with(&["b/p/notes.txt"]);
    let empty = stores.freeze(&["s3://b/p"], "out").await.unwrap_err();
    assert!(matches!(empty, CorpusError::Empty { .. }), "{empty}");
    let other = stores.freeze(&["gs://b/p"], "out").await.unwrap_err();
    assert!(other.to_string().contains("s3://BUCKET/PREFIX"), "{other}");
    let files_alone = freeze(
        &["s3://b/p".to_owned()],
        &Choice::default(),
        &PathBuf::from("out"),
    );
    assert!(
        files_alone
            .unwrap_err()
            .to_string()
            .contains("plumbline score")
    );
}

#[tokio::test]
async fn two_objects_of_one_name_are_refused() {
    let stores = Directories::with(&["b/p/a.mp4", "c/p/a.mp4"]);
    stores.put("local/a.mp4", b"y");
    let local = stores.0.path().join("local");
    let sources = ["s3://b/p", local.to_str().unwrap()];
    let error = stores.freeze(&sources, "out").await.unwrap_err();
    assert!(matches!(error, CorpusError::Duplicate { .. }), "{error}");
    let two_buckets = stores.freeze(&["s3://b/p", "s3://c/p"], "out").await;
    assert_eq!(names(&two_buckets.unwrap()), ["b/p/a.mp4", "c/p/a.mp4"]);
}
