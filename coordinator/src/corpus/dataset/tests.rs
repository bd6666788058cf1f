//! Datasets as they are published, and as nobody should publish them; in a directory and in a bucket. No video
//! is opened here, so that any bytes are one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use async_trait::async_trait;
use plumbline_common::store::{DirStore, ObjectStore, StoreError};
use serde_json::json;
use tar::{Builder, EntryType, Header};
use tempfile::TempDir;

use super::*;
use crate::corpus::{Buckets, Choice, Listing, freeze, freeze_anywhere};

/// A directory `set`, which is also all of a bucket.
struct Set(TempDir);

#[async_trait]
impl Buckets for Set {
    async fn open(&self, _bucket: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
        Ok(Arc::new(DirStore::new(self.root())))
    }
}

impl Set {
    fn new() -> Self {
        let set = Self(tempfile::tempdir().unwrap());
        std::fs::create_dir(set.root()).unwrap();
        set
    }

    fn root(&self) -> PathBuf {
        self.0.path().join("set")
    }

    fn put(&self, file: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.root().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }

    fn remove(&self, file: &str) {
        std::fs::remove_file(self.root().join(file)).unwrap();
    }

    /// The listing of a source below the directory; that of the bucket is the same but for places.
    async fn freeze(&self, source: &str, choice: &Choice) -> Result<Listing, CorpusError> {
        let local = [format!("{}/{source}", self.root().display())];
        let local = freeze(&local, choice, Path::new("out"));
        let bucket = [format!("s3://b/{source}")];
        let bucket = freeze_anywhere(&bucket, choice, "out", self).await;
        match (&local, &bucket) {
            (Ok(local), Ok(bucket)) => {
                let told = |listing: &Listing| -> Vec<_> {
                    let entries = listing.entries.iter();
                    let told = entries.map(|entry| {
                        let (part, is_there) = (entry.location.part(), entry.problem.is_none());
                        (
                            entry.video.clone(),
                            part,
                            entry.bytes,
                            is_there,
                            entry.carried.clone(),
                        )
                    });
                    told.collect()
                };
                assert_eq!(told(local), told(bucket));
                assert_eq!(local.ignored, bucket.ignored);
            }
            (Err(local), Err(bucket)) => {
                let place = self.root().display().to_string();
                let said = local.to_string().replace(&format!("{place}/"), "s3://b/");
                assert_eq!(said, bucket.to_string());
            }
            _ => panic!("{local:?}, but {bucket:?}"),
        }
        local
    }

    async fn all(&self) -> Listing {
        self.freeze("", &Choice::default()).await.unwrap()
    }

    async fn refused(&self) -> String {
        let refused = self.freeze("", &Choice::default()).await;
        refused.unwrap_err().to_string()
    }
}

fn names(listing: &Listing) -> Vec<&str> {
    let entries = listing.entries.iter();
    entries.map(|entry| entry.video.as_str()).collect()
}

fn entry<'a>(listing: &'a Listing, video: &str) -> &'a Entry {
    let mut entries = listing.entries.iter();
    let found = entries.find(|entry| entry.video.as_str() == video);
    found.unwrap_or_else(|| panic!("{video} is not among {:?}", names(listing)))
}

fn problem<'a>(listing: &'a Listing, video: &str) -> &'a str {
    entry(listing, video).problem.as_deref().unwrap_or_default()
}

// --- WebDataset ---

fn header(kind: EntryType, bytes: u64) -> Header {
    let mut header = Header::new_gnu();
    header.set_entry_type(kind);
    header.set_size(bytes);
    header.set_mode(0o644);
    header.set_cksum();
    header
}

fn shard(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut tar = Builder::new(Vec::new());
    for (name, content) in files {
        let mut header = header(EntryType::Regular, content.len() as u64);
        // The library that writes here leaves the `./` of `tar -c .` out.
        if name.starts_with("./") {
            header.as_old_mut().name[..name.len()].copy_from_slice(name.as_bytes());
            header.set_cksum();
            tar.append(&header, *content).unwrap();
        } else {
            tar.append_data(&mut header, name, *content).unwrap();
        }
    }
    tar.into_inner().unwrap()
}

/// The bytes that an entry is of.
fn content(entry: &Entry) -> Vec<u8> {
    let path = String::from_utf8(entry.location.path().unwrap().to_vec()).unwrap();
    let Some(Part::Bytes { offset, bytes }) = entry.location.part() else {
        panic!("{entry:?}");
    };
    std::fs::read(path).unwrap()[offset as usize..][..bytes as usize].to_vec()
}

#[tokio::test]
async fn members_of_shards_are_videos_with_the_columns_of_their_samples() {
    let set = Set::new();
    let long = format!("deep/{}/9.mp4", "n".repeat(180));
    set.put(
        "train/shard-000000.tar",
        shard(&[
            (
                "0007.json",
                br#"{"seed": 7, "caption": "pick it up", "tags": ["a"]}"#,
            ),
            ("0007.left.mp4", b"left"),
            ("0007.right.mp4", b"right!"),
            ("./a/0008.mp4", &[8; 70_000]),
            ("./a/0008.txt", b" push \n"),
            ("./a/0008.note.txt", "ü".as_bytes()),
            ("__meta__.mp4__", b"x"),
            (&long, b"nine"),
            (&long.replace(".mp4", ".npy"), &[1; 4000]),
        ]),
    );
    set.put("train/shard-000001.tar", shard(&[("0007.mp4", b"another")]));
    set.put("loose.mp4", b"y");
    set.put("texts.tar", shard(&[("a.txt", b"no video")]));
    let listing = set.all().await;
    let nine = format!("train/shard-000000.tar/{long}");
    assert_eq!(
        names(&listing),
        [
            "loose.mp4",
            "train/shard-000000.tar/0007.left.mp4",
            "train/shard-000000.tar/0007.right.mp4",
            "train/shard-000000.tar/a/0008.mp4",
            &nine,
            "train/shard-000001.tar/0007.mp4",
        ]
    );
    assert_eq!(listing.ignored, BTreeMap::from([("tar".to_owned(), 1)]));
    for (video, bytes, key) in [
        ("train/shard-000000.tar/0007.left.mp4", &b"left"[..], "0007"),
        ("train/shard-000000.tar/0007.right.mp4", b"right!", "0007"),
        (
            "train/shard-000000.tar/a/0008.mp4",
            &[8; 70_000],
            "./a/0008",
        ),
        (&nine, b"nine", long.strip_suffix(".mp4").unwrap()),
        ("train/shard-000001.tar/0007.mp4", b"another", "0007"),
    ] {
        let entry = entry(&listing, video);
        assert!(content(entry) == bytes, "{video}");
        assert_eq!(entry.carried["__key__"], key);
        assert!(video.starts_with(entry.carried["__shard__"].as_str().unwrap()));
    }
    let first = &entry(&listing, "train/shard-000000.tar/0007.left.mp4").carried;
    assert_eq!(
        (&first["seed"], &first["prompt"]),
        (&json!(7), &json!("pick it up"))
    );
    let second = &entry(&listing, "train/shard-000000.tar/a/0008.mp4").carried;
    assert_eq!(
        (&second["prompt"], &second["note"]),
        (&json!("push"), &json!("ü"))
    );

    // Groups of a column that only some videos have; and of one that none has.
    let by = |column: &str| Choice {
        group_by: Some(column.parse().unwrap()),
        ..Choice::default()
    };
    let grouped = set.freeze("", &by("prompt")).await.unwrap();
    let groups: Vec<_> = grouped
        .entries
        .iter()
        .filter_map(|entry| entry.group.as_deref())
        .collect();
    assert_eq!(groups, ["pick it up", "pick it up", "push"]);
    assert!(set.freeze("", &by("promt")).await.is_err());
}

#[tokio::test]
async fn shards_are_named_one_by_one_by_pattern_and_by_glob() {
    let set = Set::new();
    for index in 0..3 {
        let file = format!("x/shard-{index:03}.tar");
        set.put(&file, shard(&[("a.mp4", b"1"), ("b.mp4", b"22")]));
    }
    let choice = Choice::default();
    let one = set.freeze("x/shard-001.tar", &choice).await.unwrap();
    assert_eq!(names(&one), ["shard-001.tar/a.mp4", "shard-001.tar/b.mp4"]);
    let two = set.freeze("x/shard-{001..002}.tar", &choice).await.unwrap();
    assert_eq!(
        names(&two)[..3],
        [
            "shard-001.tar/a.mp4",
            "shard-001.tar/b.mp4",
            "shard-002.tar/a.mp4"
        ]
    );
    // Of several sources a shard is named as its videos are: below what they share.
    let several =
        ["x/shard-000.tar", "y"].map(|source| format!("{}/{source}", set.root().display()));
    set.put("y/a.tar", shard(&[("a.mp4", b"1")]));
    let several = freeze(&several, &choice, Path::new("out")).unwrap();
    for entry in &several.entries {
        let shard = entry.carried["__shard__"].as_str().unwrap();
        assert!(
            entry.video.as_str().starts_with(&format!("{shard}/")),
            "{entry:?}"
        );
    }
    assert_eq!(names(&several)[2], "y/a.tar/a.mp4");
    let glob = [format!("{}/x/*-00{{0,2}}.tar", set.root().display())];
    let glob = freeze(&glob, &choice, Path::new("out")).unwrap();
    assert_eq!(glob.entries.len(), 4);
    let missing = [format!("{}/x/shard-{{002..003}}.tar", set.root().display())];
    let missing = freeze(&missing, &choice, Path::new("out")).unwrap_err();
    assert!(missing.to_string().contains("shard-003.tar"), "{missing}");
}

#[tokio::test]
async fn compressed_shards_are_refused_with_the_remedy() {
    let set = Set::new();
    set.put("a.tar.gz", b"\x1f\x8bx");
    let choice = Choice::default();
    let refused = set
        .freeze("a.tar.gz", &choice)
        .await
        .unwrap_err()
        .to_string();
    assert!(refused.contains("unpack it"), "{refused}");
    // Among others it is passed over, and that is said; under a plain name it is a row.
    set.put("b.tar", b"\x1f\x8b\x08rest");
    let listing = set.all().await;
    assert_eq!(listing.ignored, BTreeMap::from([("gz".to_owned(), 1)]));
    assert!(problem(&listing, "b.tar").contains("compressed (gzip)"));
}

#[tokio::test]
async fn hostile_tars_become_rows() {
    let set = Set::new();
    let whole = shard(&[("a.mp4", b"1"), ("b.mp4", &[2; 2000]), ("c.mp4", b"3")]);

    // Cut within a member, and within a header: what is before it stays.
    set.put("cut.tar", &whole[..1536 + 100]);
    set.put("cut-header.tar", &whole[..1024 + 100]);
    // Between two members.
    set.put("cut-between.tar", &whole[..1024]);
    // A checksum that is wrong.
    let mut damaged = whole.clone();
    damaged[1024] ^= 1;
    set.put("damaged.tar", damaged);
    // A size that runs out of every file, and one that overflows.
    for (file, size) in [("huge.tar", u64::MAX >> 1), ("overflow.tar", u64::MAX)] {
        let mut tar = shard(&[("a.mp4", b"1")])[..1024].to_vec();
        let mut lie = header(EntryType::Regular, size);
        lie.set_path("lie.mp4").unwrap();
        lie.set_cksum();
        tar.extend(lie.as_bytes());
        set.put(file, tar);
    }
    // A name of a gigabyte that is really there, as far as a sparse file is.
    let mut tar = shard(&[("a.mp4", b"1")])[..1024].to_vec();
    let mut name = header(EntryType::GNULongName, 1 << 30);
    name.set_path("././@LongLink").unwrap();
    name.set_cksum();
    tar.extend(name.as_bytes());
    let path = set.put("name.tar", tar);
    let file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
    file.set_len(2 << 30).unwrap();
    // Links, directories and devices are no videos; neither is a name that leads elsewhere a path.
    let mut tar = Builder::new(Vec::new());
    for kind in [
        EntryType::Symlink,
        EntryType::Link,
        EntryType::Directory,
        EntryType::Block,
    ] {
        let mut link = header(kind, 0);
        link.set_link_name("/etc/passwd").unwrap();
        tar.append_data(&mut link, "link.mp4", &b""[..]).unwrap();
    }
    let mut up = header(EntryType::Regular, 3);
    up.as_gnu_mut().unwrap().name[..18].copy_from_slice(b"../../etc/evil.mp4");
    up.set_cksum();
    tar.append(&up, &b"abc"[..]).unwrap();
    set.put("links.tar", tar.into_inner().unwrap());
    // In pieces.
    let mut sparse = header(EntryType::GNUSparse, 0);
    sparse.set_path("s.mp4").unwrap();
    sparse.as_gnu_mut().unwrap().realsize = *b"00000000000\0";
    sparse.set_cksum();
    set.put("sparse.tar", sparse.as_bytes());
    let mut tar = Builder::new(Vec::new());
    tar.append_pax_extensions([("GNU.sparse.major", &b"1"[..])])
        .unwrap();
    let mut pieces = header(EntryType::Regular, 4);
    tar.append_data(&mut pieces, "p.mp4", &b"map!"[..]).unwrap();
    set.put("pax.tar", tar.into_inner().unwrap());
    set.put("noise.tar", [7; 3000]);
    set.put("empty.tar", b"");

    let listing = set.all().await;
    for (video, said) in [
        ("cut.tar/b.mp4", "ends within this member"),
        ("cut-header.tar", "does not read to its end"),
        ("cut-between.tar", "lacks the zeros"),
        ("damaged.tar", "checksum"),
        ("huge.tar/lie.mp4", "ends within this member"),
        ("overflow.tar", "does not read to its end"),
        ("name.tar", "a header of more than"),
        ("sparse.tar/s.mp4", "without --sparse"),
        ("pax.tar/p.mp4", "without --sparse"),
        ("noise.tar", "does not read to its end"),
    ] {
        assert!(
            problem(&listing, video).contains(said),
            "{video}: {:?}",
            problem(&listing, video)
        );
        assert_eq!(entry(&listing, video).bytes, None);
    }
    for video in [
        "cut.tar/a.mp4",
        "cut-header.tar/a.mp4",
        "damaged.tar/a.mp4",
        "overflow.tar/a.mp4",
    ] {
        assert_eq!(content(entry(&listing, video)), b"1", "{video}");
    }
    assert_eq!(
        content(entry(&listing, "links.tar/../../etc/evil.mp4")),
        b"abc"
    );
    let all = names(&listing);
    assert!(
        !all.iter()
            .any(|name| name.contains("link.mp4") || name.starts_with("empty.tar")),
        "{all:?}"
    );
}

#[tokio::test]
async fn a_member_that_stands_in_a_shard_twice_is_refused() {
    let set = Set::new();
    set.put("a.tar", shard(&[("x.mp4", b"1"), ("x.mp4", b"2")]));
    assert!(set.refused().await.contains("a.tar/x.mp4: named twice"));
}

// --- Hugging Face folders ---

#[tokio::test]
async fn metadata_gives_the_files_of_its_folder_their_columns() {
    let set = Set::new();
    for video in [
        "train/a.mp4",
        "train/sub/b.mp4",
        "train/c.mp4",
        "test/a.mp4",
        "extra/l.mp4",
        "extra/r.mp4",
    ] {
        set.put(video, b"x");
    }
    set.put(
        "train/metadata.csv",
        "file_name,prompt,seed\na.mp4,pick,1\n./sub/b.mp4,push,2\ngone.mp4,pick,3\n",
    );
    set.put(
        "test/metadata.jsonl",
        "{\"file_name\": \"a.mp4\", \"prompt\": \"reach\", \"seed\": 4}\n",
    );
    let pairs = "{\"left_file_name\": \"l.mp4\", \"others_file_names\": [\"r.mp4\", \"note.txt\"], \"seed\": 5}\n";
    set.put("extra/metadata.jsonl", pairs);
    // Metadata of something else.
    set.put("other/metadata.csv", "a,b\n1,2\n");
    let listing = set.all().await;
    assert_eq!(
        names(&listing),
        [
            "extra/l.mp4",
            "extra/r.mp4",
            "test/a.mp4",
            "train/a.mp4",
            "train/c.mp4",
            "train/gone.mp4",
            "train/sub/b.mp4"
        ]
    );
    assert_eq!(listing.ignored, BTreeMap::from([("csv".to_owned(), 1)]));
    assert_eq!(entry(&listing, "train/sub/b.mp4").carried["prompt"], "push");
    assert_eq!(entry(&listing, "train/a.mp4").carried["seed"], "1");
    assert_eq!(entry(&listing, "test/a.mp4").carried["seed"], 4);
    assert_eq!(
        entry(&listing, "extra/r.mp4").carried["left_file_name"],
        "l.mp4"
    );
    assert!(entry(&listing, "train/c.mp4").carried.is_empty());
    assert!(
        !entry(&listing, "train/a.mp4")
            .carried
            .contains_key("file_name")
    );
    assert!(!problem(&listing, "train/gone.mp4").is_empty());

    // The nearer metadata counts.
    set.put(
        "metadata.csv",
        "file_name,prompt\ntrain/a.mp4,far\ntrain/c.mp4,far\n",
    );
    let listing = set.all().await;
    assert_eq!(entry(&listing, "train/a.mp4").carried["prompt"], "pick");
    assert_eq!(entry(&listing, "train/c.mp4").carried["prompt"], "far");
    for (content, said) in [
        ("file_name\n../outside.mp4\n", "leads out of the folder"),
        ("file_name\n/etc/x.mp4\n", "leads out of the folder"),
        ("file_name\ntrain/a.mp4\n./train/a.mp4\n", "twice"),
        ("file_name,x\ntrain/a.mp4\n", "mend it or rename it"),
    ] {
        set.put("metadata.csv", content);
        let refused = set.refused().await;
        assert!(
            refused.contains(said) && refused.contains("metadata.csv"),
            "{refused}"
        );
    }
}

// --- LeRobot ---

const TOP: &str = "observation.images.top";
const WRIST: &str = "observation.images.wrist";

fn info(version: &str) -> Value {
    json!({
        "codebase_version": version,
        "fps": 10,
        "total_episodes": 3,
        "chunks_size": 2,
        "features": {
            TOP: {"dtype": "video", "shape": [48, 64, 3]},
            WRIST: {"dtype": "video", "shape": [48, 64, 3], "info": {"video.is_depth_map": false}},
            "observation.images.depth": {"dtype": "video", "info": {"is_depth_map": true}},
            "action": {"dtype": "float32", "shape": [6]}
        }
    })
}

fn v2() -> Set {
    let set = Set::new();
    set.put("meta/info.json", info("v2.1").to_string());
    let mut lines = String::new();
    for (episode, length) in [(2, 7), (0, 4), (1, 5)] {
        let line = json!({"episode_index": episode, "tasks": ["pick", "place"], "length": length});
        lines.push_str(&format!("{line}\n"));
        for camera in [TOP, WRIST] {
            let chunk = episode / 2;
            set.put(
                &format!("videos/chunk-{chunk:03}/{camera}/episode_{episode:06}.mp4"),
                b"x",
            );
        }
    }
    set.put("meta/episodes.jsonl", lines);
    set.put("data/chunk-000/episode_000000.parquet", b"unread");
    set
}

#[tokio::test]
async fn episodes_of_v2_are_files() {
    let set = v2();
    set.remove(&format!("videos/chunk-000/{WRIST}/episode_000001.mp4"));
    let listing = set.all().await;
    assert_eq!(names(&listing).len(), 6);
    assert_eq!(
        names(&listing)[4..],
        [
            format!("episode_000002/{TOP}"),
            format!("episode_000002/{WRIST}")
        ]
    );
    assert!(listing.ignored.is_empty());
    let last = entry(&listing, &format!("episode_000002/{WRIST}"));
    assert_eq!(
        Value::Object(last.carried.clone()),
        json!({"episode_index": 2, "dataset_from_index": 9, "length": 7, "task": "pick; place", "camera": WRIST})
    );
    assert!(
        last.address()
            .ends_with(&format!("videos/chunk-001/{WRIST}/episode_000002.mp4"))
    );
    assert_eq!(last.location.part(), None);
    // An episode without its video is a row.
    assert!(!problem(&listing, &format!("episode_000001/{WRIST}")).is_empty());

    let of = |cameras: &[&str]| Choice {
        cameras: cameras.iter().map(|&camera| camera.to_owned()).collect(),
        ..Choice::default()
    };
    let wrist = set.freeze("", &of(&[WRIST])).await.unwrap();
    assert_eq!(
        names(&wrist),
        (0..3)
            .map(|e| format!("episode_{e:06}/{WRIST}"))
            .collect::<Vec<_>>()
    );
    let unknown = set
        .freeze("", &of(&[TOP, "wrist"]))
        .await
        .unwrap_err()
        .to_string();
    assert!(unknown.contains(&format!("{TOP}, {WRIST}")), "{unknown}");
}

#[tokio::test]
async fn what_is_wrong_with_the_metadata_is_told_with_its_file() {
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut info = info("v2.1");
        change(&mut info);
        info.to_string()
    };
    let features = |features: Value| changed(&move |info| info["features"] = features.clone());
    for (file, content, said) in [
        (
            "meta/info.json",
            changed(&|info| info["codebase_version"] = json!("v1.6")),
            "codebase_version 1.6 is not read",
        ),
        (
            "meta/info.json",
            changed(&|info| info["codebase_version"] = json!("v4.0")),
            "convert the dataset",
        ),
        (
            "meta/info.json",
            changed(&|info| info["fps"] = json!(0)),
            "fps is 0",
        ),
        (
            "meta/info.json",
            changed(&|info| info["fps"] = json!("ten")),
            "copy the dataset again",
        ),
        (
            "meta/info.json",
            changed(&|info| info["total_episodes"] = json!(4)),
            "declares 4",
        ),
        (
            "meta/info.json",
            features(json!({"a": {"dtype": "image"}})),
            "convert it to videos",
        ),
        (
            "meta/info.json",
            features(json!({"a": {"dtype": "float32"}})),
            "nothing to score",
        ),
        (
            "meta/episodes.jsonl",
            "{\"tasks\": []}\n".to_owned(),
            "no episode_index",
        ),
        ("meta/episodes.jsonl", "nonsense".to_owned(), "line 1"),
        (
            "meta/episodes.jsonl",
            "{\"episode_index\":1}\n{\"episode_index\":1}\n".to_owned(),
            "episode 1 twice",
        ),
    ] {
        let set = v2();
        set.put(file, content);
        let refused = set.refused().await;
        assert!(
            refused.contains("/meta/") && refused.contains(said),
            "{said}: {refused}"
        );
    }
    let set = v2();
    set.remove("meta/episodes.jsonl");
    assert!(
        set.refused()
            .await
            .contains("meta/episodes.jsonl: is missing")
    );
    // Another program's info.json is none of ours.
    let set = Set::new();
    set.put("meta/info.json", "{\"name\": 1}");
    set.put("a.mp4", b"x");
    assert_eq!(names(&set.all().await), ["a.mp4"]);

    for (path, said) in [
        ("/etc/{episode_index}.mp4", "outside of the dataset"),
        ("../{video_key}.mp4", "outside of the dataset"),
        ("{nothing}.mp4", "nothing says the nothing"),
        ("{episode_index!r}.mp4", "nothing says"),
    ] {
        let set = v2();
        set.put(
            "meta/info.json",
            changed(&|info| info["video_path"] = json!(path)),
        );
        let listing = set.all().await;
        assert_eq!(listing.entries.len(), 6);
        assert!(
            problem(&listing, &format!("episode_000000/{TOP}")).contains(said),
            "{path}"
        );
    }
}

/// Writes rows as the Parquet file that they are.
fn parquet(rows: &[Value]) -> Vec<u8> {
    use arrow_json::reader::{ReaderBuilder, infer_json_schema_from_iterator};
    let schema =
        infer_json_schema_from_iterator(rows.iter().map(Ok::<_, arrow_schema::ArrowError>));
    let schema = Arc::new(schema.unwrap());
    let mut decoder = ReaderBuilder::new(Arc::clone(&schema))
        .build_decoder()
        .unwrap();
    decoder.serialize(rows).unwrap();
    let batch = decoder.flush().unwrap().unwrap();
    let mut out = Vec::new();
    let mut writer = parquet::arrow::ArrowWriter::try_new(&mut out, schema, None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    out
}

fn episode_v3(episode: u64, file: u64, from_s: f64, to_s: f64) -> Value {
    let mut row = json!({
        "episode_index": episode,
        "tasks": ["pick"],
        "length": 5,
        "dataset_from_index": 5 * episode,
        "dataset_to_index": 5 * episode + 5,
        "stats/action/min": [0.5],
    });
    for camera in [TOP, WRIST] {
        row[format!("videos/{camera}/chunk_index")] = json!(0);
        row[format!("videos/{camera}/file_index")] = json!(file);
        row[format!("videos/{camera}/from_timestamp")] = json!(from_s);
        row[format!("videos/{camera}/to_timestamp")] = json!(to_s);
    }
    row
}

#[tokio::test]
async fn episodes_of_v3_are_parts_of_files() {
    let set = Set::new();
    set.put("sets/one/meta/info.json", info("v3.0").to_string());
    let episodes = |rows: &[Value]| parquet(rows);
    set.put(
        "sets/one/meta/episodes/chunk-000/file-000.parquet",
        episodes(&[episode_v3(0, 0, 0.0, 0.5), episode_v3(1, 0, 0.5, 1.0)]),
    );
    set.put(
        "sets/one/meta/episodes/chunk-000/file-001.parquet",
        episodes(&[episode_v3(2, 1, 0.7, 0.7)]),
    );
    for camera in [TOP, WRIST] {
        set.put(
            &format!("sets/one/videos/{camera}/chunk-000/file-000.mp4"),
            b"xyz",
        );
    }
    set.put(
        &format!("sets/one/videos/{WRIST}/chunk-000/file-001.mp4"),
        b"x",
    );
    set.put("beside.mp4", b"x");
    let listing = set.all().await;
    assert_eq!(listing.entries.len(), 7, "{:?}", names(&listing));
    let second = entry(&listing, &format!("sets/one/episode_000001/{TOP}"));
    assert_eq!(
        second.location.part(),
        Some(Part::Interval {
            from_ns: 450_000_000,
            to_ns: 950_000_000
        })
    );
    assert_eq!(
        (second.bytes, &second.carried["dataset_from_index"]),
        (Some(3), &json!(5))
    );
    let first = entry(&listing, &format!("sets/one/episode_000000/{TOP}"));
    assert!(matches!(
        first.location.part(),
        Some(Part::Interval {
            from_ns: -50_000_000,
            ..
        })
    ));
    assert!(
        problem(&listing, &format!("sets/one/episode_000002/{WRIST}")).contains("which is nothing")
    );
    assert_eq!(entry(&listing, "beside.mp4").carried, Map::new());

    // Its name begins at the source.
    let one = set.freeze("sets/one", &Choice::default()).await.unwrap();
    assert_eq!(names(&one)[0], format!("episode_000000/{TOP}"));
    // A second dataset has the same numbers.
    set.put("sets/two/meta/info.json", info("v3.0").to_string());
    set.put(
        "sets/two/meta/episodes/chunk-000/file-000.parquet",
        episodes(&[0, 1, 2].map(|e| episode_v3(e, 0, 0.0, 0.5))),
    );
    assert!(set.refused().await.contains("score each by itself"));
    set.put(
        "sets/two/meta/episodes/chunk-000/file-000.parquet",
        b"no parquet",
    );
    assert!(set.refused().await.contains("copy the dataset again"));
    set.remove("sets/two/meta/episodes/chunk-000/file-000.parquet");
    assert!(set.refused().await.contains("meta/episodes/: is missing"));
}
