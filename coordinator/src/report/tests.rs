//! The page as a whole: it renders whatever the corpus, escapes every text, stays bounded, asks
//! for nothing from outside.

use plumbline_common::row::{Cost, Row};

use super::fixture::{corpus_of, hostile, rollouts, thumbnails};
use super::*;
use crate::reduce::outcome::Recipe;

fn page(title: &str, rows: Vec<Row>, recipe: Recipe, warnings: &[&str]) -> String {
    page_beside(title, rows, recipe, warnings, &BTreeMap::new())
}

fn page_beside(
    title: &str,
    mut rows: Vec<Row>,
    recipe: Recipe,
    warnings: &[&str],
    beside: &BesideReport,
) -> String {
    let mut corpus = corpus_of(&mut rows, recipe);
    corpus.statistics.warnings = warnings.iter().map(|&text| text.to_owned()).collect();
    let costs = CostSummary::of(&[CostRow {
        video: VideoId::new("a").unwrap(),
        cost: Cost {
            total_s: 4_000.0,
            decode_s: 400.0,
            flow_s: 2_600.0,
            signals_s: 300.0,
            geometry_s: 700.0,
            ..Cost::default()
        },
        attempts: 2,
        worker: "w".to_owned(),
        rung: None,
    }]);
    render(&ReportInput {
        title,
        corpus: &corpus,
        rows: &rows,
        thumbnails: &thumbnails,
        heat_maps: &BTreeMap::new(),
        beside,
        player: &|_| None,
        reference: None,
        costs: Some(costs),
        options: &[("--group-by".to_owned(), "path:1".to_owned())],
        ranked: DEFAULT_RANKED,
    })
}

const WARNINGS: [&str; 2] = [
    "The entropy weights are fragile: reproj_px weighs 0.52 as used, but 0.61 with Freedman-Diaconis bins.",
    "6 videos have too little motion to judge and are left out.",
];

/// Not a check: writes pages to look at, below the system's temporary directory.
#[test]
#[ignore = "writes pages for the eye"]
fn pages_to_look_at() {
    let folder = std::env::temp_dir().join("report_dev");
    std::fs::create_dir_all(&folder).unwrap();
    let put = |name: &str, html: String| std::fs::write(folder.join(name), html).unwrap();
    put(
        "usual.html",
        page(
            "rollouts/2026-05",
            rollouts(640, 6),
            Recipe::Paper,
            &WARNINGS,
        ),
    );
    let mut rows = rollouts(120, 3);
    hostile(&mut rows);
    put(
        "hostile.html",
        page(
            "<script>\u{202e}x</script>",
            rows,
            Recipe::Balanced,
            &["<b>w</b>"],
        ),
    );
    let rows = rollouts(5_000, 40);
    let out = crate::publish::OutDir::create(&folder).unwrap();
    let (beside, _) = beside::write(&out, &rows, &thumbnails).unwrap();
    put(
        "large.html",
        page_beside("s3://rollouts/all", rows, Recipe::Balanced, &[], &beside),
    );
    put(
        "single.html",
        page("one", rollouts(1, 0), Recipe::Paper, &[]),
    );
    put(
        "plain.html",
        page("flat/", rollouts(40, 0), Recipe::Paper, &[]),
    );
    put(
        "empty.html",
        page("nothing/", unscored(), Recipe::Paper, &[]),
    );
}

fn unscored() -> Vec<Row> {
    rollouts(640, 6)
        .into_iter()
        .filter(|row| row.measured.status != Status::Scored)
        .collect()
}

#[test]
fn every_section_is_there_and_equal_input_gives_equal_bytes() {
    let html = page("rollouts", rollouts(640, 6), Recipe::Paper, &WARNINGS);
    for id in [
        "overview",
        "worst",
        "spread",
        "groups",
        "motion",
        "measures",
        "best",
        "table",
        "unscored",
        "provenance",
    ] {
        assert!(html.contains(&format!("<section id=\"{id}\">")), "{id}");
    }
    assert_eq!(html.matches("<article class=\"clip\">").count(), 24);
    assert_eq!(html.matches("data:image/jpeg;base64,").count(), 48);
    assert!(html.contains("Spearman ρ"));
    assert!(html.contains("66.7 min over 1 video"));
    assert!(!html.contains("NaN") && !html.contains(">inf"));
    let again = page("rollouts", rollouts(640, 6), Recipe::Paper, &WARNINGS);
    assert_eq!(html, again);
}

#[test]
fn nothing_scored_still_makes_a_page() {
    for rows in [Vec::new(), unscored()] {
        let listed = rows.len();
        let html = page("nothing", rows, Recipe::Paper, &[]);
        assert!(html.contains("No video has a score"));
        assert!(html.contains("id=\"provenance\""));
        assert!(!html.contains("id=\"groups\"") && !html.contains("<article"));
        assert_eq!(html.contains("moov box is missing"), listed > 0);
    }
}

#[test]
fn one_or_two_videos_are_not_shown_twice() {
    for videos in [1, 2, 3] {
        let html = page("few", rollouts(videos, 1), Recipe::Paper, &[]);
        assert_eq!(html.matches("<article").count(), videos);
    }
}

#[test]
fn hostile_names_are_only_text() {
    let mut rows = rollouts(30, 3);
    hostile(&mut rows);
    let html = page(
        "<script>alert(0)</script>",
        rows,
        Recipe::Paper,
        &["<b>bold</b>"],
    );
    // The page's own data, script and style, and no other.
    assert_eq!(html.matches("<script").count(), 2);
    assert_eq!(html.matches("</script").count(), 2);
    assert_eq!(html.matches("<style").count(), 1);
    assert!(!html.contains("<img src=x") && !html.contains("<b>bold"));
    assert!(html.contains("&lt;script&gt;document.title"));
    assert!(html.contains("line\\nbreak\\tand\\rreturn.mp4"));
    assert!(html.contains("invoice\\u{202e}4pm.exe"));
    assert!(!html.contains('\u{202e}'));
    assert!(html.contains("&amp;lt;b&amp;gt;already"));
    let longest = "very_long_folder_".repeat(8);
    assert!(html.contains("end_of_a_long_name.mp4"));
    let heading = format!(">{longest}");
    assert!(!html.contains(&heading), "long names are shortened");
}

#[test]
fn asks_for_nothing_from_outside() {
    let html = page("rollouts", rollouts(100, 3), Recipe::Paper, &[]);
    assert!(html.contains("default-src &#39;none&#39;") || html.contains("default-src 'none'"));
    for request in ["http://", "https://", "url(", "@import", "<link", "<iframe"] {
        assert!(!html.contains(request), "{request}");
    }
    let sources = html.matches(" src=\"").count();
    assert_eq!(
        sources,
        html.matches(" src=\"data:image/jpeg;base64,").count()
    );
}

#[test]
fn ten_thousand_rows_stay_below_ten_megabytes() {
    let html = page("large", rollouts(10_000, 40), Recipe::Paper, &[]);
    assert!(html.len() < 10_000_000, "{} bytes", html.len());
    assert!(html.contains("The 5,000 of 10,000 videos with the highest anomaly scores"));
    assert!(html.contains("The 24 largest of 40 groups"));
}

#[test]
fn a_picture_that_is_too_large_is_left_out() {
    let mut rows = rollouts(2, 1);
    let corpus = corpus_of(&mut rows, Recipe::Paper);
    let html = render(&ReportInput {
        title: "large pictures",
        corpus: &corpus,
        rows: &rows,
        heat_maps: &BTreeMap::new(),
        beside: &BTreeMap::new(),
        player: &|_| None,
        reference: None,
        thumbnails: &|_| {
            Some(Thumbnails {
                frame_jpeg: vec![0; 10 << 20],
                heat_jpeg: Vec::new(),
            })
        },
        costs: None,
        options: &[],
        ranked: DEFAULT_RANKED,
    });
    assert!(html.len() < 200_000, "{} bytes", html.len());
    assert!(html.contains("<article") && !html.contains("<img"));
}

#[test]
fn extreme_scores_draw_finite_figures() {
    let mut rows = rollouts(60, 2);
    for (row, value) in rows
        .iter_mut()
        .zip([1e300, -1e300, 1.7e308, -1.7e308, 5e-324])
    {
        row.anomaly = Some(value);
        row.anomaly_lo = Some(value);
        row.anomaly_hi = Some(value);
        row.measured.motion_px = Some(value.abs());
        row.measured.series.reproj_px = vec![Some(value.abs()); 3];
    }
    let html = page("extremes", rows, Recipe::Paper, &[]);
    assert!(!html.contains("NaN") && !html.contains(" inf") && !html.contains("\"inf"));
}
