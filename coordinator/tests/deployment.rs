//! Dashboard and alerts ask for what the programs export, under names and labels that they use.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeSet;
use std::path::Path;

use plumbline_coordinator::metrics::Metrics as RunMetrics;
use plumbline_worker::fleet::Metrics as WorkerMetrics;
use prometheus_client::encoding::text;
use prometheus_client::registry::Registry;

/// Names of the series that both programs export.
fn exported() -> BTreeSet<String> {
    let mut registry = Registry::default();
    RunMetrics::default().register(&mut registry, true);
    WorkerMetrics::default().register(&mut registry);
    let mut shown = String::new();
    text::encode(&mut shown, &registry).unwrap();
    let types = shown
        .lines()
        .filter_map(|line| line.strip_prefix("# TYPE "));
    types
        .flat_map(|line| {
            let (name, kind) = line.split_once(' ').unwrap();
            let ends: &[&str] = match kind {
                "counter" => &["_total"],
                "gauge" => &[""],
                "histogram" => &["_bucket", "_sum", "_count"],
                other => panic!("{name} is a {other}"),
            };
            ends.iter().map(move |end| format!("{name}{end}"))
        })
        .collect()
}

fn asked_for(file: &str) -> BTreeSet<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../deploy")
        .join(file);
    let text = std::fs::read_to_string(path).unwrap();
    let words = text.split(|letter: char| !(letter.is_ascii_alphanumeric() || letter == '_'));
    words
        .filter(|word| word.starts_with("plumbline_"))
        .map(str::to_owned)
        .collect()
}

#[test]
fn dashboard_and_alerts_ask_for_what_is_exported() {
    let exported = exported();
    for file in [
        "grafana/plumbline.json",
        "prometheus/alerts.yaml",
        "prometheus/alerts.test.yaml",
    ] {
        let asked_for = asked_for(file);
        assert!(asked_for.len() > 5, "{file}: {asked_for:?}");
        let missing: Vec<_> = asked_for.difference(&exported).collect();
        assert!(missing.is_empty(), "{file}: {missing:?} are not exported");
    }
    // What nobody looks at is not worth exporting.
    let unseen: Vec<_> = exported
        .difference(&asked_for("grafana/plumbline.json"))
        .cloned()
        .collect();
    assert!(unseen.is_empty(), "the dashboard leaves out {unseen:?}");
}
