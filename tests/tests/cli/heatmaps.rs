//! `score --heatmaps K`: pictures beside the report, and nothing else changed.

use std::collections::BTreeMap;

use plumbline_tests::run::Place;

/// The pictures of a run, by path below OUT.
fn pictures(place: &Place, out: &str) -> BTreeMap<String, Vec<u8>> {
    let Ok(entries) = std::fs::read_dir(place.path(out).join("heatmaps")) else {
        return BTreeMap::new();
    };
    let entries = entries.map(Result::unwrap);
    entries
        .map(|entry| {
            let name = entry.file_name().into_string().unwrap();
            (
                format!("heatmaps/{name}"),
                std::fs::read(entry.path()).unwrap(),
            )
        })
        .collect()
}

#[test]
fn the_worst_videos_get_pictures_and_every_table_stays_the_same() {
    let place = Place::with_clips(5);
    place.run("plain", &[]).expect_code(0);
    place
        .run("drawn", &["--heatmaps", "2"])
        .expect_code(0)
        .expect_line(&["drawing 2 heat maps"]);
    let drawn = pictures(&place, "drawn");
    assert_eq!(drawn.len(), 2, "{:?}", drawn.keys());
    assert!(pictures(&place, "plain").is_empty());
    let stable = place.published("drawn").stable_files();
    assert_eq!(place.published("plain").stable_files(), stable);

    // Of the two highest ranks, linked by name; everything that the page shows itself is inside it.
    let report = std::fs::read_to_string(place.path("drawn/report.html")).unwrap();
    let rows = place.published("drawn").rows();
    for row in &rows {
        let name = row["video"].as_str().unwrap().replace('.', "_");
        let of_it = |file: &&String| file.contains(&name);
        let file = drawn.keys().find(of_it);
        assert_eq!(file.is_some(), row["rank"].as_u64().unwrap() > 3, "{name}");
        assert_eq!(
            file.is_some(),
            file.is_some_and(|file| report.contains(&format!("href=\"{file}\"")))
        );
    }
    assert_eq!(
        report.matches(" src=\"").count(),
        report.matches(" src=\"data:").count()
    );
    for bytes in drawn.values() {
        assert!(image::load_from_memory(bytes).unwrap().width() > 640);
    }

    // Taken over by the next run, made again where it is gone, removed where it is not asked for.
    let ended = place.run("drawn", &["--heatmaps", "2"]).expect_code(0);
    assert!(!ended.stderr.contains("drawing"), "{}", ended.stderr);
    let gone = drawn.keys().next().unwrap();
    std::fs::remove_file(place.path("drawn").join(gone)).unwrap();
    std::fs::write(place.path("drawn/heatmaps/mine.png"), "mine").unwrap();
    place
        .run("drawn", &["--heatmaps", "2"])
        .expect_code(0)
        .expect_line(&["drawing 1 heat maps"])
        .expect_line(&["0 measured now"]);
    let mut again = pictures(&place, "drawn");
    assert!(again.remove("heatmaps/mine.png").is_some());
    assert_eq!(again, drawn);
    place.run("drawn", &[]).expect_code(0);
    let left: Vec<String> = pictures(&place, "drawn").into_keys().collect();
    assert_eq!(left, ["heatmaps/mine.png"]);
}
