//! Points side by side: fronts, the recommendation and the sentence, the page and the columns.

use std::collections::{BTreeMap, BTreeSet};

use super::judge::recommend;
use super::*;
use crate::agreement::Flips;

/// A point of this cost, order and number of flips among 50 videos; its run of 1000 takes `wall_s`.
fn point(name: &str, cpu_s: f64, spearman: f64, flips: u64, wall_s: f64) -> PointResult {
    PointResult {
        name: name.to_owned(),
        profile: format!("profiles/{name}.toml"),
        profile_digest: "0".repeat(64),
        top: spearman == 1.0,
        working_height_px: 256,
        finest_scale: 1,
        edge_spans: vec![1, 2],
        scored: 50,
        cpu_s_per_video: cpu_s,
        relative_cost: cpu_s / 10.0,
        stages_s: Stages::default(),
        on_front: true,
        agreement: Agreement {
            videos: 50,
            spearman: Some(spearman),
            kendall: Some(spearman),
            score_error_median: Some(0.1),
            score_error_p95: Some(0.2),
            flips: Flips {
                videos: 50,
                keep_to_drop: flips,
                ..Flips::default()
            },
            flips_within_interval: 0,
            spearman_by_signal: BTreeMap::new(),
        },
        spearman_by_recipe: BTreeMap::new(),
        auroc_failure: None,
        truth: None,
        faults: None,
        cost_model: None,
        plan: Some(Plan {
            cpu_s: 4.0 * wall_s,
            cpu_interval_90_s: (3.6 * wall_s, 4.4 * wall_s),
            wall_s,
            wall_interval_90_s: (0.9 * wall_s, 1.1 * wall_s),
        }),
    }
}

fn found(hours: f64) -> Tradeoff {
    let points = vec![
        point("low", 1.0, 0.8, 9, 3600.0),
        point("middle", 3.0, 0.95, 3, 3.0 * 3600.0),
        point("high", 10.0, 1.0, 0, 10.0 * 3600.0),
    ];
    let question = Question {
        videos: 1000,
        shape: None,
        cores: 4,
        hours,
    };
    let recommended = recommend(&points, &question).map(|point| point.name.clone());
    Tradeoff {
        source: vec!["videos".to_owned()],
        corpus_videos: 80,
        sample: vec!["a.mp4".to_owned(); 50],
        recipe: Recipe::Balanced,
        keep: "80%".to_owned(),
        top_uncertain: 7,
        question,
        waiting: 1.0,
        points,
        recommended,
    }
}

#[test]
fn the_best_point_that_is_done_in_time_is_recommended() {
    let told = |hours| sentence(&found(hours));
    // 1.1 · 3 h is more than 3.2 h.
    assert_eq!(found(3.2).recommended.as_deref(), Some("low"));
    assert_eq!(found(3.4).recommended.as_deref(), Some("middle"));
    assert_eq!(found(12.0).recommended.as_deref(), Some("high"));
    assert_eq!(found(0.5).recommended, None);
    let middle = told(3.4);
    // 3 of 50 is 60 of 1000; Wilson's 90% interval is 2.4% to 14%.
    assert!(
        middle.starts_with(
            "for 1,000 videos, 4 cores and 3.4 hours use profiles/middle.toml; expect 60 flips (2"
        ),
        "{middle}"
    );
    assert!(middle.contains("3.0 h (2.7 h to 3.3 h)"), "{middle}");
    assert!(told(12.0).contains("no flips"));
    assert!(told(0.5).contains("the cheapest, profiles/low.toml, takes about 60 min"));
}

#[test]
fn a_point_off_the_front_is_not_recommended() {
    let mut points = found(12.0).points;
    points[2].on_front = false;
    let question = found(12.0).question;
    assert_eq!(recommend(&points, &question).unwrap().name, "middle");
}

#[test]
fn every_column_has_a_name_of_its_own_and_every_signal_one() {
    let columns = document::columns();
    let names: BTreeSet<_> = columns.iter().map(|column| &column.name).collect();
    assert_eq!(names.len(), columns.len());
    let mut point = point("low", 1.0, 0.8, 9, 60.0);
    for (k, signal) in reduce::recipe::Signal::ALL.into_iter().enumerate() {
        let by_signal = &mut point.agreement.spearman_by_signal;
        by_signal.insert(signal.column(), Some(k as f64));
        let name = format!("spearman_{}", signal.column());
        let column = columns.iter().find(|column| column.name == name).unwrap();
        assert_eq!(column.cell(&point), (k as f64).into(), "{name}");
    }
}

#[test]
fn the_page_escapes_names_and_loads_nothing() {
    let mut found = found(12.0);
    let hostile = "<script>alert(1)</script>\u{202e}\"'&";
    found.source = vec![hostile.to_owned()];
    found.keep = hostile.to_owned();
    for point in &mut found.points {
        point.name = hostile.to_owned();
        point.profile = hostile.to_owned();
    }
    found.recommended = Some(hostile.to_owned());
    let page = page::render(&found);
    assert!(!page.contains("<script>alert") && !page.contains('\u{202e}'));
    // The page's own script is the only one.
    assert_eq!(page.matches("<script").count(), 1);
    for loading in ["http:", "https:", "src=\"", "url("] {
        assert!(!page.contains(loading), "{loading}");
    }
    assert!(page.contains("default-src 'none'"));
    assert_eq!(page, page::render(&found));
}
