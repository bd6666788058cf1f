//! Sources that are files of this machine.

use super::*;
use std::fs;

fn names(listing: &Listing) -> Vec<&str> {
    listing
        .entries
        .iter()
        .map(|entry| entry.video.as_str())
        .collect()
}

fn touch(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, b"x").unwrap();
}

fn freeze_all(sources: &[&Path], out: &Path) -> Result<Listing, CorpusError> {
    let sources: Vec<String> = sources
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    freeze(&sources, &Choice::default(), out)
}

#[test]
fn a_directory_is_walked_sorted_and_without_out_or_hidden_files() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    for name in [
        "b.mp4",
        "a/c d.MOV",
        "a/.hidden.mp4",
        "out/x.mp4",
        "notes.txt",
        "a/ü\n.webm",
        "-x.gif",
    ] {
        touch(&root.join(name));
    }
    let listing = freeze_all(&[root], &root.join("out")).unwrap();
    assert_eq!(
        names(&listing),
        ["-x.gif", "a/c d.MOV", "a/ü\n.webm", "b.mp4"]
    );
    assert_eq!(listing.ignored, BTreeMap::from([("txt".to_owned(), 1)]));
}

#[test]
fn names_that_are_not_utf8_are_percent_encoded() {
    let dir = tempfile::tempdir().unwrap();
    touch(&dir.path().join(OsStr::from_bytes(b"a\xff.mp4")));
    let listing = freeze_all(&[dir.path()], Path::new("out")).unwrap();
    assert_eq!(names(&listing), ["a%FF.mp4"]);
}

#[test]
fn several_sources_share_their_parent_and_overlaps_count_once() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["real/a.mp4", "generated/a.mp4"] {
        touch(&dir.path().join(name));
    }
    let (real, generated) = (dir.path().join("real"), dir.path().join("generated"));
    let listing = freeze_all(&[&real, &generated, &real.join("a.mp4")], Path::new("out")).unwrap();
    assert_eq!(names(&listing), ["generated/a.mp4", "real/a.mp4"]);
}

#[test]
fn globs_take_what_they_match() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["x/a.mp4", "x/b.mp4", "y/c.bin"] {
        touch(&dir.path().join(name));
    }
    let listing = freeze_all(&[&dir.path().join("*/[ac].*")], Path::new("out")).unwrap();
    assert_eq!(names(&listing), ["x/a.mp4", "y/c.bin"]);
}

#[test]
fn a_list_keeps_missing_videos_as_rows_and_refuses_duplicates() {
    let dir = tempfile::tempdir().unwrap();
    touch(&dir.path().join("a.mp4"));
    let list = dir.path().join("list.txt");
    fs::write(&list, "./a.mp4\nmissing.mp4\n").unwrap();
    let listing = freeze_all(&[&list], Path::new("out")).unwrap();
    assert_eq!(names(&listing), ["a.mp4", "missing.mp4"]);
    assert!(listing.entries[0].problem.is_none());
    assert!(listing.entries[1].problem.is_some());
    fs::write(&list, "a.mp4\n./a.mp4\n").unwrap();
    assert!(
        freeze_all(&[&list], Path::new("out"))
            .unwrap_err()
            .to_string()
            .contains("twice")
    );
}

#[test]
fn nothing_there_is_an_error_that_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let empty = freeze_all(&[dir.path()], Path::new("out")).unwrap_err();
    assert!(matches!(empty, CorpusError::Empty { .. }));
    let missing = freeze_all(&[&dir.path().join("nope")], Path::new("out")).unwrap_err();
    assert!(missing.to_string().contains("nope"), "{missing}");
}
